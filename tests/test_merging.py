"""Two maps of one place become one, or are refused."""

from __future__ import annotations

import functools
import itertools
import math
import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, covered_poses, heading_error_rad, lab, room, tour_poses
from test_cli import amr_slam, error_line

from amr_slam.engine import SlamEngine
from amr_slam.geometry import Array, Pose2, inverse_matrix
from amr_slam.map import (
    Imported,
    LayerKind,
    Layers,
    MapParams,
    PointMap,
    load_map,
    save_map,
)
from amr_slam.map.file import decode, encode
from amr_slam.map.lineage import frame_of
from amr_slam.map.ties import MapTies
from amr_slam.merging import Found, MergeError, MergeParams, Merger, find, join
from amr_slam.params import SlamParams
from amr_slam.simulation import World
from amr_slam.simulation.shapes import box, edges
from amr_slam.slam_request import SlamRequest

PARAMS = SlamParams()
FEW = MergeParams(looks=8, judged=24)
FIRST_FROM_SECOND = Pose2(7.3, -4.1, 1.3)
OTHER_ID = uuid.UUID(int=7)
STEP = np.diag([0.02**2, 0.02**2, 0.006**2])


def mapped(world: World, poses: Sequence[Pose2], seed: int, bend_rad: float = 0.0) -> PointMap:
    """Along true poses, each step believed to be turned by so much more, with its graph."""
    grown, rng = PointMap(MapParams(), f"session{seed}"), np.random.default_rng(seed)
    believed = poses[0]
    for row, pose in enumerate(poses):
        if row:
            step = poses[row - 1].inverse() @ pose
            believed = believed @ step @ Pose2(0.0, 0.0, bend_rad)
        stamp_ns = (row + 1) * 4_000_000_000
        grown.insert(cloud_at(world, pose, rng, sigma_m=0.01, stamp_ns=stamp_ns), believed)
    path = [pose for _, pose in grown.path]
    steps = [(a.inverse() @ b).as_array() for a, b in itertools.pairwise(path)]
    grown.ties = MapTies(
        starts=np.arange(len(steps)),
        ends=np.arange(1, len(steps) + 1),
        deltas=np.array(steps),
        informations=np.tile(inverse_matrix(STEP), (len(steps), 1, 1)),
        loops=np.zeros(len(steps), dtype=np.bool_),
    )
    return grown


def elsewhere(known: PointMap, new_from_old: Pose2) -> PointMap:
    """In another frame, with its graph."""
    there = known.rebuilt([new_from_old @ pose for _, pose in known.path])
    there.ties = known.ties
    return there


@functools.cache
def sessions() -> tuple[PointMap, PointMap]:
    """Both parts of a laboratory, the second bent and in a frame of its own. Nobody may insert."""
    poses = tour_poses(3)[::2]
    first = mapped(lab(3), poses[: round(0.6 * len(poses))], 1)
    second = mapped(lab(3), poses[round(0.4 * len(poses)) :], 2, bend_rad=math.radians(0.1))
    return first, elsewhere(second, FIRST_FROM_SECOND.inverse())


def merged(known: PointMap, other: PointMap, near: Pose2 | None = None) -> tuple[Found, Merger]:
    found = find(known, other, PARAMS, FEW, near, lambda *_: None)
    return found, join(known, other, OTHER_ID, found, PARAMS)


@functools.cache
def laboratory() -> tuple[Found, Merger]:
    return merged(*sessions())


def place(known: PointMap, pose: Pose2, world: World) -> Pose2:
    cloud = cloud_at(world, pose, np.random.default_rng(5), sigma_m=0.01)
    engine = SlamEngine(PARAMS, known, "localization")
    fix = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None)).fix
    assert fix is not None
    return fix.map_from_base


def test_two_sessions_are_one_map_in_the_frame_of_the_first() -> None:
    first, second = sessions()
    found, merger = laboratory()
    whole = merger.map
    assert found.witnesses >= 4
    assert found.overlay.fits > 0.85
    assert len(merger.changes) <= 1
    # Nothing of the first has moved; the second was bent, and is no more.
    assert whole.path[: len(first.path)] == first.path
    assert frame_of(whole) == frame_of(first)
    truth = tour_poses(3)[::2][round(0.4 * len(tour_poses(3)[::2])) :]
    off = [a.distance_to(b) for (_, a), b in zip(whole.path[len(first.path) :], truth, strict=True)]
    rigid = [
        (found.known_from_other @ a).distance_to(b)
        for (_, a), b in zip(second.path, truth, strict=True)
    ]
    assert max(off) < 0.02
    assert max(rigid) > 2.0 * max(off)
    for pose in covered_poses(3, 4):
        fix = place(whole, pose, lab(3))
        assert fix.distance_to(pose) < 0.02
        assert heading_error_rad(fix, pose) < math.radians(0.3)


def test_the_merged_map_has_both_graphs_and_tells_where_it_comes_from() -> None:
    first, second = sessions()
    _, merger = laboratory()
    again, _ = decode(encode(merger.map)[0])
    (told,) = again.merged
    assert (told.map_id, told.name, told.scans) == (str(OTHER_ID), "session2", len(second.path))
    ties, begun = again.ties, len(first.path)
    across = (ties.starts < begun) & (ties.ends >= begun)
    assert across.sum() > 5
    assert ties.loops[across].all()
    assert len(ties) == len(first.ties) + len(second.ties) + across.sum()
    # What a tie says is where the scans are.
    for row in np.flatnonzero(across)[::5]:
        start, end = (again.path[i][1] for i in (ties.starts[row], ties.ends[row]))
        said = start @ Pose2.from_array(ties.deltas[row])
        assert said.distance_to(end) < 0.05


