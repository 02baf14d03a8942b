"""A localizer fed by hand: wheels of a perfect drive, scans, and answers of a registration."""

from __future__ import annotations

import numpy as np

from amr_slam.clouds import CloudParams
from amr_slam.engine import Mode, SlamRequest, SlamResult
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.samples import Outcome, PoseEstimate, Scan, SlamPose, State, WheelSample
from amr_slam.evidence import Answer, Rung, Verdict, unknown

WHEEL_NS = 20_000_000
DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
PARAMS = LocalizerParams()
SURE = np.diag([1e-4, 1e-4, 1e-6])


class Rig:
    """Time passes only in :meth:`drive`; ``truth`` is where the perfect wheels lead."""

    def __init__(
        self,
        mode: Mode = "localization",
        *,
        start: Pose2 | None = None,
        scanners: tuple[str, ...] = ("front",),
        params: LocalizerParams = PARAMS,
    ) -> None:
        mountings = {
            name: Mounting(base_from_lidar=Pose2(0.2 - 0.4 * i, 0.0, 0.0))
            for i, name in enumerate(scanners)
        }
        self.localizer = Localizer(
            params,
            FilterParams(),
            CloudParams(),
            DRIVE,
            mountings,
            mode,
            None if start is None else (start, SURE),
        )
        self.truth = start or Pose2.identity()
        self.now_ns = 1_000_000_000
        self.wheels_rad = np.zeros(2)
        self.requests: list[SlamRequest] = []
        self.wheels()

    def wheels(self) -> Outcome:
        left, right = self.wheels_rad
        sample = WheelSample(stamp_ns=self.now_ns, left_rad=left, right_rad=right)
        outcome = self.localizer.handle(sample)
        self.collect()
        return outcome

    def drive(self, seconds: float, v_mps: float = 0.3, omega_radps: float = 0.0) -> None:
        """Wheel samples at 50 Hz."""
        for _ in range(round(seconds * 1e9 / WHEEL_NS)):
            self.now_ns += WHEEL_NS
            way, turn = v_mps * 0.02, omega_radps * 0.02
            self.truth = self.truth @ Pose2.exp([way, 0.0, turn])
            self.wheels_rad += np.array([way - 0.25 * turn, way + 0.25 * turn]) / 0.1
            self.wheels()

    def pause(self, seconds: float) -> None:
        """The wheels are silent, the robot stands."""
        self.now_ns += round(seconds * 1e9)

    def scan(self, scanner: str = "front", *, ago_s: float = 0.0) -> Outcome:
        outcome = self.localizer.handle(
            Scan(
                scanner=scanner,
                stamp_ns=self.now_ns - round(1e9 * ago_s),
                ranges_m=np.full(90, 3.0),
                angle_min_rad=-0.4,
                angle_step_rad=0.01,
            )
        )
        self.collect()
        return outcome

    def collect(self) -> None:
        request = self.localizer.take_request()
        if request is not None:
            self.requests.append(request)

    def answer(
        self,
        pose: Pose2 | None,
        *,
        relocalized: bool = False,
        inserted: bool = False,
        covariance: Array = SURE,
        stamp_ns: int | None = None,
    ) -> Outcome:
        """The registration's word on this instant: a pose, or None where it found none."""
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        fix = None
        answer = unknown("no such place")
        if pose is not None:
            fix = SlamPose(
                stamp_ns=stamp_ns,
                map_from_base=pose,
                covariance=covariance,
                relocalized=relocalized,
            )
            answer = Answer(
                verdict=Verdict.ACCEPTED,
                rung=Rung.ABSOLUTE if relocalized else Rung.RELATIVE,
                candidates=1,
                margin=1.0,
            )
        result = SlamResult(
            stamp_ns=stamp_ns,
            answer=answer,
            climbed=(answer,),
            fix=fix,
            inserted=inserted,
            map_scans=1,
            map_points=1,
        )
        outcome = self.localizer.handle(result)
        self.collect()
        return outcome

    @property
    def estimate(self) -> PoseEstimate:
        estimate = self.localizer.estimate(self.now_ns)
        assert estimate is not None
        return estimate

    def state(self) -> State:
        return self.estimate.state

    @property
    def off_m(self) -> float:
        return self.estimate.map_from_base.distance_to(self.truth)
