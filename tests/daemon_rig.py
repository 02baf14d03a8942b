"""A daemon as a real process, and the emulated robot in front of it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Self

from paths import REPO

from amr_drivers.can_odometry.settings import Settings
from amr_drivers.emulators.s300 import EmulatedS300
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_slam.client import FleetListener
from amr_slam.samples import Scan, WheelSample
from amr_slam.simulation import (
    ScannerModel,
    SimulatedRobot,
    laboratory,
    opposite_scanners,
    plan_tour,
)
from amr_slam.wire import PoseMessage, StatusMessage

DEADLINE_S = 90.0
ROBOT = "amr7"
DBC = str(REPO / "config/wheels.dbc")

CONFIG = """
[robot]
name = "amr7"
[drive]
kind = "differential"
radius_left_m = 0.1
radius_right_m = 0.1
track_m = 0.5
[odometry]
driver = "can"
[odometry.options]
interface = "slcan"
channel = "{folder}/can"
dbc = "{dbc}"
sequence_signal = "Sequence"
left = {{ signal = "LeftCount" }}
right = {{ signal = "RightCount" }}
[[scanners]]
name = "front"
driver = "sick_s300"
poll_period_s = 0.4
options = {{ port = "{folder}/front", latency_limit_s = 1.0 }}
mounting = {{ x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }}
[[scanners]]
name = "rear"
driver = "sick_s300"
poll_period_s = 0.4
options = {{ port = "{folder}/rear", latency_limit_s = 1.0 }}
mounting = {{ x_m = -0.24, y_m = -0.2, theta_deg = -135.0 }}
[map]
mode = "mapping"
directory = "{folder}"
name = "hall"
[zenoh]
listen = ["{endpoint}"]
[recording]
directory = "{folder}/recordings"
ring_s = {ring_s}
[service]
save_period_s = {save_period_s}
answer_limit_s = {answer_limit_s}
"""


def until(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition; fails by ``what`` when it does not come true."""
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"in vain: {what}"
        time.sleep(0.01)


def write_config(
    folder: Path,
    endpoint: str = "tcp/127.0.0.1:7447",
    save_period_s: float = 60.0,
    answer_limit_s: float = 30.0,
    edit: Callable[[str], str] = str,
    *,
    localize: bool = False,
    ring_s: float = 600.0,
) -> Path:
    """A robot.toml whose devices are those of :class:`Robot` in the same folder, as ``edit``
    leaves it.

    ``localize``: in the map that an earlier run has made there.
    """
    text = CONFIG.format(
        folder=folder,
        dbc=DBC,
        endpoint=endpoint,
        save_period_s=save_period_s,
        answer_limit_s=answer_limit_s,
        ring_s=ring_s,
    )
    if localize:
        mode = f'mode = "localization"\npath = "{folder}/hall.amrmap"'
        text = text.replace('mode = "mapping"', mode)
    path = folder / "robot.toml"
    path.write_text(edit(text))
    return path


class Robot:
    """Turns slowly in a laboratory; two S300s on ptys, wheel counts on an slcan pty, 50 Hz."""

    def __init__(self, folder: Path) -> None:
        world = laboratory(3)
        self.front, self.rear = EmulatedS300(folder / "front"), EmulatedS300(folder / "rear")
        self.can = EmulatedSlcan(folder / "can")
        self._wheels = EmulatedWheels(Settings(dbc=DBC, sequence_signal="Sequence"))
        self._robot = SimulatedRobot(
            world=world,
            world_from_map=plan_tour(world).world_from_map,
            scanners=opposite_scanners(ScannerModel(sigma_range_m=0.01)),
            scan_period_s=0.2,
            seed=3,
            start_ns=time.monotonic_ns(),
        )
        self.turn_radps = 0.15
        self.disturb: Callable[[Scan], Scan] = lambda scan: scan
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live)
        self._thread.start()

    def _live(self) -> None:
        while not self._stop.is_set():
            for sample in self._robot.advance(0.0, self.turn_radps):
                if isinstance(sample, Scan):
                    scanner = self.front if sample.scanner == "front" else self.rear
                    scanner.measure(self.disturb(sample).ranges_m)
                elif isinstance(sample, WheelSample):
                    for frame in self._wheels.frames(sample.left_rad, sample.right_rad):
                        self.can.send(frame)
            self._stop.wait(max(0.0, 1e-9 * (self._robot.stamp_ns - time.monotonic_ns())))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._stop.set()
        self._thread.join()
        self.front.close()
        self.rear.close()
        self.can.close()


