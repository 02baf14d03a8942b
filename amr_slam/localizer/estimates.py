"""What is told to people: the fused pose at an instant, and what it is worth."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.frozen import FrozenScans
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array
from amr_slam.localizer.fused import FusedPose
from amr_slam.localizer.placing import Placing
from amr_slam.pairing import Pairing
from amr_slam.samples import Candidate, PoseEstimate, State
from amr_slam.suspicions import Suspicions
from amr_slam.trust import LocalizerParams, fault_of, scanner_fault, too_wide

# Candidates that leave the robot, and the least odds that are worth telling.
_SHOWN: Final = 5
_SHOWN_ODDS: Final = 0.01


class Estimates:
    """Reads all that is known of the pose, and changes nothing."""

    def __init__(
        self,
        params: LocalizerParams,
        fused: FusedPose,
        placing: Placing,
        pairing: Pairing,
        frozen: FrozenScans,
        suspicions: Suspicions,
    ) -> None:
        self._params = params
        self._fused = fused
        self._placing = placing
        self._pairing = pairing
        self._frozen = frozen
        self._suspicions = suspicions

    def at(self, now_ns: int) -> PoseEstimate | None:
        """See :meth:`Localizer.estimate`."""
        fusion, wheels, easing = self._fused.filter, self._fused.wheels, self._fused.easing
        if fusion is None or wheels is None:
            return None
        fused = fusion.estimate_at(now_ns)
        wheel_age_s = 1e-9 * (now_ns - wheels.stamp_ns)
        shown, covariance = easing.applied(fused.stamp_ns, fused.map_from_base, fused.covariance)
        beyond_ns = now_ns - fused.stamp_ns
        if beyond_ns > 0 and wheel_age_s > self._params.wheels_silent_s:
            unseen = self._fused.odometry.silence(fused.stamp_ns, now_ns)
            covariance = covariance + unseen.covariance
        since_fix_s = 1e-9 * (now_ns - fusion.stamp_ns) + fusion.since_fix_s
        state = self._state(covariance, since_fix_s, wheel_age_s)
        elsewhere = self._placing.elsewhere
        if elsewhere is not None:
            # The scan is wrong or the pose is: until the next one tells, both are possible.
            covariance = covariance + np.outer(elsewhere, elsewhere)
        result = self._placing.last_result
        if result is not None:
            # All fixes share it: however many there are, they do not average it away.
            covariance = covariance + np.diag([result.map_error_m**2] * 2 + [0.0])
        change = None if result is None else result.change
        return PoseEstimate(
            stamp_ns=fused.stamp_ns,
            map_from_base=shown,
            covariance=covariance,
            odom_from_base=fused.odom_from_base,
            vx_mps=fused.vx_mps,
            omega_radps=fused.omega_radps,
            state=state,
            epoch=easing.epoch,
            epoch_delta=easing.delta,
            error95_m=error95_m(covariance),
            since_fix_s=since_fix_s,
            since_fix_m=fusion.since_fix_m,
            wheel_age_s=wheel_age_s,
            fault=self._fault(now_ns, wheel_age_s)
            or self._fused.events.fault(now_ns, self._params.slip_told_s),
            candidates=self._candidates(fused.stamp_ns) if state is State.AMBIGUOUS else (),
            explained=None if change is None else change.explained,
        )

    def _fault(self, now_ns: int, wheel_age_s: float) -> str | None:
        since_ns = now_ns if self._fused.first_ns is None else self._fused.first_ns
        missing = self._pairing.missing(now_ns, since_ns)
        result, refusals = self._placing.last_result, self._placing.refusals
        faults = (
            self._suspicions.fault and f"scanner configuration: {self._suspicions.fault}",
            scanner_fault(missing, sorted(self._frozen.names)),
            fault_of(result, refusals, wheel_age_s, self._params),
        )
        return "; ".join(fault for fault in faults if fault) or None

    def _candidates(self, stamp_ns: int) -> tuple[Candidate, ...]:
        """The places that are worth telling, moved on by the wheels."""
        fusion, hypotheses = self._fused.running, self._placing.hypotheses
        found_ns, until_ns = hypotheses.stamp_ns, min(stamp_ns, fusion.stamp_ns)
        motion = None if found_ns is None else fusion.motion_between(found_ns, until_ns)
        if motion is None:
            return ()
        return tuple(
            Candidate(map_from_base=one.map_from_base @ motion.delta, odds=one.odds)
            for one in hypotheses.candidates()[:_SHOWN]
            if one.odds >= _SHOWN_ODDS
        )

    def _state(self, covariance: Array, since_fix_s: float, wheel_age_s: float) -> State:
        params, placing = self._params, self._placing
        if placing.last_result is None:
            return State.STARTING
        mismounted = self._suspicions.fault is not None or self._suspicions.doubtful
        if not mismounted and (not placing.located or placing.is_doubtful):
            places = sum(one.odds for one in placing.hypotheses.candidates())
            return State.AMBIGUOUS if places >= 0.5 else State.LOST
        if (
            mismounted
            or too_wide(covariance, params)
            or (since_fix_s > params.lost_s and placing.zone is None)
            or wheel_age_s > params.wheels_lost_s
            or placing.refusals >= params.lost_refusals
        ):
            return State.LOST
        silent = wheel_age_s > params.wheels_silent_s
        doubtful = placing.unconfirmed or placing.elsewhere is not None or placing.zone is not None
        if doubtful or since_fix_s > params.fresh_s or silent:
            return State.ODOMETRY_ONLY
        return State.MAPPING if placing.mode == "mapping" else State.LOCALIZED
