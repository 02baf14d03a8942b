from __future__ import annotations

import functools
import hashlib
import json
import math
import struct
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, room

from amr_slam.cli import main
from amr_slam.geometry import Array, Pose2
from amr_slam.map import (
    LayerError,
    LayerKind,
    Layers,
    MapError,
    MapParams,
    PointMap,
    load_map,
    moved,
    save_map,
)
from amr_slam.map.file import MAGIC, decode, encode
from amr_slam.map.layers import MAX_CORNERS, MAX_LAYERS

CORNER = np.array([[7.0, 5.0], [9.0, 5.0], [9.0, 7.0], [7.0, 7.0]])
ACROSS = np.array([[4.03, 0.5], [4.03, 5.5]])
ERASE, WALL, ZONE = LayerKind.ERASE, LayerKind.WALL, LayerKind.ZONE


@functools.cache
def bare() -> PointMap:
    """A room of 8 x 6 m; nobody may change it."""
    grown = PointMap(MapParams(), "room")
    for i, x in enumerate((2.0, 4.0, 6.0)):
        pose = Pose2(x, 3.0, 0.3 * i)
        grown.insert(cloud_at(room(), pose, np.random.default_rng(i), stamp_ns=i), pose)
    return grown


def again() -> PointMap:
    return bare().rebuilt([pose for _, pose in bare().path])


def drawn(*layers: tuple[LayerKind, Array]) -> PointMap:
    known = again()
    told = [(kind, f"{kind}-{i}", corners) for i, (kind, corners) in enumerate(layers)]
    known.edit(Layers().with_drawn(told, "Ada", 1_000))
    return known


def near(points: Array, place: Array | tuple[float, float], reach_m: float = 0.5) -> int:
    return int(np.sum(np.hypot(*(points - place).T) < reach_m))


@pytest.mark.parametrize("centre", [None, Pose2(4.0, 3.0, 0.0)])
def test_layers_change_what_counts_and_not_what_was_seen(centre: Pose2 | None) -> None:
    known = drawn((ERASE, CORNER), (WALL, ACROSS))
    seen, counts = bare().target(centre), known.target(centre)
    assert near(seen.points_m, (8.0, 6.0)) > 10
    assert near(counts.points_m, (8.0, 6.0)) == 0
    assert near(seen.points_m, (4.0, 3.0)) == 0
    assert near(counts.points_m, (4.0, 3.0)) >= 40  # both sides of it
    assert not counts.lookup.seen_free(np.array([[4.03, 3.0]]))[0]
    assert seen.lookup.seen_free(np.array([[4.03, 3.0]]))[0]
    assert len(known.walls) == len(again().walls)
    # ... and the next scan that sees the corner does not bring it back.
    known.insert(cloud_at(room(), Pose2(6.0, 4.0, 0.0), np.random.default_rng(3)), Pose2(6, 4, 0))
    assert near(known.target(centre).points_m, (8.0, 6.0)) == 0


def test_no_robot_is_looked_for_in_a_drawn_wall() -> None:
    places = drawn((WALL, ACROSS)).places(0.5, 0.3)
    assert np.all(np.abs(places[(places[:, 1] > 0.5) & (places[:, 1] < 5.5), 0] - 4.0) > 0.3)
    assert len(places) < len(bare().places(0.5, 0.3))


def test_a_zone_is_no_landmark_and_stays_on_the_map_for_people() -> None:
    known = drawn((ZONE, CORNER))
    assert near(known.target().points_m, (8.0, 6.0)) == 0
    assert not known.target().lookup.seen_free(np.array([[7.5, 5.5]]))[0]
    assert near(known.surfaces().points_m, (8.0, 6.0)) > 10


def test_layers_go_with_the_map_into_another_frame() -> None:
    by = Pose2(10.0, -3.0, 0.7)
    there = moved(drawn((ERASE, CORNER)), by)
    moved_to = by @ np.array([[8.0, 6.0], [0.0, 0.0]])
    assert near(there.target().points_m, moved_to[0]) == 0
    assert near(there.target().points_m, moved_to[1]) > 10


def test_layers_come_back_from_the_file_and_are_part_of_its_identity(tmp_path: Path) -> None:
    known = drawn((ERASE, CORNER), (WALL, ACROSS))
    map_id = save_map(known, tmp_path / "room.amrmap")
    loaded, same_id = load_map(tmp_path / "room.amrmap")
    assert map_id == same_id != encode(again())[1]
    assert [replace_corners(one) for one in loaded.layers.active] == [
        replace_corners(one) for one in known.layers.active
    ]
    np.testing.assert_array_equal(loaded.target().points_m, known.target().points_m)
    known.edit(Layers())
    assert encode(known)[1] == encode(again())[1]


def replace_corners(one: object) -> tuple[object, ...]:
    fields = ("kind", "layer_id", "name", "added", "removed")
    corners = getattr(one, "corners_m").tolist()  # noqa: B009 - any layer
    return (*(getattr(one, name) for name in fields), corners)


