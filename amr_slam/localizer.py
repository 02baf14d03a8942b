"""The one owner of state: samples in, outcomes and pose estimates out.

No thread, no clock, no socket: the daemon, the replay and the tests feed it the same samples and
get the same result. Registration is somebody else's work: :meth:`Localizer.take_request` hands it
out, the result comes back as a sample like any other.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Final

import numpy as np

from amr_slam.agreement import AGREE_D2, agreement_d2, moved
from amr_slam.clouds import CloudParams
from amr_slam.engine import Mode, SlamRequest, SlamResult
from amr_slam.evidence import Answer, Rung, apart
from amr_slam.frozen import FrozenScans
from amr_slam.fusion import Calibration, Easing, FilterParams, PoseFilter, Slip, error95_m
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.hypotheses import Hypotheses
from amr_slam.mounting import Mounting
from amr_slam.odometry import Odometry
from amr_slam.pairing import Pairing, end_ns
from amr_slam.region import Region
from amr_slam.samples import (
    Candidate,
    DriveSample,
    Motion,
    Outcome,
    PoseEstimate,
    Scan,
    SlamPose,
    State,
)
from amr_slam.seeking import Seek
from amr_slam.suspicions import Suspicions
from amr_slam.trust import LocalizerParams, fault_of, scanner_fault, too_wide, whole_map
from amr_slam.wheel_events import WheelEvent, WheelEvents

__all__ = ["Localizer", "LocalizerParams", "Mounting", "Sample"]

Sample = DriveSample | Scan | SlamResult

# Where nothing is known: wider than any hall, well inside what the filter can compute with.
_ANYWHERE = np.diag([1e4**2, 1e4**2, math.pi**2])
_NEW_MAP: Final = (Pose2.identity(), np.diag([1e-4, 1e-4, 1e-6]))
"""A map begins where the robot stands."""
_SHOWN: Final = 5
"""Candidates that leave the robot, and the least odds that are worth telling."""
_SHOWN_ODDS: Final = 0.01


class Localizer:
    """Fuses wheels and registered scans; says at any time what the pose is worth."""

    def __init__(
        self,
        params: LocalizerParams,
        filter_params: FilterParams,
        cloud_params: CloudParams,
        odometry: Odometry,
        mountings: Mapping[str, Mounting],
        mode: Mode,
        start: tuple[Pose2, Array] | None = None,
    ) -> None:
        """``start``: pose and covariance (3, 3) to begin with. None: the origin of the new map
        in mapping mode, anywhere in localization mode."""
        self._params = params
        self._filter_params = filter_params
        self._odometry = odometry
        self._pairing = Pairing(mountings, cloud_params, params.pair_wait_s)
        self._mode: Mode = mode
        if start is None and mode == "mapping":
            start = _NEW_MAP
        self._start = start
        self._located = start is not None
        self._filter: PoseFilter | None = None
        self._wheels: DriveSample | None = None
        self._request: SlamRequest | None = None
        self._busy = False
        self._agreeing: list[SlamPose] = []
        self._left: SlamPose | None = None
        self._easing = Easing(params.easing)
        self._events = WheelEvents(odometry)
        self._hypotheses = Hypotheses(params.tracking)
        self._refusals = 0
        self._elsewhere: Array | None = None
        """The newest scan fits, but not where the robot is thought to be: (3,), from there."""
        self._last_result: SlamResult | None = None
        self._frozen = FrozenScans()
        self._suspicions = Suspicions()
        self._answered_ns: int | None = None
        """Instant of the newest scan that was registered."""
        self._alone = False
        """The cloud handed out last lacks a scanner."""
        self._first_ns: int | None = None
        self._seek: Seek | None = None
        self._unconfirmed = False
        """The pose is what somebody said; no scan has agreed with it yet."""
        self.outcomes: Counter[str] = Counter()
        """How many samples of which kind had which outcome, e.g. ``scan.accepted``."""

    # -- samples in ------------------------------------------------------------------------

    def handle(self, sample: Sample) -> Outcome:
        """Take in one sample. Samples of one kind come in the order of their stamps."""
        if isinstance(sample, Scan):
            kind, outcome = "scan", self._handle_scan(sample)
        elif isinstance(sample, SlamResult):
            kind, outcome = "fix", self._handle_result(sample)
        else:
            kind, outcome = "wheels", self._handle_wheels(sample)
        self.outcomes[f"{kind}.{outcome}"] += 1
        self._prepare_request()
        return outcome

    def take_request(self) -> SlamRequest | None:
        """The cloud to register next, once; its :class:`SlamResult` must be handed back."""
        request, self._request = self._request, None
        return request

    def drop_request(self) -> None:
        """The request handed out last will never be answered (the worker died)."""
        self._busy = False

    # -- what people say -------------------------------------------------------------------

    def objection(self) -> str | None:
        """Why the pose cannot be set now, or None."""
        if self._mode == "mapping":
            return "not while mapping: the new map grows around the pose"
        if self._filter is None:
            return "no wheel sample has come yet"
        return self._suspicions.fault and f"scanner configuration: {self._suspicions.fault}"

    def seek(self, region: Region) -> Seek:
        """Look for the pose in ``region``, as of now; the estimate jumps when scans confirm it.

        Until :class:`Seek` has ended, scans are asked for nothing else. Only without
        :meth:`objection`.
        """
        assert self._filter is not None
        self._seek = Seek(self._filter.stamp_ns, region)
        return self._seek

    def place(self, map_from_base: Pose2, covariance: Array) -> None:
        """The pose is this (covariance (3, 3)): a new epoch. Only without :meth:`objection`.

        ``odometry_only`` until a scan agrees.
        """
        self._end_seek("another command has set the pose")
        self._begin(None, map_from_base, covariance, located=True)
        self._unconfirmed = True

    def forget(self) -> None:
        """Nothing is known: search the whole map. A new epoch. Only without :meth:`objection`."""
        assert self._filter is not None
        self._end_seek("another command has made the robot forget its pose")
        self._begin(None, self._filter.map_from_base, _ANYWHERE, located=False)

    def restart(self, mode: Mode) -> None:
        """Poses refer to another map from now on: a new epoch. ``odom`` goes on."""
        self._end_seek("the map has been changed")
        self._mode = mode
        self._last_result = None
        pose, covariance = _NEW_MAP if mode == "mapping" else (Pose2.identity(), _ANYWHERE)
        self._start = pose, covariance
        self._begin(None, pose, covariance, located=mode == "mapping")

    def _end_seek(self, reason: str) -> None:
        if self._seek is not None and not self._seek.ended:
            self._seek.give_up(reason)
        self._seek = None

    def _begin(
        self, stamp_ns: int | None, map_from_base: Pose2, covariance: Array, *, located: bool
    ) -> Outcome:
        """Jump to a pose of ``stamp_ns`` (None: of now) and forget what spoke for the last one."""
        if self._filter is not None:
            stamp_ns = self._filter.stamp_ns if stamp_ns is None else stamp_ns
            with self._eased(self._filter):
                outcome = self._filter.reset(stamp_ns, map_from_base, covariance)
            if outcome is not Outcome.RESET:
                return outcome
        self._located, self._unconfirmed, self._refusals = located, False, 0
        self._elsewhere = None
        self._left = None
        self._agreeing.clear()
        self._hypotheses.clear()
        # The way from an older scan to the next one says nothing of the scanners' mounting.
        self._answered_ns = None
        return Outcome.RESET

    @contextmanager
    def _eased(self, fusion: PoseFilter) -> Iterator[None]:
        """What changes the filter's pose within enters the published one slowly, or as a jump."""
        now_ns, epoch = fusion.stamp_ns, fusion.epoch
        shown, _ = self._easing.applied(now_ns, fusion.map_from_base, fusion.covariance)
        yield
        self._easing.corrected(now_ns, shown, fusion.map_from_base, is_jump=fusion.epoch > epoch)

    def _handle_wheels(self, sample: DriveSample) -> Outcome:
        if self._filter is None:
            pose, covariance = self._start or (Pose2.identity(), _ANYWHERE)
            self._filter = PoseFilter(self._filter_params, sample.stamp_ns, pose, covariance)
            self._wheels = sample
            self._first_ns = sample.stamp_ns
            return Outcome.ACCEPTED
        if sample.stamp_ns <= self._filter.stamp_ns or self._wheels is None:
            same = sample.stamp_ns == self._filter.stamp_ns
            return Outcome.DUPLICATE if same else Outcome.LATE
        if self._wheels.stamp_ns < self._filter.stamp_ns:
            # The silence was already bridged up to a scan: go on from there.
            motion = self._odometry.silence(self._filter.stamp_ns, sample.stamp_ns)
        else:
            motion = self._odometry.motion(self._wheels, sample)
        self._wheels = sample
        outcome = self._filter.predict(motion)
        leap = self._filter.last_leap
        if leap is not None and leap.stamp_ns == sample.stamp_ns:
            self._events.note_leap(leap, self._params.slip_told_s)
        return outcome

    def _handle_scan(self, scan: Scan) -> Outcome:
        scan = self._pairing.on_wheels_clock(scan)
        outcome = self._pairing.check(scan)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        if self._filter is None:
            return Outcome.FUTURE
        self._bridge_silence(end_ns(scan))
        if self._frozen.repeats(scan, self._filter.motion_between):
            return Outcome.FROZEN
        self._pairing.keep(scan)
        return Outcome.ACCEPTED

    def _bridge_silence(self, until_ns: int) -> None:
        """Wheels that are silent must not stop the scans: carry the filter on, unsure."""
        if self._filter is None:
            return
        if until_ns - self._filter.stamp_ns > round(1e9 * self._params.wheels_silent_s):
            self._filter.predict(self._odometry.silence(self._filter.stamp_ns, until_ns))

    def _handle_result(self, result: SlamResult) -> Outcome:
        self._busy = False
        if result.sought:
            return self._handle_sought(result)
        self._last_result = result
        self._answered_ns = result.stamp_ns
        if self._filter is None:
            return Outcome.UNKNOWN
        self._hear_of_mounting(result)
        if self._suspicions.withholds(result.inspection):
            return Outcome.MISMOUNTED
        if result.fix is None and result.inserted:
            self._refusals, self._elsewhere = 0, None
            return Outcome.ACCEPTED
        fix = self._weakened(result.fix)
        with self._eased(self._filter):
            outcome = self._take_in(result, whole_map(result), fix)
        self._note_slip(result)
        self._elsewhere = self._beside(fix) if outcome is Outcome.GATED else None
        if outcome in {Outcome.ACCEPTED, Outcome.INFLATED, Outcome.RESET}:
            if outcome is not Outcome.RESET:
                self._left = None
            self._refusals, self._unconfirmed = 0, False
            self._agreeing.clear()
            self._hypotheses.clear()
        elif outcome is not Outcome.UNKNOWN or not self._fits_where_expected(result):
            self._refusals += 1
        return outcome

    def _handle_sought(self, result: SlamResult) -> Outcome:
        """A search around a pose that was named says nothing of any other pose."""
        self._answered_ns = None
        if self._filter is None or self._seek is None or self._seek.ended:
            return Outcome.UNKNOWN
        fix = self._weakened(self._seek.hear(result, self._filter.motion_between))
        if fix is None:
            return Outcome.UNKNOWN
        outcome = self._begin(fix.stamp_ns, fix.map_from_base, fix.covariance, located=True)
        if outcome is not Outcome.RESET:
            self._seek.give_up("the scan came too late")
            return outcome
        self._last_result = result
        return outcome

    def _hear_of_mounting(self, result: SlamResult) -> None:
        """A fault that looked like another pose has made that of the fusion wrong: seek anew."""
        found = self._suspicions.hear(result.inspection)
        if found and self._suspicions.by_motion and self._mode == "localization":
            self._located = False
            self._hypotheses.clear()

    def _weakened(self, fix: SlamPose | None) -> SlamPose | None:
        """A fix without the other scanner as a second witness claims less."""
        if fix is None or not self._alone:
            return fix
        return replace(fix, covariance=self._params.alone_inflation * fix.covariance)

    def _take_in(
        self, result: SlamResult, whole_map: Answer | None, fix: SlamPose | None
    ) -> Outcome:
        """A fix near the expected pose is the fusion's; what a search of the whole map found must
        first be the only place left, unless the fusion's own pose agrees with it."""
        assert self._filter is not None
        from_whole_map = whole_map is not None and result.answer is whole_map
        outcome = Outcome.UNKNOWN if fix is None else Outcome.GATED
        if fix is not None and self._located and not (from_whole_map and self._adrift(fix)):
            outcome = self._filter.correct(fix)
        if outcome not in {Outcome.UNKNOWN, Outcome.GATED}:
            return outcome
        if whole_map is not None:
            jumped = self._weigh(result.stamp_ns, whole_map)
            outcome = jumped or outcome
        if fix is not None and not from_whole_map and outcome is Outcome.GATED:
            outcome = self._consider_jump(fix)
        return outcome

    def _beside(self, fix: SlamPose | None) -> Array | None:
        """(3,) from the expected pose to that of a fix which was refused, in the map frame."""
        assert self._filter is not None
        expected = None if fix is None else self._filter.pose_at(fix.stamp_ns)
        if fix is None or expected is None:
            return None
        off = fix.map_from_base.as_array() - expected[0].as_array()
        off[2] = wrap_angle(float(off[2]))
        return off

    def _note_slip(self, result: SlamResult) -> None:
        assert self._filter is not None
        innovation = self._filter.last_innovation
        if innovation is None or innovation.slip is None or innovation.stamp_ns != result.stamp_ns:
            return
        slip = innovation.slip
        self._events.note(slip, self._filter.motion_between(slip.since_ns, slip.stamp_ns))

    def _adrift(self, fix: SlamPose) -> bool:
        """Whether the fusion knows so little that agreeing with it proves nothing."""
        assert self._filter is not None
        expected = self._filter.pose_at(fix.stamp_ns)
        return expected is not None and too_wide(expected[1], self._params)

    def _weigh(self, stamp_ns: int, answer: Answer) -> Outcome | None:
        """Weigh the places found in the whole map; jump to one when no other is left."""
        assert self._filter is not None
        expected = self._filter.pose_at(stamp_ns)
        if expected is None:
            return None
        if self._located and not len(self._hypotheses) and not too_wide(expected[1], self._params):
            self._hypotheses.expect(stamp_ns, *expected)
        self._hypotheses.weigh(stamp_ns, answer, self._filter.motion_between)
        unique = self._hypotheses.unique()
        if unique is None or too_wide(unique[1], self._params):
            return None
        outcome = self._filter.reset(stamp_ns, *unique)
        self._located = self._located or outcome is Outcome.RESET
        return outcome

    def _fits_where_expected(self, result: SlamResult) -> bool:
        """Whether a scan that was not accepted still lies for the most part on the walls around
        the expected pose: then the place has changed, and the robot is not lost."""
        near, change = result.climbed[0], result.change
        if not self._located or self._filter is None or near.best is None or change is None:
            return False
        expected = self._filter.pose_at(result.stamp_ns)
        return (
            near.rung is Rung.RELATIVE
            and expected is not None
            and change.explained >= self._params.explained_share
            and not apart(expected[0], near.best.pose)
        )

    def _consider_jump(self, fix: SlamPose) -> Outcome:
        """A fix that contradicts the estimate: jump once enough of them agree."""
        assert self._filter is not None
        if self._left is not None and self._agrees(self._left, fix):
            # The jump after the outage was to a wrong place.
            return self._jump(fix)
        since_fix_s = self._filter.since_fix_s - 1e-9 * (self._filter.stamp_ns - fix.stamp_ns)
        expected = self._filter.pose_at(fix.stamp_ns)
        # A growing map has no place to be found in: what it does not forget must agree first.
        is_outage = self._mode == "localization" and since_fix_s > self._params.outage_s
        if is_outage and expected is not None:
            outcome = self._jump(fix)
            self._left = SlamPose(
                stamp_ns=fix.stamp_ns, map_from_base=expected[0], covariance=expected[1]
            )
            return outcome
        if self._agreeing and not self._agrees(self._agreeing[-1], fix):
            self._agreeing.clear()
        self._agreeing.append(fix)
        independent = all(refused.relocalized for refused in self._agreeing)
        needed = (
            self._params.agreeing_relocalizations if independent else self._params.agreeing_refusals
        )
        if len(self._agreeing) < needed:
            return Outcome.GATED
        self._note_lies(fix)
        return self._jump(fix)

    def _note_lies(self, fix: SlamPose) -> None:
        """Scans that agree with one another have outvoted the wheels."""
        assert self._filter is not None
        expected = self._filter.pose_at(fix.stamp_ns)
        since_ns = self._filter.stamp_ns - round(1e9 * self._filter.since_fix_s)
        if expected is not None:
            error = expected[0].inverse() @ fix.map_from_base
            slip = Slip(
                stamp_ns=fix.stamp_ns,
                since_ns=since_ns,
                forward_m=error.x_m,
                left_m=error.y_m,
                turn_rad=error.theta_rad,
            )
            self._events.note(slip, self._filter.motion_between(since_ns, fix.stamp_ns))

    def _jump(self, fix: SlamPose) -> Outcome:
        assert self._filter is not None
        self._left = None
        return self._filter.reset(fix.stamp_ns, fix.map_from_base, fix.covariance)

    def _agrees(self, earlier: SlamPose, later: SlamPose) -> bool:
        """Whether the wheels' motion carries one fix onto the other."""
        assert self._filter is not None
        motion = self._filter.motion_between(earlier.stamp_ns, later.stamp_ns)
        if motion is None:
            return False
        expected, covariance = moved(earlier.map_from_base, earlier.covariance, motion)
        spread = covariance + later.covariance
        return agreement_d2(expected, later.map_from_base, spread) <= AGREE_D2

    # -- scans out to registration ---------------------------------------------------------

    def _prepare_request(self) -> None:
        if self._busy or self._filter is None:
            return
        scans = self._pairing.take(self._filter.stamp_ns)
        if not scans:
            return
        merged, late = self._pairing.merged(scans, self._filter)
        if late:
            self.outcomes["scan.late"] += late
        prior = None if merged is None else self._filter.pose_at(merged.cloud.stamp_ns)
        if merged is None or prior is None:
            return
        cloud = merged.cloud
        if len(self._hypotheses):
            self._hypotheses.carry(cloud.stamp_ns, self._filter.motion_between)
        self._request = SlamRequest(
            cloud=cloud,
            map_from_base=prior[0] if self._located else None,
            covariance=prior[1] if self._located else None,
            also=self._hypotheses.poses(),
            views=merged.views,
            motion=self._since_answer(cloud.stamp_ns),
            region=self._region_at(cloud.stamp_ns),
        )
        self._alone = len(merged.views) < len(self._pairing)
        self._busy = True

    def _region_at(self, stamp_ns: int) -> Region | None:
        if self._seek is None or self._filter is None:
            return None
        return self._seek.region_at(stamp_ns, self._filter.motion_between)

    def _since_answer(self, stamp_ns: int) -> Motion | None:
        if self._answered_ns is None or self._filter is None:
            return None
        return self._filter.motion_between(self._answered_ns, stamp_ns)

    # -- estimates out ---------------------------------------------------------------------

    @property
    def last_result(self) -> SlamResult | None:
        """The newest answer of the registration, evidence included."""
        return self._last_result

    @property
    def filter(self) -> PoseFilter | None:
        """The fusion; None before the first wheel sample."""
        return self._filter

    @property
    def calibration(self) -> Calibration | None:
        """What was learned of the wheels; None before the first wheel sample."""
        return None if self._filter is None else self._filter.calibration

    @property
    def wheel_events(self) -> tuple[WheelEvent, ...]:
        """The last times that wheels and scans disagreed, the newest last."""
        return self._events.newest

    def estimate(self, now_ns: int) -> PoseEstimate | None:
        """The fused pose at ``now_ns`` (or as near to it as the wheels allow) and its worth.

        None before the first wheel sample.
        """
        if self._filter is None or self._wheels is None:
            return None
        fused = self._filter.estimate_at(now_ns)
        wheel_age_s = 1e-9 * (now_ns - self._wheels.stamp_ns)
        shown, covariance = self._easing.applied(
            fused.stamp_ns, fused.map_from_base, fused.covariance
        )
        beyond_ns = now_ns - fused.stamp_ns
        if beyond_ns > 0 and wheel_age_s > self._params.wheels_silent_s:
            unseen = self._odometry.silence(fused.stamp_ns, now_ns)
            covariance = covariance + unseen.covariance
        since_fix_s = 1e-9 * (now_ns - self._filter.stamp_ns) + self._filter.since_fix_s
        state = self._state(covariance, since_fix_s, wheel_age_s)
        if self._elsewhere is not None:
            # The scan is wrong or the pose is: until the next one tells, both are possible.
            covariance = covariance + np.outer(self._elsewhere, self._elsewhere)
        change = self._last_result.change if self._last_result is not None else None
        return PoseEstimate(
            stamp_ns=fused.stamp_ns,
            map_from_base=shown,
            covariance=covariance,
            odom_from_base=fused.odom_from_base,
            vx_mps=fused.vx_mps,
            omega_radps=fused.omega_radps,
            state=state,
            epoch=self._easing.epoch,
            epoch_delta=self._easing.delta,
            error95_m=error95_m(covariance),
            since_fix_s=since_fix_s,
            since_fix_m=self._filter.since_fix_m,
            wheel_age_s=wheel_age_s,
            fault=self._fault(now_ns, wheel_age_s)
            or self._events.fault(now_ns, self._params.slip_told_s),
            candidates=self._candidates(fused.stamp_ns) if state is State.AMBIGUOUS else (),
            explained=None if change is None else change.explained,
        )

    def _fault(self, now_ns: int, wheel_age_s: float) -> str | None:
        since_ns = now_ns if self._first_ns is None else self._first_ns
        missing = self._pairing.missing(now_ns, since_ns)
        faults = (
            self._suspicions.fault and f"scanner configuration: {self._suspicions.fault}",
            scanner_fault(missing, sorted(self._frozen.names)),
            fault_of(self._last_result, self._refusals, wheel_age_s, self._params),
        )
        return "; ".join(fault for fault in faults if fault) or None

    def _candidates(self, stamp_ns: int) -> tuple[Candidate, ...]:
        """The places that are worth telling, moved on by the wheels."""
        assert self._filter is not None
        found_ns = self._hypotheses.stamp_ns
        until_ns = min(stamp_ns, self._filter.stamp_ns)
        motion = None if found_ns is None else self._filter.motion_between(found_ns, until_ns)
        if motion is None:
            return ()
        return tuple(
            Candidate(map_from_base=one.map_from_base @ motion.delta, odds=one.odds)
            for one in self._hypotheses.candidates()[:_SHOWN]
            if one.odds >= _SHOWN_ODDS
        )

    def _state(self, covariance: Array, since_fix_s: float, wheel_age_s: float) -> State:
        params = self._params
        if self._last_result is None:
            return State.STARTING
        mismounted = self._suspicions.fault is not None or self._suspicions.doubtful
        if not mismounted and (not self._located or self._doubtful()):
            places = sum(one.odds for one in self._hypotheses.candidates())
            return State.AMBIGUOUS if places >= 0.5 else State.LOST
        if (
            mismounted
            or too_wide(covariance, params)
            or since_fix_s > params.lost_s
            or wheel_age_s > params.wheels_lost_s
            or self._refusals >= params.lost_refusals
        ):
            return State.LOST
        silent = wheel_age_s > params.wheels_silent_s
        doubtful = self._unconfirmed or self._elsewhere is not None
        if doubtful or since_fix_s > params.fresh_s or silent:
            return State.ODOMETRY_ONLY
        return State.MAPPING if self._mode == "mapping" else State.LOCALIZED

    def _doubtful(self) -> bool:
        """Whether more than one scan says that the robot is elsewhere."""
        home_odds = self._hypotheses.home_odds
        return self._refusals > 1 and home_odds is not None and home_odds < 0.5
