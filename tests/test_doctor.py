"""What the doctor says of real devices that are not well, of a robot that runs, and of none."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from daemon_rig import Daemon, Robot, write_config
from messages import pose_of, status_of

from amr_slam.cli import main
from amr_slam.client import RobotView
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.service import probe
from amr_slam.service.doctor import computer
from amr_slam.service.doctor.findings import Finding, advice
from amr_slam.service.doctor.running import look_at_robot
from amr_slam.states import State
from amr_slam.wire import HealthPart, MapPart


class Told:
    """What was printed, by part: (is it well, what, do)."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.findings: list[tuple[str, bool, str, str]] = []
        for line in text.splitlines():
            if line.startswith("      -> "):
                part, well, what, _ = self.findings.pop()
                self.findings.append((part, well, what, line.removeprefix("      -> ")))
            else:
                mark, part, what = line[:5].strip(), *line[6:].split(": ", 1)
                self.findings.append((part, mark == "ok", what, ""))

    def wrong(self, part: str) -> tuple[str, str]:
        """(what, do) of the part's findings, joined."""
        found = [(what, do) for name, well, what, do in self.findings if name == part and not well]
        assert found, self.text
        return "\n".join(what for what, _ in found), "\n".join(do for _, do in found)

    def wrong_parts(self) -> set[str]:
        return {part for part, well, *_ in self.findings if not well}


@pytest.fixture
def doctor(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, Told]]:
    monkeypatch.setattr(probe, "PROBE_S", 3.0)

    def ask(*arguments: object) -> tuple[int, Told]:
        status = main(["doctor", *map(str, arguments)])
        return status, Told(capsys.readouterr().out)

    return ask


def free_endpoint() -> str:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{found.getsockname()[1]}"


def test_nothing_is_wrong_and_that_is_said(
    tmp_path: Path, doctor: Callable[..., tuple[int, Told]]
) -> None:
    with Robot(tmp_path):
        config = write_config(tmp_path, free_endpoint())
        status, told = doctor("--config", config)
    # What this computer lacks is not the robot's: its clock, a full disk.
    assert told.wrong_parts() <= {"clock", "disk", "service"}, told.text
    assert status == (1 if told.wrong_parts() else 0)
    for part in ("front", "rear", "wheels", "map", "disk"):
        assert any(name == part for name, *_ in told.findings)


def test_what_the_scanners_and_ports_lack_is_told_with_what_to_do(
    tmp_path: Path, doctor: Callable[..., tuple[int, Told]]
) -> None:
    with Robot(tmp_path) as robot:
        config = write_config(tmp_path, free_endpoint())
        robot.rear.unplug()
        robot.front.mode = "standby"
        status, told = doctor("--config", config)
    assert status == 1
    what, do = told.wrong("front")
    assert "standby" in what
    assert "end standby" in do
    what, do = told.wrong("rear")
    assert "no such file" in what.lower()
    assert "/dev/serial/by-id/" in do


def test_a_configuration_that_is_wrong_is_the_first_thing_told(
    tmp_path: Path, doctor: Callable[..., tuple[int, Told]]
) -> None:
    config = tmp_path / "robot.toml"
    config.write_text('[robot]\nname = "amr7"\ncolour = "red"\n')
    status, told = doctor("--config", config)
    assert status == 1
    what, _ = told.wrong("configuration")
    assert "robot.colour: unknown key" in what


def test_a_damaged_map_and_an_absent_router_are_told(
    tmp_path: Path, doctor: Callable[..., tuple[int, Told]]
) -> None:
    path = tmp_path / "hall.amrmap"
    for _ in range(2):
        save_map(PointMap(MapParams(), "hall"), path)
    path.write_bytes(path.read_bytes()[:-1])
    config = write_config(tmp_path, free_endpoint(), localize=True)
    nobody = free_endpoint()
    config.write_text(config.read_text().replace("listen =", f'connect = ["{nobody}"]\nlisten ='))
    status, told = doctor("--config", config)
    assert status == 1
    what, do = told.wrong("map")
    assert "using hall.amrmap.1, an older map" in what
    assert "copy the right map" in do
    what, do = told.wrong("network")
    assert f"router {nobody}" in what
    assert "ping the router" in do


