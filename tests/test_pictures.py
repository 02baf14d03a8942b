from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import matplotlib.image as mpl_image
import numpy as np
import pytest

from amr_slam.clouds import CloudParams, cloud_from_scan
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.pictures import Georeference, MapPanel, draw_map, map_panels, style
from amr_slam.recording import Trajectory
from amr_slam.simulation import ScannerModel, World, take_scan


def room() -> PointMap:
    """8 m x 5 m, seen from inside: walls at x = -3 and 5, y = -2 and 3."""
    corners = np.array([[-3.0, -2.0], [5.0, -2.0], [5.0, 3.0], [-3.0, 3.0]])
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    world = World(seed=0, outline_m=corners, segments_m=walls, table_tops_m=np.empty((0, 4)))
    model = ScannerModel(beams=720, angle_min_rad=-math.pi)
    scan = take_scan(model, world, Pose2.identity(), np.random.default_rng(0))
    grown = PointMap(MapParams(), "room")
    grown.insert(cloud_from_scan(scan, Pose2.identity(), CloudParams()), Pose2.identity())
    return grown


def pixel(picture: Array, place: Georeference, x_m: float, y_m: float) -> Array:
    """Mean colour of the 3 x 3 pixels at a point of the map frame."""
    column = place.column_of_x0_px + x_m / place.metres_per_px
    row = place.row_of_y0_px - y_m / place.metres_per_px
    near = picture[int(row) - 1 : int(row) + 2, int(column) - 1 : int(column) + 2, :3]
    mean: Array = near.reshape(-1, 3).mean(axis=0)
    return mean


def test_walls_floor_and_paths_are_where_they_belong(tmp_path: Path) -> None:
    fused = Trajectory(
        stamps_ns=np.array([0, 1], dtype=np.int64),
        poses=np.array([[-2.0, 1.5, 0.0], [4.0, 1.5, 0.0]]),
    )
    truth = np.array([[-1.5, -1.5], [-1.5, 2.5]])
    out = tmp_path / "room.png"
    place = draw_map(room(), [("fused", fused), ("truth", truth)], out, "room")
    picture = mpl_image.imread(out)
    assert picture.shape[:2] == (place.height_px, place.width_px)
    assert 1500 <= place.width_px <= 1800
    # 9 m with the border over 10 inches of 150 dots.
    assert place.metres_per_px == pytest.approx(9.0 / 1500.0, rel=0.01)
    for x_m, y_m in ((-3.0, 0.5), (5.0, -0.5), (1.3, -2.0), (2.2, 3.0)):
        assert pixel(picture, place, x_m, y_m).max() < 0.3, (x_m, y_m)
    floor = pixel(picture, place, 1.3, 0.5)
    assert 0.85 < floor.min() < 0.97
    assert pixel(picture, place, 5.3, 0.5).min() > 0.97  # unknown: the paper itself
    blue = pixel(picture, place, 2.5, 1.5)
    assert blue[2] > blue[0] + 0.3
    columns = [pixel(picture, place, -1.5, y_m) for y_m in np.linspace(-1.4, 1.2, 40)]
    assert max(colour[0] - colour[2] for colour in columns) > 0.3  # a vermilion dash


@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_the_same_map_gives_the_same_bytes(tmp_path: Path, ending: str) -> None:
    settings = dict(mpl.rcParams)
    for name in ("first", "second"):
        draw_map(room(), [("path", np.zeros((1, 2)))], tmp_path / f"{name}{ending}", "room")
    assert dict(mpl.rcParams) == settings
    first = (tmp_path / f"first{ending}").read_bytes()
    assert first == (tmp_path / f"second{ending}").read_bytes()


def test_a_map_can_be_drawn_without_paths_or_points(tmp_path: Path) -> None:
    draw_map(room(), [], tmp_path / "room.png", "room")
    empty = PointMap(MapParams(), "empty")
    place = draw_map(empty, [("none", np.empty((0, 2)))], tmp_path / "empty.png", "empty")
    assert mpl_image.imread(tmp_path / "empty.png").shape[:2] == (place.height_px, place.width_px)


def test_other_endings_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\.png or \.svg"):
        draw_map(room(), [], tmp_path / "room.jpg", "room")


def test_maps_side_by_side_have_one_scale_and_say_what_is_what(tmp_path: Path) -> None:
    path = np.array([[-2.0, 1.0], [0.0, 1.5], [9.0, 1.5]])  # leaves the second map's walls
    scan = np.array([[5.0, 0.25]])
    figure = map_panels(
        [
            MapPanel(title="one", known=room(), path_m=path[:2]),
            MapPanel(title="two", known=room(), path_m=path, scan_m=scan),
        ],
        12.0,
    )
    first, second = figure.axes
    assert first.get_xlim() == second.get_xlim()
    assert first.get_ylim() == second.get_ylim()
    assert second.get_xlim()[1] > 9.0
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["walls", "poses of the scans", "the scan, as registered", "the robot"]
    style.save(figure, tmp_path / "two.png")
    picture = mpl_image.imread(tmp_path / "two.png")
    box = second.get_position()
    column = box.x0 + box.width * (5.0 - second.get_xlim()[0]) / np.ptp(second.get_xlim())
    row = box.y0 + box.height * (0.25 - second.get_ylim()[0]) / np.ptp(second.get_ylim())
    height, width = picture.shape[:2]
    near = picture[int(height * (1.0 - row)) - 3 :, int(width * column) - 3 :][:6, :6, :3]
    assert (near[..., 0] - near[..., 2]).max() > 0.3  # vermilion on the blue wall


def test_no_two_things_in_a_chart_look_alike() -> None:
    looks = [style.look(number) for number in range(9)]
    assert len({look.marker for look in looks}) == 9
    assert len({look.colour for look in looks}) == 7
    assert len({(look.colour, look.line) for look in looks}) == 9
