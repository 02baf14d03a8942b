"""The rays that a map was made of, packed: what any later rebuilding of the map begins with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from numpy.typing import NDArray

from amr_slam.clouds import Cloud
from amr_slam.geometry import Array, Pose2, readonly

_FULL = 32767
# A scan 25 m wide is kept to three quarters of a millimetre, a small room's to a tenth.
_LEAST_QUANTUM_M = 1e-4
_UNKNOWN = -32768
BYTES_PER_RAY = 11
# The oldest of two scans from about the same place goes when there are more rays than this.
_BYTES_PER_M2 = 5000.0
_LEAST_BYTES = 500_000
# A turn of one radian shows as much that is new as this travel.
_TURN_M = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rays:
    """One scan's rays in its base frame; arrays are row-aligned."""

    quantum_m: float
    """Unit of the coordinates."""
    across_m: float
    """The cloud's noise across walls; kept when the rays are forgotten."""
    ends: NDArray[np.int16]
    """(n, 2) where the rays ended."""
    origins: NDArray[np.int16]
    """(n, 2) where the scanner stood."""
    normals: NDArray[np.int16]
    """(n,) direction of the surface's normal in pi / 32767; -32768 where it is unknown."""
    weights: NDArray[np.uint8]
    """(n,) the cloud's weights in 1 / 255."""

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def ends_m(self) -> Array:
        """(n, 2) where the rays ended, in the base frame."""
        return np.asarray(self.ends * self.quantum_m, dtype=np.float64)

    @property
    def origins_m(self) -> Array:
        """(n, 2) where the scanner stood, in the base frame."""
        return np.asarray(self.origins * self.quantum_m, dtype=np.float64)

    def take(self, kept: NDArray[np.bool_]) -> Rays:
        """Only these (n,)."""
        if kept.all():
            return self
        return replace(
            self,
            ends=self.ends[kept],
            origins=self.origins[kept],
            normals=self.normals[kept],
            weights=self.weights[kept],
        )

    def cloud(self, stamp_ns: int, sigma_m: float) -> Cloud:
        """The scan as it was inserted, but for the rounding."""
        known = self.normals != _UNKNOWN
        angle = self.normals * (math.pi / _FULL)
        normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return Cloud(
            stamp_ns=stamp_ns,
            points_m=self.ends_m,
            normals=np.where(known[:, None], normals, 0.0),
            origins_m=self.origins_m,
            weights=np.maximum(self.weights, 1) / 255.0,
            # Who saw it matters where a place is sought, not where a map is made.
            scanners=np.zeros(len(self), dtype=np.int8),
            sigma_m=sigma_m,
            across_m=self.across_m,
        )


def pack(cloud: Cloud) -> Rays:
    """A cloud's rays, rounded."""
    widest = max(
        float(np.abs(array).max(initial=0.0)) for array in (cloud.points_m, cloud.origins_m)
    )
    quantum_m = max(widest / _FULL, _LEAST_QUANTUM_M)
    angle = np.arctan2(cloud.normals[:, 1], cloud.normals[:, 0]) * (_FULL / math.pi)
    return Rays(
        quantum_m=quantum_m,
        across_m=cloud.across_m,
        ends=_whole(cloud.points_m / quantum_m),
        origins=_whole(cloud.origins_m / quantum_m),
        normals=np.where(cloud.has_normal, _whole(angle), _UNKNOWN).astype(np.int16),
        weights=np.round(255.0 * cloud.weights).astype(np.uint8),
    )


def _whole(values: Array) -> NDArray[np.int16]:
    return np.round(values).astype(np.int16)


def nothing(across_m: float) -> Rays:
    """What is left of a scan that was forgotten."""
    return Rays(
        quantum_m=_LEAST_QUANTUM_M,
        across_m=across_m,
        ends=np.empty((0, 2), dtype=np.int16),
        origins=np.empty((0, 2), dtype=np.int16),
        normals=np.empty(0, dtype=np.int16),
        weights=np.empty(0, dtype=np.uint8),
    )


def needs_room(rays: Sequence[Rays]) -> bool:
    """Whether these are more than are kept of any place."""
    return BYTES_PER_RAY * sum(len(one) for one in rays) > _LEAST_BYTES


def forget(rays: list[Rays], poses: Sequence[Pose2], area_m2: float) -> None:
    """Forget scans until the rays need no more than 5 MB for each 1000 m2 of ``area_m2``: each
    time the older one of the two that were taken nearest to each other."""
    most = max(_LEAST_BYTES, _BYTES_PER_M2 * area_m2) / BYTES_PER_RAY
    total = sum(len(one) for one in rays)
    while total > most:
        kept = np.array([i for i, one in enumerate(rays) if len(one)])
        if len(kept) < 2:
            return
        places = np.array([_place(poses[i]) for i in kept])
        found = scipy.spatial.cKDTree(places).query(places, k=2)
        distance, other = np.asarray(found[0]), np.asarray(found[1])
        # Rows in which a twin at the same place came first hold it in column 0.
        first = int(np.argmin(distance[:, 1]))
        older = int(kept[min(first, *other[first].tolist())])
        total -= len(rays[older])
        rays[older] = nothing(rays[older].across_m)


def _place(pose: Pose2) -> Array:
    turned = (_TURN_M * math.cos(pose.theta_rad), _TURN_M * math.sin(pose.theta_rad))
    return readonly(np.array([pose.x_m, pose.y_m, *turned]))
