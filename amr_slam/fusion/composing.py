"""Many steps of the wheels as one motion: its noise, and how it depends on the calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from amr_slam.geometry import Array, Pose2

NOMINAL: Final = np.zeros(4)
"""Travel, yaw, bend and lag of wheels that are what their driver says."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Composed:
    """One motion out of many steps."""

    delta: Pose2
    """``start_from_end`` of the base frame."""
    noise: Array
    """(3, 3) of the wheels' own noise, in the end's frame (right perturbation): of what they
    report, so that wheels which report too little are as much noisier."""
    by_calibration: Array
    """(3, 4) derivative of the same perturbation by travel, yaw, bend and lag."""
    travel_m: float
    """Way that the wheels reported, forth and back summed."""
    turn_rad: float
    """By how much the heading has changed, at least 0. Summed step by step it would be the wheels'
    noise for the most part, and more the oftener they are read."""

    def reversed(self) -> Composed:
        """``end_from_start``, as unsure."""
        carry = self.delta.adjoint()
        return Composed(
            delta=self.delta.inverse(),
            noise=carry @ self.noise @ carry.T,
            by_calibration=-carry @ self.by_calibration,
            travel_m=self.travel_m,
            turn_rad=self.turn_rad,
        )


def composed(
    steps: tuple[Array, Array],
    rates: tuple[Array, Array],
    *,
    travel_m: float,
    calibration: Array,
    pull: Array | None,
) -> Composed:
    """One motion out of successive steps, under what is believed of the wheels.

    ``steps``: (n, 3) twists and (n, 3, 3) noises as the wheels told them. ``rates``: (3,) and (3,)
    twists per second at the beginning and at the end. ``travel_m``: as of :class:`Composed`.
    ``calibration``: (4,) as :data:`NOMINAL`; its lag has chosen the steps. ``pull``: (3,) in the
    end's frame, or None, as in :meth:`amr_slam.fusion.trail.Trail.compose`.
    """
    twists, noises = steps
    scale = np.array([1.0 + calibration[0], 1.0 + calibration[0], 1.0 + calibration[1]])
    true, noises = twists * scale, noises * np.outer(scale, scale)
    true[:, 2] += calibration[2] * twists[:, 0]
    ends, middles = _chained(true)
    delta = Pose2.from_array(ends[-1]) if len(ends) else Pose2.identity()
    to_end = delta.inverse().adjoint()
    by_lag = rates[1] * scale - to_end @ (rates[0] * scale)
    if pull is not None:
        twists = twists + _likely_noise(ends, noises, to_end.T @ pull) / scale
    return Composed(
        delta=delta,
        noise=to_end @ _carried_noise(ends, noises) @ to_end.T,
        by_calibration=np.column_stack([to_end @ _sensitivity(middles, twists), by_lag]),
        travel_m=travel_m,
        turn_rad=abs(float(ends[-1, 2])) if len(ends) else 0.0,
    )


def _chained(twists: Array) -> tuple[Array, Array]:
    """(n, 3) poses at the ends and in the middles of (n, 3) successive twists, from the origin.

    Headings are not wrapped.
    """
    turns = twists[:, 2]
    ends_rad = np.cumsum(turns)
    starts_rad = ends_rad - turns
    # The chord of an arc points along its middle and is sinc(half the turn) as long.
    middles_rad = starts_rad + 0.5 * turns
    chord = np.sinc(turns / (2.0 * np.pi))
    c, s = np.cos(middles_rad), np.sin(middles_rad)
    steps = np.column_stack(
        [c * twists[:, 0] - s * twists[:, 1], s * twists[:, 0] + c * twists[:, 1]]
    )
    steps *= chord[:, None]
    ends = np.cumsum(steps, axis=0)
    middles = ends - 0.5 * steps
    return np.column_stack([ends, ends_rad]), np.column_stack([middles, middles_rad])


def _adjoints(poses: Array) -> Array:
    """(n, 3, 3) of (n, 3) poses."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    found = np.zeros((len(poses), 3, 3))
    found[:, 0, 0], found[:, 0, 1], found[:, 0, 2] = c, -s, poses[:, 1]
    found[:, 1, 0], found[:, 1, 1], found[:, 1, 2] = s, c, -poses[:, 0]
    found[:, 2, 2] = 1.0
    return found


def _carried_noise(ends: Array, noises: Array) -> Array:
    """(3, 3) sum of the steps' noise in the frame of the beginning."""
    carry = _adjoints(ends)
    carried = (carry @ noises).transpose(1, 0, 2).reshape(3, -1)
    total: Array = carried @ carry.transpose(1, 0, 2).reshape(3, -1).T
    return total


def _likely_noise(ends: Array, noises: Array, pull: Array) -> Array:
    """(n, 3) what each step most likely missed, given what a fix says of all of them together.

    ``pull``: (3,) as in :func:`composed`, but in the frame of the beginning.
    """
    likely: Array = (noises @ (_adjoints(ends).transpose(0, 2, 1) @ pull)[:, :, None])[:, :, 0]
    return likely


def _sensitivity(middles: Array, twists: Array) -> Array:
    """(3, 3) derivative by travel, yaw and bend in the frame of the beginning: each step's error
    arises along it, in the mean at its middle."""
    carry = _adjoints(middles)
    travel = (carry[:, :, :2] * twists[:, None, :2]).sum(axis=(0, 2))
    turned, bent = carry[:, :, 2].T @ twists[:, 2], carry[:, :, 2].T @ twists[:, 0]
    return np.column_stack([travel, turned, bent])
