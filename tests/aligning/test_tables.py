from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from amr_slam.aligning import (
    AlignError,
    FitParams,
    fit_pairs,
    read_camera,
    read_landmarks,
    read_pairs,
    write_residuals,
)


def write(folder: Path, text: str, name: str = "table.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_pairs_as_shadow_mode_records_them(tmp_path: Path) -> None:
    pairs = read_pairs(
        write(
            tmp_path,
            "stamp,camera_x,camera_y,camera_theta,slam_x,slam_y,slam_theta,slam_vx,slam_omega,state\n"
            "10.5,1,2,0.5,3,4,-0.5,0.3,0.1,localized\n"
            "11.5,1,2,0.5,3,4,-0.5,0.3,0.1,lost\n\n"
            "12.5,1.5,2,0.6,3.5,4,-0.4,0.3,0.1,mapping\n",
        )
    )
    assert pairs.labels == ("10.5", "12.5")
    np.testing.assert_array_equal(pairs.site, [[1, 2, 0.5], [1.5, 2, 0.6]])
    np.testing.assert_array_equal(pairs.map, [[3, 4, -0.5], [3.5, 4, -0.4]])
    assert pairs.twists is not None
    np.testing.assert_array_equal(pairs.twists, [[0.3, 0, 0.1]] * 2)


def test_rows_of_other_maps_are_not_mixed_in(tmp_path: Path) -> None:
    text = "camera_x,camera_y,slam_x,slam_y,map\n1,2,3,4,one\n5,6,7,8,two\n"
    path = write(tmp_path, text)
    assert read_pairs(path, "two").site[:, 0].tolist() == [5.0]
    with pytest.raises(AlignError, match=r"all 2 rows are of other maps than three: drive in this"):
        read_pairs(path, "three")


def test_positions_alone_and_degrees(tmp_path: Path) -> None:
    plain = read_pairs(write(tmp_path, "camera_x,camera_y,slam_x,slam_y\n1,2,3,4\n"))
    assert plain.labels == ("line 2",)
    assert not plain.has_map_headings
    assert plain.twists is None
    degrees = read_pairs(
        write(
            tmp_path,
            "camera_x,camera_y,camera_theta_deg,slam_x,slam_y,slam_theta_deg\n1,2,90,3,4,-45\n",
        )
    )
    assert degrees.has_headings
    assert degrees.site[0, 2] == pytest.approx(math.pi / 2.0)
    assert degrees.map[0, 2] == pytest.approx(-math.pi / 4.0)


def test_landmarks_as_a_german_spreadsheet_saves_them(tmp_path: Path) -> None:
    text = "\ufeffname;x_map;y_map;x_site;y_site\nSäule 3;1,5;2;101,25;-7\n"
    pairs = read_landmarks(write(tmp_path, text))
    assert pairs.labels == ("Säule 3",)
    np.testing.assert_array_equal(pairs.map[0, :2], [1.5, 2.0])
    np.testing.assert_array_equal(pairs.site[0, :2], [101.25, -7.0])


def test_camera_files(tmp_path: Path) -> None:
    iso = read_camera(write(tmp_path, "stamp,x,y\n2026-11-24T18:00:00Z,1,2\n1795543201.25,3,4\n"))
    assert iso.stamps_ns.tolist() == [1795543200_000_000_000, 1795543201_250_000_000]
    assert np.isnan(iso.poses[:, 2]).all()
    tum = read_camera(write(tmp_path, "1.5 1 2 0 0 0 0 1\n", "camera.tum"))
    np.testing.assert_array_equal(tum.poses, [[1, 2, 0]])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", r":1: the first line must name the columns .*missing: name, x_map"),
        ("name,x_map\n", r"missing: y_map, x_site, y_site"),
        ("name,x_map,y_map,x_site,y_site\na,1,2,3\n", r":2: 4 cells, the header has 5"),
        ("name,x_map,y_map,x_site,y_site\n\na,1,2,3,x\n", r":3: y_site: 'x' is not a number"),
        ("name,x_map,y_map,x_site,y_site\na,1,2,3,nan\n", r":2: y_site: 'nan' is not a number"),
        ("name,x_map,y_map,x_site,y_site\na,1,2,3,1e300\n", r"is not a number"),
    ],
)
def test_what_makes_no_sense_is_refused_by_line(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(AlignError, match=complaint):
        read_landmarks(write(tmp_path, text))


def test_binary_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_bytes(b"\xff\xfe\x00" * 100)
    with pytest.raises(AlignError, match="not a text in UTF-8"):
        read_landmarks(path)


def test_a_wrong_stamp_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AlignError, match=r":2: 'soon' is not a time"):
        read_camera(write(tmp_path, "stamp,x,y\nsoon,1,2\n"))


def test_residuals_are_written_pair_by_pair(tmp_path: Path) -> None:
    table = "name,x_map,y_map,x_site,y_site\na,0,0,10,0\nb,9,0,19,0\nc,9,5,19,5\nd,0,5,10,5\n"
    rows = table + "e,4,4,17,4\n"
    pairs = read_landmarks(write(tmp_path, rows))
    fit = fit_pairs(pairs, FitParams(), ordered=False)
    write_residuals(tmp_path / "left.csv", pairs, fit)
    lines = (tmp_path / "left.csv").read_text().splitlines()
    assert lines[0] == "pair,agrees,dx_m,dy_m,distance_m,dtheta_deg"
    assert lines[1].startswith("a,yes,")
    assert lines[5].startswith("e,no,3.000")
