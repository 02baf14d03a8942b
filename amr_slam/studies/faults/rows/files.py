"""Rows 21, 22, 23, 27 and 33: what is on the disk, and what is started from it."""

from __future__ import annotations

import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from amr_slam.client.asking import AskingError, call
from amr_slam.map import MapError, load_map
from amr_slam.states import State
from amr_slam.studies.faults.judging import states_of
from amr_slam.studies.faults.row import Case, Finding, Row, fault_says
from amr_slam.studies.faults.rows.processes import gone
from amr_slam.studies.faults.settings import (
    PREFIX,
    ROBOT,
    STANDARD,
    Pace,
    Setting,
    config_text,
)
from amr_slam.studies.faults.stage import Stage, is_localized, is_mapping
from amr_slam.studies.faults.witness import Heard, Message
from amr_slam.trial import TrialError
from amr_slam.wire import SaveMap, StatusMessage

_MAPPING: Final = Setting(mapping=True)
_KEEPS_MAPPING: Final = frozenset({State.MAPPING})
_FULL_BYTES: Final = 4096
_KILLS: Final = 6
_SAVING_S: Final = 0.1
"""In it a save begins and ends."""
_ASK_S: Final = 2.0
_STORM: Final = 3
_START_S: Final = 60.0
_REFUSAL_S: Final = 1.0
_EX_CONFIG: Final = 2
"""Not restarted, by the unit file."""


@contextmanager
def _disk_full(stage: Stage) -> Iterator[None]:
    path, worker = stage.folder / "new.amrmap", stage.slam()
    _wait(path.exists)
    soft, hard = resource.prlimit(worker, resource.RLIMIT_FSIZE)
    resource.prlimit(worker, resource.RLIMIT_FSIZE, (_FULL_BYTES, hard))
    stage.mark()
    try:
        yield
        _look_at_map(stage, path)
    finally:
        resource.prlimit(worker, resource.RLIMIT_FSIZE, (soft, hard))


def _tells_full(message: Message) -> bool:
    if not isinstance(message, StatusMessage):
        return False
    return "cannot write the map" in (message.slam.detail or "")


@contextmanager
def _killed_while_saving(stage: Stage) -> Iterator[None]:
    dice = random.Random(4)
    path = stage.folder / "new.amrmap"
    whole = 0
    for _ in range(_KILLS):
        stage.settle()
        worker = stage.slam()
        asking = threading.Thread(target=_save, args=(stage,))
        asking.start()
        stage.rest(dice.uniform(0.0, _SAVING_S))
        os.kill(worker, signal.SIGKILL)
        stage.mark()
        asking.join()
        whole += not path.exists() or _look_at_map(stage, path)
    stage.notes.append(f"{whole} of {_KILLS} times no map or a whole one")
    yield


def _save(stage: Stage) -> None:
    with suppress(AskingError):  # who is killed does not answer
        call(stage.witness.listener.session, PREFIX, ROBOT, SaveMap(name="new"), _ASK_S)


@contextmanager
def _storm(stage: Stage) -> Iterator[None]:
    stage.mark()
    for _ in range(_STORM):
        stage.kill_daemon()
        stage.start_daemon()
    yield


def _look_at_map(stage: Stage, path: Path) -> bool:
    try:
        load_map(path)
    except MapError as error:
        stage.broken.append(str(error))
        return False
    return True


def _wait(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 60.0
    while not condition():
        if time.monotonic() > deadline_s:
            raise TimeoutError("the map was not saved")
        time.sleep(0.005)


def _map_damaged(case: Case, make: Callable[[Setting], Stage]) -> Finding:
    with make(STANDARD) as stage:
        stage.settle()
        stage.stop_daemon()
        path = stage.place.map_path
        data = path.read_bytes()
        shutil.copy(path, path.with_name(f"{path.name}.1"))
        middle = len(data) // 2
        path.write_bytes(data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :])
        begin_ns = time.monotonic_ns()
        try:
            with suppress(TrialError):  # it may end before anybody has heard it
                stage.start_daemon()
            back = _localized_or_ended(stage, begin_ns)
        finally:
            path.write_bytes(data)
        took_s = 1e-9 * (time.monotonic_ns() - begin_ns)
        states = states_of(stage.witness.since(begin_ns), begin_ns)
        status = stage.daemon.status
        if back is not None:
            said = back.message.fault or "goes on with the version before it"
        else:
            said = f"ends with status {status}: {_last_line(stage.log)}"
        broken = ["neither refused nor localized"] if back is None and status is None else []
    return _finding(case, took_s, states, said, broken)


