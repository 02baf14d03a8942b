"""From one fix to the next: predict over the wheels, weigh the fix, absorb or refuse it.

A function of the state before, the wheels' trail and the fix: whoever replays it in the order of
the stamps gets the same states.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from amr_slam.fusion.composing import Composed
from amr_slam.fusion.covariance import floored, sound, symmetric
from amr_slam.fusion.ekf import CALIBRATION, MEASURED, POSE, Ekf, residual, seen
from amr_slam.fusion.slipping import explicable, missed, suspicious, told
from amr_slam.fusion.trail import Reported, Trail
from amr_slam.fusion.values import FilterParams, Innovation
from amr_slam.geometry import Array, Pose2, readonly
from amr_slam.samples import Outcome, SlamPose

# Two refused fixes are one place when the wheels' motion carries one onto the other (99.9 %).
_AGREE_D2: Final = 16.27
# By how much the distrust in wheels that slipped falls with each fix that they agree with.
_FORGIVEN: Final = 3.0
# By how much it grows with each further fix that they do not agree with.
_OUTVOTED: Final = 10.0


def _no_doubt() -> Array:
    return np.zeros((3, 3))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """A snapshot: x (10,) and P (10, 10), which nobody changes in place, the last fix in them, and
    what the fixes so far say of the wheels."""

    stamp_ns: int
    x: Array
    P: Array
    fix_ns: int
    fix_reported: Reported
    """What the wheels had reported by then."""
    distrust: float = 1.0
    """Factor on the wheels' variance."""
    refused: tuple[SlamPose, Reported] | None = None
    """The last fix where it was refused, and what the wheels had reported since one was taken."""
    doubt: Array = field(default_factory=_no_doubt)
    """(3, 3) more covariance while a refused fix may yet turn out to be right."""

    @property
    def pose(self) -> Pose2:
        return Pose2.from_array(self.x[POSE])

    @property
    def covariance(self) -> Array:
        """(3, 3) read-only, of the pose."""
        return readonly(symmetric(self.P[POSE, POSE] + self.doubt))


