"""A map that grows beside a part that is held."""

from __future__ import annotations

import numpy as np
from labs import cloud_at, room, world_of

from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap, moved
from amr_slam.map.held import Held

# Two rooms and a door between them.
INNER = np.array([[6.0, 0.0, 6.0, 2.5], [6.0, 3.5, 6.0, 6.0]])
WORLD = world_of(np.concatenate([room(12.0, 6.0).segments_m, INNER]))
LEFT = (Pose2(1.5, 1.5, 0.4), Pose2(4.0, 4.5, -1.0), Pose2(4.5, 1.5, 2.0))
RIGHT = (Pose2(7.5, 3.0, 0.0), Pose2(10.0, 1.5, 2.0), Pose2(9.5, 4.5, -2.0))


def grown(poses: tuple[Pose2, ...], known: PointMap, held: Held | None, off: Pose2) -> None:
    rng = np.random.default_rng(len(known.path))
    for pose in poses:
        cloud = cloud_at(WORLD, pose, rng, sigma_m=0.01)
        (known if held is None else held).insert(cloud, pose @ off)


def points(known: PointMap) -> Array:
    return np.asarray(known.target().points_m)


def test_held_part_never_changes_and_the_new_part_joins() -> None:
    known = PointMap(MapParams())
    grown(LEFT, known, None, Pose2.identity())
    walls, space = known.walls.keys.copy(), known.space.keys.copy()
    sums, counts = known.walls.sums.copy(), known.space.sums.copy()
    before = points(known)
    # Poses that are a little wrong would double the walls of a map that takes all in.
    grown(RIGHT, known, Held(known), Pose2(0.05, 0.05, 0.01))
    assert np.array_equal(known.walls.sums[known.walls.find(walls)], sums)
    assert np.array_equal(known.space.sums[known.space.find(space)], counts)
    after = points(known)
    assert set(map(tuple, before)) <= set(map(tuple, after))
    left = after[after[:, 0] < 5.5]
    assert len(left) == int((before[:, 0] < 5.5).sum())
    # The far walls of the other room are there, from one end to the other.
    far = after[after[:, 0] > 11.8]
    assert len(far) > 80
    assert np.ptp(far[:, 1]) > 5.0


def test_a_held_map_moved_is_the_same_map() -> None:
    known = PointMap(MapParams())
    grown(LEFT, known, None, Pose2.identity())
    grown(RIGHT, known, Held(known), Pose2(0.05, 0.05, 0.01))
    again = points(moved(known, Pose2.identity()))
    before = points(known)
    off = np.hypot(*(before[:, None] - again).transpose(2, 0, 1)).min(axis=1)
    assert np.quantile(off, 0.99) < 0.03


def test_what_shows_nothing_new_leaves_the_walls_alone() -> None:
    known = PointMap(MapParams())
    grown(LEFT, known, None, Pose2.identity())
    before = points(known)
    grown(LEFT, known, Held(known), Pose2(0.1, 0.0, 0.02))
    assert np.array_equal(points(known), before)
