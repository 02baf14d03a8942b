"""A wheel whose counts stand from one moment to the next while the other one goes on turning.

No motor stops a wheel that fast: its counter has died, or its frames come without news. The robot
drives on, and until the next scan says so the wheels lead the pose astray. They are still followed
(a wheel may be blocked after all), but the pose claims no more than it knows.
"""

from __future__ import annotations

import itertools
from collections import deque
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array
from amr_slam.odometry import DifferentialDrive, Odometry
from amr_slam.samples import DriveSample, Motion, WheelSample

# Speeds before and after are means over this time: one step's quotient is counting noise.
_WINDOW_NS: Final = 100_000_000
# So many samples must be in either: who is read more seldom cannot be judged.
_LEAST_SAMPLES: Final = 3
# The other wheel goes on when it does so with half of its speed, and is not all but standing.
_GOES_ON: Final = 0.5
_SLOW_MPS: Final = 0.05
# Scans come at least so often, and put right what was missed.
_LONGEST_S: Final = 2.0
_OTHER: Final = {"left": "right", "right": "left"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """A wheel that is suspected."""

    last: WheelSample
    """With which it came to stand."""
    ratio: float
    """Of its speed to the other wheel's before: straight ahead, 1."""
    longest_m: float
    """The way that it would have gone until the next scan at the latest."""


class StandingWheels:
    """Watches the wheels of a differential drive; other drives are let pass."""

    def __init__(self, odometry: Odometry, params: FilterParams) -> None:
        self._drive = odometry if isinstance(odometry, DifferentialDrive) else None
        self._samples: deque[WheelSample] = deque()
        self._suspects: dict[str, Standing] = {}
        if self._drive is not None:
            limit_mps2 = params.acceleration_limit_mps2
            limit_mps2 += 0.5 * self._drive.track_m * params.turn_acceleration_limit_radps2
            # The mean over the window of a wheel that brakes to a stop at its end.
            window_s = 1e-9 * _WINDOW_NS + self._drive.stamp_jitter_s
            self._stoppable_mps = 0.5 * limit_mps2 * window_s

    @property
    def suspects(self) -> dict[str, Standing]:
        """The wheels that stand while they should turn, by name."""
        return dict(self._suspects)

    def heed(self, sample: DriveSample, motion: Motion) -> Motion:
        """Take in the sample with which ``motion`` ends; the motion as unsure as it is."""
        if self._drive is None or not isinstance(sample, WheelSample):
            return motion
        if motion.gap or (self._samples and self._samples[-1].segment != sample.segment):
            self._samples.clear()
            self._suspects.clear()
        self._samples.append(sample)
        while self._samples[0].stamp_ns < sample.stamp_ns - 4 * _WINDOW_NS:
            self._samples.popleft()
        covariance = motion.covariance
        before = self._samples[-2] if len(self._samples) > 1 else sample
        for wheel in _OTHER:
            suspect, begun = self._suspects.get(wheel), before
            if suspect is None and (suspect := self._found(wheel)) is not None:
                self._suspects[wheel] = suspect
                begun = suspect.last  # what was missed until it was noticed
            if suspect is None:
                continue
            if _angle(suspect.last, wheel) != _angle(sample, wheel):
                del self._suspects[wheel]
                continue
            covariance = covariance + self._missed(wheel, suspect, begun, sample)
        return motion if covariance is motion.covariance else replace(motion, covariance=covariance)

    def _found(self, wheel: str) -> Standing | None:
        """The wheel, where it stands and cannot have stopped."""
        newest, other = self._samples[-1], _OTHER[wheel]
        angle = _angle(newest, wheel)
        stood = list(
            itertools.takewhile(lambda one: _angle(one, wheel) == angle, reversed(self._samples))
        )
        first = stood[-1]
        before = [
            one
            for one in self._samples
            if first.stamp_ns - _WINDOW_NS <= one.stamp_ns <= first.stamp_ns
        ]
        if (
            newest.stamp_ns - first.stamp_ns < _WINDOW_NS
            or first.stamp_ns - before[0].stamp_ns < _WINDOW_NS // 2
            or min(len(stood), len(before)) <= _LEAST_SAMPLES
        ):
            return None
        speed_mps = self._speed_mps(wheel, before[0], first)
        other_mps = self._speed_mps(other, first, newest)
        usual_mps = max(_SLOW_MPS, abs(self._speed_mps(other, before[0], first)))
        goes_on = abs(other_mps) >= max(_SLOW_MPS, _GOES_ON * usual_mps)
        if abs(speed_mps) <= self._stoppable_mps or not goes_on:
            return None
        return Standing(
            last=first, ratio=abs(speed_mps) / usual_mps, longest_m=_LONGEST_S * abs(speed_mps)
        )

    def _way_m(self, wheel: str, early: WheelSample, late: WheelSample) -> float:
        assert self._drive is not None
        radius_m = self._drive.radius_left_m if wheel == "left" else self._drive.radius_right_m
        return radius_m * (_angle(late, wheel) - _angle(early, wheel))

    def _speed_mps(self, wheel: str, early: WheelSample, late: WheelSample) -> float:
        return self._way_m(wheel, early, late) / (1e-9 * (late.stamp_ns - early.stamp_ns))

    def _missed(
        self, wheel: str, suspect: Standing, early: WheelSample, late: WheelSample
    ) -> Array:
        """(3, 3) more covariance of a step: of all steps together, the square of the way that the
        wheel would have gone beside the other one. Where that one stands, the robot does."""
        assert self._drive is not None
        ways_m = [
            suspect.ratio * abs(self._way_m(_OTHER[wheel], suspect.last, one))
            for one in (early, late)
        ]
        until_m = sum(min(way_m, suspect.longest_m) for way_m in ways_m)
        side = -1.0 if wheel == "left" else 1.0
        by_way = np.array([0.5, 0.0, side / self._drive.track_m])
        missed: Array = until_m * abs(ways_m[1] - ways_m[0]) * np.outer(by_way, by_way)
        return missed


def _angle(sample: WheelSample, wheel: str) -> float:
    return sample.left_rad if wheel == "left" else sample.right_rad
