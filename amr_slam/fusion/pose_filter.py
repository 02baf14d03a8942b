"""The filter with a memory: wheels as they come, fixes late and in any order."""

from __future__ import annotations

import numpy as np

from amr_slam.fusion.chain import Chain, State
from amr_slam.fusion.covariance import symmetric, usable_covariance, usable_motion, usable_pose
from amr_slam.fusion.ekf import CALIBRATION
from amr_slam.fusion.history import History
from amr_slam.fusion.slipping import LEAP_NS, leaps
from amr_slam.fusion.trail import Trail
from amr_slam.fusion.values import Calibration, FilterEstimate, FilterParams, Innovation, Slip
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Motion, Outcome, SlamPose

# The trail may outgrow its length by this factor before it is cut, as cutting costs.
_SLACK = 1.25


class PoseFilter:
    """The robot's pose in the map, from wheels and delayed fixes. No clock, no thread.

    All instants are the scans': where the wheels' clock was learned to lag behind, the wheels'
    stamps are put right. The pose given at the start counts as its first fix.
    """

    def __init__(
        self, params: FilterParams, stamp_ns: int, map_from_base: Pose2, covariance: Array
    ) -> None:
        """``covariance`` is (3, 3) of (x, y, theta) in the map frame.

        Raises ValueError when pose or covariance are not usable.
        """
        if not (usable_pose(map_from_base) and usable_covariance(covariance)):
            raise ValueError("the first pose must be finite, its covariance positive definite")
        self.params = params
        self._trail = Trail(stamp_ns)
        self._chain = Chain(params, self._trail)
        self._odom_from_base = Pose2.identity()
        self._epoch = 0
        self._innovation: Innovation | None = None
        self._now: State | None = None
        self._leap: Slip | None = None
        self._start(self._chain.begun(stamp_ns, map_from_base, covariance))

    # -- what comes in

    def predict(self, motion: Motion) -> Outcome:
        """Add the newest wheel motion. It must start where the last one ended.

        ACCEPTED, DUPLICATE (same end), LATE (older end), or INVALID (not finite, covariance not
        positive semi-definite, another start); only ACCEPTED changes the filter.
        """
        newest_ns = self.stamp_ns
        if motion.end_ns <= newest_ns:
            return Outcome.DUPLICATE if motion.end_ns == newest_ns else Outcome.LATE
        if motion.start_ns != newest_ns or not usable_motion(motion):
            return Outcome.INVALID
        # Fixes that the wheels had not reached were absorbed by guessing how these would go on.
        known_ns = newest_ns
        self._trail.append(motion)
        if not motion.gap and leaps(self._trail, self.params):
            known_ns = min(known_ns, self._doubt_newest())
        self._odom_from_base = self._odom_from_base @ self._believed(motion.delta)
        self._history.weigh_after(known_ns - self._reach_ns)
        self._now = None
        self._trim()
        return Outcome.ACCEPTED

    def correct(self, fix: SlamPose) -> Outcome:
        """Put a fix in its place in the history.

        ACCEPTED, INFLATED or GATED by its squared Mahalanobis distance to the prediction at its
        stamp; LATE before the history or the last reset, FUTURE ahead of the wheels, DUPLICATE for
        a stamp that is taken, INVALID when not finite or not positive definite. A gated fix stays
        in the history: an earlier fix that comes later may vindicate it, as it would have in order.
        Fixes of another map frame are the caller's to refuse.
        """
        if not (usable_pose(fix.map_from_base) and usable_covariance(fix.covariance)):
            return Outcome.INVALID
        if (refused := self._refused(fix.stamp_ns)) is not None:
            return refused
        self._innovation = self._history.insert(fix)
        self._now = None
        return self._innovation.outcome

    def reset(self, stamp_ns: int, map_from_base: Pose2, covariance: Array) -> Outcome:
        """Jump: from ``stamp_ns`` (which may be past) on, only this pose and the wheels count.

        RESET and a new epoch; or LATE, FUTURE, INVALID as in :meth:`correct`, nothing changed.
        """
        if not (usable_pose(map_from_base) and usable_covariance(covariance)):
            return Outcome.INVALID
        if stamp_ns < self._trail.start_ns:
            return Outcome.LATE
        if self._is_future(stamp_ns):
            return Outcome.FUTURE
        at_ns = min(stamp_ns, self.stamp_ns)
        before = self._history.state_at(max(at_ns, self._history.start_ns))
        known = before.x[CALIBRATION], before.P[CALIBRATION, CALIBRATION]
        self._start(self._chain.begun(at_ns, map_from_base, covariance, known))
        self._epoch += 1
        return Outcome.RESET

    # -- what is known

    @property
    def stamp_ns(self) -> int:
        """The newest wheel sample: "now"."""
        return self._trail.end_ns

    @property
    def map_from_base(self) -> Pose2:
        """The pose now."""
        return self._current().pose

    @property
    def covariance(self) -> Array:
        """(3, 3) read-only, of (x, y, theta) in the map frame, now."""
        return self._current().covariance

    @property
    def odom_from_base(self) -> Pose2:
        """Wheels alone, as calibrated at each moment, since the filter was made: drifts, never
        jumps."""
        return self._odom_from_base

    @property
    def calibration(self) -> Calibration:
        """What is known of the wheels now."""
        last = self._last
        values = last.x[CALIBRATION]
        sigmas = np.sqrt(np.diag(last.P)[CALIBRATION])
        return Calibration(
            travel=float(values[0]),
            yaw=float(values[1]),
            bend_radpm=float(values[2]),
            lag_s=float(values[3]),
            travel_sigma=float(sigmas[0]),
            yaw_sigma=float(sigmas[1]),
            bend_sigma_radpm=float(sigmas[2]),
            lag_sigma_s=float(sigmas[3]),
        )

    @property
    def last_leap(self) -> Slip | None:
        """The last time that the wheels changed their speed faster than a robot can."""
        return self._leap

    @property
    def epoch(self) -> int:
        """Number of resets so far."""
        return self._epoch

    @property
    def last_innovation(self) -> Innovation | None:
        """Of the last fix that :meth:`correct` weighed."""
        return self._innovation

    @property
    def since_fix_s(self) -> float:
        """Time from the last fix taken (its stamp) to now."""
        return 1e-9 * (self.stamp_ns - self._last.fix_ns)

    @property
    def since_fix_m(self) -> float:
        """Path since the last fix taken."""
        reported = self._trail.reported(self.stamp_ns)
        return reported.since(self._last.fix_reported).travel_m

    def pose_at(self, stamp_ns: int) -> tuple[Pose2, Array] | None:
        """Pose and (3, 3) covariance at a past instant from wheels and fixes up to it.

        The prior for a scan. None outside the history; up to ``future_tolerance_s`` ahead of the
        wheels these go on as they last went.
        """
        if stamp_ns < self._history.start_ns or self._is_future(stamp_ns):
            return None
        state = self._history.state_at(stamp_ns)
        return state.pose, state.covariance

    def motion_between(self, start_ns: int, end_ns: int) -> Motion | None:
        """What the wheels alone say between two instants, either of which may be the earlier.

        None when one of them is outside the history (same tolerance as :meth:`pose_at`).
        """
        if min(start_ns, end_ns) < self._trail.start_ns or self._is_future(max(start_ns, end_ns)):
            return None
        start_ns, end_ns = min(start_ns, self.stamp_ns), min(end_ns, self.stamp_ns)
        last = self._last
        composed = self._trail.compose(start_ns, end_ns, last.x[CALIBRATION])
        J = composed.by_calibration
        return Motion(
            start_ns=start_ns,
            end_ns=end_ns,
            delta=composed.delta,
            covariance=symmetric(composed.noise + J @ last.P[CALIBRATION, CALIBRATION] @ J.T),
            gap=self._trail.has_gap(*sorted((start_ns, end_ns))),
        )

    def estimate_at(self, now_ns: int) -> FilterEstimate:
        """The pose carried on to ``now_ns`` at the last speed, at most ``max_extrapolation_s``.

        Its stamp is the instant reached, the newest wheel sample at least. The covariance grows as
        it did over the last steps, and by the acceleration that no wheel sample has shown yet.
        """
        newest_ns = self.stamp_ns
        window_ns = round(1e9 * self.params.twist_window_s)
        since_ns = max(self._trail.start_ns, newest_ns - window_ns)
        twist = np.zeros(3)
        if newest_ns > since_ns:
            twist = self._believed_twist(self._trail.twist_rate(since_ns, newest_ns))
        ahead_ns = max(0, min(now_ns - newest_ns, round(1e9 * self.params.max_extrapolation_s)))
        ahead = (
            self._chain.advanced(self._last, newest_ns + ahead_ns) if ahead_ns else self._current()
        )
        return FilterEstimate(
            stamp_ns=newest_ns + ahead_ns,
            map_from_base=ahead.pose,
            covariance=ahead.covariance,
            odom_from_base=self._odom_from_base @ Pose2.exp(1e-9 * ahead_ns * twist),
            vx_mps=float(twist[0]),
            omega_radps=float(twist[2]),
        )

    # -- how

    def _start(self, begun: State) -> None:
        self._history = History(self._chain, begun)
        self._now = None

    def _is_future(self, stamp_ns: int) -> bool:
        return stamp_ns - self.stamp_ns > 1e9 * self.params.future_tolerance_s

    def _refused(self, stamp_ns: int) -> Outcome | None:
        """Why a fix of this stamp cannot be taken in."""
        if self._is_future(stamp_ns):
            return Outcome.FUTURE
        # By time, not by what happens to be kept: the same data must give the same answer.
        if stamp_ns < max(self._history.start_ns, self.stamp_ns - 1e9 * self.params.history_s):
            return Outcome.LATE
        if self._history.holds(stamp_ns):
            return Outcome.DUPLICATE
        return None

    @property
    def _last(self) -> State:
        """The state after the newest fix."""
        return self._history.last

    @property
    def _reach_ns(self) -> int:
        """How far the wheels' stamps may lie from the scans'."""
        return round(1e9 * self.params.calibration.lag_limit_s)

    def _believed(self, delta: Pose2) -> Pose2:
        """One step of the wheels as calibrated now."""
        if not self._last.x[CALIBRATION].any():
            return delta
        return Pose2.exp(self._believed_twist(delta.log()))

    def _believed_twist(self, twist: Array) -> Array:
        travel, yaw, bend, _ = self._last.x[CALIBRATION]
        x, y, turn = twist
        return np.array([(1.0 + travel) * x, (1.0 + travel) * y, (1.0 + yaw) * turn + bend * x])

    def _doubt_newest(self) -> int:
        """Faster than physics: the last moment's wheels count for little. Returns its beginning."""
        since_ns, now_ns = self.stamp_ns - LEAP_NS, self.stamp_ns
        self._trail.doubt_since(since_ns, self.params.slip_factor)
        self._leap = Slip(
            stamp_ns=now_ns, since_ns=since_ns, forward_m=0.0, left_m=0.0, turn_rad=0.0
        )
        return since_ns

    def _current(self) -> State:
        if self._now is None:
            self._now = self._chain.advanced(self._last, self.stamp_ns)
        return self._now

    def _trim(self) -> None:
        """Forget what is older than the history; when depends on the wheels' stamps alone."""
        history_ns = 1e9 * self.params.history_s
        if self.stamp_ns - self._trail.start_ns <= _SLACK * history_ns:
            return
        cut_ns = self._trail.node_before(self.stamp_ns - round(history_ns))
        if cut_ns == self._trail.start_ns:  # one long gap covers the history
            return
        if cut_ns > self._history.start_ns:
            self._history.forget_before(cut_ns)
        # Wheels whose stamps are early by the lag belong to later instants of the scans.
        self._trail.forget_before(cut_ns - self._reach_ns)
