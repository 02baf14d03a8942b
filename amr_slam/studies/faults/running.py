"""Runs rows, those of one setting on one robot, and tells how they went."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

from amr_slam.studies.faults.place import Place, mapped
from amr_slam.studies.faults.playing import play
from amr_slam.studies.faults.row import Case, Finding, Row
from amr_slam.studies.faults.settings import Pace, Setting
from amr_slam.studies.faults.stage import Stage


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
    ordered = _by_setting(rows)
    with ExitStack() as opened:
        stage: Stage | None = None
        for row in ordered:
            if isinstance(row, Case):
                opened.close()
                stage = None
                yield row.play(row, bench.stage)
                continue
            if stage is None or stage.setting != row.setting:
                opened.close()
                stage = opened.enter_context(bench.stage(row.setting))
            finding = play(row, stage)
            if finding.recovered_s is None:
                opened.close()
                stage = None
            yield finding


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
