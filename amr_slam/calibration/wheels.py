"""The path that given measures make of the wheels' angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from amr_slam.calibration.values import Measures
from amr_slam.geometry import Array, wrap_angle
from amr_slam.samples import WheelSample


class WheelTrack:
    """Both wheels' angles over time. Intervals in which they cannot be trusted are known."""

    def __init__(self, samples: Sequence[WheelSample]) -> None:
        """``samples`` in the order of time, two at least."""
        self.stamps_ns = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
        self._times_s = 1e-9 * (self.stamps_ns - self.stamps_ns[0])
        angles = np.array([(sample.left_rad, sample.right_rad) for sample in samples])
        self._steps_rad = np.diff(angles, axis=0)
        self._breaks = np.concatenate([[0], np.cumsum(np.diff([s.segment for s in samples]) != 0)])

    def seconds(self, stamps_ns: NDArray[np.int64]) -> Array:
        """(n,) stamps as seconds since the first wheel sample."""
        return np.asarray(1e-9 * (stamps_ns - self.stamps_ns[0]))

    def covers(self, times_s: Array, margin_s: float) -> NDArray[np.bool_]:
        """(n,) whether the wheels were heard ``margin_s`` before and after each time."""
        inside = (times_s - margin_s >= 0.0) & (times_s + margin_s <= self._times_s[-1])
        return np.asarray(inside)

    def whole(self, times_s: Array) -> NDArray[np.bool_]:
        """(n - 1,) whether the counting went on without a break between successive times."""
        where = np.searchsorted(self._times_s, times_s)
        found = self._breaks[np.clip(where, 0, len(self._breaks) - 1)]
        return np.asarray(np.diff(found) == 0)

    def motions(self, measures: Measures, times_s: Array) -> Array:
        """(n - 1, 3) x, y (m), heading (rad): the base's motion between successive times (n,)."""
        left_m = measures.radius_left_m * self._steps_rad[:, 0]
        right_m = measures.radius_right_m * self._steps_rad[:, 1]
        turn = (right_m - left_m) / measures.track_m
        heading = np.concatenate([[0.0], np.cumsum(turn)])
        # The chord of an arc of constant curvature points along its middle heading.
        chord = 0.5 * (left_m + right_m) * np.sinc(turn / (2.0 * np.pi))
        middle = heading[:-1] + 0.5 * turn
        x = np.concatenate([[0.0], np.cumsum(chord * np.cos(middle))])
        y = np.concatenate([[0.0], np.cumsum(chord * np.sin(middle))])
        path = np.column_stack([np.interp(times_s, self._times_s, v) for v in (x, y, heading)])
        return between(path)

    def travel(self, measures: Measures, times_s: Array) -> tuple[Array, Array]:
        """(n - 1,) way of both wheels' mean (m) and (n - 1,) sum of turns (rad), never negative."""
        left_m = measures.radius_left_m * self._steps_rad[:, 0]
        right_m = measures.radius_right_m * self._steps_rad[:, 1]
        way = np.concatenate([[0.0], np.cumsum(0.5 * (np.abs(left_m) + np.abs(right_m)))])
        turned = np.concatenate([[0.0], np.cumsum(np.abs(right_m - left_m) / measures.track_m)])
        return (
            np.abs(np.diff(np.interp(times_s, self._times_s, way))),
            np.abs(np.diff(np.interp(times_s, self._times_s, turned))),
        )


def between(poses: Array) -> Array:
    """(n - 1, 3) each pose of (n, 3) in the frame of the one before it."""
    step = np.diff(poses, axis=0)
    c, s = np.cos(poses[:-1, 2]), np.sin(poses[:-1, 2])
    return np.column_stack(
        [
            c * step[:, 0] + s * step[:, 1],
            -s * step[:, 0] + c * step[:, 1],
            wrap_angle(step[:, 2]),
        ]
    )
