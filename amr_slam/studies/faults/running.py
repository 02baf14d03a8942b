"""Runs rows, those of one setting on one robot, and tells how they went."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from amr_drivers.errors import DriverError
from amr_slam.studies.faults.place import Place, mapped
from amr_slam.studies.faults.playing import play
from amr_slam.studies.faults.row import Case, Finding, Row
from amr_slam.studies.faults.settings import Pace, Setting
from amr_slam.studies.faults.stage import Stage, StageError
from amr_slam.trial import TrialError


class Bench:
    """Makes stages, each in a folder of its own. A context manager; ends them."""

    def __init__(self, folder: Path, dbc: Path, pace: Pace) -> None:
        self._folder, self._dbc, self._pace = folder, dbc, pace
        self._places: dict[str, Place] = {}
        self._stages = 0

    def stage(self, setting: Setting) -> Stage:
        """A robot that has just been switched on."""
        if setting.place not in self._places:
            self._places[setting.place] = mapped(setting.place, self._folder)
        self._stages += 1
        folder = self._folder / f"stage-{self._stages}"
        folder.mkdir()
        return Stage(folder, self._dbc, self._places[setting.place], setting, self._pace)


def run(rows: Iterable[Row | Case], bench: Bench) -> Iterator[Finding]:
    """One finding a row, as they come. A robot that did not get over a row is replaced."""
    with ExitStack() as opened:
        stage: Stage | None = None
        for row in _by_setting(rows):
            if stage is not None and (isinstance(row, Case) or stage.setting != row.setting):
                opened.close()
                stage = None
            try:
                if isinstance(row, Case):
                    finding = row.play(row, bench.stage)
                else:
                    stage = stage or opened.enter_context(bench.stage(row.setting))
                    finding = play(row, stage)
            except (StageError, TrialError, DriverError) as error:
                finding = _failed(row, str(error))
            if finding.recovered_s is None:
                opened.close()
                stage = None
            yield finding


def _failed(row: Row | Case, reason: str) -> Finding:
    return Finding(
        number=row.number, fault=row.fault, sign=row.sign, detected_s=None,
        deadline_s=row.within_s, states="", said="", recovered_s=None, worst_m=None,
        unsaid_m=None, beyond=None, gap_max_ms=None, gap_p99_ms=None, broken=(reason,),
        elsewhere=row.elsewhere,
    )  # fmt: skip


def chosen(rows: Sequence[Row | Case], numbers: Sequence[str]) -> list[Row | Case]:
    """Rows by their numbers; 32 stands for 32a, 32b, ..., none for all. Raises ValueError."""
    found = [
        row for row in rows if not numbers or row.number in numbers
        or row.number.rstrip("abcd") in numbers
    ]  # fmt: skip
    names = {row.number for row in found} | {row.number.rstrip("abcd") for row in found}
    unknown = [number for number in numbers if number not in names]
    if unknown:
        raise ValueError(
            f"no row {', '.join(unknown)}; there are {', '.join(r.number for r in rows)}"
        )
    return found


def _by_setting(rows: Iterable[Row | Case]) -> list[Row | Case]:
    groups: dict[object, list[Row | Case]] = {}
    for row in rows:
        groups.setdefault(row.setting if isinstance(row, Row) else row.number, []).append(row)
    return [row for group in groups.values() for row in group]
