"""What a pose is worth, in the words of VDA 5050. Never more than its state and errors say."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from amr_slam.encodings.vda5050.settings import Vda5050Settings
from amr_slam.states import State
from amr_slam.wire import UNKNOWN, PoseMessage

_PLACED: Final = frozenset({State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY})
_REASONS: Final = {
    State.STARTING: "no scan has been registered yet",
    State.LOST: "no place in the map fits the scans",
    State.AMBIGUOUS: "a place is not confirmed, or several places fit the scans",
}
_SIGMAS_95: Final = 1.96
"""So many standard deviations of a heading are not exceeded in 95 % of the cases."""
_MAX_TEXT: Final = 500


@dataclass(frozen=True, slots=True, kw_only=True)
class Worth:
    """What a pose is worth."""

    objection: str | None
    """Why x, y and theta cannot be trusted, for people; None where they can."""
    score: float
    """``localizationScore``."""
    deviation_m: float | None
    """``deviationRange``: None where it is not known."""

    @property
    def localized(self) -> bool:
        return self.objection is None


def worth(message: PoseMessage, settings: Vda5050Settings) -> Worth:
    """Trusted where the state has a place, in a map, and the errors of position and heading that
    are not exceeded in 95 % of the cases are within the limits; then the score is the part of the
    position's limit that is left, else 0."""
    objection = _objection(message, settings)
    if objection is not None and message.fault:
        objection = f"{objection}; {message.fault}"
    return Worth(
        objection=None if objection is None else f"{message.state}: {objection}"[:_MAX_TEXT],
        score=1.0 - message.error95_m / settings.trusted_error_m if objection is None else 0.0,
        deviation_m=message.error95_m if message.error95_m < UNKNOWN else None,
    )


def _objection(message: PoseMessage, settings: Vda5050Settings) -> str | None:
    if message.map is None:
        return "there is no map yet"
    if message.state not in _PLACED:
        return _REASONS[message.state]
    if message.error95_m >= UNKNOWN:
        return "the position error is not known"
    if message.error95_m > settings.trusted_error_m:
        limit = f"{settings.trusted_error_m:g} m"
        return f"the position error is up to {message.error95_m:.2f} m, more than {limit}"
    variance = message.covariance[8]
    heading_deg = math.degrees(_SIGMAS_95 * math.sqrt(variance)) if variance >= 0.0 else math.inf
    if heading_deg > settings.trusted_heading_deg:
        limit = f"{settings.trusted_heading_deg:g} deg"
        return f"the heading error is up to {heading_deg:.1f} deg, more than {limit}"
    return None
