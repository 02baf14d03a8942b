from __future__ import annotations

import itertools

import numpy as np
import pytest

from amr_slam.geometry import Pose2
from amr_slam.simulation import (
    SCANNERS,
    Coverage,
    free_poses,
    laboratory,
    mapping_poses,
    offices,
)


def test_free_poses_are_free_even_and_look_everywhere() -> None:
    world = laboratory(2)
    poses = free_poses(world, np.random.default_rng(0), 400, 0.4)
    places = np.array([pose.translation for pose in poses])
    assert len(poses) == 400
    assert world.clearance(places).min() >= 0.4
    quarter = np.histogram([pose.theta_rad for pose in poses], 4, (-np.pi, np.pi))[0]
    assert quarter.min() > 70
    again = free_poses(world, np.random.default_rng(0), 400, 0.4)
    assert poses == again
    with pytest.raises(ValueError, match="hardly any"):
        free_poses(world, np.random.default_rng(0), 1, 30.0)


def test_mapping_poses_follow_the_tour_and_look_ahead() -> None:
    poses = mapping_poses(laboratory(2), 0.6)
    for here, there in itertools.pairwise(poses):
        assert here.distance_to(there) < 0.66
    ahead = [(a.inverse() @ b).x_m for a, b in itertools.pairwise(poses)]
    assert np.mean(np.array(ahead) > 0.3) > 0.9


def test_a_mapping_pose_is_covered_and_another_room_is_not() -> None:
    house = offices(1, 200.0)
    mapping = mapping_poses(house, 1.0)
    model = SCANNERS["S300"]
    whole = Coverage(house, mapping, model)
    assert all(whole.share(pose) > 0.999 for pose in mapping[::20])
    begun = Coverage(house, mapping[:1], model)
    shares = [begun.share(pose) for pose in mapping]
    assert shares[0] > 0.999
    assert min(shares) < 0.3
    assert [begun.covers(pose) for pose in mapping] == [share > 0.85 for share in shares]


def test_noise_and_rounding_play_no_part_in_what_is_covered() -> None:
    world = laboratory(3)
    mapping = mapping_poses(world, 2.0)
    poses = free_poses(world, np.random.default_rng(1), 5, 0.4)
    exact, rounded = (Coverage(world, mapping, SCANNERS[name]) for name in ("S300", "LMS111 0.5"))
    for pose in poses:
        assert exact.share(pose) == pytest.approx(rounded.share(pose), abs=0.02)
    nowhere = Pose2(500.0, 500.0, 0.0)
    assert exact.share(nowhere) == 0.0


def test_what_lies_behind_half_a_view_is_not_covered() -> None:
    world, model = laboratory(2), SCANNERS["office 81 m"]
    here = free_poses(world, np.random.default_rng(3), 1, 1.5)[0]
    back = here @ Pose2(0.0, 0.0, np.pi)
    ahead = Coverage(world, [here], model)
    assert ahead.share(here) == 1.0
    assert ahead.share(here @ Pose2(0.0, 0.0, 0.5 * np.pi)) == pytest.approx(0.5, abs=0.1)
    assert ahead.share(back) < 0.1
