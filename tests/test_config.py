from __future__ import annotations

import math
import runpy
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from paths import REPO
from robot_file import ROBOT, edited

from amr_drivers.can_odometry import driver as can
from amr_drivers.can_odometry.settings import WheelSettings
from amr_drivers.sick_s300 import driver as s300
from amr_slam import config
from amr_slam.config import ConfigError
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.localizer import LocalizerParams
from amr_slam.odometry import DifferentialDrive, PoseOdometry
from amr_slam.params import SlamParams, preset
from amr_slam.wire import ZenohSettings

SECTIONS = [field.name for field in fields(config.Config)]
derandomized = settings(derandomize=True, deadline=None, max_examples=150)


def load_bytes(tmp_path: Path, content: bytes) -> config.Config:
    (tmp_path / "robot.toml").write_bytes(content)
    return config.load(tmp_path / "robot.toml")


def test_values_arrive_in_the_dataclasses(tmp_path: Path) -> None:
    loaded = load_bytes(tmp_path, ROBOT.encode())
    assert loaded.robot.name == "amr7"
    assert loaded.drive == DifferentialDrive(radius_left_m=0.1, radius_right_m=0.11, track_m=0.5)
    assert loaded.odometry.options == can.Settings(
        dbc="config/wheels.dbc",
        left=WheelSettings(signal="LeftCount"),
        right=WheelSettings(signal="RightCount", sign=-1),
    )
    front, rear = loaded.scanners
    assert (front.name, front.poll_period_s, rear.name) == ("front", 2.0, "rear")
    assert [front.options, rear.options] == [
        s300.Settings(port="/dev/ttyS0"),
        s300.Settings(port="/dev/ttyS1"),
    ]
    assert front.mounting.mounting.base_from_lidar == Pose2(0.24, 0.2, math.pi / 4)
    assert not front.mounting.mounting.upside_down
    assert rear.mounting.mounting.upside_down
    assert (loaded.map.mode, loaded.map.path, loaded.map.directory) == (
        "mapping",
        None,
        Path("maps"),
    )
    assert loaded.slam == preset("default")
    assert (loaded.fusion, loaded.localizer) == (FilterParams(), LocalizerParams())
    assert loaded.zenoh == ZenohSettings()
    assert loaded.service == config.ServiceSettings(publish_hz=20.0)
    assert isinstance(loaded.service.publish_hz, float)


def test_lists_become_tuples_and_strings_paths(tmp_path: Path) -> None:
    (tmp_path / "hall.amrmap").touch()
    text = edited("[zenoh]", '[zenoh]\nlisten = []\nconnect = ["tcp/a:1", "tls/b:2"]').replace(
        'mode = "mapping"', f'mode = "localization"\npath = "{tmp_path / "hall.amrmap"}"'
    )
    loaded = load_bytes(tmp_path, text.encode())
    assert (loaded.zenoh.listen, loaded.zenoh.connect) == ((), ("tcp/a:1", "tls/b:2"))
    assert (loaded.map.mode, loaded.map.path) == ("localization", tmp_path / "hall.amrmap")


def test_a_drive_with_odometry_of_its_own() -> None:
    table = tomllib.loads(ROBOT)
    table["drive"] = {"kind": "poses"}
    table["odometry"] = {"driver": "replay", "options": {"log": "run.mcap"}}
    assert config.parse(table).drive == PoseOdometry()


def test_overrides_start_from_the_preset() -> None:
    table = tomllib.loads(ROBOT)
    paper = preset("paper")
    table["slam"] = {"preset": "paper"}
    assert config.parse(table).slam == paper
    table["slam"] |= {"grid_m": 0.25, "icp": {"kernel_m": 0.5}, "rescue": {"e_max_m": 0.2}}
    assert config.parse(table).slam == replace(
        paper,
        grid_m=0.25,
        icp=replace(paper.icp, kernel_m=0.5),
        rescue=replace(paper.rescue, e_max_m=0.2),
    )
    del table["slam"]
    assert config.parse(table).slam == preset("default")


