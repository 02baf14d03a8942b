"""Drives by name: what plug-ins must have, and that drive and odometry fit to each other."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Annotated, Any, ClassVar

import numpy as np
import pytest
from annotated_types import Gt
from paths import REPO
from robot_file import ROBOT

from amr_drivers.can_odometry.cia402.driver import Settings as Cia402Settings
from amr_slam import config
from amr_slam.config import ConfigError
from amr_slam.geometry import Pose2
from amr_slam.odometry import (
    DifferentialDrive,
    PoseOdometry,
    TricycleDrive,
    drive_kinds,
    elapsed_s,
    gap,
    joints_of,
    kinds,
)
from amr_slam.samples import DriveSample, JointSample, Motion, OdometrySample, WheelSample


@dataclass(frozen=True, slots=True, kw_only=True)
class RailDrive:
    """The example of docs/drivers/kinematics.md: one wheel on a rail."""

    joints: ClassVar[tuple[str, ...]] = ("wheel",)

    radius_m: Annotated[float, Gt(0)]
    """Rolling radius in m."""
    travel_m2_per_m: Annotated[float, Gt(0)] = 1e-4
    """Variance of the travel in m2 per m."""
    max_speed_mps: Annotated[float, Gt(0)] = 2.0
    """What it can do at most in m/s."""

    def motion(self, previous: DriveSample, current: DriveSample) -> Motion:
        if not (isinstance(previous, JointSample) and isinstance(current, JointSample)):
            raise TypeError("a rail drive needs joint samples")
        rolled_m = self.radius_m * (current.angles_rad[0] - previous.angles_rad[0])
        limit_m = self.max_speed_mps * elapsed_s(previous, current)
        if previous.segment != current.segment or not abs(rolled_m) <= limit_m:
            return self.silence(previous.stamp_ns, current.stamp_ns)
        return Motion(
            start_ns=previous.stamp_ns,
            end_ns=current.stamp_ns,
            delta=Pose2(rolled_m, 0.0, 0.0),
            covariance=np.diag([self.travel_m2_per_m * abs(rolled_m), 0.0, 0.0]),
        )

    def silence(self, start_ns: int, end_ns: int) -> Motion:
        return gap(start_ns, end_ns, self.max_speed_mps * 1e-9 * (end_ns - start_ns), 0.0)


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[EntryPoint]:
    points: list[EntryPoint] = []
    monkeypatch.setattr(kinds, "entry_points", lambda **_: points)
    return points


def test_the_own_kinds_come_first() -> None:
    own = drive_kinds()
    assert list(own)[:3] == ["differential", "tricycle", "poses"]
    assert [kind.joints for kind in list(own.values())[:3]] == [
        DifferentialDrive.joints,
        TricycleDrive.joints,
        PoseOdometry.joints,
    ]


def test_a_plug_in_is_configured_and_moves(
    plugged: list[EntryPoint], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Point(EntryPoint):
        def load(self) -> Any:
            return RailDrive

    plugged.append(Point("rail", "acme_amr.rail:RailDrive", "amr_slam.drives"))
    table = tomllib.loads(ROBOT)
    table["drive"] = {"kind": "rail", "radius_m": 0.2}
    table["odometry"] = {"driver": "replay", "options": {"log": "run.mcap"}}
    drive = config.parse(table).drive
    assert drive == RailDrive(radius_m=0.2)
    samples = [
        JointSample(stamp_ns=n * 20_000_000, names=("wheel",), angles_rad=(0.1 * n,))
        for n in range(2)
    ]
    assert drive.motion(*samples).delta == Pose2(0.2 * 0.1, 0.0, 0.0)
    table["drive"] = {"kind": "rail", "radius_m": 0.2, "radus": 1}
    with pytest.raises(ConfigError, match=r"drive\.radus: unknown key"):
        config.parse(table)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("amr_slam.absent:Drive", "drive 'acme' cannot be loaded"),
        ("amr_slam.odometry:Absent", "drive 'acme' cannot be loaded"),
        ("amr_slam.geometry:Pose2", "amr_slam.geometry:Pose2 has no joints"),
        ("amr_slam.odometry:joints_of", "is no dataclass|has no joints"),
    ],
)
def test_an_unusable_plug_in_is_named(plugged: list[EntryPoint], value: str, reason: str) -> None:
    plugged.append(EntryPoint("acme", value, "amr_slam.drives"))
    with pytest.raises(ValueError, match=reason):
        drive_kinds()
    with pytest.raises(ConfigError, match=r"drive\.kind: drive 'acme'"):
        config.parse(tomllib.loads(ROBOT))


def test_a_drive_that_the_odometry_does_not_serve_is_refused() -> None:
    table = tomllib.loads(ROBOT)
    table["drive"] = {"kind": "tricycle", "radius_m": 0.1, "wheel_base_m": 1.4}
    with pytest.raises(ConfigError) as caught:
        config.parse(table)
    assert str(caught.value) == (
        "odometry.options: gives left and right, and drive.kind needs drive and steer"
    )
    table["drive"] = {"kind": "poses"}
    with pytest.raises(ConfigError, match="needs integrated poses"):
        config.parse(table)


def test_the_examples_have_the_drives_that_they_show() -> None:
    tricycle = config.load(REPO / "config/tricycle.toml")
    assert isinstance(tricycle.drive, TricycleDrive)
    assert tricycle.odometry.options.joints == ("drive", "steer")
    cia402 = config.load(REPO / "config/cia402.toml")
    assert isinstance(cia402.odometry.options, Cia402Settings)
    assert cia402.odometry.options.left.mapping == (0x60640020, 0x606C0020)


def test_what_samples_tell() -> None:
    assert joints_of(WheelSample(stamp_ns=0, left_rad=0.0, right_rad=0.0)) == ("left", "right")
    assert joints_of(JointSample(stamp_ns=0, names=("a",), angles_rad=(0.0,))) == ("a",)
    assert joints_of(OdometrySample(stamp_ns=0, odom_from_base=Pose2.identity())) == ()
