from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import EXACT, cloud_at, world_of

from amr_slam.arrangement import Rearrangement, View, matrix, pose_of, rearrangements, seen_motion
from amr_slam.clouds import CloudParams, cloud_from_scan, merge
from amr_slam.geometry import Pose2
from amr_slam.simulation import take_scan

poses = st.builds(Pose2, st.floats(-2, 2), st.floats(-2, 2), st.floats(-3, 3))
FRONT, REAR = Pose2(0.3, 0.1, 0.4), Pose2(-0.2, -0.3, 2.5)
VIEWS = (
    View(scanner="front", base_from_lidar=FRONT),
    View(scanner="rear", base_from_lidar=REAR, base_from_then=Pose2(-0.1, 0.02, 0.05)),
)
ROOM = world_of(
    np.array([[-3, -2, 4, -2], [4, -2, 4, 3], [4, 3, 0, 3], [0, 3, 0, 2], [0, 2, -3, 2],
              [-3, 2, -3, -2]], dtype=np.float64)
)  # fmt: skip


def named(views: tuple[View, ...], word: str) -> Rearrangement:
    (found,) = [fault for fault in rearrangements(views) if word in fault.name]
    return found


def test_each_fault_is_named_once() -> None:
    names = [fault.name for fault in rearrangements(VIEWS)]
    assert len(set(names)) == len(names) == 11
    assert "front scanner looks mirrored: upside_down = true?" in names
    hanging = (View(scanner="front", base_from_lidar=FRONT, upside_down=True),)
    names = [fault.name for fault in rearrangements(hanging)]
    assert names[0] == "front scanner looks mirrored: upside_down = false?"
    assert len(names) == 4


def test_undoing_a_swap_puts_the_walls_back() -> None:
    """Both clouds are built with the other scanner's mounting."""
    rng = np.random.default_rng(0)
    params, here = CloudParams(), Pose2.identity()
    parts = []
    for view, true in zip(VIEWS, (REAR, FRONT), strict=True):
        base = here @ view.base_from_then
        scan = take_scan(EXACT, ROOM, base @ true, rng)
        parts.append((cloud_from_scan(scan, view.base_from_lidar, params), view.base_from_then))
    cloud = merge(parts)
    assert np.quantile(np.abs(ROOM.clearance(cloud.points_m)), 0.5) > 0.1
    right = named(VIEWS, "swapped").apply(cloud)
    assert np.abs(ROOM.clearance(right.points_m)).max() < 1e-6
    towards = np.sum((right.origins_m - right.points_m) * right.normals, axis=1)
    assert np.all(towards >= -1e-9)


def test_undoing_a_mirror_puts_the_walls_back() -> None:
    scan = take_scan(EXACT, ROOM, FRONT, np.random.default_rng(0))
    cloud = cloud_from_scan(scan, FRONT, CloudParams(), upside_down=True)
    fault = named(VIEWS[:1], "mirrored")
    assert np.abs(ROOM.clearance(fault.apply(cloud).points_m)).max() < 1e-6
    assert fault.true_base(0) is None
    assert not fault.is_rigid


def test_only_faults_like_another_pose_are_rigid() -> None:
    rigid = [fault.name for fault in rearrangements(VIEWS) if fault.is_rigid]
    assert rigid == ["all scanners look turned by 180 deg: ahead is behind"]
    half_turn = Pose2(0.0, 0.0, math.pi)
    opposite = (VIEWS[0], View(scanner="rear", base_from_lidar=half_turn @ FRONT))
    assert named(opposite, "swapped").is_rigid


@settings(derandomize=True)
@given(pose=poses, other=poses)
def test_matrices_are_poses(pose: Pose2, other: Pose2) -> None:
    assert np.allclose(matrix(pose) @ matrix(other), matrix(pose @ other))
    assert pose_of(matrix(pose)).distance_to(pose) < 1e-9


@settings(derandomize=True)
@given(before=poses, delta=poses)
def test_a_turned_robot_sees_itself_go_the_other_way(before: Pose2, delta: Pose2) -> None:
    """What the wheels call ``delta`` carries the seen pose as :func:`seen_motion` says."""
    fault = named(VIEWS[:1], "turned by 180 deg")
    common = fault.common
    assert common is not None
    seen = [pose @ pose_of(common) for pose in (before, before @ delta)]
    expected = seen[0] @ seen_motion(delta, common)
    assert expected.distance_to(seen[1]) < 1e-6


def test_a_cloud_without_a_fault_stays_as_it_is() -> None:
    cloud = cloud_at(ROOM, Pose2.identity(), np.random.default_rng(0))
    assert len(np.unique(cloud.scanners)) == 2
    fault = named(VIEWS, "front scanner looks turned by 90 deg")
    rear = cloud.scanners == 1
    moved = fault.apply(cloud)
    assert np.allclose(moved.points_m[rear], cloud.points_m[rear])
    assert not np.allclose(moved.points_m[~rear], cloud.points_m[~rear])
