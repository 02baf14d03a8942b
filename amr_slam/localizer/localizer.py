"""Samples in, requests and estimates out: the parts of the localizer put together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

from amr_slam.clouds import CloudParams
from amr_slam.frozen import FrozenScans
from amr_slam.fusion import Calibration, FilterParams, PoseFilter
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer.commands import Commands
from amr_slam.localizer.estimates import Estimates
from amr_slam.localizer.fused import NEW_MAP, FusedPose
from amr_slam.localizer.placing import Placing
from amr_slam.mounting import Mounting
from amr_slam.odometry import Odometry
from amr_slam.pairing import Pairing, end_ns
from amr_slam.region import Region
from amr_slam.samples import DriveSample, Motion, Outcome, PoseEstimate, Scan, SlamPose
from amr_slam.seeking import Seek
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.states import Mode
from amr_slam.suspicions import Suspicions
from amr_slam.trust import LocalizerParams
from amr_slam.wheel_events import WheelEvent

Sample = DriveSample | Scan | SlamResult


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
        if start is None and mode == "mapping":
            start = NEW_MAP
        self._pairing = Pairing(mountings, cloud_params, params.pair_wait_s)
        self._frozen = FrozenScans()
        self._suspicions = Suspicions()
        self._fused = FusedPose(params, filter_params, odometry, start)
        self._placing = Placing(params, self._fused, mode, located=start is not None)
        self._commands = Commands(self._fused, self._placing, self._suspicions)
        self._estimates = Estimates(
            params, self._fused, self._placing, self._pairing, self._frozen, self._suspicions
        )
        self._request: SlamRequest | None = None
        self._busy = False
        self._alone = False
        """The cloud handed out last lacks a scanner."""
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
            kind, outcome = "wheels", self._fused.handle_wheels(sample)
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

    def _handle_scan(self, scan: Scan) -> Outcome:
        scan = self._pairing.on_wheels_clock(scan)
        outcome = self._pairing.check(scan)
        if outcome is not Outcome.ACCEPTED:
            return outcome
        if self._fused.filter is None:
            return Outcome.FUTURE
        self._fused.bridge_silence(end_ns(scan))
        if self._frozen.repeats(scan, self._fused.motion_between):
            return Outcome.FROZEN
        self._pairing.keep(scan)
        return Outcome.ACCEPTED

    def _handle_result(self, result: SlamResult) -> Outcome:
        self._busy = False
        if result.sought:
            return self._handle_sought(result)
        self._placing.last_result = result
        self._placing.answered_ns = result.stamp_ns
        if self._fused.filter is None:
            return Outcome.UNKNOWN
        outcome = self._take_in(result)
        if result.moved is not None:
            self._placing.follow_map(result.stamp_ns, result.moved)
        return outcome

    def _take_in(self, result: SlamResult) -> Outcome:
        self._hear_of_mounting(result)
        if self._suspicions.withholds(result.inspection):
            return Outcome.MISMOUNTED
        if result.fix is None and result.inserted:
            self._placing.refusals, self._placing.elsewhere = 0, None
            return Outcome.ACCEPTED
        return self._placing.take_in(result, self._weakened(result.fix))

    def _handle_sought(self, result: SlamResult) -> Outcome:
        """A search around a pose that was named says nothing of any other pose."""
        self._placing.answered_ns = None
        fix = self._weakened(self._commands.hear(result))
        if fix is None:
            return Outcome.UNKNOWN
        outcome = self._placing.begin(fix.stamp_ns, fix.map_from_base, fix.covariance, located=True)
        if outcome is not Outcome.RESET:
            self._commands.miss()
            return outcome
        self._placing.last_result = result
        return outcome

    def _hear_of_mounting(self, result: SlamResult) -> None:
        """A fault that looked like another pose has made that of the fusion wrong: seek anew."""
        found = self._suspicions.hear(result.inspection)
        if found and self._suspicions.by_motion and self._placing.mode == "localization":
            self._placing.seek_anew()

    def _weakened(self, fix: SlamPose | None) -> SlamPose | None:
        """A fix without the other scanner as a second witness claims less."""
        if fix is None or not self._alone:
            return fix
        return replace(fix, covariance=self._params.alone_inflation * fix.covariance)

    # -- scans out to registration ---------------------------------------------------------

    def _prepare_request(self) -> None:
        fusion = self._fused.filter
        if self._busy or fusion is None:
            return
        scans = self._pairing.take(fusion.stamp_ns)
        if not scans:
            return
        merged, late = self._pairing.merged(scans, fusion)
        if late:
            self.outcomes["scan.late"] += late
        prior = None if merged is None else fusion.pose_at(merged.cloud.stamp_ns)
        if merged is None or prior is None:
            return
        cloud, hypotheses = merged.cloud, self._placing.hypotheses
        if len(hypotheses):
            hypotheses.carry(cloud.stamp_ns, fusion.motion_between)
        self._request = SlamRequest(
            cloud=cloud,
            map_from_base=prior[0] if self._placing.located else None,
            covariance=prior[1] if self._placing.located else None,
            also=hypotheses.poses(),
            views=merged.views,
            motion=self._since_answer(cloud.stamp_ns),
            region=self._commands.region_at(cloud.stamp_ns),
        )
        self._alone = len(merged.views) < len(self._pairing)
        self._busy = True

    def _since_answer(self, stamp_ns: int) -> Motion | None:
        answered_ns = self._placing.answered_ns
        return None if answered_ns is None else self._fused.motion_between(answered_ns, stamp_ns)

    # -- what people say -------------------------------------------------------------------

    def objection(self) -> str | None:
        """Why the pose cannot be set now, or None."""
        return self._commands.objection()

    def seek(self, region: Region) -> Seek:
        """Look for the pose in ``region``, as of now; the estimate jumps when scans confirm it.

        Until :class:`Seek` has ended, scans are asked for nothing else. Only without
        :meth:`objection`.
        """
        return self._commands.seek(region)

    def abandon(self, seek: Seek, reason: str) -> None:
        """End a search that has not ended; one that another has replaced has."""
        self._commands.abandon(seek, reason)

    def place(self, map_from_base: Pose2, covariance: Array) -> None:
        """The pose is this (covariance (3, 3)): a new epoch. Only without :meth:`objection`.

        ``odometry_only`` until a scan agrees.
        """
        self._commands.place(map_from_base, covariance)

    def forget(self) -> None:
        """Nothing is known: search the whole map. A new epoch. Only without :meth:`objection`."""
        self._commands.forget()

    def go_on_mapping(self) -> None:
        """The map in which the robot was localized grows from now on; its pose goes on."""
        self._commands.go_on_mapping()

    def restart(self, mode: Mode, keeps_pose: bool = False) -> None:  # noqa: FBT001 - recorded
        """Poses refer to another map from now on: a new epoch. ``odom`` goes on.

        ``keeps_pose``: it is another version of the map in the same frame, so that the pose, if
        there is one, is still true; ``odometry_only`` until a scan agrees.
        """
        self._commands.restart(mode, keeps_pose=keeps_pose)

    # -- estimates out ---------------------------------------------------------------------

    def estimate(self, now_ns: int) -> PoseEstimate | None:
        """The fused pose at ``now_ns`` (or as near to it as the wheels allow) and its worth.

        None before the first wheel sample.
        """
        return self._estimates.at(now_ns)

    @property
    def last_result(self) -> SlamResult | None:
        """The newest answer of the registration, evidence included."""
        return self._placing.last_result

    @property
    def filter(self) -> PoseFilter | None:
        """The fusion; None before the first wheel sample."""
        return self._fused.filter

    @property
    def calibration(self) -> Calibration | None:
        """What was learned of the wheels; None before the first wheel sample."""
        return None if self._fused.filter is None else self._fused.filter.calibration

    @property
    def wheel_events(self) -> tuple[WheelEvent, ...]:
        """The last times that wheels and scans disagreed, the newest last."""
        return self._fused.events.newest