def _localized_or_ended(stage: Stage, begin_ns: int) -> Heard | None:
    deadline_s = time.monotonic() + _START_S
    while stage.daemon.status is None and time.monotonic() < deadline_s:
        heard = stage.witness.wait_for(is_localized, begin_ns, 0.1)
        if heard is not None:
            return heard
    return None


def _config_wrong(case: Case, _make: Callable[[Setting], Stage]) -> Finding:
    notes: list[str] = []
    broken: list[str] = []
    longest_s = 0.0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        right = config_text(
            STANDARD, Pace(), folder=path, dbc=path / "no.dbc", map_path=path / "no.amrmap",
            can_port=1, listen="tcp/127.0.0.1:1", connect="", keys=None,
        )  # fmt: skip
        for old, new in (
            ("poll_period_s", "pol_period_s"),
            ("track_m = 0.5", "track_m = 0.0"),
            (f'port = "{path}/rear"', f'port = "{path}/front"'),
            ("radius_left_m = 0.1", 'radius_left_m = "wide"'),
        ):
            config = path / "robot.toml"
            config.write_text(right.replace(old, new), encoding="utf-8")
            begin_s = time.monotonic()
            ended = subprocess.run(
                [sys.executable, "-m", "amr_slam", "run", "--config", str(config)],
                capture_output=True, text=True, timeout=60.0, check=False,
            )  # fmt: skip
            longest_s = max(longest_s, time.monotonic() - begin_s)
            lines = ended.stderr.strip().splitlines()
            notes.append(lines[-1].replace(folder, "…") if lines else "nothing said")
            if ended.returncode != _EX_CONFIG or len(lines) != 1:
                broken.append(f"{new}: status {ended.returncode}, {len(lines)} lines")
    return _finding(case, longest_s, "none", notes[0], broken, tuple(notes[1:]))


def _finding(
    case: Case, took_s: float, states: str, said: str, broken: list[str],
    notes: tuple[str, ...] = (),
) -> Finding:  # fmt: skip
    late = [] if took_s <= case.within_s else [f"after {took_s:.1f} s, wanted {case.within_s:g} s"]
    return Finding(
        number=case.number, fault=case.fault, sign=case.sign, detected_s=took_s,
        deadline_s=case.within_s, states=states, said=said, recovered_s=None, worst_m=None,
        unsaid_m=None, beyond=None, gap_max_ms=None, gap_p99_ms=None,
        broken=(*broken, *late), notes=notes, elsewhere=case.elsewhere,
    )  # fmt: skip


def _last_line(log: Path) -> str:
    lines = log.read_text("utf-8").strip().splitlines()
    return lines[-1].replace(str(log.parent.parent), "…") if lines else ""


FILES: Final = (
    Row(
        number="21", fault="no room for the map's file", inject=_disk_full,
        sign="health: slam: cannot write the map", says=_tells_full, within_s=7.0, within_scans=2,
        lasts_s=5.0, back=is_mapping, stays=_KEEPS_MAPPING, setting=_MAPPING,
        elsewhere="a full disk for all files",
    ),
    Case(
        number="22", fault="map file damaged, the version before it whole",
        sign="refused, or the version before it", within_s=10.0, play=_map_damaged,
    ),
    Row(
        number="23", fault=f"SLAM process killed {_KILLS} times while it saves its map",
        inject=_killed_while_saving, sign="fault: slam: killed",
        says=fault_says("slam: killed by SIGKILL"), within_s=0.5, lasts_s=0.0, back=is_mapping,
        back_s=10.0, setting=_MAPPING, elsewhere="power",
    ),
    Case(
        number="27", fault="wrong key, track of 0 m, one port for two scanners, text for a number",
        sign="status 2 and one line", within_s=_REFUSAL_S, play=_config_wrong,
    ),
    Row(
        number="33", fault=f"daemon killed {_STORM} times as soon as it is up", inject=_storm,
        sign="alive token falls", says=gone, within_s=1.5, lasts_s=0.0, back=is_localized,
        back_s=10.0, back_scans=0,
        restarts=True, elsewhere="StartLimitBurst",
    ),
)  # fmt: skip
