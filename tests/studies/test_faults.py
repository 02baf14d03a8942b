"""The fault harness: whole robots for some of its rows, and its judge held against lies.

On a busy machine times say nothing: that all deadlines are met is for `make faults`.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from messages import pose_of, status_of
from paths import REPO

from amr_slam.recording import Trajectory
from amr_slam.states import State
from amr_slam.studies.faults.judging import Figures, Times, figures
from amr_slam.studies.faults.page import BEGIN, END, renew, tables
from amr_slam.studies.faults.place import Place, mapped
from amr_slam.studies.faults.playing import play
from amr_slam.studies.faults.row import Finding, Row
from amr_slam.studies.faults.rows import ROWS
from amr_slam.studies.faults.running import chosen
from amr_slam.studies.faults.settings import QUICK, STANDARD, Setting
from amr_slam.studies.faults.stage import Stage
from amr_slam.studies.faults.witness import Heard
from amr_slam.trial import reported

S = 1_000_000_000
MS = 1_000_000
DBC = REPO / "config/wheels.dbc"
TIMES = Times(calm_ns=0, onset_ns=2 * S, end_ns=6 * S, back_ns=7 * S, due_ns=3 * S)
# An error frame, a clock that is set and a robot that is carried: no other test lets a whole robot
# live through them.
LIVE = ("9", "16", "24")
PATIENCE = 10.0


# -- the judge -------------------------------------------------------------------------------


def heard_at(second: float, **changes: Any) -> Heard:
    """A pose of the instant at which it comes in, at the origin, right to 5 cm."""
    stamp_ns = round(second * S)
    fields: dict[str, Any] = {"x": 0.0, "y": 0.0, "theta": 0.0, "stamp": second}
    fields = {"seq": round(50 * second)} | fields | changes
    message = pose_of(**fields)
    return Heard(
        received_ns=stamp_ns, message=message, report=reported(message, stamp_ns, stamp_ns)
    )


def drive(change: Callable[[float], dict[str, object]] = lambda _: {}) -> list[Heard]:
    return [heard_at(0.02 * i, **change(0.02 * i)) for i in range(500)]


def truth() -> Trajectory:
    stamps_ns = np.arange(0, 11 * S, 20 * MS, dtype=np.int64)
    return Trajectory(stamps_ns=stamps_ns, poses=np.zeros((len(stamps_ns), 3)))


def judged(heard: list[Heard], **options: object) -> Figures:
    return figures(heard, truth(), TIMES, **options)  # type: ignore[arg-type]


def test_an_honest_robot_breaks_nothing() -> None:
    found = judged(drive(), stays=frozenset({State.LOCALIZED}))
    assert found.broken == ()
    assert found.worst_m == 0.0
    assert found.beyond == 0.0
    assert found.gap_max_ms == pytest.approx(20.0)


def test_wrong_poses_are_lies_once_the_deadline_has_passed() -> None:
    late = judged(drive(lambda s: {"x": 0.5 if 4.0 < s < 5.0 else 0.0}))
    assert [text[:24] for text in late.broken] == ["wrong without saying so:"]
    assert late.worst_m == late.unsaid_m == pytest.approx(0.5)
    told = judged(drive(lambda s: {"x": 0.5, "state": State.LOST} if 4.0 < s < 5.0 else {}))
    assert told.broken == ()
    early = judged(drive(lambda s: {"x": 0.5 if 2.1 < s < 2.9 else 0.0}))
    assert early.broken == ()
    assert early.worst_m == pytest.approx(0.5)
    assert early.unsaid_m == 0.0
    assert early.beyond == pytest.approx(0.08, abs=0.01)


def lie_about_stamps(second: float) -> dict[str, object]:
    return {"stamp": 4.0} if 4.0 < second < 4.2 else {}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: {"stamp": s - 0.5 if s == 4.0 else s}, "1 poses stamped before the one before"),
        (lie_about_stamps, "poses repeated without saying so"),
        (lambda s: {"seq": round(50 * s) % 300}, "pose numbers began anew"),
        (lambda s: {"x": 0.04 if s > 7.0 else 0.0}, "0.040 m off afterwards, 0.000 m before"),
    ],
)
def test_what_must_never_happen_is_named(
    change: Callable[[float], dict[str, object]], said: str
) -> None:
    broken = judged(drive(change)).broken
    assert any(said in text for text in broken), broken


def test_stale_poses_that_say_so_are_none_of_these() -> None:
    def old(second: float) -> dict[str, object]:
        return {"stamp": 4.0, "age_s": second - 4.0 + 0.11} if 4.0 < second < 4.4 else {}

    assert judged(drive(old)).broken == ()


def test_a_pause_is_told_unless_the_row_has_one() -> None:
    paused = [heard for heard in drive() if not 4 * S < heard.received_ns < 5 * S]
    assert judged(paused).broken == ("no pose for 1.00 s",)
    assert judged(paused, restarts=True).broken == ()


def test_who_should_go_on_must_not_stop() -> None:
    stopped = drive(lambda s: {"state": State.LOST} if s > 4.0 else {})
    assert judged(stopped, stays=frozenset({State.LOCALIZED})).broken == (
        "did not go on, but was lost",
    )
    assert judged(stopped).broken == ()


def test_memory_that_grows_is_told() -> None:
    used = [
        Heard(received_ns=at * S, message=status_of(memory_mb=100.0 + 10.0 * at)) for at in range(9)
    ]
    assert judged(sorted(drive() + used, key=lambda one: one.received_ns)).broken == (
        "grown by 80 MB",
    )


# -- choosing and telling --------------------------------------------------------------------


def test_every_row_of_the_catalogue_is_there() -> None:
    numbers = {int(row.number.rstrip("abcd")) for row in ROWS}
    assert numbers == set(range(34))
    assert len({row.number for row in ROWS}) == len(ROWS)


def test_rows_are_chosen_by_number() -> None:
    assert [row.number for row in chosen(ROWS, ["32", "7"])] == ["7", "32a", "32b", "32c", "32d"]
    assert chosen(ROWS, []) == list(ROWS)
    with pytest.raises(ValueError, match=r"^no row 99; there are 0, 1, 2, "):
        chosen(ROWS, ["1", "99"])


def found(**changes: object) -> Finding:
    finding = Finding(
        number="6", fault="one scanner silent", sign="fault", detected_s=0.5, deadline_s=0.6,
        states="localized", said="rear stale", recovered_s=1.0, worst_m=0.01, unsaid_m=0.005,
        beyond=0.0, gap_max_ms=30.0, gap_p99_ms=22.0, broken=(),
    )  # fmt: skip
    return replace(finding, **changes)  # type: ignore[arg-type]


def test_a_page_is_renewed_between_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    written = tables([found(), found(number="7", said="a|b", broken=("late",))], 2.0, 60.0)
    renew(page, written)
    text = page.read_text()
    assert text.startswith(f"before\n{BEGIN}\n2 rows in 1 minutes")
    assert text.endswith(f"{END}\nafter\n")
    assert "Rows with something broken: 7." in text
    assert "a/b" in text
    with pytest.raises(ValueError, match="lacks the marks"):
        renew(REPO / "LICENSE", written)


def test_the_tool_says_which_rows_there_are() -> None:
    command = [sys.executable, str(REPO / "tools/faults.py"), "1", "99"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert ended.returncode == 1
    assert ended.stderr.startswith("faults: no row 99; there are 0, 1, 2, ")
    assert ended.stdout == ""


# -- whole robots ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    return mapped("laboratory", tmp_path_factory.mktemp("place"))


@pytest.fixture
def staged(tmp_path: Path, place: Place) -> Iterator[Callable[[Setting], Stage]]:
    stages: list[Stage] = []

    def make(setting: Setting) -> Stage:
        stages.append(Stage(tmp_path, DBC, place, setting, QUICK))
        return stages[-1]

    yield make
    for stage in stages:
        stage.close()


def row_of(number: str) -> Row:
    (row,) = chosen(ROWS, [number])
    assert isinstance(row, Row)
    return row


def serious(finding: Finding) -> list[str]:
    """Of what is broken, what no busy computer explains."""
    return [text for text in finding.broken if "wrong without" in text or "ended" in text]


@pytest.mark.timeout(300)
@pytest.mark.parametrize("number", LIVE)
def test_a_fault_is_said_and_got_over(number: str, staged: Callable[[Setting], Stage]) -> None:
    row = row_of(number)
    finding = play(row, staged(row.setting), PATIENCE)
    assert finding.detected_s is not None, finding
    assert finding.recovered_s is not None, finding
    assert serious(finding) == [], finding


@pytest.mark.timeout(300)
def test_a_daemon_that_lies_is_caught(tmp_path: Path, place: Place) -> None:
    program = (str(REPO / "tests/lying_daemon.py"),)
    with Stage(tmp_path, DBC, place, STANDARD, QUICK, program) as stage:
        finding = play(replace(row_of("7"), lasts_s=1.0, within_s=2.0), stage)
    assert any("wrong without saying so" in text for text in finding.broken), finding
    assert "never said" in finding.broken