@pytest.mark.parametrize(
    ("kind", "corners", "complaint"),
    [
        (ERASE, CORNER[[0, 2, 1, 3]], "edges cross"),
        (ZONE, CORNER[:2], "needs 3"),
        (WALL, ACROSS[:1], "needs 2"),
        (WALL, ACROSS[[0, 0]], "all its points are one"),
        (ERASE, CORNER[[0, 1, 0]] + [[0, 0], [0, 0], [1e-9, 0]], "edges cross|no area"),
        (ERASE, CORNER * math.nan, "numbers"),
        (ERASE, CORNER * 1e6, "100 km"),
        (WALL, np.zeros((MAX_CORNERS + 1, 2)), "needs 2"),
        (WALL, np.array([[0.0, 0.0], [9e4, 0.0]]), "km of walls"),
    ],
)
def test_layers_that_cannot_be_are_refused(kind: LayerKind, corners: Array, complaint: str) -> None:
    with pytest.raises(LayerError, match=complaint):
        Layers().with_drawn([(kind, "x", corners)], "Ada", 1)


def test_what_was_removed_makes_room_and_what_is_there_does_not() -> None:
    layers = Layers().with_drawn([(WALL, f"w{i}", ACROSS + i) for i in range(MAX_LAYERS)], "Ada", 1)
    with pytest.raises(LayerError, match="more than a map may have"):
        layers.with_drawn([(WALL, "more", ACROSS)], "Ada", 2)
    layers = layers.without(["w3"], "Ada", 3).without(["w0"], "Ada", 4)
    layers = layers.with_drawn([(WALL, "more", ACROSS)], "Ada", 5)
    names = [one.name for one in layers.everything]
    assert ("w0" in names, "w3" in names, len(names)) == (True, False, MAX_LAYERS)


@pytest.mark.parametrize(
    "damage",
    [
        3,
        [3],
        [{}],
        {"kind": "bomb"},
        {"uuid": "1"},
        {"name": "a\nb"},
        {"name": 3},
        {"points_m": [[0, 1], [2, 10**400], [3, 4]]},
        {"points_m": [[0, 0], [1, 1], [1, 0], [0, 1]]},
        {"added": None},
        {"added": {"step": 0, "by": "x", "at_s": 1}},
    ],
)
def test_damaged_layers_in_a_file_are_refused(damage: object) -> None:
    good = {
        "kind": "erase", "uuid": "6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11", "name": "a",
        "points_m": [[0, 0], [1, 0], [1, 1]], "added": {"step": 1, "by": "x", "at_s": 1},
        "removed": None,
    }  # fmt: skip
    assert len(decode(with_layers([good]))[0].layers) == 1
    with pytest.raises(MapError, match="makes no sense"):
        decode(with_layers([good | damage] if isinstance(damage, dict) else damage))


def with_layers(told: object) -> bytes:
    """A file that says so, with a right checksum."""
    data = encode(PointMap(MapParams()))[0]
    (length,) = struct.unpack_from("<I", data, len(MAGIC))
    start = len(MAGIC) + 4
    header = json.loads(data[start : start + length]) | {"layers": told}
    text = json.dumps(header).encode()
    body = MAGIC + struct.pack("<I", len(text)) + text + data[start + length : -32]
    return body + hashlib.sha256(body).digest()


def test_layers_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "room.amrmap"
    first = save_map(bare(), path)
    edit = ["map", "edit", str(path)]

    def names() -> list[str]:
        return [one.name for one in load_map(path)[0].layers.active]

    assert main([*edit, "zone", "-1,-1", "9,-1", "9,2", "--name", "docks", "--by", "Ada"]) == 0
    assert load_map(tmp_path / "room.amrmap.1")[1] == first
    assert main([*edit, "wall", "4,0.5", "4,5.5"]) == 0
    assert names() == ["docks", "wall-1"]
    capsys.readouterr()
    assert main([*edit, "list", "--json"]) == 0
    (tmp_path / "layers.json").write_text(capsys.readouterr().out)
    assert main([*edit, "remove", "docks", "wall-1"]) == 0
    assert names() == []
    assert main([*edit, "undo"]) == 0
    assert names() == ["docks", "wall-1"]
    for step in ("undo", "undo"):
        assert main([*edit, step]) == 0
    assert names() == []
    assert main([*edit, "undo"]) == 1
    assert main([*edit, "draw", str(tmp_path / "layers.json")]) == 0
    assert names() == ["docks", "wall-1"]
    capsys.readouterr()
    assert main([*edit, "erase", "0,0", "2,2", "2,0", "0,2"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "edges cross" in line
    (tmp_path / "layers.json").write_text('{"layers": [{"kind": "wall", "points_m": [[1, "2"]]}]}')
    assert main([*edit, "draw", str(tmp_path / "layers.json")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "layer 1: points must be pairs" in line
    assert names() == ["docks", "wall-1"]
