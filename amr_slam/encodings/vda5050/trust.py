"""What a pose is worth, in the words of VDA 5050. Never more than its state and error say."""

from __future__ import annotations

from typing import Final

from amr_slam.states import State
from amr_slam.wire import UNKNOWN, PoseMessage

_PLACED: Final = frozenset({State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY})
_REASONS: Final = {
    State.STARTING: "no scan has been registered yet",
    State.LOST: "no place in the map fits the scans",
    State.AMBIGUOUS: "a place is not confirmed, or several places fit the scans",
}
_MAX_TEXT: Final = 500


def is_localized(message: PoseMessage, trusted_error_m: float) -> bool:
    """Whether x, y and theta can be trusted: the state has a place, in a map, and the error that is
    not exceeded in 95 % of the cases is within ``trusted_error_m``."""
    return (
        message.state in _PLACED
        and message.map is not None
        and message.error95_m <= trusted_error_m
    )


def localization_score(message: PoseMessage, trusted_error_m: float) -> float:
    """0 where the pose is not to be trusted, else 1 - error95_m / trusted_error_m."""
    if not is_localized(message, trusted_error_m):
        return 0.0
    return 1.0 - message.error95_m / trusted_error_m


def deviation_range_m(message: PoseMessage) -> float | None:
    """``error95_m``; None where that is not known."""
    return message.error95_m if message.error95_m < UNKNOWN else None


def objection(message: PoseMessage, trusted_error_m: float) -> str | None:
    """Why the pose is not to be trusted, for people; None where it is."""
    if is_localized(message, trusted_error_m):
        return None
    reason = "there is no map yet" if message.map is None else _reason(message, trusted_error_m)
    return f"{message.state}: {reason}{f'; {message.fault}' if message.fault else ''}"[:_MAX_TEXT]


def _reason(message: PoseMessage, trusted_error_m: float) -> str:
    if message.state in _REASONS:
        return _REASONS[message.state]
    deviation_m = deviation_range_m(message)
    if deviation_m is None:
        return "the position error is not known"
    return f"the position error is up to {deviation_m:.2f} m, more than {trusted_error_m:g} m"