class Chain:
    """The step from one state to the next."""

    def __init__(self, params: FilterParams, trail: Trail) -> None:
        """``trail``: of the filter, which goes on appending to it."""
        self._params = params
        self._trail = trail
        self._ekf = Ekf(params)

    def begun(
        self,
        stamp_ns: int,
        pose: Pose2,
        covariance: Array,
        known: tuple[Array, Array] | None = None,
    ) -> State:
        """The state at a given or found pose (:meth:`Ekf.start`)."""
        x, P = self._ekf.start(pose, covariance, known)
        return State(
            stamp_ns=stamp_ns,
            x=x,
            P=self._floored(P),
            fix_ns=stamp_ns,
            fix_reported=self._trail.reported(stamp_ns),
        )

    def _composed(self, state: State, stamp_ns: int, pull: Array | None = None) -> Composed:
        """The wheels' motion since a state, under what that state knows of them.

        ``pull``: what a fix says of it (:meth:`Trail.compose`). To learn from noise would make the
        wheels seem known that are not: along a corridor a robot hardly turns, and most of the turn
        that its wheels report is noise.
        """
        if pull is not None:
            pull = state.distrust * pull
        composed = self._trail.compose(state.stamp_ns, stamp_ns, state.x[CALIBRATION], pull)
        unseen_s = 1e-9 * (stamp_ns - self._trail.end_ns) + float(state.x[CALIBRATION][3])
        noise = composed.noise * state.distrust
        if unseen_s > 0.0:
            sigma_m = 0.5 * self._params.acceleration_mps2 * unseen_s**2
            sigma_rad = 0.5 * self._params.turn_acceleration_radps2 * unseen_s**2
            noise = noise + np.diag([sigma_m**2, sigma_m**2, sigma_rad**2])
        return replace(composed, noise=noise)

    def advanced(self, state: State, stamp_ns: int) -> State:
        """Predicted over the composed wheel motion."""
        return self._after(state, stamp_ns, self._composed(state, stamp_ns))

    def _after(self, state: State, stamp_ns: int, motion: Composed) -> State:
        x, P = self._ekf.predicted(state.x, state.P, motion)
        carry = np.eye(3)
        carry[:2, 2] = state.x[1] - x[1], x[0] - state.x[0]
        doubt = carry @ state.doubt @ carry.T
        return replace(state, stamp_ns=stamp_ns, x=x, P=P, doubt=doubt)

    def absorbed(self, last: State, fix: SlamPose) -> tuple[State, Innovation]:
        """The state after a fix, or without it when it is refused. The one place that catches
        numbers gone wrong: the filter goes on from its last good state."""
        motion = self._composed(last, fix.stamp_ns)
        prior = self._after(last, fix.stamp_ns, motion)
        x, P = prior.x, prior.P
        z, R = fix.map_from_base.as_array(), self._params.fix_inflation * fix.covariance
        y = residual(z, seen(x))
        pull = np.linalg.solve(MEASURED @ P @ MEASURED.T + R, y)
        d2 = float(y @ pull)
        outcome, slip, distrust = Outcome.ACCEPTED, None, max(1.0, last.distrust / _FORGIVEN)
        error = missed(Pose2.from_array(seen(x)), fix.map_from_base)
        if last.refused is not None:  # what looked like a wrong fix was the wheels' fault, or not
            slip = told(last.fix_ns, fix.stamp_ns, error)
        if d2 > self._params.gate_d2:
            P_slipped = self._slipped(prior, motion, fix, d2)
            if P_slipped is None:
                refused = self._contradicted(prior, fix, error, y)
                return refused, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=Outcome.GATED)
            P, R = P_slipped, R * min(d2, self._params.gate_d2_inflated) / self._params.gate_d2
            outcome, distrust = Outcome.INFLATED, self._params.slip_factor
            slip = told(last.fix_ns, fix.stamp_ns, error)
        else:
            body = Pose2(0.0, 0.0, float(x[2])).adjoint().T
            motion = self._composed(last, fix.stamp_ns, body @ pull)
            P = self._after(last, fix.stamp_ns, motion).P
        x, P = self._ekf.updated(x, P, z, R)
        if not sound(x, P):
            return prior, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=Outcome.INVALID)
        posterior = State(
            stamp_ns=fix.stamp_ns,
            x=x,
            P=self._floored(P),
            fix_ns=fix.stamp_ns,
            fix_reported=self._trail.reported(fix.stamp_ns),
            distrust=distrust,
        )
        return posterior, Innovation(stamp_ns=fix.stamp_ns, d2=d2, outcome=outcome, slip=slip)

    def _contradicted(self, prior: State, fix: SlamPose, error: Pose2, y: Array) -> State:
        """The state after a fix that was refused. The pose stays; but the wheels may have slipped,
        and the more fixes in a row say so, the less the wheels count: in the end one is taken."""
        reported = self._trail.reported(fix.stamp_ns).since(prior.fix_reported)
        doubt, distrust = prior.doubt, prior.distrust
        if explicable(error, reported) is not None:
            doubt = doubt + 0.5 * np.outer(y, y)  # half and half
        if suspicious(error, reported):
            more = _OUTVOTED * distrust if prior.refused is not None else 1.0
            distrust = min(max(self._params.slip_factor, more), self._params.slip_factor**2)
        return replace(prior, refused=(fix, reported), doubt=doubt, distrust=distrust)

    def _slipped(self, prior: State, motion: Composed, fix: SlamPose, d2: float) -> Array | None:
        """The prior's covariance (10, 10) for wheels that slipped; None where the fix alone is no
        reason to believe that."""
        turned = Pose2(0.0, 0.0, float(prior.x[2])).adjoint()
        if d2 <= self._params.gate_d2_inflated:
            return _widened(prior.P, turned, self._params.slip_factor * motion.noise)
        if prior.refused is None:
            return None
        # Two refused fixes that the wheels carry onto each other, off by no more than wheels can
        # be: they slipped before the first of them.
        earlier, reported = prior.refused
        step = self._trail.compose(earlier.stamp_ns, fix.stamp_ns, prior.x[CALIBRATION])
        expected = earlier.map_from_base @ step.delta
        apart = residual(fix.map_from_base.as_array(), expected.as_array())
        turn = Pose2(0.0, 0.0, expected.theta_rad).adjoint()
        carry = np.eye(3)
        carry[:2, 2] = (
            (earlier.map_from_base.y_m - expected.y_m),
            (expected.x_m - earlier.map_from_base.x_m),
        )
        spread = (
            carry @ earlier.covariance @ carry.T
            + turn @ step.noise @ turn.T
            + fix.covariance
            + self._ekf.map_error
        )
        if float(apart @ np.linalg.solve(spread, apart)) > _AGREE_D2:
            return None
        error = missed(Pose2.from_array(seen(prior.x)), fix.map_from_base)
        reach = explicable(error, reported)
        return None if reach is None else _widened(prior.P, turned, reach)

    def _floored(self, P: Array) -> Array:
        raised = symmetric(P)
        raised[POSE, POSE] = floored(
            raised[POSE, POSE], self._params.floor_xy_m, self._params.floor_yaw_rad
        )
        return raised


def _widened(P: Array, turned: Array, by: Array) -> Array:
    """P (10, 10) with (3, 3) more of the pose in the body's frame."""
    wider = P.copy()
    wider[POSE, POSE] += turned @ by @ turned.T
    return symmetric(wider)
