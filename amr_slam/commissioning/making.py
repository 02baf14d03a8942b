"""The whole report as values: everything that page and JSON tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from amr_slam.commissioning.cold_starts import ColdStarts, cold_starts
from amr_slam.commissioning.coverage import Coverage, coverage
from amr_slam.commissioning.look_alikes import Pair, pairs
from amr_slam.commissioning.places import reachable
from amr_slam.commissioning.precision import Precision, precision
from amr_slam.commissioning.settings import ReportParams
from amr_slam.commissioning.suggestions import (
    Altogether,
    Anchor,
    Resolution,
    Trials,
    anchor,
    resolutions,
)
from amr_slam.commissioning.viewing import Eye
from amr_slam.map import PointMap
from amr_slam.params import SlamParams

Say = Callable[[str, float | None], None]
"""Told the step that is under way, and the share of it that is done where that is known."""

# Areas of a pair are about as large as a room.
_LEAST_REACH_M = 4.0


class ReportError(Exception):
    """The map has no floor on which a robot could stand."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Report:
    """What was found out about a map."""

    known: PointMap
    eyes: tuple[Eye, ...]
    slam: SlamParams
    params: ReportParams
    coverage: Coverage
    precision: Precision
    starts: ColdStarts
    pairs: tuple[Pair, ...]
    resolutions: tuple[Resolution, ...]
    """Of the first pairs."""
    together: Altogether | None
    """All boxes of these; None where there are none."""
    anchors: tuple[Anchor, ...]


def make_report(
    known: PointMap, eyes: Sequence[Eye], slam: SlamParams, params: ReportParams, say: Say
) -> Report:
    """Some minutes for a large hall. The same map and parameters give the same report.

    Raises ReportError.
    """
    say("floor", None)
    places = reachable(known, slam)
    if not len(places):
        raise ReportError("no floor was seen free on which the robot fits")
    covered = coverage(known, places, slam.grid_m, params.seen_often)
    say("expected error", None)
    exact = precision(known.target(), eyes, places, slam, params)
    say("cold starts", None)
    started = cold_starts(
        known, eyes, places, slam, params, lambda share: say("cold starts", share)
    )
    alike = pairs(started.tried, max(_LEAST_REACH_M, 1.6 * started.spacing_m))
    trials = Trials(
        known=known, eyes=eyes, slam=slam, params=params, say=lambda text: say(text, None)
    )
    resolved, together = resolutions(trials, alike)
    return Report(
        known=known,
        eyes=tuple(eyes),
        slam=slam,
        params=params,
        coverage=covered,
        precision=exact,
        starts=started,
        pairs=alike,
        resolutions=resolved,
        together=together,
        anchors=tuple(anchor(trials, exact, weak) for weak in exact.weak[: params.corridors_tried]),
    )
