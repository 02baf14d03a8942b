"""The rigid motion from a map's frame to the site's, from pairs of poses.

Estimated together: shift and turn, where the marker sits that the cameras see, by how much their
clock is off. What the drive does not tell is left out and said. Never estimated into the result:
a scale. It is measured beside it, as a camera frame that is wrong by 1 % is a finding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Gt, Interval
from numpy.typing import NDArray

from amr_slam.aligning.consensus import start
from amr_slam.aligning.pairs import AlignError, PosePairs
from amr_slam.aligning.solving import CLOCK, MARKER, SCALE, SHIFT, TURN, YAW, Solved, solve
from amr_slam.geometry import Array, Pose2, wrap_angle

__all__ = ["AlignError", "Fit", "FitParams", "fit_pairs"]

_FEW: Final = 10
"""With fewer pairs than this, a marker's offset would be fitted to their noise."""
_MOST_TURN_SIGMA_RAD: Final = math.radians(0.5)
_MIRROR_FACTOR: Final = 3.0
_LINE_M: Final = 0.3
_LEAST_SCALE: Final = 0.001
_ONE_WAY: Final = 0.99
"""Mean of unit vectors along headings that differ by 8 deg (1 sigma)."""
_NO_MARKER: Final = (
    "where the marker sits on the robot cannot be told from these pairs (too few, or the robot "
    "turns too little): taken to be over the base; what it is off is in the result"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class FitParams:
    """When something counts as told."""

    marker_sigma_m: Annotated[float, Gt(0.0)] = 0.02
    """A marker's offset that is less sure than this is left out."""
    clock_sigma_s: Annotated[float, Gt(0.0)] = 0.02
    """The same for a clock difference."""
    agreeing: Annotated[float, Interval(ge=0.5, le=1.0)] = 0.6
    """So many of the pairs must agree with each other."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """What the pairs say; arrays are row-aligned with them."""

    site_from_map: Pose2
    sigma_m: float
    """Standard deviation of a place in the middle of the pairs, in each direction ..."""
    sigma_rad: float
    """... and of the turn."""
    base_from_marker: Pose2
    """As estimated, as given, or the base itself."""
    marker_sigma_m: float | None
    """None where it was not estimated."""
    clock_s: float
    """This added to a stamp of the site's is the map's; beyond what they were paired with."""
    clock_sigma_s: float | None
    """None where it was not estimated."""
    scale: float
    """Site over map, as measured; not applied."""
    scale_sigma: float
    offsets_m: Array
    """(n, 2) where the site has the marker, less where the map puts it, in the site's frame."""
    offsets_rad: Array
    """(n,) the same of the heading; NaN where there is none."""
    agrees: NDArray[np.bool_]
    """(n,) False: left out, as it contradicts the others."""
    findings: tuple[str, ...]
    """What people should know."""
    problems: tuple[str, ...]
    """Why it must not be used; empty where it may."""

    @property
    def sizes_m(self) -> Array:
        """(n,) lengths of ``offsets_m``."""
        return np.asarray(np.hypot(*self.offsets_m.T))

    @property
    def rms_m(self) -> float:
        """Of the pairs that agree."""
        return float(np.sqrt(np.mean(self.sizes_m[self.agrees] ** 2)))

    @property
    def p95_m(self) -> float:
        """Of the pairs that agree."""
        return float(np.percentile(self.sizes_m[self.agrees], 95.0))

    @property
    def rms_rad(self) -> float | None:
        """Of the pairs that agree; None without headings."""
        known = self.offsets_rad[self.agrees]
        known = known[np.isfinite(known)]
        return float(np.sqrt(np.mean(known**2))) if len(known) else None


def fit_pairs(
    pairs: PosePairs, params: FitParams, marker: Pose2 | None = None, *, ordered: bool = True
) -> Fit:
    """Bring the map's frame onto the site's.

    ``marker``: base_from_marker, where it is known. ``ordered``: neighbouring pairs were taken
    one after another, so that their errors are alike; landmarks are not.
    Raises AlignError where nothing can be said at all.
    """
    if len(pairs) < 2:
        raise AlignError(f"{len(pairs)} pairs are too few: two at least, better all over the map")
    seen = marker if marker is not None else Pose2.identity()
    free = marker is None and len(pairs) >= _FEW and _turns(pairs)
    active = [*SHIFT, TURN]
    if marker is None and pairs.has_headings:
        active.append(YAW)
    if free:
        active += MARKER
    if pairs.twists is not None and len(pairs) >= _FEW:
        active.append(CLOCK)
    # Two surveyed points always lie on a line, and people know which way round they stand.
    problems = _mirror_problem(pairs, seen, free=free) if len(pairs) > 2 else []
    solved, findings = _told(pairs, active, seen, params, ordered=ordered)
    scaled = solve(pairs, [*solved.active, SCALE], solved, ordered=ordered)
    if marker is None and pairs.has_map_headings and not free:
        findings.insert(0, _NO_MARKER)
    problems += _problems(solved, params)
    findings += _scale_finding(scaled)
    return _fit(solved, scaled, tuple(findings), tuple(problems))


def _turns(pairs: PosePairs) -> bool:
    if not pairs.has_map_headings:
        return False
    return bool(abs(np.mean(np.exp(1j * pairs.map[:, 2]))) < _ONE_WAY)


def _told(
    pairs: PosePairs, active: list[int], seen: Pose2, params: FitParams, *, ordered: bool
) -> tuple[Solved, list[str]]:
    """Solve; leave out what is not told, the least sure first, and solve again."""
    findings: list[str] = []
    while True:
        with_marker = MARKER[0] in active
        begun = _begin(pairs, seen, with_marker=with_marker)
        solved = solve(pairs, active, begun, ordered=ordered)
        doubts = {
            "marker": solved.sigma(MARKER) / params.marker_sigma_m if with_marker else 0.0,
            "clock": solved.sigma([CLOCK]) / params.clock_sigma_s if CLOCK in active else 0.0,
        }
        what = max(doubts, key=lambda name: doubts[name])
        if doubts[what] <= 1.0:
            return solved, findings
        if what == "marker":
            active = [index for index in active if index not in MARKER]
            findings.append(_NO_MARKER)
        else:
            active = [index for index in active if index != CLOCK]
            findings.append("a clock difference cannot be told from this drive: taken as none")


def _begin(pairs: PosePairs, seen: Pose2, *, with_marker: bool) -> Solved:
    """From the consensus; a marker that is known is put into the map's positions."""
    positions = _marker_positions(pairs, seen)
    headings = pairs.map[:, 2] if with_marker else None
    found = start(pairs.site[:, :2], positions, headings)
    turn_rad = math.atan2(found.turn.imag, found.turn.real)
    offset = found.offset if with_marker else complex(seen.x_m, seen.y_m)
    yaw_rad = seen.theta_rad
    if pairs.has_headings:
        off = pairs.site[:, 2] - pairs.map[:, 2] - turn_rad
        agreed = np.exp(1j * off)
        yaw_rad = seen.theta_rad or _median_angle(agreed)
    values = np.array(
        [found.shift.real, found.shift.imag, turn_rad, offset.real, offset.imag, yaw_rad, 0.0, 0.0]
    )
    return Solved.beginning(pairs, values, found.median_m)


def _median_angle(directions: NDArray[np.complex128]) -> float:
    """The one of some of the directions from which the others differ least."""
    some = directions[:: max(1, len(directions) // 200)]
    cost = np.abs(np.angle(directions[None, :] / some[:, None])).sum(axis=1)
    return float(np.angle(some[int(np.argmin(cost))]))


def _marker_positions(pairs: PosePairs, seen: Pose2) -> Array:
    if not pairs.has_map_headings or (seen.x_m == 0.0 and seen.y_m == 0.0):
        return pairs.map[:, :2]
    c, s = np.cos(pairs.map[:, 2]), np.sin(pairs.map[:, 2])
    arm = np.stack([c * seen.x_m - s * seen.y_m, s * seen.x_m + c * seen.y_m], axis=1)
    return np.asarray(pairs.map[:, :2] + arm)


def _mirror_problem(pairs: PosePairs, seen: Pose2, *, free: bool) -> list[str]:
    """A camera frame whose y runs down fits nothing; on a line it fits as well as the right one."""
    positions, headings = _marker_positions(pairs, seen), pairs.map[:, 2] if free else None
    plain = start(pairs.site[:, :2], positions, headings).median_m
    try:
        mirrored = start(pairs.site[:, :2], positions, headings, mirrored=True).median_m
    except AlignError:
        return []
    if mirrored * _MIRROR_FACTOR + 0.005 < plain:
        return ["the site's frame is mirrored (its y runs the other way): turn it round first"]
    if plain * _MIRROR_FACTOR + 0.005 < mirrored or _headings_tell(pairs) or not _on_line(pairs):
        return []
    line = (
        "all pairs lie on a line: a mirrored frame would fit as well, and nothing is known beside "
        "the line; take pairs all over the map"
    )
    return [line]


def _on_line(pairs: PosePairs) -> bool:
    """Whether most of the map's positions lie within a hand of one line."""
    off = pairs.map[:, :2] - np.median(pairs.map[:, :2], axis=0)
    across = np.linalg.svd(off, full_matrices=False)[2][1]
    return bool(np.percentile(np.abs(off @ across), 80.0) < _LINE_M)


def _headings_tell(pairs: PosePairs) -> bool:
    """Whether the headings turn the same way in both frames, and turn at all."""
    if not pairs.has_headings:
        return False
    same = abs(np.mean(np.exp(1j * (pairs.site[:, 2] - pairs.map[:, 2]))))
    opposite = abs(np.mean(np.exp(1j * (pairs.site[:, 2] + pairs.map[:, 2]))))
    return bool(same > opposite + 0.1)


def _problems(solved: Solved, params: FitParams) -> list[str]:
    problems = []
    share = float(np.mean(solved.agrees))
    if share < params.agreeing:
        problems.append(
            f"only {share:.0%} of the pairs agree with each other, {params.agreeing:.0%} must"
        )
    turn_sigma = solved.sigma([TURN])
    if turn_sigma > _MOST_TURN_SIGMA_RAD:
        problems.append(
            f"the turn is known to {math.degrees(turn_sigma):.1f} deg only: the pairs lie too near "
            "to each other; take them all over the map"
        )
    return problems


def _scale_finding(scaled: Solved) -> list[str]:
    off, sigma = float(scaled.values[SCALE]), scaled.sigma([SCALE])
    if abs(off) < max(_LEAST_SCALE, 4.0 * sigma):
        return []
    larger = "larger" if off > 0.0 else "smaller"
    finding = (
        f"the site's frame is {larger} than the map by {abs(off):.2%} (+- {2.0 * sigma:.2%}): "
        "check the cameras' calibration; the map is not stretched"
    )
    return [finding]


def _fit(
    solved: Solved,
    scaled: Solved,
    findings: tuple[str, ...],
    problems: tuple[str, ...],
) -> Fit:
    values = solved.values
    return Fit(
        site_from_map=Pose2(float(values[0]), float(values[1]), float(values[TURN])),
        sigma_m=solved.sigma(SHIFT),
        sigma_rad=solved.sigma([TURN]),
        base_from_marker=Pose2(*(float(values[index]) for index in (*MARKER, YAW))),
        marker_sigma_m=solved.sigma(MARKER) if MARKER[0] in solved.active else None,
        clock_s=float(values[CLOCK]),
        clock_sigma_s=solved.sigma([CLOCK]) if CLOCK in solved.active else None,
        scale=1.0 + float(scaled.values[SCALE]),
        scale_sigma=scaled.sigma([SCALE]),
        offsets_m=solved.offsets_m,
        offsets_rad=wrap_angle(solved.offsets_rad),
        agrees=solved.agrees,
        findings=findings,
        problems=problems,
    )
