from __future__ import annotations

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.samples import State
from amr_slam.simulation import MAX_POSE_AGE_S, CautiousPilot

ANGLES = np.linspace(0.0, 2.0 * np.pi, 252, endpoint=False)
RING = 2.0 * np.column_stack([np.sin(ANGLES), 1.0 - np.cos(ANGLES)])


@pytest.mark.parametrize("state", list(State))
def test_drives_only_by_poses_that_may_be_driven_by(state: State) -> None:
    command = CautiousPilot(RING).command(Pose2.identity(), state, 0.01)
    may_drive = state in {State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY}
    assert (command != (0.0, 0.0)) is may_drive


@pytest.mark.parametrize("age_s", [MAX_POSE_AGE_S + 0.01, 100.0, -1.0, float("nan")])
def test_stands_when_the_pose_is_old_and_goes_on_with_a_fresh_one(age_s: float) -> None:
    pilot = CautiousPilot(RING)
    assert pilot.command(Pose2.identity(), State.MAPPING, age_s) == (0.0, 0.0)
    assert pilot.command(Pose2.identity(), State.MAPPING, 0.02) != (0.0, 0.0)


def test_follows_the_way() -> None:
    pilot = CautiousPilot(RING)
    pose, way = Pose2.identity(), []
    for _ in range(2500):
        v_mps, omega_radps = pilot.command(pose, State.LOCALIZED, 0.02)
        pose = pose @ Pose2.exp([0.02 * v_mps, 0.0, 0.02 * omega_radps])
        way.append(pose.translation)
    radii = np.hypot(*(np.array(way) - [0.0, 2.0]).T)
    assert np.abs(radii - 2.0).max() < 0.1
    assert np.ptp(np.array(way)[:, 1]) > 3.9
