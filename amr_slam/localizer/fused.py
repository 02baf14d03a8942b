"""Wheels and fixes in one filter, and how its corrections enter the published pose."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np

from amr_slam.fusion import Easing, FilterParams, PoseFilter, Slip
from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.odometry import Odometry
from amr_slam.samples import DriveSample, Motion, Outcome, SlamPose
from amr_slam.standing_wheels import StandingWheels
from amr_slam.trust import LocalizerParams
from amr_slam.wheel_events import WheelEvents

ANYWHERE: Final = readonly(np.diag([1e4**2, 1e4**2, math.pi**2]))
"""Covariance where nothing is known: wider than any hall, well inside what the filter can compute
with."""
NEW_MAP: Final = (Pose2.identity(), readonly(np.diag([1e-4, 1e-4, 1e-6])))
"""A map begins where the robot stands."""


class FusedPose:
    """The filter, the wheels that feed it, and what is published of it."""

    def __init__(
        self,
        params: LocalizerParams,
        filter_params: FilterParams,
        odometry: Odometry,
        start: tuple[Pose2, Array] | None,
    ) -> None:
        """``start``: pose and covariance (3, 3) to begin with; None: anywhere."""
        self._params = params
        self._filter_params = filter_params
        self.odometry = odometry
        self.start = start
        self.filter: PoseFilter | None = None
        """None before the first wheel sample."""
        self.wheels: DriveSample | None = None
        """The newest wheel sample."""
        self.first_ns: int | None = None
        """Instant of the first one."""
        self.easing = Easing(params.easing)
        self.events = WheelEvents(odometry)
        self._standing = StandingWheels(odometry, filter_params)

    @property
    def running(self) -> PoseFilter:
        """The filter; only after the first wheel sample."""
        assert self.filter is not None
        return self.filter

    def handle_wheels(self, sample: DriveSample) -> Outcome:
        """Carry the pose on by the wheels."""
        if self.filter is None:
            pose, covariance = self.start or (Pose2.identity(), ANYWHERE)
            self.filter = PoseFilter(self._filter_params, sample.stamp_ns, pose, covariance)
            self.wheels = sample
            self.first_ns = sample.stamp_ns
            return Outcome.ACCEPTED
        if sample.stamp_ns <= self.filter.stamp_ns or self.wheels is None:
            same = sample.stamp_ns == self.filter.stamp_ns
            return Outcome.DUPLICATE if same else Outcome.LATE
        if self.wheels.stamp_ns < self.filter.stamp_ns:
            # The silence was already bridged up to a scan: go on from there.
            motion = self.odometry.silence(self.filter.stamp_ns, sample.stamp_ns)
        else:
            motion = self._doubted(sample, self.odometry.motion(self.wheels, sample))
        self.wheels = sample
        outcome = self.filter.predict(motion)
        leap = self.filter.last_leap
        if leap is not None and leap.stamp_ns == sample.stamp_ns:
            self.events.note_leap(leap, self._params.slip_told_s)
        return outcome

    def _doubted(self, sample: DriveSample, motion: Motion) -> Motion:
        """A motion by wheels of which one may be stuck."""
        known = self._standing.suspects
        motion = self._standing.heed(sample, motion)
        for wheel, suspect in self._standing.suspects.items():
            if wheel not in known:
                self.events.note_standing(wheel, suspect.last.stamp_ns, sample.stamp_ns)
        return motion

    def bridge_silence(self, until_ns: int) -> None:
        """Wheels that are silent must not stop the scans: carry the filter on, unsure."""
        fusion = self.running
        if until_ns - fusion.stamp_ns > round(1e9 * self._params.wheels_silent_s):
            fusion.predict(self.odometry.silence(fusion.stamp_ns, until_ns))

    def reset(self, stamp_ns: int | None, map_from_base: Pose2, covariance: Array) -> Outcome:
        """Jump to a pose of ``stamp_ns`` (None: of now); RESET where that was done, or nothing was
        to do as no wheels have come yet."""
        if self.filter is None:
            return Outcome.RESET
        stamp_ns = self.filter.stamp_ns if stamp_ns is None else stamp_ns
        with self.eased():
            return self.filter.reset(stamp_ns, map_from_base, covariance)

    @contextmanager
    def eased(self) -> Iterator[None]:
        """What changes the filter's pose within enters the published one slowly, or as a jump."""
        fusion = self.running
        now_ns, epoch = fusion.stamp_ns, fusion.epoch
        shown, _ = self.easing.applied(now_ns, fusion.map_from_base, fusion.covariance)
        yield
        self.easing.corrected(now_ns, shown, fusion.map_from_base, is_jump=fusion.epoch > epoch)

    def motion_between(self, start_ns: int, end_ns: int) -> Motion | None:
        """What the wheels say between two instants; None where they do not reach."""
        return None if self.filter is None else self.filter.motion_between(start_ns, end_ns)

    def note_slip(self, stamp_ns: int) -> None:
        """Tell people what the fix of this stamp has shown of the wheels, if anything."""
        innovation = self.running.last_innovation
        if innovation is None or innovation.slip is None or innovation.stamp_ns != stamp_ns:
            return
        slip = innovation.slip
        self.events.note(slip, self.motion_between(slip.since_ns, slip.stamp_ns))

    def note_lies(self, fix: SlamPose) -> None:
        """Scans that agree with one another have outvoted the wheels."""
        fusion = self.running
        expected = fusion.pose_at(fix.stamp_ns)
        since_ns = fusion.stamp_ns - round(1e9 * fusion.since_fix_s)
        if expected is None:
            return
        error = expected[0].inverse() @ fix.map_from_base
        slip = Slip(
            stamp_ns=fix.stamp_ns,
            since_ns=since_ns,
            forward_m=error.x_m,
            left_m=error.y_m,
            turn_rad=error.theta_rad,
        )
        self.events.note(slip, self.motion_between(since_ns, fix.stamp_ns))
