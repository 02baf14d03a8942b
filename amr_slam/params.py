"""Every constant of localization in one tree, with the two presets."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from amr_slam.clouds import CloudParams
from amr_slam.geometry import Array
from amr_slam.living.params import WatchParams
from amr_slam.map.params import MapParams
from amr_slam.registration.cpd import CpdParams
from amr_slam.registration.field import FieldParams
from amr_slam.registration.icp import IcpParams
from amr_slam.registration.rdnm import RdnmParams

Share = Annotated[float, Ge(0.0), Le(1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Acceptance:
    """What a pose must show before it is called right."""

    inliers: Share
    """Least share on walls, of the points in known places."""
    conflict: Share
    """Greatest share standing in seen-free space: people and moved things, not more."""
    known: Share
    """Least share in known places: less is new territory, not a registration."""
    margin: Share
    """Least lead of the score over a second place."""
    e_max_m: Annotated[float, Gt(0.0)] = 1.0
    """The paper's e_max: a registration error (eq. 1) at or above it is a failure. At 1 m, its
    own threshold, it never speaks: new territory raises it as much as a wrong pose does."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Plausibility:
    """How probable it is that the best place found without a prior is the right one: a logistic
    regression on what the scan shows there (fields of :class:`amr_slam.evidence.Hypothesis`).

    Weights fitted over many worlds, clutter and noise by ``tools/fit_acceptance.py``; why they are
    believed elsewhere: ``docs/adr/0010-acceptance.md``.
    """

    bias: float = -7.4
    margin: float = 19.4
    """Of the lead over the second place: wrong places come in crowds."""
    agreeing: float = 7.6
    passes: float = -4.0
    accept: Share = 0.95
    """Least odds at which one scan alone is believed."""
    sure: Share = 0.9999
    """Least odds at which the exhaustive search for a better place is left out."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriftParams:
    """How fast a way along registered scans goes astray, at the worst that real drives showed:
    ``docs/adr/0033-loops-after-a-long-way.md``."""

    heading_radpsqrtm: Annotated[float, Gt(0.0)] = 0.006
    """Standard deviation of the heading after a metre; it grows with the root of the way."""
    scale: Annotated[float, Ge(0.0), Le(1.0)] = 0.02
    """Of the way: corridors have no marks, wheels measure them a little long or short."""
    place_m: Annotated[float, Gt(0.0)] = 0.3
    """And this much in any case."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosingParams:
    """Loops of a map that is made from nothing."""

    enabled: bool = True
    """False closes none: to see what they do."""
    submap_m: Annotated[float, Gt(1.0), Le(1000.0)] = 30.0
    """Way in m after which a piece of the map is finished."""
    step_m: Annotated[float, Gt(0.0)] = 1.0
    """A loop is sought each time that the robot has gone so far."""
    least_way_m: Annotated[float, Gt(0.0)] = 12.0
    """What was left less than this much way ago is no loop yet."""
    reach_m: Annotated[float, Gt(0.0)] = 0.5
    """A place may be off by this much"""
    drift: Annotated[float, Ge(0.0), Le(1.0)] = 0.05
    """and this share of the way since it was left, or since the last loop was closed,"""
    most_m: Annotated[float, Gt(0.0)] = 6.0
    """but not more than this: what may be farther off is recalled."""
    beyond_m: Annotated[float, Gt(0.0)] = 2.5
    """So far from the way of a submap's own scans a scan may be found in it."""
    turn_rad: Annotated[float, Gt(0.0)] = 0.15
    """So much it may be turned,"""
    drift_radpm: Annotated[float, Ge(0.0)] = 0.1
    """and this much more for each metre that it may be off."""
    known: Annotated[float, Ge(0.0), Le(1.0)] = 0.7
    """Least share of the scan that lies where the submap knows anything."""
    conflict: Annotated[float, Ge(0.0), Le(1.0)] = 0.12
    """Greatest share of it that stands where the submap saw free space,"""
    score: Annotated[float, Ge(0.0), Le(1.0)] = 0.5
    """and least mean fit: places that look alike differ in their details."""
    weak_m: Annotated[float, Gt(0.0)] = 0.1
    """A place that is known no better than this (one standard deviation) along its worst direction
    is a corridor, and closes nothing."""
    agree_m: Annotated[float, Gt(0.0)] = 0.3
    """Two closures say the same when they differ by no more than this"""
    agree_rad: Annotated[float, Gt(0.0)] = 0.06
    """and this;"""
    apart_m: tuple[float, float] = (0.4, 8.0)
    """the scans were taken between so much way apart."""
    drift_model: DriftParams = field(default_factory=DriftParams)
    """Where the robot may be after a long way:"""
    beyond_d2: Annotated[float, Gt(0.0)] = 13.8
    """squared Mahalanobis distance that chance exceeds once in a thousand times."""
    recall_step_m: Annotated[float, Gt(0.0)] = 4.0
    """A piece of the way is recalled each time that the robot has gone so far."""
    piece_m: Annotated[float, Gt(0.0)] = 12.0
    """Length of the piece."""
    rival_way_m: Annotated[float, Gt(0.0)] = 40.0
    """Places that were left so much way ago are places that the piece might be taken for."""
    recall_candidates: Annotated[int, Ge(2), Le(500)] = 60
    """Rough poses of the piece that are refined."""
    recall_witnesses: Annotated[int, Ge(2), Le(20)] = 3
    """So many pieces must say the same"""
    recall_within_m: Annotated[float, Gt(0.0)] = 30.0
    """within so much way"""
    recall_agree: tuple[float, float] = (0.5, 0.06)
    """to within this (m, rad)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlamParams:
    """The strategies of :mod:`amr_slam.slam` and the methods below them."""

    clouds: CloudParams = field(default_factory=CloudParams)
    map: MapParams = field(default_factory=MapParams)
    rdnm: RdnmParams = field(default_factory=RdnmParams)
    icp: IcpParams = field(default_factory=IcpParams)
    cpd: CpdParams = field(default_factory=CpdParams)
    exhaustive: FieldParams = field(default_factory=FieldParams)

    grid_m: Annotated[float, Gt(0.0)] = 0.5
    """The paper's g: spacing of the places that the absolute strategy tries."""
    robot_radius_m: Annotated[float, Gt(0.0)] = 0.3
    """Places nearer to a wall than this are not tried: the robot would not fit."""
    absolute_candidates: Annotated[int, Ge(1), Le(500)] = 24
    """Rough poses that the absolute strategy refines."""
    first_points: Annotated[int, Ge(20)] = 180
    """Points of the scan with which many rough poses are refined, to choose the finalists."""
    finalists: Annotated[int, Ge(2), Le(50)] = 6
    """Distinct poses that are refined with the whole scan."""
    local_candidates: Annotated[int, Ge(0), Le(100)] = 5
    """Rough poses that the relative strategy refines beside the prior itself."""
    local_spacing_m: Annotated[float, Gt(0.0)] = 0.3
    """Spacing of the places inside the prior's window."""
    window_xy_m: tuple[float, float] = (0.3, 1.8)
    """Least and greatest half side of the prior's window."""
    window_deg: tuple[float, float] = (15.0, 60.0)
    """Least and greatest half width of the prior's heading window."""

    fit_m: Annotated[float, Gt(0.0)] = 0.25
    """A point this far from the nearest wall fits no better than one in the open."""
    relative: Acceptance = field(
        default_factory=lambda: Acceptance(inliers=0.5, conflict=0.3, known=0.35, margin=0.0)
    )
    """What a pose near the expected one must show."""
    settled: Acceptance = field(
        default_factory=lambda: Acceptance(inliers=0.75, conflict=0.12, known=0.0, margin=0.0)
    )
    """What it must show to end the search: a poorer one counts if the later rungs find none."""
    absolute: Acceptance = field(
        default_factory=lambda: Acceptance(inliers=0.3, conflict=0.4, known=0.5, margin=0.0)
    )
    """What a pose found without a prior must show at the least,"""
    plausibility: Plausibility = field(default_factory=Plausibility)
    """and what it shows in all."""
    rescue: Acceptance = field(
        default_factory=lambda: Acceptance(inliers=0.75, conflict=0.2, known=0.6, margin=0.2)
    )
    """What a pose found by the absolute strategy around the expected one must show."""
    rescue_m: Annotated[float, Gt(0.0)] = 2.6
    """How far from the expected pose a pose may be found that is not sought everywhere."""
    insert_m: Annotated[float, Ge(0.0)] = 0.1
    """While mapping, a scan joins the map after this much travel"""
    insert_rad: Annotated[float, Ge(0.0)] = 0.1
    """... or this much turn since the last one: a standing robot adds nothing but noise."""
    closing: ClosingParams = field(default_factory=ClosingParams)
    """Loops of a growing map."""
    watching: WatchParams = field(default_factory=WatchParams)
    """Changes of the place, while localizing."""

    @property
    def window_min(self) -> Array:
        """(x m, y m, theta rad) least half window."""
        return np.array([self.window_xy_m[0]] * 2 + [math.radians(self.window_deg[0])])

    @property
    def window_max(self) -> Array:
        """(x m, y m, theta rad) greatest half window."""
        return np.array([self.window_xy_m[1]] * 2 + [math.radians(self.window_deg[1])])