def test_a_robot_that_runs_is_asked_and_its_devices_left_alone(
    tmp_path: Path, doctor: Callable[..., tuple[int, Told]]
) -> None:
    with Robot(tmp_path) as robot, Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(lambda s: s.state is State.MAPPING, "mapping")
        robot.front.mode = "lock-out"
        daemon.status_when(lambda s: "lock-out" in (s.scanners["front"].detail or ""), "lock-out")
        for asked in (["--config", daemon.config], ["amr7", "--connect", daemon.endpoint]):
            status, told = doctor(*asked)
            assert status == 1
            what, do = told.wrong("front")
            assert "lock-out" in what
            assert "reset" in do
            assert "robot: amr7 at tcp/" in told.text
        assert daemon.stop() == 0
        assert daemon.log().count("front: ") <= 1  # nobody has taken its port away
    status, told = doctor("amr7", "--connect", daemon.endpoint)
    assert status == 1
    assert "service running" in told.wrong("network")[1]


# -- words ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("/dev/ttyUSB0: [Errno 13] could not open port: Permission denied", "dialout"),
        ("/dev/ttyUSB0: [Errno 2] could not open port: No such file or directory", "by-id"),
        ("70 kB received and nothing of use in it: noise, baud rate, or another device?", "baud"),
        ("contamination warning: clean the front screen soon", "window"),
        ("contaminated: clean the front screen", "window"),
        ("standby", "control input"),
        ("no left and right wheel counts for 1.2 s", "drive"),
        ("can0: [Errno 100] Network is down", "ip link set"),
        ("can0: [Errno 19] No such device", "ip link"),
        ("bus-off", "termination"),
        ("192.168.0.1: [Errno 111] Connection refused", "ping"),
        ("scanner configuration: rear scanner looks mirrored", "scanner-faults"),
        ("frozen: the scan number stands still", "power-cycle"),
    ],
)
def test_faults_in_the_drivers_words_have_a_next_step(text: str, word: str) -> None:
    assert word in advice(text, "nothing")


def parts(view: RobotView) -> dict[str, Finding]:
    return {finding.part: finding for finding in look_at_robot(view) if not finding.is_well}


def test_a_robot_whose_scans_lie_on_no_walls_is_in_another_place() -> None:
    status = status_of().model_copy(
        update={
            "state": State.LOST,
            "explained": 0.1,
            "map": MapPart(id="838d0393-99c7-5f72-b7b6-44ce3a318038", name="hall", version=60),
        }
    )
    wrong = parts(RobotView(robot="amr7", pose=pose_of(), status=status))
    assert "set_pose" in (wrong["state"].do or "")
    assert "not for this place" in wrong["map"].what
    fits = status.model_copy(update={"explained": 0.9})
    assert "map" not in parts(RobotView(robot="amr7", pose=pose_of(), status=fits))


def test_a_map_that_is_still_to_be_made_is_not_looked_for_in_a_file() -> None:
    for mode, word in (("mapping", "first scan"), ("localization", "map.path")):
        status = status_of(map=None, mode=mode, state=State.STARTING)
        wrong = parts(RobotView(robot="amr7", pose=pose_of(), status=status))
        assert word in (wrong["map"].do or "")


def test_faults_of_the_service_itself_are_told_once() -> None:
    silent = HealthPart(
        link="LOST", age_s=9.0, rate_hz=0.0, samples=5, errors=1, detail="can0: Network is down"
    )
    status = status_of().model_copy(
        update={
            "wheels": silent,
            "fault": "wheels lost: can0: Network is down; maps/hall.amrmap: cannot write the map: "
            "No space left on device",
            "clock_steps": 2,
        }
    )
    findings = [
        f for f in look_at_robot(RobotView(robot="amr7", pose=pose_of(), status=status)) if f.do
    ]
    texts = [f.what for f in findings]
    assert sum("Network is down" in text for text in texts) == 1
    assert any("No space left" in text for text in texts)
    assert any("set 2 times" in text for text in texts)


@pytest.mark.parametrize(
    ("facts", "well", "word"),
    [
        ({"LoadState": "not-found"}, True, "not installed"),
        ({"ActiveState": "active", "SubState": "running", "NRestarts": "0"}, True, "running"),
        ({"ActiveState": "active", "SubState": "running", "NRestarts": "3"}, False, "journalctl"),
        ({"ActiveState": "inactive", "Result": "success"}, False, "enable --now"),
        ({"ActiveState": "failed", "Result": "start-limit-hit"}, False, "reset-failed"),
    ],
)
def test_the_service_as_systemd_sees_it(facts: dict[str, str], well: bool, word: str) -> None:
    finding = computer.unit_finding("amr-slam@amr7.service", {"LoadState": "loaded"} | facts)
    assert finding.is_well is well
    assert word in finding.lines()


def test_a_disk_that_is_nearly_full_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(computer, "_LEAST_FREE_BYTES", 1 << 62)
    (finding,) = computer._disks({tmp_path / "not" / "there"})
    assert "nearly full" in finding.what
    assert finding.do is not None
