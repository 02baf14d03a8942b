"""From a scanner's polar readings to a cloud in the robot's base frame that can be registered."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.samples import Scan

# Beams this far apart on a surface each count in full.
_FULL_WEIGHT_M = 0.05
# Noise of a third of a metre needs this many to each side; their cost is no more than that.
_MOST_NORMAL_BEAMS = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudParams:
    """Which readings are used, and how the surface's direction is taken from them."""

    range_min_m: Annotated[float, Ge(0.0)] = 0.05
    """Nearer readings are the robot's own body or dirt on the window."""
    range_max_m: Annotated[float, Gt(0.0)] = 25.0
    """Farther readings are dropped: neighbouring beams no longer lie on one surface."""
    normal_beams: Annotated[int, Ge(1), Le(30)] = 8
    """A normal is taken from at most this many beams to each side."""
    normal_radius_m: Annotated[float, Gt(0.0)] = 0.15
    """... that end within this distance of the point, or 2.5 beam spacings, or four standard
    deviations of the noise, if that is more: with noise, more beams are taken in proportion."""
    grazing_deg: Annotated[float, Ge(0.0), Le(45.0)] = 5.0
    """Hits flatter than this to their surface are mixed pixels more often than walls."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cloud:
    """The hits of one instant in the base frame; all arrays are read-only and row-aligned."""

    stamp_ns: int
    points_m: Array
    """(n, 2)."""
    normals: Array
    """(n, 2) unit normals that face the scanner; (0, 0) where the neighbours tell none."""
    origins_m: Array
    """(n, 2) where the scanner stood that saw the point."""
    weights: Array
    """(n,) in (0, 1]: how much surface the point stands for, full at 5 cm between beams. Near
    things fill many beams: counted plainly, two legs outweigh a wall."""
    scanners: NDArray[np.int8]
    """(n,) number of the scanner that saw the point: each is a witness of its own."""
    sigma_m: float
    """Noise of one range, estimated from the scan itself."""
    across_m: float
    """Noise of a point's distance to its wall: less than ``sigma_m``, as most walls are met
    obliquely. The same estimate, each beam's part projected on the wall's normal."""

    def __post_init__(self) -> None:
        for name in ("points_m", "normals", "origins_m", "weights"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        self.scanners.flags.writeable = False

    def __len__(self) -> int:
        return len(self.points_m)

    def take(self, rows: NDArray[np.intp]) -> Cloud:
        """The same cloud with only these points."""
        return Cloud(
            stamp_ns=self.stamp_ns,
            points_m=self.points_m[rows],
            normals=self.normals[rows],
            origins_m=self.origins_m[rows],
            weights=self.weights[rows],
            scanners=self.scanners[rows],
            sigma_m=self.sigma_m,
            across_m=self.across_m,
        )

    def even(self, count: int) -> NDArray[np.intp]:
        """Rows of at most ``count`` points that share the scan's surface evenly."""
        if not len(self):
            return np.empty(0, dtype=np.intp)
        surface = np.cumsum(self.weights)
        marks = (np.arange(count) + 0.5) * (surface[-1] / count)
        return np.unique(np.searchsorted(surface, marks).clip(max=len(self) - 1))

    @property
    def has_normal(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """(n,) whether the point's surface direction is known."""
        return np.asarray(np.any(self.normals != 0.0, axis=1))


def _bends(ranges_m: Array, step_rad: float) -> Array:
    """(n - 2,) by how much each inner range leaves the straight wall through its neighbours.

    On such a wall u = 1/r obeys u[i-1] + u[i+1] = 2 cos(step) u[i] exactly, however oblique it
    is; what is left, times r^2, has a variance of 6 sigma^2.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = 1.0 / ranges_m
        left = inverse[:-2] + inverse[2:] - 2.0 * math.cos(step_rad) * inverse[1:-1]
        return np.asarray(left * ranges_m[1:-1] ** 2)


def _spread(bends: Array) -> float:
    """Standard deviation in m of one range, from what :func:`_bends` returned.

    The median absolute deviation ignores corners and gaps; NaN and inf are skipped. 0 where fewer
    than 8 triples tell.
    """
    bends = bends[np.isfinite(bends)]
    if len(bends) < 8:
        return 0.0
    return float(1.4826 * np.median(np.abs(bends)) / math.sqrt(6.0))


def _surface(
    points: Array, spacing: Array, sigma_m: float, params: CloudParams
) -> tuple[Array, Array]:
    """Normals (n, 2) and neighbour counts (n,) of points in beam order, by local PCA.

    ``spacing`` (n,) is the distance of neighbouring beams at the point's range.
    """
    n = len(points)
    noisy = max(4.0 * sigma_m / params.normal_radius_m, 1.0)
    radius = np.maximum(noisy * params.normal_radius_m, 2.5 * spacing)
    beams = min(round(noisy * params.normal_beams), _MOST_NORMAL_BEAMS)
    offsets = np.arange(-beams, beams + 1)
    index = np.arange(n) + offsets[:, None]
    inside = (index >= 0) & (index < n)
    difference = points[np.clip(index, 0, n - 1)] - points
    with np.errstate(invalid="ignore"):
        near = inside & (np.hypot(difference[..., 0], difference[..., 1]) <= radius)
    difference = np.where(near[..., None], difference, 0.0)
    count = near.sum(axis=0)
    mean = difference.sum(axis=0) / np.maximum(count, 1)[:, None]
    centred = np.where(near[..., None], difference - mean, 0.0)
    xx = np.sum(centred[..., 0] ** 2, axis=0)
    yy = np.sum(centred[..., 1] ** 2, axis=0)
    xy = np.sum(centred[..., 0] * centred[..., 1], axis=0)
    # The larger eigenvector of [[xx, xy], [xy, yy]] runs along the surface.
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    return np.stack([-np.sin(along), np.cos(along)], axis=1), count


def cloud_from_scan(
    scan: Scan,
    base_from_lidar: Pose2,
    params: CloudParams,
    *,
    upside_down: bool = False,
    sweep: Sequence[Pose2] | None = None,
) -> Cloud:
    """The scan's usable hits in the base frame of its middle instant.

    ``sweep``: where the base stood at the first beam, at instants evenly after it, and at the last
    beam, in the base frame of the middle instant (two poses at least); each beam is moved by its
    own time (deskewed). None: no motion.
    ``upside_down``: the scanner hangs, its counter-clockwise is the robot's clockwise.
    """
    angles = -scan.angles_rad if upside_down else scan.angles_rad
    ranges = scan.ranges_m
    with np.errstate(invalid="ignore"):
        usable = (ranges >= params.range_min_m) & (ranges <= min(scan.range_max_m, 1e9))
    ranges = np.where(usable, ranges, np.nan)
    points = ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return cloud_from_points(
        points,
        base_from_lidar,
        params,
        step_rad=scan.angle_step_rad,
        stamp_ns=scan.mid_stamp_ns,
        sweep=sweep,
    )


def cloud_from_points(
    points_m: Array,
    base_from_lidar: Pose2,
    params: CloudParams,
    *,
    step_rad: float,
    stamp_ns: int = 0,
    sweep: Sequence[Pose2] | None = None,
) -> Cloud:
    """The same from points (beams, 2) in the lidar's frame, in the order of their beams, which
    are ``step_rad`` apart; NaN where a beam returned nothing."""
    every = len(points_m)
    ranges = np.hypot(points_m[:, 0], points_m[:, 1])
    with np.errstate(invalid="ignore"):
        usable = (ranges >= params.range_min_m) & (ranges <= params.range_max_m)
    beams = np.flatnonzero(usable)
    ranges = np.where(usable, ranges, np.nan)
    points = base_from_lidar @ points_m[beams]
    origins = np.broadcast_to(base_from_lidar.translation, points.shape)
    if sweep is not None and every > 1:
        fraction = (beams / (every - 1))[:, None]
        points, origins = _deskew(points, fraction, sweep), _deskew(origins, fraction, sweep)
    if not len(beams):
        nothing = np.empty(0)
        return Cloud(
            stamp_ns=stamp_ns, points_m=points, normals=points, origins_m=origins,
            weights=nothing, scanners=np.empty(0, dtype=np.int8), sigma_m=0.0, across_m=0.0,
        )  # fmt: skip
    # Neighbours are counted in beams, so that a gap of missing returns separates surfaces.
    spread = np.full((every, 2), np.nan)
    spread[beams] = points
    spacing = np.where(usable, ranges, 0.0) * abs(step_rad)
    bends = _bends(ranges, step_rad)
    sigma_m = _spread(bends)
    normals, count = _surface(spread, spacing, sigma_m, params)
    normals, count = normals[beams], count[beams]
    sight = origins - points
    sight = sight / np.maximum(np.linalg.norm(sight, axis=1, keepdims=True), 1e-9)
    facing = np.sum(normals * sight, axis=1)
    normals = normals * np.where(facing < 0.0, -1.0, 1.0)[:, None]
    steepness = np.full(every, np.nan)
    steepness[beams] = np.abs(facing)
    straight = np.abs(facing) >= math.sin(math.radians(params.grazing_deg))
    known = (count >= 4) & straight
    # An isolated return (mixed pixel, dust) has no neighbour at all: count includes itself.
    keep = (count >= 2) & (straight | (count < 4))
    return Cloud(
        stamp_ns=stamp_ns,
        points_m=points[keep],
        normals=np.where(known[:, None], normals, 0.0)[keep],
        origins_m=origins[keep],
        weights=np.clip(spacing[beams] / _FULL_WEIGHT_M, 0.01, 1.0)[keep],
        scanners=np.zeros(int(keep.sum()), dtype=np.int8),
        sigma_m=sigma_m,
        across_m=_spread(bends * steepness[1:-1]),
    )


def _deskew(points: Array, fraction: Array, sweep: Sequence[Pose2]) -> Array:
    """Each point moved by the base's pose at its own fraction of the sweep (between two poses,
    position and heading linearly)."""
    knots = np.array([pose.as_array() for pose in sweep])
    knots[:, 2] = np.unwrap(knots[:, 2])
    at = np.linspace(0.0, 1.0, len(knots))
    x, y, theta = (np.interp(fraction[:, 0], at, knots[:, axis]) for axis in range(3))
    c, s = np.cos(theta), np.sin(theta)
    px, py = points.T
    return np.stack([c * px - s * py + x, s * px + c * py + y], axis=1)


def merge(clouds: Sequence[tuple[Cloud, Pose2]]) -> Cloud:
    """Several scanners' clouds in the base frame of the first one's instant.

    Each comes with ``target_from_base``: where the base stood at that cloud's own instant, in
    the base frame of the common one. Noise is the largest: the weakest scanner sets the trust.
    """
    return Cloud(
        stamp_ns=clouds[0][0].stamp_ns,
        points_m=np.concatenate([pose @ cloud.points_m for cloud, pose in clouds]),
        normals=np.concatenate([cloud.normals @ pose.rotation.T for cloud, pose in clouds]),
        origins_m=np.concatenate([pose @ cloud.origins_m for cloud, pose in clouds]),
        weights=np.concatenate([cloud.weights for cloud, _ in clouds]),
        scanners=np.repeat(np.arange(len(clouds), dtype=np.int8), [len(c) for c, _ in clouds]),
        sigma_m=max(cloud.sigma_m for cloud, _ in clouds),
        across_m=max(cloud.across_m for cloud, _ in clouds),
    )
