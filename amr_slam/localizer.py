"""The one owner of state: samples in, outcomes and pose estimates out.

No thread, no clock, no socket: the daemon, the replay and the tests feed it the same samples and
get the same result. Registration is somebody else's work: :meth:`Localizer.take_request` hands it
out, the result comes back as a sample like any other.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.engine import Mode, SlamRequest, SlamResult
from amr_slam.evidence import Verdict
from amr_slam.fusion import FilterParams, PoseFilter, error95_m
from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.odometry import Odometry
from amr_slam.samples import (
    OdometrySample,
    Outcome,
    PoseEstimate,
    Scan,
    SlamPose,
    State,
    WheelSample,
)

Sample = WheelSample | OdometrySample | Scan | SlamResult

# Where nothing is known: wider than any hall, well inside what the filter can compute with.
_ANYWHERE = np.diag([1e4**2, 1e4**2, math.pi**2])
# Two poses agree when their squared Mahalanobis distance is below this (99.9 %, 3 dof).
_AGREE_D2 = 16.27


@dataclass(frozen=True, slots=True, kw_only=True)
class Mounting:
    """Where a scanner sits on the robot."""

    base_from_lidar: Pose2
    upside_down: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizerParams:
    """When scans belong together, and when a pose is no longer worth driving by."""

    pair_wait_s: Annotated[float, Ge(0.0)] = 0.15
    """How long a scan waits for the other scanner's before it is registered alone."""
    fresh_s: Annotated[float, Gt(0.0)] = 5.0
    """A fix older than this (2.5 scan periods) is not fresh: odometry_only."""
    lost_s: Annotated[float, Gt(0.0)] = 20.0
    """Without a fix for this long: lost."""
    lost_axis_m: Annotated[float, Gt(0.0)] = 1.5
    """Three standard deviations along the error ellipse's major axis above this: lost."""
    lost_refusals: Annotated[int, Ge(1)] = 5
    """This many scans in a row without an accepted pose: lost."""
    agreeing_relocalizations: Annotated[int, Ge(1)] = 2
    """Agreeing solutions of the absolute strategy before the pose jumps to them."""
    agreeing_refusals: Annotated[int, Ge(1)] = 3
    """Refused fixes that agree with one another before the filter gives in."""
    wheels_late_s: Annotated[float, Gt(0.0)] = 0.1
    """Wheels silent for this long: said in the fault text."""
    wheels_silent_s: Annotated[float, Gt(0.0)] = 0.5
    """Wheels silent for this long: they no longer count, the robot may be anywhere it could
    have driven to."""
    wheels_lost_s: Annotated[float, Gt(0.0)] = 2.0
    """Wheels silent for this long: lost."""


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
        self._cloud_params = cloud_params
        self._odometry = odometry
        self._mountings = dict(mountings)
        self._mode: Mode = mode
        if start is None and mode == "mapping":
            start = (Pose2.identity(), np.diag([1e-4, 1e-4, 1e-6]))
        self._start = start
        self._located = start is not None
        self._filter: PoseFilter | None = None
        self._wheels: WheelSample | OdometrySample | None = None
        self._pending: dict[str, Scan] = {}
        self._newest_scan_ns: dict[str, int] = {}
        self._request: SlamRequest | None = None
        self._busy = False
        self._agreeing: list[SlamPose] = []
        self._refusals = 0
        self._last_result: SlamResult | None = None
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

    def _handle_wheels(self, sample: WheelSample | OdometrySample) -> Outcome:
        if self._filter is None:
            pose, covariance = self._start or (Pose2.identity(), _ANYWHERE)
            self._filter = PoseFilter(self._filter_params, sample.stamp_ns, pose, covariance)
            self._wheels = sample
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
        return self._filter.predict(motion)

    def _handle_scan(self, scan: Scan) -> Outcome:
        if scan.scanner not in self._mountings:
            return Outcome.INVALID
        newest = self._newest_scan_ns.get(scan.scanner)
        if newest is not None and scan.stamp_ns <= newest:
            return Outcome.DUPLICATE if scan.stamp_ns == newest else Outcome.LATE
        self._newest_scan_ns[scan.scanner] = scan.stamp_ns
        if self._filter is None:
            return Outcome.FUTURE
        self._bridge_silence(_end_ns(scan))
        # Newest wins: an unregistered scan of this scanner is not worth waiting for.
        self._pending[scan.scanner] = scan
        return Outcome.ACCEPTED

    def _bridge_silence(self, until_ns: int) -> None:
        """Wheels that are silent must not stop the scans: carry the filter on, unsure."""
        if self._filter is None:
            return
        if until_ns - self._filter.stamp_ns > round(1e9 * self._params.wheels_silent_s):
            self._filter.predict(self._odometry.silence(self._filter.stamp_ns, until_ns))

    def _handle_result(self, result: SlamResult) -> Outcome:
        self._busy = False
        self._last_result = result
        if result.fix is None or self._filter is None:
            founding = result.inserted
            self._refusals = 0 if founding else self._refusals + 1
            return Outcome.ACCEPTED if founding else Outcome.UNKNOWN
        outcome = Outcome.GATED
        if self._located:
            outcome = self._filter.correct(result.fix)
        if outcome is Outcome.GATED:
            outcome = self._consider_jump(result.fix)
        if outcome in {Outcome.ACCEPTED, Outcome.INFLATED, Outcome.RESET}:
            self._refusals = 0
            self._agreeing.clear()
        else:
            self._refusals += 1
        return outcome

    def _consider_jump(self, fix: SlamPose) -> Outcome:
        """A fix that contradicts the estimate: jump once enough of them agree."""
        assert self._filter is not None
        if self._agreeing and not self._agrees(self._agreeing[-1], fix):
            self._agreeing.clear()
        self._agreeing.append(fix)
        independent = all(refused.relocalized for refused in self._agreeing)
        needed = (
            self._params.agreeing_relocalizations
            if independent or not self._located
            else self._params.agreeing_refusals
        )
        if len(self._agreeing) < needed:
            return Outcome.GATED
        outcome = self._filter.reset(fix.stamp_ns, fix.map_from_base, fix.covariance)
        self._located = self._located or outcome is Outcome.RESET
        return outcome

    def _agrees(self, earlier: SlamPose, later: SlamPose) -> bool:
        """Whether the wheels' motion carries one fix onto the other."""
        assert self._filter is not None
        motion = self._filter.motion_between(earlier.stamp_ns, later.stamp_ns)
        if motion is None:
            return False
        expected = earlier.map_from_base @ motion.delta
        difference = later.map_from_base.as_array() - expected.as_array()
        difference[2] = wrap_angle(float(difference[2]))
        turn = np.eye(3)
        turn[:2, :2] = expected.rotation
        spread = earlier.covariance + later.covariance + turn @ motion.covariance @ turn.T
        return float(difference @ inverse_matrix(spread) @ difference) <= _AGREE_D2

    # -- scans out to registration ---------------------------------------------------------

    def _prepare_request(self) -> None:
        if self._busy or self._filter is None or not self._pending:
            return
        now_ns = self._filter.stamp_ns
        ready = {name: scan for name, scan in self._pending.items() if _end_ns(scan) <= now_ns}
        if not ready:
            return
        oldest_ns = min(_end_ns(scan) for scan in ready.values())
        wait_ns = round(1e9 * self._params.pair_wait_s)
        if len(ready) < len(self._mountings) and now_ns - oldest_ns < wait_ns:
            return
        for name in ready:
            del self._pending[name]
        self._request = self._compose(list(ready.values()))
        self._busy = self._request is not None

    def _compose(self, scans: list[Scan]) -> SlamRequest | None:
        """The scans as one cloud at the newest one's instant, with the fusion's prior there."""
        assert self._filter is not None
        stamp_ns = max(scan.mid_stamp_ns for scan in scans)
        parts: list[tuple[Cloud, Pose2]] = []
        for scan in sorted(scans, key=lambda scan: -scan.mid_stamp_ns):
            to_scan = self._filter.motion_between(stamp_ns, scan.mid_stamp_ns)
            first = self._filter.motion_between(scan.mid_stamp_ns, scan.stamp_ns)
            last = self._filter.motion_between(scan.mid_stamp_ns, _end_ns(scan))
            if to_scan is None or first is None or last is None:
                self.outcomes["scan.late"] += 1
                continue
            mounting = self._mountings[scan.scanner]
            cloud = cloud_from_scan(
                scan,
                mounting.base_from_lidar,
                self._cloud_params,
                upside_down=mounting.upside_down,
                sweep=(first.delta, last.delta) if scan.sweep_s > 0.0 else None,
            )
            parts.append((cloud, to_scan.delta))
        prior = self._filter.pose_at(stamp_ns)
        if not parts or prior is None:
            return None
        return SlamRequest(
            cloud=merge(parts),
            map_from_base=prior[0] if self._located else None,
            covariance=prior[1] if self._located else None,
        )

    # -- estimates out ---------------------------------------------------------------------

    @property
    def last_result(self) -> SlamResult | None:
        """The newest answer of the registration, evidence included."""
        return self._last_result

    @property
    def filter(self) -> PoseFilter | None:
        """The fusion; None before the first wheel sample."""
        return self._filter

    def estimate(self, now_ns: int) -> PoseEstimate | None:
        """The fused pose at ``now_ns`` (or as near to it as the wheels allow) and its worth.

        None before the first wheel sample.
        """
        if self._filter is None or self._wheels is None:
            return None
        fused = self._filter.estimate_at(now_ns)
        wheel_age_s = 1e-9 * (now_ns - self._wheels.stamp_ns)
        covariance = fused.covariance
        beyond_ns = now_ns - fused.stamp_ns
        if beyond_ns > 0 and wheel_age_s > self._params.wheels_silent_s:
            unseen = self._odometry.silence(fused.stamp_ns, now_ns)
            covariance = covariance + unseen.covariance
        since_fix_s = 1e-9 * (now_ns - self._filter.stamp_ns) + self._filter.since_fix_s
        return PoseEstimate(
            stamp_ns=fused.stamp_ns,
            map_from_base=fused.map_from_base,
            covariance=covariance,
            odom_from_base=fused.odom_from_base,
            vx_mps=fused.vx_mps,
            omega_radps=fused.omega_radps,
            state=self._state(covariance, since_fix_s, wheel_age_s),
            epoch=self._filter.epoch,
            error95_m=error95_m(covariance),
            since_fix_s=since_fix_s,
            since_fix_m=self._filter.since_fix_m,
            wheel_age_s=wheel_age_s,
            fault=self._fault(wheel_age_s),
        )

    def _state(self, covariance: Array, since_fix_s: float, wheel_age_s: float) -> State:
        params = self._params
        if self._last_result is None:
            return State.STARTING
        if not self._located:
            verdict = self._last_result.answer.verdict
            return State.LOST if verdict is Verdict.UNKNOWN else State.AMBIGUOUS
        major_m = math.sqrt(float(np.linalg.eigvalsh(covariance[:2, :2])[-1]))
        if (
            3.0 * major_m > params.lost_axis_m
            or since_fix_s > params.lost_s
            or wheel_age_s > params.wheels_lost_s
            or self._refusals >= params.lost_refusals
        ):
            return State.LOST
        if since_fix_s > params.fresh_s or wheel_age_s > params.wheels_silent_s:
            return State.ODOMETRY_ONLY
        return State.MAPPING if self._mode == "mapping" else State.LOCALIZED

    def _fault(self, wheel_age_s: float) -> str | None:
        if wheel_age_s > self._params.wheels_late_s:
            return f"wheels silent for {wheel_age_s:.1f} s"
        if self._refusals and self._last_result is not None:
            return self._last_result.answer.reason
        return None


def _end_ns(scan: Scan) -> int:
    return scan.stamp_ns + round(1e9 * scan.sweep_s)