def refused_or_loaded(text: bytes, file: Path) -> None:
    file.write_bytes(text)
    try:
        loaded = config.load(file)
    except ConfigError as error:
        line = str(error)
    else:
        assert isinstance(loaded.slam, SlamParams)
        return
    assert line.startswith(f"{file}: ")
    assert line.isprintable()


@pytest.fixture(scope="module")
def junk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("junk") / "robot.toml"


@derandomized
@given(content=st.binary(max_size=200))
def test_junk_is_refused(junk: Path, content: bytes) -> None:
    refused_or_loaded(content, junk)


@derandomized
@given(start=st.integers(0, len(ROBOT)), length=st.integers(0, 40), middle=st.binary(max_size=12))
@example(start=0, length=0, middle=b"")
def test_damage_is_refused_or_harmless(junk: Path, start: int, length: int, middle: bytes) -> None:
    text = ROBOT.encode()
    refused_or_loaded(text[:start] + middle + text[start + length :], junk)


SCALARS = st.one_of(
    st.booleans(),
    st.integers(),
    st.sampled_from([2**63, -(10**400)]),
    st.floats(),
    st.text(max_size=8),
    st.dates(),
    st.times(),
    st.datetimes(),
)
WORDS = st.sampled_from([*SECTIONS, "name", "driver", "options", "kind", "preset", "x_m", "path"])
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.one_of(WORDS, st.text(max_size=5)), inner, max_size=3),
    ),
    max_leaves=6,
)


def places(value: Any) -> Iterator[tuple[dict[str, Any] | list[Any], Any]]:
    """Every (container, key) in a parsed file."""
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in entries:
        yield value, key
        if isinstance(inner, dict | list):
            yield from places(inner)


@derandomized
@given(data=st.data())
def test_any_value_in_any_place_is_refused_or_harmless(data: st.DataObject) -> None:
    table = tomllib.loads(ROBOT)
    spots = list(places(table))
    container, key = spots[data.draw(st.integers(0, len(spots) - 1))]
    container[key] = data.draw(VALUES)
    try:
        config.parse(table)
    except ConfigError as error:
        line = str(error)
    else:
        return
    assert line.isprintable()
    assert len(line) < 1000


def test_default_toml_is_what_its_tool_writes_and_holds_the_defaults() -> None:
    rendered = runpy.run_path(str(REPO / "tools/default_config.py"))["render"]()
    assert (REPO / "config/default.toml").read_text() == rendered
    loaded = config.load(REPO / "config/default.toml")
    assert loaded.slam == preset("default")
    assert (loaded.fusion, loaded.localizer) == (FilterParams(), LocalizerParams())
    assert (loaded.zenoh, loaded.service) == (ZenohSettings(), config.ServiceSettings())
    assert [scanner.name for scanner in loaded.scanners] == ["front"]


def test_default_toml_has_every_key() -> None:
    file = REPO / "config/default.toml"
    table = tomllib.loads(file.read_text())
    del table["drive"]["kind"], table["slam"]["preset"]
    table["map"]["path"] = "only in a comment, as mapping must not have it"
    table["odometry"]["options"] |= {"drive": "as well", "steer": "a tricycle's"}
    table["zenoh"]["keys"] = "only in a comment, as most have none"
    table["vda5050"] |= {"manufacturer": "only needed where it is on", "serial_number": "likewise"}
    table["ros2"]["namespace"] = "only in a comment, as the robot's name is in its place"
    table["shadow"] |= {"key": "only in a comment: off", "clock_s": "estimated"}
    table["scanners"] = table["scanners"][0]
    loaded = config.load(file)
    assert keys(table) == keys(replace(loaded, scanners=loaded.scanners[0]))  # type: ignore[arg-type]  # one, as in the table


def keys(value: object) -> dict[str, Any]:
    """The tree of keys of tables or of dataclasses."""
    if is_dataclass(value):
        return {field.name: keys(getattr(value, field.name)) for field in fields(value)}
    return {key: keys(inner) for key, inner in value.items()} if isinstance(value, dict) else {}


@pytest.mark.parametrize(
    "file", sorted((REPO / "config").glob("*.toml")), ids=lambda file: file.name
)
def test_every_configuration_here_is_valid(file: Path) -> None:
    assert config.load(file).robot.name
