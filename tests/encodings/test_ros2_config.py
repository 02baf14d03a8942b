"""``[ros2]`` in the configuration: off unless switched on, and checked."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from robot_file import ROBOT

from amr_slam.cli import main
from amr_slam.config import ConfigError, parse
from amr_slam.encodings.ros2 import Ros2Settings
from amr_slam.service.encoders import encoders


def with_ros2(*lines: str, text: str = ROBOT) -> str:
    return text + "\n".join(["[ros2]", *lines]) + "\n"


def test_it_is_off_unless_a_kind_of_keys_is_switched_on() -> None:
    config = parse(tomllib.loads(ROBOT))
    assert config.ros2 == Ros2Settings()
    assert encoders(config) == []
    assert encoders(parse(tomllib.loads(with_ros2('namespace = "hall"')))) == []


def test_switched_on_it_speaks_under_the_robots_name() -> None:
    config = parse(tomllib.loads(with_ros2("plain = true", "rmw_zenoh = true", "domain = 3")))
    (made,) = encoders(config)
    keys = [outlet.key for outlet in made.outlets]
    assert "amr7/tf" in keys
    assert any(key.startswith("3/amr7/tf/") for key in keys)
    assert not made.inlets


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        (["plain = 1"], "ros2.plain: should be a valid boolean, not 1"),
        (["domain = 233"], "ros2.domain: should be less than or equal to 232, not 233"),
        (["plian = true"], "ros2.plian: unknown key; did you mean plain?"),
        (["initialpose = true"], "ros2: initialpose needs plain or rmw_zenoh"),
        (
            ["plain = true", 'namespace = "1st"'],
            "ros2: namespace: '1st' should be names of letters",
        ),
        (["plain = true", 'namespace = "/amr7"'], "ros2: namespace: '/amr7' should be names of"),
        (
            ["plain = true", 'namespace = "amr/amr7"'],
            "ros2.namespace: amr/amr7 is where the robot's",
        ),
        (['map_frame = "/map"'], "ros2: '/map': a frame should be letters, digits"),
        (['map_frame = ""'], "ros2.map_frame: String should have at least 1 character"),
        (['base_frame = "odom"'], "ros2: map_frame, odom_frame and base_frame should differ"),
        (["speed_sigma_mps = 0"], "ros2.speed_sigma_mps: should be greater than 0, not 0"),
    ],
)
def test_check_names_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], lines: list[str], complaint: str
) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(with_ros2(*lines))
    assert main(["check", "--config", str(path)]) == 2
    assert complaint in capsys.readouterr().err


def test_a_name_that_makes_no_namespace_needs_one() -> None:
    text = ROBOT.replace('name = "amr7"', 'name = "amr-7"')
    assert parse(tomllib.loads(with_ros2(text=text))).robot.name == "amr-7"
    with pytest.raises(ConfigError, match=r"ros2.namespace: is missing: the robot's name 'amr-7'"):
        parse(tomllib.loads(with_ros2("rmw_zenoh = true", text=text)))
    parse(tomllib.loads(with_ros2("rmw_zenoh = true", 'namespace = "amr_7"', text=text)))
    parse(tomllib.loads(with_ros2("rmw_zenoh = true", 'namespace = ""', text=text)))
