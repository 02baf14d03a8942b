from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path

import pytest
from robot_file import ROBOT, edited

from amr_slam import config
from amr_slam.config import ConfigError

SECTIONS = ", ".join(field.name for field in fields(config.Config))
EDITS: dict[str, tuple[tuple[str, str], str]] = {
    # unknown keys, at every level
    "unknown section": (("[zenoh]", "[zenho]"), "zenho: unknown key; did you mean zenoh?"),
    "unknown section, far": (("[zenoh]", "[q]"), f"q: unknown key; known here: {SECTIONS}"),
    "in a section": (
        ("[zenoh]", "[zenoh]\nprefx = 1"),
        "zenoh.prefx: unknown key; did you mean prefix?",
    ),
    "beside a choice": (
        ("track_m = 0.5", "trackm = 0.5"),
        "drive.trackm: unknown key; did you mean track_m? (and 1 more)",
    ),
    "a choice's own": (("kind =", "knd ="), "drive.knd: unknown key; did you mean kind?"),
    "a preset's own": (
        ("preset =", "pre_set ="),
        "slam.pre_set: unknown key; did you mean preset?",
    ),
    "nested": (
        ("[service]", "[slam.icp]\nkernel = 1\n[service]"),
        "slam.icp.kernel: unknown key; did you mean kernel_m?",
    ),
    "over a parent's default": (
        ("[service]", "[slam.rescue]\ninlier = 1\n[service]"),
        "slam.rescue.inlier: unknown key; did you mean inliers?",
    ),
    "in a list": (
        ("upside_down = true", "upsidedown = true"),
        "scanners[1].mounting.upsidedown: unknown key; did you mean upside_down?",
    ),
    "a driver's": (
        ('"/dev/ttyS1" }', '"/dev/ttyS1", baudrate = 9600 }'),
        "scanners[1].options.baudrate: unknown key; did you mean baud_rate?",
    ),
    "nested in a driver's": (
        ("sign = -1", "sing = -1"),
        "odometry.options.right.sing: unknown key; did you mean sign?",
    ),
    "unprintable": (
        ("[service]", '[slam.icp]\n"metric\\n\\u007f" = 1\n[service]'),
        'slam.icp."metric\\n?": unknown key; did you mean metric?',
    ),
    # types: nothing is converted
    "text for a number": (
        ("track_m = 0.5", 'track_m = "0.5"'),
        'drive.track_m: should be a valid number, not "0.5"',
    ),
    "yes for a number": (
        ("= 20", "= true"),
        "service.publish_hz: should be a valid number, not true",
    ),
    "fraction": (
        ("[zenoh]", "[zenoh]\nlease_ms = 500.5"),
        "zenoh.lease_ms: should be a valid integer, not 500.5",
    ),
    "number for a text": (('"amr7"', "7"), "robot.name: should be a valid string, not 7"),
    "date": (("track_m = 0.5", "track_m = 2026-01-31"), "drive.track_m: should be a valid number"),
    "value for a table": (
        ("[service]\npublish_hz = 20", "[slam.icp]\n[[service]]"),
        "service: should be a table, not [{}]",
    ),
    "value for options": (
        ('{ port = "/dev/ttyS1" }', "5"),
        "scanners[1].options: should be a table, not 5",
    ),
    "text for a list": (
        ("[zenoh]", '[zenoh]\nlisten = "tcp/a:1"'),
        'zenoh.listen: should be a valid array, not "tcp/a:1"',
    ),
    "in a list of texts": (
        ("[zenoh]", '[zenoh]\nlisten = ["tcp/a:1", 5]'),
        "zenoh.listen[1]: should be a valid string, not 5",
    ),
    "choice": (
        ("[service]", "[slam.icp]\nmetric = 1\n[service]"),
        "slam.icp.metric: should be 'line' or 'point', not 1",
    ),
    # bounds
    "zero": (("track_m = 0.5", "track_m = 0"), "drive.track_m: should be greater than 0, not 0"),
    "infinite": (
        ("track_m = 0.5", "track_m = inf"),
        "drive.track_m: should be a finite number, not Infinity",
    ),
    "not a number": (
        ("track_m = 0.5", "track_m = nan"),
        "drive.track_m: should be a finite number, not NaN",
    ),
    "infinite in options": (
        ('"/dev/ttyS1" }', '"/dev/ttyS1", silence_s = inf }'),
        "scanners[1].options.silence_s: should be a finite number, not Infinity",
    ),
    "lease over the contract's": (
        ("[zenoh]", "[zenoh]\nlease_ms = 1001"),
        "zenoh.lease_ms: should be less than or equal to 1000, not 1001",
    ),
    "in a nested table": (
        ("[service]", "[slam.rescue]\ninliers = 1.5\n[service]"),
        "slam.rescue.inliers: should be less than or equal to 1, not 1.5",
    ),
    "name": (
        ('"amr7"', '"amr/7"'),
        (
            "robot.name: should be 1 to 64 letters, digits, '_', '-' or '.', no such sign first, "
            'not "amr/7"'
        ),
    ),
    "endpoint": (
        ("[zenoh]", '[zenoh]\nconnect = ["a:1"]'),
        'zenoh.connect[0]: should be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447, not "a:1"',
    ),
    "prefix": (
        ("[zenoh]", '[zenoh]\nprefix = "amr/**"'),
        (
            "zenoh.prefix: should be names of letters, digits, '_', '-' or '.', joined by '/', "
            'not "amr/**"'
        ),
    ),
    # choices
    "unknown drive": (
        ('"differential"', '"bicycle"'),
        'drive.kind: should be one of: differential, tricycle, poses; not "bicycle"',
    ),
    "unknown preset": (
        ('"default"', '"papr"'),
        'slam.preset: should be one of: default, paper; not "papr"',
    ),
    "unknown mode": (
        ('"mapping"', '"maping"'),
        "map.mode: should be 'mapping' or 'localization', not \"maping\"",
    ),
    "unknown odometry": (
        ('"can"', '"cann"'),
        "odometry.driver: no odometry driver is named 'cann'; did you mean 'can'?",
    ),
    # missing
    "missing key": (("track_m = 0.5", ""), "drive.track_m: is missing"),
    "missing choice": (('kind = "differential"', ""), "drive.kind: is missing"),
    "missing section": (('[robot]\nname = "amr7"', ""), "robot: is missing"),
    "missing option": (('{ port = "/dev/ttyS1" }', "{}"), "scanners[1].options.port: is missing"),
    # across
    "two of one name": (
        ('"rear"', '"front"'),
        "scanners[1].name: front is also the name of scanners[0]",
    ),
    "name of the wheels": (
        ('"rear"', '"wheels"'),
        "scanners[1].name: wheels is also the name of odometry",
    ),
    "two at one port": (
        ("ttyS1", "ttyS0"),
        "scanners[1].options: /dev/ttyS0 is also the address of scanners[0]",
    ),
    "no map": (('"mapping"', '"localization"'), "map.path: is missing: localization needs a map"),
    "absent map": (
        ('"mapping"', '"localization"\npath = "no.amrmap"'),
        "map.path: there is no file no.amrmap",
    ),
    "map of a mapper": (
        ('"mapping"', '"mapping"\npath = "a.amrmap"'),
        "map.path: is for localization; mapping saves <directory>/<name>.amrmap",
    ),
    "gates": (
        ("[zenoh]", "[fusion]\ngate_d2 = 40.0"),
        "fusion: gate_d2_inflated (30.67) is below gate_d2 (40.0)",
    ),
}