class Supervisor:
    """systemd's end of the notification socket."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.told: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        path.unlink(missing_ok=True)
        self._socket.bind(str(path))
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def count(self, line: str) -> int:
        return sum(line in message.splitlines() for message in list(self.told))

    def _listen(self) -> None:
        while message := self._socket.recv(4096):
            self.told.append(message.decode())

    def close(self) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", str(self.path))
        self._thread.join()
        self._socket.close()


class Daemon:
    """``amr-slam run`` in a session of its own, with a supervisor and a fleet that listens."""

    def __init__(
        self,
        folder: Path,
        save_period_s: float = 60.0,
        answer_limit_s: float = 30.0,
        record: Path | None = None,
        edit: Callable[[str], str] = str,
        *,
        localize: bool = False,
        ring_s: float = 600.0,
        settings: str = "",
    ) -> None:
        """``settings``: more of the configuration, TOML."""
        self.endpoint = f"tcp/127.0.0.1:{_free_port()}"
        self.map_path = folder / "hall.amrmap"
        self.config = write_config(
            folder,
            self.endpoint,
            save_period_s,
            answer_limit_s,
            edit,
            localize=localize,
            ring_s=ring_s,
        )
        with self.config.open("a") as stream:
            stream.write(settings)
        self.supervisor = Supervisor(folder / "notify")
        self._log = folder / "log.txt"
        command = [sys.executable, "-m", "amr_slam", "run", "--config", str(self.config)]
        if record is not None:
            command += ["--record", str(record)]
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(
                command,
                stderr=log,
                env=environment(NOTIFY_SOCKET=str(folder / "notify"), WATCHDOG_USEC="2000000"),
                start_new_session=True,
            )
        self.fleet: FleetListener | None = None

    def log(self) -> str:
        return self._log.read_text()

    def listen(self) -> None:
        """Wait for READY and connect."""
        until(lambda: self.supervisor.count("READY=1") == 1, f"READY, {self.log()}")
        self.fleet = FleetListener(self.endpoint, [ROBOT], queue_size=100_000)

    def waiting_poses(self) -> list[PoseMessage]:
        """All that came in since the last call, in order."""
        assert self.fleet is not None
        poses = []
        while (pose := self.fleet.next_pose(0.0)) is not None:
            poses.append(pose)
        return poses

    def next_poses(self, count: int) -> list[PoseMessage]:
        """The poses that come in from now on."""
        assert self.fleet is not None
        self.waiting_poses()
        poses = []
        for _ in range(count):
            pose = self.fleet.next_pose(DEADLINE_S)
            assert pose is not None, self.log()
            poses.append(pose)
        return poses

    def status_when(self, condition: Callable[[StatusMessage], bool], what: str) -> StatusMessage:
        """The first status for which ``condition`` holds."""
        assert self.fleet is not None
        found: list[StatusMessage] = []

        def holds(_: object) -> bool:
            assert self.fleet is not None
            status = self.fleet.views()[ROBOT].status
            if status is not None and condition(status):
                found.append(status)
            return bool(found)

        assert self.fleet.wait_for(holds, DEADLINE_S), f"{what}: {self.fleet.views()}, {self.log()}"
        return found[0]

    def children(self) -> list[str]:
        """Process identifiers."""
        pid = self.process.pid
        return Path(f"/proc/{pid}/task/{pid}/children").read_text().split()

    def slam_process(self) -> int:
        """Of the present worker; multiprocessing's other child is its resource tracker."""
        children = self.children()
        (worker,) = (
            c for c in children if b"spawn_main" in Path(f"/proc/{c}/cmdline").read_bytes()
        )
        return int(worker)

    def stop(self, number: signal.Signals = signal.SIGTERM, *, group: bool = False) -> int:
        """Send a signal, to the whole group as a terminal does, and wait for the end."""
        if group:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)
        return self.process.wait(DEADLINE_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        if self.fleet is not None:
            self.fleet.close()
        self.supervisor.close()


def has_ended(pid: int) -> bool:
    """Gone, or a zombie that somebody else has to bury."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def environment(**changes: str) -> Mapping[str, str]:
    """Ours, without what a supervisor of the tests may have left in it."""
    left_out = {"NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"}
    return {key: value for key, value in os.environ.items() if key not in left_out} | changes


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
