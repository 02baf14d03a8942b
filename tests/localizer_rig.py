"""A localizer fed by hand: wheels of a perfect drive, scans, and answers of a registration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from amr_slam.changes import Change
from amr_slam.clouds import CloudParams
from amr_slam.evidence import Answer, Hypothesis, Rung, Verdict, unknown
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Array, Pose2, inverse_matrix
from amr_slam.inspection import Inspection
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.registration.alignment import Alignment
from amr_slam.samples import Outcome, PoseEstimate, Scan, SlamPose, State, WheelSample
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.states import Mode

WHEEL_NS = 20_000_000
DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
PARAMS = LocalizerParams()
SURE = np.diag([1e-4, 1e-4, 1e-6])
UNTOLD = Inspection()


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
        self.noise = np.random.default_rng(0)
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
                ranges_m=3.0 + self.noise.normal(0.0, 0.01, 90),
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

    def found(
        self,
        *places: tuple[Pose2, float],
        verdict: Verdict | None = None,
        stamp_ns: int | None = None,
    ) -> Outcome:
        """A search of the whole map: these places, with these odds, the best one first."""
        stamp_ns = self.now_ns if stamp_ns is None else stamp_ns
        answer = answer_of(*places, verdict=verdict)
        fix = None
        if answer.verdict is Verdict.ACCEPTED:
            fix = SlamPose(
                stamp_ns=stamp_ns, map_from_base=places[0][0], covariance=SURE, relocalized=True
            )
        return self.hand_back(answer, fix, stamp_ns=stamp_ns)

    def sought(self, pose: Pose2 | None) -> Outcome:
        """A search in the region that somebody named."""
        fix = None
        if pose is not None:
            fix = SlamPose(
                stamp_ns=self.now_ns, map_from_base=pose, covariance=SURE, relocalized=True
            )
        return self.hand_back(unknown("only 30% fit", Rung.REGION), fix, sought=True)

    def near(self, pose: Pose2, change: Change, *, verdict: Verdict = Verdict.ACCEPTED) -> Outcome:
        """A scan that was compared at the expected place."""
        found = answer_of((pose, 0.5), verdict=verdict)
        answer = replace(found, rung=Rung.RELATIVE, odds=(), reason="it does not fit")
        fix = SlamPose(stamp_ns=self.now_ns, map_from_base=pose, covariance=SURE)
        accepted = verdict is Verdict.ACCEPTED
        return self.hand_back(answer, fix if accepted else None, change=change)

    def answer(
        self,
        pose: Pose2 | None,
        *,
        relocalized: bool = False,
        inserted: bool = False,
        covariance: Array = SURE,
        stamp_ns: int | None = None,
        moved: Pose2 | None = None,
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
                rung=Rung.RESCUE if relocalized else Rung.RELATIVE,
                candidates=1,
                margin=1.0,
            )
        return self.hand_back(answer, fix, inserted=inserted, stamp_ns=stamp_ns, moved=moved)

    def hand_back(
        self,
        answer: Answer,
        fix: SlamPose | None,
        *,
        inserted: bool = False,
        stamp_ns: int | None = None,
        change: Change | None = None,
        sought: bool = False,
        moved: Pose2 | None = None,
        inspection: Inspection = UNTOLD,
    ) -> Outcome:
        result = SlamResult(
            stamp_ns=self.now_ns if stamp_ns is None else stamp_ns,
            answer=answer,
            climbed=(answer,),
            fix=fix,
            inserted=inserted,
            map_scans=1,
            change=change,
            sought=sought,
            moved=moved,
            inspection=inspection,
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


def answer_of(*places: tuple[Pose2, float], verdict: Verdict | None = None) -> Answer:
    """Of a search of the whole map: accepted where it is 95 % sure, unless told otherwise."""
    sure = bool(places) and places[0][1] >= 0.95
    return Answer(
        verdict=verdict or (Verdict.ACCEPTED if sure else Verdict.AMBIGUOUS),
        rung=Rung.EXHAUSTIVE,
        candidates=len(places),
        places=tuple(hypothesis(pose) for pose, _ in places),
        odds=tuple(odds for _, odds in places),
    )


def hypothesis(pose: Pose2, covariance: Array = SURE) -> Hypothesis:
    return Hypothesis(
        alignment=Alignment(
            target_from_source=pose,
            information=inverse_matrix(covariance),
            converged=True,
            iterations=1,
            inliers=1.0,
            rmse_m=0.01,
        ),
        score=1.0,
        inliers=1.0,
        known=1.0,
        conflict=0.0,
        passes=0.0,
        agreeing=1.0,
        e_psr_m=0.01,
    )