def test_layers_of_both_are_there() -> None:
    first, second = (copied(one) for one in sessions())
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    first.edit(Layers().with_drawn([(LayerKind.ZONE, "dock", square)], "Ada", 1))
    drawn = [(LayerKind.ERASE, "dock", square), (LayerKind.WALL, "gate", square[:2])]
    second.edit(Layers().with_drawn(drawn, "Bob", 2))
    found, _ = laboratory()
    layers = join(first, second, OTHER_ID, found, PARAMS).map.layers
    assert [(one.kind, one.name, one.added.by) for one in layers.active] == [
        ("zone", "dock", "Ada"), ("erase", "dock 2", "Bob"), ("wall", "gate", "Bob"),
    ]  # fmt: skip
    np.testing.assert_allclose(layers.active[0].corners_m, square)
    np.testing.assert_allclose(layers.active[1].corners_m, found.known_from_other @ square)
    assert layers.undone()[0].active[0].name == "dock"


def copied(known: PointMap) -> PointMap:
    return elsewhere(known, Pose2.identity())


def with_box(x_m: float, y_m: float) -> World:
    """A room that looks the same from no two places, and a box."""
    corner = np.array([[8.0, 3.5, 6.5, 3.5], [6.5, 3.5, 6.5, 2.5], [6.5, 2.5, 8.0, 2.5]])
    thing = edges(Pose2(x_m, y_m, 0.2) @ box(0.8, 0.6))
    return replace(room(), segments_m=np.concatenate([room().segments_m, corner, thing]))


def test_what_was_moved_between_the_sessions_is_where_the_second_saw_it() -> None:
    round_about = [Pose2(4.0 + 2.2 * math.cos(a), 3.0 + 1.7 * math.sin(a), 2.0 * a)
                   for a in np.arange(0.0, 6.2, 0.45)]  # fmt: skip
    before = mapped(with_box(3.4, 3.0), round_about, 3)
    after = elsewhere(mapped(with_box(4.8, 3.0), round_about, 4), FIRST_FROM_SECOND.inverse())
    # But for the box, the room looks nearly the same from its other end.
    _, merger = merged(before, after, near=FIRST_FROM_SECOND)
    assert sorted(change.kind for change in merger.changes) == ["gone", "new"]
    points = merger.map.target().points_m
    assert near_box(points, 3.4) == 0
    assert near_box(points, 4.8) > 25
    # It holds when the map is made anew from its rays.
    again = merger.map.rebuilt([pose for _, pose in merger.map.path]).target().points_m
    assert near_box(again, 3.4) <= 2
    assert near_box(again, 4.8) > 25


def near_box(points: Array, x_m: float) -> int:
    return int(np.sum(np.max(np.abs(points - [x_m, 3.0]), axis=1) < 0.55))


def test_another_laboratory_is_refused() -> None:
    first, _ = sessions()
    other = mapped(lab(4), tour_poses(4)[::3], 5)
    with pytest.raises(MergeError, match=r"fits nowhere|is it the same hall|scans are found"):
        merged(first, other)


def test_a_place_that_looks_the_same_from_both_ends_needs_a_hint() -> None:
    poses = [Pose2(1.5 + 0.5 * i, 1.5 + 0.3 * i, 0.5 * i) for i in range(11)]
    known = mapped(room(), poses, 6)
    site = Pose2(400.0, -300.0, 0.5)  # its origin lies far from the room
    other = elsewhere(mapped(room(), poses[::-1], 7), site.inverse())
    with pytest.raises(MergeError, match=r"ambiguous: .*--near X,Y,THETA_DEG"):
        merged(known, other)
    found, _ = merged(known, other, near=site @ Pose2(2.0, 1.0, 0.0))
    way = found.known_from_other
    off = [
        (way @ pose).distance_to(true)
        for (_, pose), true in zip(other.path, poses[::-1], strict=True)
    ]
    assert max(off) < 0.03


def test_a_map_without_scans_is_refused() -> None:
    first, second = sessions()
    imported = copied(second)
    imported.imported = Imported(source="site.pgm", resolution_m=0.05, error_m=0.025)
    with pytest.raises(MergeError, match=r"the second map was imported.*--mapping --hold"):
        merged(first, imported)
    with pytest.raises(MergeError, match="the first map keeps the rays of no scans"):
        merged(PointMap(MapParams()), second)


def test_what_is_in_a_map_already_does_not_join_it_again() -> None:
    _, second = sessions()
    _, merger = laboratory()
    with pytest.raises(MergeError, match=f"{len(second.path)} scans of the second map are in"):
        merged(merger.map, second)


def test_as_people_call_it(tmp_path: Path) -> None:
    first, second = sessions()
    east, west, out = (tmp_path / name for name in ("east.amrmap", "west.amrmap", "hall.amrmap"))
    save_map(first, east)
    save_map(second, west)
    done = amr_slam("map", "merge", east, west, "--out", out, "--near", "7,-4,75")
    assert (done.status, done.err) == (0, "")
    assert "lies at     x +7." in done.out
    assert "merged    with session2" in amr_slam("map", "info", out).out
    assert load_map(out)[0].name == "hall"
    wrong = amr_slam("map", "merge", east, west, "-o", tmp_path / "no.amrmap", "--near", "-9,9,200")
    assert wrong.status == 1
    assert error_line(wrong).startswith(f"{west}, {east}: the second map fits nowhere in ")
    assert not (tmp_path / "no.amrmap").exists()
    assert amr_slam("map", "merge", east, west, "--out", east).status == 2
