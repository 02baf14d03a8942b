"""One robot with its daemon and a listener of the fleet, for the rows of one setting."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, Self

from amr_drivers.emulators.ports import free_port
from amr_slam.client.session import close_session, open_session
from amr_slam.config import load
from amr_slam.keys import create
from amr_slam.states import State
from amr_slam.studies.faults.place import Place
from amr_slam.studies.faults.processes import has_ended, slam_process
from amr_slam.studies.faults.robot import FailingRobot
from amr_slam.studies.faults.settings import ROBOT, Pace, Setting, config_text
from amr_slam.studies.faults.witness import Message, Witness
from amr_slam.trial import DaemonProcess
from amr_slam.wire import PoseMessage

_SCAN_PERIOD_S: Final = 0.2
"""Of the scanners. Real ones are five times as fast: two small processors carry all of this."""
_START_S: Final = 120.0
_END_S: Final = 60.0
"""A SLAM process that is just starting looks for its daemon when it has started."""
_PROGRAM: Final = ("-m", "amr_slam")


class StageError(Exception):
    """The robot did not come to where a row can begin. One line."""


class Stage:
    """A context manager; everything that it has started ends with it."""

    def __init__(
        self,
        folder: Path,
        dbc: Path,
        place: Place,
        setting: Setting,
        pace: Pace,
        program: tuple[str, ...] = _PROGRAM,
    ) -> None:
        """``folder``: an empty one, for ports, maps and logs. ``dbc``: describes the wheels'
        frames. ``program``: what is run as the daemon; the robot's is the right one."""
        self.folder, self.place, self.setting, self.pace = folder, place, setting, pace
        self.onset_ns: int | None = None
        """When the fault really began, where that is later than it was ordered."""
        self.broken: list[str] = []
        """What an injection has found to be wrong by itself."""
        self.notes: list[str] = []
        """What else is to be told of the row under way."""
        self.clock = folder / "clock"
        """Seconds that the wall clock is off, for a setting with ``clocked``."""
        self._router: Any = None
        self._starts = 0
        self.set_clock(0.0)
        is_routed, is_keyed = setting.router != "none", setting.router == "keys"
        self._own = f"tcp/127.0.0.1:{free_port()}"
        scheme = "tls" if is_keyed else "tcp"
        self._routers = f"{scheme}/127.0.0.1:{free_port()}" if is_routed else ""
        if is_keyed:
            self._make_keys()
        self.config = folder / "robot.toml"
        self.config.write_text(
            config_text(
                setting, pace, folder=folder, dbc=dbc, map_path=place.map_path,
                can_port=free_port(), listen="" if is_keyed else self._own, connect=self._routers,
                keys=self.keys_of("robots", ROBOT),
            ),
            encoding="utf-8",
        )  # fmt: skip
        if setting.clocked:
            program = ("-m", "amr_slam.studies.faults.clocked", str(self.clock))
        self._program = program
        with ExitStack() as opened:
            self.witness = opened.enter_context(Witness(ROBOT))
            opened.callback(self.stop_router)
            self.robot = opened.enter_context(
                FailingRobot(load(self.config), place, _SCAN_PERIOD_S)
            )
            opened.callback(self.stop_daemon)
            if is_routed:
                self.start_router()
            self.start_daemon()
            self._opened = opened.pop_all()

    # -- the daemon --------------------------------------------------------------------------

    @property
    def log(self) -> Path:
        """Of the present daemon."""
        return self.folder / f"daemon-{self._starts}.log"

    def start_daemon(self) -> None:
        """As systemd does it, and listen to it. Raises TrialError when it does not come up."""
        self._starts += 1
        self.daemon = DaemonProcess(self.config, self.log, self._program)
        self.listen()

    def listen(self) -> None:
        """Connect the listener (anew). Raises TrialError when nobody answers."""
        endpoint = self._routers if self.setting.router == "keys" else self._own
        keys = self.keys_of("fleet", "main")
        self.witness.follow(self.daemon.listener(endpoint, ROBOT, _START_S, keys))

    def stop_daemon(self) -> None:
        """However it is: whoever wants to see a clean end looks for it before. Idempotent."""
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.daemon.pid, signal.SIGCONT)
        worker = None if self.daemon.status is not None else slam_process(self.daemon.pid)
        self.daemon.kill()
        if worker is not None:
            _wait_for_end(worker)

    def kill_daemon(self) -> None:
        """``kill -9`` of the daemon alone; its SLAM process has to see to itself."""
        worker = slam_process(self.daemon.pid)
        os.kill(self.daemon.pid, signal.SIGKILL)
        _wait_for_end(self.daemon.pid)
        if worker is not None:
            _wait_for_end(worker)

    def slam(self) -> int:
        """The SLAM process, once there is one."""
        deadline_s = time.monotonic() + _START_S
        while (worker := slam_process(self.daemon.pid)) is None:
            if time.monotonic() > deadline_s:
                raise StageError(f"no SLAM process; see {self.log}")
            time.sleep(0.01)
        return worker

    # -- what is around it -------------------------------------------------------------------

    def set_clock(self, seconds: float) -> None:
        """UTC is off by so much from now on."""
        fresh = self.clock.with_suffix(".new")
        fresh.write_text(repr(seconds), encoding="utf-8")
        fresh.replace(self.clock)

    def start_router(self) -> None:
        """The fleet's router is there (again)."""
        options: dict[str, object] = {
            "mode": "router",
            "listen/endpoints": [self._routers],
            "scouting/multicast/enabled": False,
        }
        if self.setting.router == "keys":
            folder = self._site.router_folder.resolve()
            written = self._site.router_settings(folder)
            written["listen"] = {"endpoints": [self._routers]}
            options = dict(written)
        self._router = open_session(options, (self._routers,), None)

    def stop_router(self) -> None:
        """It is gone. Idempotent."""
        if self._router is not None:
            close_session(self._router)
            self._router = None

    @property
    def endpoint(self) -> str:
        """Where the fleet connects: the router, or the robot itself."""
        return self._routers or self._own

    def keys_of(self, kind: str, name: str) -> Path | None:
        """The folder of a member's keys; None where none are used."""
        return self.folder / "keys" / kind / name if self.setting.router == "keys" else None

    def _make_keys(self) -> None:
        self._site = create(self.folder / "keys", "hall", ["127.0.0.1"], auth="tls")
        for robot in (ROBOT, "amr8"):
            self._site.add_robot(robot, 30)
        self._site.add_controller("main", 30, commands=True)
        self._site.add_controller("board", 30, commands=False)

    # -- time --------------------------------------------------------------------------------

    def mark(self) -> None:
        """The fault begins now; only the first time counts."""
        if self.onset_ns is None:
            self.onset_ns = time.monotonic_ns()

    def rest(self, seconds: float) -> None:
        """Let time pass. Raises RuntimeError when the emulated robot fails meanwhile."""
        time.sleep(max(0.0, seconds))
        self.robot.check()

    def settle(self) -> None:
        """Until the robot is well, and has been for a scan. Raises StageError."""
        well = is_mapping if self.setting.mapping else is_well
        begin_ns = time.monotonic_ns()
        if self.witness.wait_for(well, begin_ns, _START_S) is None:
            self.robot.check()
            raise StageError(f"not localized within {_START_S:g} s; see {self.log}")
        self.rest(self.pace.scan_period_s)

    def close(self) -> None:
        """Idempotent."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def is_well(message: Message) -> bool:
    """Localized, and nothing to complain of."""
    return (
        isinstance(message, PoseMessage)
        and message.state is State.LOCALIZED
        and message.fault is None
    )


def is_localized(message: Message) -> bool:
    """Localized, whatever else is said."""
    return isinstance(message, PoseMessage) and message.state is State.LOCALIZED


def is_mapping(message: Message) -> bool:
    """A map grows, and nothing to complain of."""
    return (
        isinstance(message, PoseMessage)
        and message.state is State.MAPPING
        and message.fault is None
    )


def _wait_for_end(pid: int) -> None:
    deadline_s = time.monotonic() + _END_S
    while not has_ended(pid):
        if time.monotonic() > deadline_s:
            os.kill(pid, signal.SIGKILL)
            raise StageError(f"process {pid} had to be ended")
        time.sleep(0.005)