def complaint(tmp_path: Path, content: bytes) -> str:
    """What is said after the file's name: one line."""
    file = tmp_path / "robot.toml"
    file.write_bytes(content)
    with pytest.raises(ConfigError) as caught:
        config.load(file)
    line = str(caught.value)
    assert line.isprintable()
    assert line.startswith(f"{file}: ")
    return line.removeprefix(f"{file}: ")


@pytest.mark.parametrize("case", EDITS)
def test_one_line_says_what_is_wrong_where(tmp_path: Path, case: str) -> None:
    edit, expected = EDITS[case]
    assert complaint(tmp_path, edited(*edit).encode()) == expected


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (
            b"[robot\n",
            "not TOML: Expected ']' at the end of a table declaration (at line 1, column 7)",
        ),
        (b"a = 1\nb =\n", "not TOML: Invalid value (at line 2, column 4)"),
        (b"a = 1\na = 2\n", "not TOML: Cannot overwrite a value (at line 2, column 6)"),
        (b"# r\xe4der\n", "not UTF-8: invalid continuation byte at byte 3"),
        (b"", "robot: is missing (and 4 more)"),
        (b"#" * 300_000, "larger than 262144 bytes"),
        (b".".join([b"a"] * 3000) + b" = 1", "nested too deeply"),
        (b".".join([b"a"] * 400) + b" = 1", "nested too deeply"),
        (b"a = " + b"[" * 3000 + b"]" * 3000, "nested too deeply"),
        (b"a = 0x" + b"f" * 5000, "a number in it has thousands of digits"),
    ],
    ids=[
        "bracket",
        "value",
        "twice",
        "latin-1",
        "empty",
        "large",
        "deep",
        "less deep",
        "lists",
        "hex",
    ],
)
def test_what_is_no_toml(tmp_path: Path, content: bytes, expected: str) -> None:
    assert complaint(tmp_path, content) == expected


def test_what_is_no_file(tmp_path: Path) -> None:
    for file, reason in [
        (tmp_path / "a.toml", "No such file or directory"),
        (tmp_path, "Is a dir"),
    ]:
        with pytest.raises(ConfigError) as caught:
            config.load(file)
        assert str(caught.value).startswith(f"{file}: {reason}")


def test_no_scanner_and_too_many() -> None:
    table = tomllib.loads(ROBOT)
    for count in (0, 18):
        with pytest.raises(ConfigError, match=r"^scanners: ") as caught:
            config.parse(table | {"scanners": table["scanners"][:1] * count})
        assert len(str(caught.value)) < 200
