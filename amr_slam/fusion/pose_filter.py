"""The filter with a memory: wheels as they come, fixes late and in any order."""

from __future__ import annotations

import bisect
from dataclasses import dataclass

import numpy as np

from amr_slam.fusion.covariance import (
    floored,
    symmetric,
    usable_covariance,
    usable_motion,
    usable_pose,
)
from amr_slam.fusion.ekf import Ekf, residual
from amr_slam.fusion.trail import Trail
from amr_slam.fusion.values import FilterEstimate, FilterParams, Innovation
from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.samples import Motion, Outcome, SlamPose

# The trail may outgrow its length by this factor before it is cut, as cutting costs.
_SLACK = 1.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _State:
    """A snapshot: x (3,) and P (3, 3), which nobody changes in place, and the last fix in them."""

    stamp_ns: int
    x: Array
    P: Array
    fix_ns: int
    fix_travel_m: float


class PoseFilter:
    """The robot's pose in the map, from wheels and delayed fixes. No clock, no thread.

    The pose given at the start counts as its first fix.
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
        self._ekf = Ekf()
        self._trail = Trail(stamp_ns)
        self._odom_from_base = Pose2.identity()
        self._epoch = 0
        self._innovation: Innovation | None = None
        self._now: _State | None = None
        self._start(stamp_ns, map_from_base, covariance)

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
        # Fixes ahead of the wheels were absorbed at the newest sample for want of a better place.
        ahead = bisect.bisect_right(self._fix_stamps_ns, newest_ns)
        self._trail.append(motion)
        self._odom_from_base = self._odom_from_base @ motion.delta
        self._absorb_from(ahead)
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
        place = bisect.bisect_left(self._fix_stamps_ns, fix.stamp_ns)
        self._fixes.insert(place, fix)
        self._fix_stamps_ns.insert(place, fix.stamp_ns)
        self._absorb_from(place)
        self._innovation = self._innovations[place]
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
        self._start(min(stamp_ns, self.stamp_ns), map_from_base, covariance)
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
        return Pose2.from_array(self._current().x)

    @property
    def covariance(self) -> Array:
        """(3, 3) read-only, of (x, y, theta) in the map frame, now."""
        return readonly(self._current().P)

    @property
    def odom_from_base(self) -> Pose2:
        """Wheels alone since the filter was made: drifts, never jumps."""
        return self._odom_from_base

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
        return 1e-9 * (self.stamp_ns - self._current().fix_ns)

    @property
    def since_fix_m(self) -> float:
        """Path since the last fix taken."""
        return self._trail.travelled_m(self.stamp_ns) - self._current().fix_travel_m

    def pose_at(self, stamp_ns: int) -> tuple[Pose2, Array] | None:
        """Pose and (3, 3) covariance at a past instant from wheels and fixes up to it.

        The prior for a scan. None outside the history; up to ``future_tolerance_s`` ahead of the
        wheels it is the pose now.
        """
        if stamp_ns < self._base.stamp_ns or self._is_future(stamp_ns):
            return None
        state = self._state_at(stamp_ns)
        return Pose2.from_array(state.x), readonly(state.P)

    def motion_between(self, start_ns: int, end_ns: int) -> Motion | None:
        """What the wheels alone say between two instants, either of which may be the earlier.

        None when one of them is outside the history (same tolerance as :meth:`pose_at`).
        """
        if min(start_ns, end_ns) < self._trail.start_ns or self._is_future(max(start_ns, end_ns)):
            return None
        return self._trail.between(min(start_ns, self.stamp_ns), min(end_ns, self.stamp_ns))

    def estimate_at(self, now_ns: int) -> FilterEstimate:
        """The pose carried on to ``now_ns`` at the last speed, at most ``max_extrapolation_s``.

        Its stamp is the instant reached, the newest wheel sample at least. The covariance grows as
        it did over the last steps, and by the acceleration that no wheel sample has shown yet.
        """
        newest_ns = self.stamp_ns
        window_ns = round(1e9 * self.params.twist_window_s)
        recent = self._trail.between(max(self._trail.start_ns, newest_ns - window_ns), newest_ns)
        recent_s = 1e-9 * (newest_ns - recent.start_ns)
        twist = recent.delta.log() / recent_s if recent_s > 0.0 else np.zeros(3)
        now = self._current()
        x, P, odom_from_base = now.x, now.P, self._odom_from_base
        ahead_ns = min(now_ns - newest_ns, round(1e9 * self.params.max_extrapolation_s))
        if ahead_ns > 0:
            ahead_s = 1e-9 * ahead_ns
            sigma_m = 0.5 * self.params.acceleration_mps2 * ahead_s**2
            sigma_rad = 0.5 * self.params.turn_acceleration_radps2 * ahead_s**2
            rate = recent.covariance / recent_s if recent_s > 0.0 else np.zeros((3, 3))
            motion = Motion(
                start_ns=newest_ns,
                end_ns=newest_ns + ahead_ns,
                delta=Pose2.exp(ahead_s * twist),
                covariance=ahead_s * rate + np.diag([sigma_m**2, sigma_m**2, sigma_rad**2]),
            )
            x, P = self._ekf.predicted(x, P, motion)
            odom_from_base = odom_from_base @ motion.delta
        return FilterEstimate(
            stamp_ns=newest_ns + max(0, ahead_ns),
            map_from_base=Pose2.from_array(x),
            covariance=readonly(P),
            odom_from_base=odom_from_base,
            vx_mps=float(twist[0]),
            omega_radps=float(twist[2]),
        )

    # -- how

    def _start(self, stamp_ns: int, map_from_base: Pose2, covariance: Array) -> None:
        self._base = _State(
            stamp_ns=stamp_ns,
            x=map_from_base.as_array(),
            P=self._floored(covariance),
            fix_ns=stamp_ns,
            fix_travel_m=self._trail.travelled_m(stamp_ns),
        )
        self._fixes: list[SlamPose] = []
        self._fix_stamps_ns: list[int] = []
        self._posteriors: list[_State] = []
        self._innovations: list[Innovation] = []
        self._now = None

    def _is_future(self, stamp_ns: int) -> bool:
        return stamp_ns - self.stamp_ns > 1e9 * self.params.future_tolerance_s

    def _refused(self, stamp_ns: int) -> Outcome | None:
        """Why a fix of this stamp cannot be taken in."""
        if self._is_future(stamp_ns):
            return Outcome.FUTURE
        # By time, not by what happens to be kept: the same data must give the same answer.
        if stamp_ns < max(self._base.stamp_ns, self.stamp_ns - 1e9 * self.params.history_s):
            return Outcome.LATE
        if stamp_ns == self._base.stamp_ns or stamp_ns in self._fix_stamps_ns:
            return Outcome.DUPLICATE
        return None

    def _current(self) -> _State:
        if self._now is None:
            last = self._posteriors[-1] if self._posteriors else self._base
            self._now = self._advanced(last, self.stamp_ns)
        return self._now

    def _state_at(self, stamp_ns: int) -> _State:
        """State at an instant of the history, with the fixes up to it."""
        fixes = bisect.bisect_right(self._fix_stamps_ns, stamp_ns)
        return self._advanced(self._posteriors[fixes - 1] if fixes else self._base, stamp_ns)

    def _advanced(self, state: _State, stamp_ns: int) -> _State:
        """Predicted over the composed wheel motion."""
        newest_ns = self.stamp_ns
        motion = self._trail.between(min(state.stamp_ns, newest_ns), min(stamp_ns, newest_ns))
        x, P = self._ekf.predicted(state.x, state.P, motion)
        return _State(
            stamp_ns=stamp_ns, x=x, P=P, fix_ns=state.fix_ns, fix_travel_m=state.fix_travel_m
        )

    def _absorb_from(self, first: int) -> None:
        """Weigh and absorb the fixes from the given one on, in the order of their stamps."""
        del self._posteriors[first:], self._innovations[first:]
        for fix in self._fixes[first:]:
            last = self._posteriors[-1] if self._posteriors else self._base
            posterior, innovation = self._absorbed(self._advanced(last, fix.stamp_ns), fix)
            self._posteriors.append(posterior)
            self._innovations.append(innovation)

    def _absorbed(self, prior: _State, fix: SlamPose) -> tuple[_State, Innovation]:
        """The posterior, or the prior again when the fix is refused. The one place that catches
        numbers gone wrong: the filter goes on from its last good state."""
        z, R = fix.map_from_base.as_array(), self.params.fix_inflation * fix.covariance
        y = residual(z, prior.x)
        d2 = float(y @ np.linalg.solve(prior.P + R, y))
        if d2 <= self.params.gate_d2:
            outcome = Outcome.ACCEPTED
        elif d2 <= self.params.gate_d2_inflated:
            outcome, R = Outcome.INFLATED, R * (d2 / self.params.gate_d2)
        else:
            return prior, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=Outcome.GATED)
        x, P = self._ekf.updated(prior.x, prior.P, z, R)
        if not (np.isfinite(x).all() and usable_covariance(P, smallest_sigma=0.0)):
            return prior, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=Outcome.INVALID)
        posterior = _State(
            stamp_ns=fix.stamp_ns,
            x=x,
            P=self._floored(P),
            fix_ns=fix.stamp_ns,
            fix_travel_m=self._trail.travelled_m(min(fix.stamp_ns, self.stamp_ns)),
        )
        return posterior, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=outcome)

    def _floored(self, P: Array) -> Array:
        return floored(symmetric(P), self.params.floor_xy_m, self.params.floor_yaw_rad)

    def _trim(self) -> None:
        """Forget what is older than the history; when depends on the wheels' stamps alone."""
        history_ns = 1e9 * self.params.history_s
        if self.stamp_ns - self._trail.start_ns <= _SLACK * history_ns:
            return
        cut_ns = self._trail.node_before(self.stamp_ns - round(history_ns))
        if cut_ns == self._trail.start_ns:  # one long gap covers the history
            return
        if cut_ns > self._base.stamp_ns:
            self._base = self._state_at(cut_ns)
            gone = bisect.bisect_right(self._fix_stamps_ns, cut_ns)
            del self._fixes[:gone], self._fix_stamps_ns[:gone]
            del self._posteriors[:gone], self._innovations[:gone]
        self._trail.forget_before(cut_ns)
