"""Maps that other programs made, and our own as others read them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import cloud_at, covered_poses, lab, mapped_lab, world_of
from numpy.typing import NDArray
from PIL import Image

from amr_slam.cli import main
from amr_slam.engine import SlamEngine
from amr_slam.fusion import error95_m
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapError, PointMap, load_map
from amr_slam.map.described import read_description
from amr_slam.map.export import write_occupancy
from amr_slam.map.importing import import_map
from amr_slam.map.occupancy import read_grid
from amr_slam.params import SlamParams
from amr_slam.simulation import World
from amr_slam.slam_request import SlamRequest

NEAR = np.diag([0.05**2, 0.05**2, 0.03**2])

# A room of 6 x 4 m with a niche, a pillar and a partition as thin as a cell, drawn by hand: "#" is
# wall, "." floor, " " nobody knows; (row, how often), from the top. Cells of 0.1 m.
ROWS = [
    ("#" * 62, 1),
    ("#" + "." * 60 + "#", 8),
    ("#" + "." * 45 + "####" + "." * 11 + "#", 4),
    ("#" + "." * 60 + "#", 6),
    ("#" * 20 + "." * 41 + "#", 1),
    ("#" + "." * 60 + "#", 9),
    ("#" + "." * 30 + "#" * 31, 1),
    ("#" + "." * 30 + "#" + " " * 30, 11),
    ("#" * 32 + " " * 30, 1),
]
CELL_M = 0.1


def hand_written() -> NDArray[np.uint8]:
    """(rows, columns) of 0 wall, 205 unknown, 254 floor."""
    grey = {"#": 0, " ": 205, ".": 254}
    lines = [[grey[c] for c in line] for line, times in ROWS for _ in range(times)]
    return np.array(lines, dtype=np.uint8)


def hand_written_world() -> World:
    """Its walls, where the one who drew it saw them: at the edges of floor."""
    y = 4.2 - 0.1  # the upper wall's lower edge
    rows = np.array(
        [
            [0.1, y, 6.1, y], [6.1, y, 6.1, 1.3], [6.1, 1.3, 3.1, 1.3], [3.1, 1.3, 3.1, 0.1],
            [3.1, 0.1, 0.1, 0.1], [0.1, 0.1, 0.1, y],
            [4.6, 3.3, 5.0, 3.3], [5.0, 3.3, 5.0, 2.9], [5.0, 2.9, 4.6, 2.9], [4.6, 2.9, 4.6, 3.3],
            [0.1, 2.3, 2.0, 2.3], [2.0, 2.3, 2.0, 2.2], [2.0, 2.2, 0.1, 2.2],
        ],
        dtype=float,
    )  # fmt: skip
    return world_of(rows)


def write(folder: Path, pixels: NDArray[np.uint8], picture: str, **keys: object) -> Path:
    """Picture and YAML file."""
    told = {"resolution": CELL_M, "origin": "[0.0, 0.0, 0.0]", "negate": 0} | keys
    rows, columns = pixels.shape
    path = folder / picture
    if picture.endswith(".p2.pgm"):
        body = "\n".join(" ".join(map(str, row)) for row in pixels)
        path.write_text(f"P2\n# drawn by hand\n{columns} {rows}\n255\n{body}\n")
    elif picture.endswith(".pgm"):
        path.write_bytes(b"P5\n%d %d\n255\n" % (columns, rows) + pixels.tobytes())
    else:
        Image.fromarray(pixels).save(path)
    described = folder / "map.yaml"
    lines = [f"image: {picture}", *(f"{key}: {value}" for key, value in told.items())]
    described.write_text("\n".join(lines) + "\n")
    return described


def imported(folder: Path, pixels: NDArray[np.uint8], picture: str, **keys: object) -> PointMap:
    return import_map(write(folder, pixels, picture, **keys), "site")


def test_a_robot_is_localized_in_a_map_drawn_by_hand(tmp_path: Path) -> None:
    known = imported(tmp_path, hand_written(), "site.p2.pgm")
    engine, rng = SlamEngine(SlamParams(), known, "localization"), np.random.default_rng(0)
    for truth in (Pose2(1.0, 3.2, 0.3), Pose2(3.5, 2.6, -1.2), Pose2(2.2, 0.8, 2.0)):
        cloud = cloud_at(hand_written_world(), truth, rng, sigma_m=0.01)
        prior = truth @ Pose2(0.06, -0.05, 0.03)
        near = SlamRequest(cloud=cloud, map_from_base=prior, covariance=NEAR)
        anywhere = SlamRequest(cloud=cloud, map_from_base=None, covariance=None)
        for request in (near, anywhere):
            result = engine.update(request)
            assert result.fix is not None, result.answer.reason
            off_m = result.fix.map_from_base.distance_to(truth)
            turn = (truth.inverse() @ result.fix.map_from_base).theta_rad
            assert off_m < CELL_M
            assert abs(turn) < math.radians(2.0)
            assert off_m < error95_m(result.fix.covariance)
            assert result.map_error_m == pytest.approx(0.5 * CELL_M)
            assert error95_m(result.fix.covariance) > 2.4 * 0.5 * CELL_M


def test_both_sides_of_a_thin_wall_are_walls_and_floor_is_floor(tmp_path: Path) -> None:
    target = imported(tmp_path, hand_written(), "site.pgm").target()
    partition = (np.abs(target.points_m[:, 1] - 2.25) < 0.06) & (target.points_m[:, 0] < 1.5)
    partition &= target.points_m[:, 0] > 0.4
    up, down = (target.normals[partition, 1] > 0.9), (target.normals[partition, 1] < -0.9)
    assert np.all(up | down)
    assert min(up.sum(), down.sum()) >= 10
    above, below = (target.points_m[partition][side, 1].mean() for side in (up, down))
    assert below < 2.25 < above
    free = target.lookup.seen_free(np.array([[3.0, 3.0], [1.0, 0.6], [4.0, 0.6], [1.0, 2.25]]))
    assert free.tolist() == [True, True, False, False]


def test_an_oblique_wall_is_straight_though_its_cells_are_stairs(tmp_path: Path) -> None:
    turn = math.radians(22.0)
    row, column = np.mgrid[:80, :80] + 0.5
    off = (column - 40.0) * math.sin(turn) + (row - 40.0) * math.cos(turn)
    pixels = np.where(np.abs(off) < 0.7, 0, np.where(off > 0, 254, 205)).astype(np.uint8)
    target = imported(tmp_path, pixels, "stairs.png").target()
    inner = np.all(np.abs(target.points_m - 4.0) < 3.0, axis=1)
    # Rows count downwards, y upwards.
    normal = np.array([math.sin(turn), -math.cos(turn)])
    distance = (target.points_m[inner] - 4.0) @ normal
    assert np.std(distance) < 0.2 * CELL_M
    assert np.median(target.normals[inner] @ normal) > math.cos(math.radians(3.0))


def turned_keys() -> Iterator[tuple[str, str, dict[str, object]]]:
    for picture in ("a.pgm", "a.p2.pgm", "a.png"):
        yield picture, "trinary", {}
    yield "a.pgm", "scale", {"mode": "scale", "free_thresh": 0.196}
    yield "a.png", "negative", {"negate": 1}
    yield "a.pgm", "raw", {"mode": "raw"}
    yield "a.pgm", "list", {"origin": "\n  - 0.0\n- 0\n  - 0.0  # yaw", "image_ignored": "x"}


@pytest.mark.parametrize(("picture", "kind", "keys"), list(turned_keys()))
def test_all_forms_of_one_map_are_one_map(
    tmp_path: Path, picture: str, kind: str, keys: dict[str, object]
) -> None:
    plain = hand_written()
    pixels = plain
    if kind == "negative":
        pixels = (255 - plain).astype(np.uint8)
    if kind == "raw":
        pixels = np.where(plain == 0, 100, np.where(plain == 254, 0, 255)).astype(np.uint8)
    grid = read_grid(read_description(write(tmp_path, pixels, picture, **keys)))
    np.testing.assert_array_equal(grid.occupied[::-1], plain == 0)
    if kind == "negative":  # grey 50 is nearer to free than 0.25: so do map servers
        assert np.all(grid.free[::-1] >= (plain == 254))
    else:
        np.testing.assert_array_equal(grid.free[::-1], plain == 254)


def test_what_is_transparent_is_unknown_in_scale_and_dark_in_trinary(tmp_path: Path) -> None:
    clear = np.zeros((4, 4, 4), dtype=np.uint8)
    clear[..., :3], clear[:2, :, 3] = 255, 255
    Image.fromarray(clear).save(tmp_path / "clear.png")
    told = "image: clear.png\nresolution: 0.1\norigin: [0, 0, 0]\n"
    (tmp_path / "map.yaml").write_text(told + "mode: scale\n")
    scale = read_grid(read_description(tmp_path / "map.yaml"))
    assert scale.free.sum() == 8
    (tmp_path / "map.yaml").write_text(told + "free_thresh: 0.3\n")
    trinary = read_grid(read_description(tmp_path / "map.yaml"))
    assert trinary.free.sum() == 16  # three quarters white


def test_a_turned_origin_turns_the_map(tmp_path: Path) -> None:
    corner = Pose2(3.0, -2.0, 0.6)
    plain = imported(tmp_path, hand_written(), "a.pgm").target()
    turned = imported(tmp_path, hand_written(), "a.pgm", origin="[3.0, -2.0, 0.6]").target()
    there = corner @ np.array(plain.points_m)
    distance, row = turned.tree.query(there)
    assert np.quantile(distance, 0.98) < 0.01
    agree = np.sum((plain.normals @ corner.rotation.T) * turned.normals[row], axis=1)
    assert np.median(agree) > 0.99
    inside = corner @ np.array([[3.0, 3.0], [1.0, 0.6], [4.0, 0.6]])
    assert turned.lookup.seen_free(inside).tolist() == [True, True, False]


@functools.cache
def taken_elsewhere(seed: int, folder: Path) -> PointMap:
    """A laboratory's map as nav2's map server gets it, and back."""
    write_occupancy(mapped_lab(seed), folder / f"lab{seed}.pgm")
    return import_map(folder / f"lab{seed}.yaml", "again")


def fixes(known: PointMap, seed: int, *, anywhere: bool) -> tuple[Array, Array]:
    """Errors in m and what they were said to be, at poses in a laboratory; inf where none."""
    engine, rng = SlamEngine(SlamParams(), known, "localization"), np.random.default_rng(seed)
    errors, claimed = [], []
    for truth in covered_poses(seed, 6):
        cloud = cloud_at(lab(seed), truth, rng, sigma_m=0.01)
        prior = None if anywhere else truth @ Pose2(*rng.normal(0.0, [0.05, 0.05, 0.03]))
        request = SlamRequest(
            cloud=cloud, map_from_base=prior, covariance=None if anywhere else NEAR
        )
        fix = engine.update(request).fix
        errors.append(math.inf if fix is None else fix.map_from_base.distance_to(truth))
        claimed.append(0.0 if fix is None else error95_m(fix.covariance))
    return np.array(errors), np.array(claimed)


@pytest.mark.parametrize("anywhere", [False, True])
def test_a_map_that_was_exported_and_imported_localizes_within_a_cell(
    tmp_path_factory: pytest.TempPathFactory, anywhere: bool
) -> None:
    again = taken_elsewhere(3, tmp_path_factory.mktemp("elsewhere"))
    errors, claimed = fixes(again, 3, anywhere=anywhere)
    before, _ = fixes(mapped_lab(3), 3, anywhere=anywhere)
    assert np.isfinite(errors).sum() >= np.isfinite(before).sum()
    assert np.all(errors[np.isfinite(errors)] < 0.05)
    assert np.all(errors[np.isfinite(errors)] <= claimed[np.isfinite(errors)])


def test_import_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    described = write(tmp_path, hand_written(), "site.png")
    out = tmp_path / "site.amrmap"
    assert main(["map", "import", str(described), "--out", str(out)]) == 0
    known, _ = load_map(out)
    assert (known.name, known.error_m) == ("site", 0.05)
    assert known.imported is not None
    assert known.imported.source == "site.png"
    assert main(["map", "info", str(out)]) == 0
    assert "walls known to 0.05 m" in capsys.readouterr().out
    # What was imported has the picture's cells when it is exported again.
    assert main(["map", "export", str(out), "--out", str(tmp_path / "again.pgm")]) == 0
    assert "of 0.1 m" in capsys.readouterr().out
    assert main(["map", "export", str(out), "--out", str(tmp_path / "again.g2o")]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "no pose graph" in line


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"resolution": "nan"}, "map.yaml: resolution: nan"),
        ({"resolution": 0.001}, "map.yaml: resolution"),
        ({"resolution": "five"}, "map.yaml: resolution: five"),
        ({"origin": "[0, 0]"}, "map.yaml: origin"),
        ({"origin": "[0, 0, inf]"}, "map.yaml: origin"),
        ({"mode": "fancy"}, "map.yaml: mode: fancy"),
        ({"negate": 2}, "map.yaml: negate: 2"),
        ({"occupied_thresh": 3}, "map.yaml: occupied_thresh"),
        ({"occupied_thresh": 0.1, "free_thresh": 0.2}, "the first must be less"),
        ({"negate": 1, "free_thresh": 0.0, "occupied_thresh": 0.999}, "shows no floor"),
        ({"image": "absent.pgm"}, "absent.pgm: cannot be read"),
        ({"image": "map.yaml"}, "map.yaml: cannot be read as a picture"),
        ({"image": ""}, "map.yaml: image"),
    ],
)
def test_what_cannot_be_imported_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: dict[str, object], complaint: str
) -> None:
    described = write(tmp_path, hand_written(), "site.png", **keys)
    out = tmp_path / "site.amrmap"
    assert main(["map", "import", str(described), "--out", str(out)]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert complaint in line
    assert not out.exists()


def test_pictures_that_claim_too_much_or_break_off_are_refused(tmp_path: Path) -> None:
    for header, complaint in (
        (b"P5\n40000 40000\n255\n", "more than"),
        (b"P5\n62 42\n255\n" + bytes(100), "damaged|cannot be read"),
        (b"P5\n-3 42\n255\n", "damaged|cannot be read"),
        (b"P2\n4 4\n255\n1 2 x", "damaged|cannot be read"),
    ):
        described = write(tmp_path, hand_written(), "site.pgm")
        (tmp_path / "site.pgm").write_bytes(header)
        with pytest.raises(MapError, match=rf"site\.pgm.*({complaint})"):
            import_map(described, "site")


def test_a_picture_of_noise_is_no_map_and_costs_little(tmp_path: Path) -> None:
    noise = np.random.default_rng(0).choice([0, 205, 254], (60, 80)).astype(np.uint8)
    known = imported(tmp_path, noise, "noise.pgm")
    engine = SlamEngine(SlamParams(), known, "localization")
    cloud = cloud_at(hand_written_world(), Pose2(1.0, 3.2, 0.3), np.random.default_rng(0))
    result = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None))
    assert result.fix is None


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.text(max_size=60),
    st.sampled_from(["image", "resolution", "origin", "mode", "negate", "free_thresh"]),
)
def test_any_description_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, value: str, key: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    told = {"image": "a.pgm", "resolution": "0.1", "origin": "[0, 0, 0]"} | {key: value}
    path.write_bytes("\n".join(f"{k}: {v}" for k, v in told.items()).encode(errors="replace"))
    try:
        described = read_description(path)
    except MapError:
        return
    assert math.isfinite(described.resolution_m)
    assert described.map_from_corner.is_finite()
