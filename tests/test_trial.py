from __future__ import annotations

import math
from pathlib import Path

import pytest
from paths import REPO

from amr_slam.geometry import Pose2
from amr_slam.samples import State
from amr_slam.trial import DaemonProcess, TrialError, adapted_config, reported
from amr_slam.wire import OdomPose, PoseMessage

MESSAGE = PoseMessage(
    robot="demo",
    seq=41,
    stamp=1_800_000_000.25,
    age_s=0.0,
    map=None,
    epoch=0,
    x=1.0,
    y=2.0,
    theta=0.5,
    vx=0.3,
    omega=0.0,
    covariance=(1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 4e-6),
    error95_m=0.02,
    state=State.MAPPING,
    since_fix_s=0.5,
    since_fix_m=0.1,
    odom=OdomPose(x=1.0, y=2.0, theta=0.5),
    fault=None,
)


def test_a_message_is_put_on_the_clock_of_this_machine() -> None:
    report = reported(MESSAGE, 1_800_000_000_260_000_000, 5_000_000_000)
    assert report.received_ns == 5_000_000_000
    assert report.stamp_ns == pytest.approx(4_990_000_000, abs=1000)  # float seconds
    assert report.map_from_base == Pose2(1.0, 2.0, 0.5)
    assert (report.seq, report.state, report.error95_m) == (41, State.MAPPING, 0.02)
    assert report.heading95_rad == pytest.approx(1.96 * 0.002)


def test_a_negative_variance_claims_certainty() -> None:
    covariance = (*MESSAGE.covariance[:8], -1.0)
    report = reported(MESSAGE.model_copy(update={"covariance": covariance}), 0, 0)
    assert report.heading95_rad == 0.0
    assert not math.isnan(report.heading95_rad)


def test_a_copy_of_a_configuration_has_its_own_places(tmp_path: Path) -> None:
    template = tmp_path / "template.toml"
    template.write_text('a = "out/demo/can"\nb = "x"  # out/demo\n', encoding="utf-8")
    copy = adapted_config(template, {"out/demo": "/tmp/here"}, tmp_path / "copy.toml")
    assert copy.read_text(encoding="utf-8") == 'a = "/tmp/here/can"\nb = "x"  # out/demo\n'
    with pytest.raises(ValueError, match="names no tcp/"):
        adapted_config(template, {"tcp/127.0.0.1:7447": "tcp/127.0.0.1:1"}, copy)


def test_a_daemon_that_refuses_its_configuration_is_reported(tmp_path: Path) -> None:
    config = adapted_config(REPO / "config/demo.toml", {"mapping": "nonsense"}, tmp_path / "x.toml")
    log = tmp_path / "daemon.log"
    with (
        pytest.raises(TrialError, match=r"status 2; see .*daemon\.log"),
        DaemonProcess(config, log) as daemon,
    ):
        daemon.listener("tcp/127.0.0.1:9", "demo")
    assert "mode" in log.read_text(encoding="utf-8")