Preset = Literal["default", "paper"]


def preset(name: Preset) -> SlamParams:
    """``default``: what this product does. ``paper``: the letter of the paper's algorithms
    (one candidate, plain norm, nearest layer, point-to-point ICP, union of scans, e_max alone),
    so that both can be measured."""
    if name == "default":
        return SlamParams()
    return SlamParams(
        map=MapParams(cell_m=0.01, thin=False, vanish_ratio=math.inf),
        rdnm=RdnmParams(
            signature="layer",
            layer_m=0.3,
            shorter_m=100.0,
            longer_m=100.0,
            unseen_m=0.0,
            rotations=1,
        ),
        icp=IcpParams(metric="point", max_iterations=50, kernel_m=1.0, reach_m=1.0),
        exhaustive=FieldParams(candidates=0),
        absolute_candidates=1,
        local_candidates=1,
        relative=Acceptance(inliers=0.0, conflict=1.0, known=0.0, margin=0.0, e_max_m=0.15),
        settled=Acceptance(inliers=0.0, conflict=1.0, known=0.0, margin=0.0, e_max_m=0.15),
        absolute=Acceptance(inliers=0.0, conflict=1.0, known=0.0, margin=0.0, e_max_m=0.15),
        plausibility=Plausibility(accept=0.0, sure=0.0),
        rescue=Acceptance(inliers=0.0, conflict=1.0, known=0.0, margin=0.0, e_max_m=0.15),
    )
