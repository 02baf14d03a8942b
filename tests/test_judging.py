from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.judging import ReportedPose, judge
from amr_slam.recording import Trajectory
from amr_slam.samples import State

MS = 1_000_000
TICK_NS = 20 * MS


def truth_at(stamp_ns: int) -> Pose2:
    return Pose2(0.3e-9 * stamp_ns, 0.0, 3.0 + 0.2e-9 * stamp_ns)


# The truth is known every 40 ms from 0 s to 4 s; every second pose lies between two of its poses.
TRUTH = Trajectory(
    stamps_ns=np.arange(101) * 2 * TICK_NS,
    poses=np.array([truth_at(2 * i * TICK_NS).as_array() for i in range(101)]),
)


def right(seq: int) -> ReportedPose:
    return ReportedPose(
        seq=seq,
        stamp_ns=seq * TICK_NS,
        received_ns=seq * TICK_NS + 2 * MS,
        map_from_base=truth_at(seq * TICK_NS),
        error95_m=0.02,
        heading95_rad=math.radians(0.5),
        state=State.MAPPING,
    )


def off(report: ReportedPose, dx_m: float = 0.0, dtheta_deg: float = 0.0) -> ReportedPose:
    pose = report.map_from_base
    moved = Pose2(pose.x_m + dx_m, pose.y_m, pose.theta_rad + math.radians(dtheta_deg))
    return replace(report, map_from_base=moved)


def test_a_right_run_is_trusted() -> None:
    verdict = judge([right(seq) for seq in range(10, 191)], TRUTH)
    assert verdict.is_trustworthy
    assert (verdict.poses, verdict.judged, verdict.lost) == (181, 181, 0)
    assert verdict.position_m is not None
    assert verdict.heading_deg is not None
    # Through the wrap of the heading at pi, too.
    assert verdict.position_m.max < 1e-9
    assert verdict.heading_deg.max < 1e-6
    assert verdict.rate_hz == pytest.approx(50.0)
    assert verdict.rate_deviation == pytest.approx(0.0)
    assert verdict.latency_median_ms == pytest.approx(2.0)
    assert verdict.states == {"mapping": 1.0}
    assert verdict.error95_coverage == 1.0


def test_made_up_errors_are_measured() -> None:
    sizes_m = [0.01 * (i % 5) for i in range(100)]
    verdict = judge([off(right(i), size, 2.0) for i, size in enumerate(sizes_m)], TRUTH)
    assert verdict.position_m is not None
    assert verdict.heading_deg is not None
    assert verdict.position_m.rms == pytest.approx(math.sqrt(6.0) * 0.01)
    assert verdict.position_m.max == pytest.approx(0.04)
    assert verdict.heading_deg.rms == pytest.approx(2.0)
    # 0.02 m as reported: of 0, 1, 2, 3 and 4 cm the first two surely, the third by rounding.
    assert 0.39 < (verdict.error95_coverage or 0.0) < 0.61
    assert verdict.wrong_silently == 0
    text = verdict.text()
    assert "rms 2.45, p95 4.00, max 4.00 cm" in text
    assert "wrong without saying so: 0 of 100" in text


@pytest.mark.parametrize("state", [State.MAPPING, State.LOCALIZED, State.ODOMETRY_ONLY])
@pytest.mark.parametrize(
    "spoil",
    [
        lambda report: off(report, dx_m=0.16),
        lambda report: off(report, dtheta_deg=-5.5),
        lambda report: replace(off(report, dx_m=0.4), error95_m=0.13),
        lambda report: replace(report, map_from_base=Pose2(math.nan, 0.0, 0.0)),
        lambda report: replace(off(report, dx_m=0.1), error95_m=math.nan),
    ],
)
def test_one_pose_wrong_without_saying_so_spoils_the_run(
    state: State, spoil: Callable[[ReportedPose], ReportedPose]
) -> None:
    reports = [replace(right(seq), state=state) for seq in range(100)]
    assert judge(reports, TRUTH).is_trustworthy
    reports[50] = spoil(reports[50])
    verdict = judge(reports, TRUTH)
    assert verdict.wrong_silently == 1
    assert not verdict.is_trustworthy
    assert "wrong without saying so: 1 of 100" in verdict.text()


@pytest.mark.parametrize(
    "say",
    [
        lambda report: replace(report, error95_m=0.4),
        lambda report: replace(report, state=State.LOST),
        lambda report: replace(report, state=State.AMBIGUOUS),
        lambda report: replace(report, state=State.STARTING),
    ],
)
def test_wrong_and_saying_so_is_honest(say: Callable[[ReportedPose], ReportedPose]) -> None:
    reports = [right(seq) for seq in range(100)]
    reports[50] = say(off(reports[50], dx_m=1.0))
    assert judge(reports, TRUTH).is_trustworthy


def test_poses_beyond_the_truth_are_not_judged() -> None:
    verdict = judge([right(seq) for seq in range(190, 211)], TRUTH)
    assert (verdict.poses, verdict.judged) == (21, 11)


def test_nothing_to_drive_by_is_no_success() -> None:
    reports = [replace(right(seq), state=State.LOST) for seq in range(10)]
    verdict = judge(reports, TRUTH)
    assert verdict.judged == 0
    assert not verdict.is_trustworthy
    assert "lost 100.0%" in verdict.text()
    with pytest.raises(ValueError, match="no poses"):
        judge([], TRUTH)


def test_gaps_and_late_poses_show() -> None:
    reports = [right(seq) for seq in range(0, 200, 2)]
    reports[7] = replace(reports[7], received_ns=reports[7].received_ns + 500 * MS)
    verdict = judge(reports, TRUTH)
    assert verdict.lost == 99
    assert verdict.rate_hz == pytest.approx(25.0)
    assert verdict.rate_deviation == pytest.approx(-0.5)
    assert verdict.latency_median_ms == pytest.approx(2.0)
    assert verdict.latency_p99_ms > 2.0
