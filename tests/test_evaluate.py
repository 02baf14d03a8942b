"""The command that writes the evaluation's page: which studies run, and what becomes of them."""

from __future__ import annotations

import importlib.util
import runpy
import sys
from pathlib import Path

import pytest
from paths import REPO

from amr_slam.studies import negatives, slam_scratch
from amr_slam.studies.report import Effort, Section, Table

TOOL = str(REPO / "tools" / "evaluate.py")


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["evaluate.py", *arguments])
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(TOOL, run_name="__main__")
    return int(ended.value.code or 0)


def test_chosen_studies_fill_one_page_in_its_own_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: list[Effort] = []

    def study(title: str, effort: Effort) -> Section:
        asked.append(effort)
        table = Table(title="numbers", columns=("a", "b"), rows=(("1", "2"),))
        return Section(title=title, text="said", tables=(table,))

    monkeypatch.setattr(slam_scratch, "run", lambda effort: study("First", effort))
    monkeypatch.setattr(negatives, "run", lambda effort: study("Second", effort))
    out = tmp_path / "page.md"
    status = run(
        monkeypatch,
        *("--scale", "0.5", "--seed", "3", "--out", str(out), "--only", "negatives", "slam"),
    )
    assert status == 0
    page = out.read_text(encoding="utf-8")
    assert page.index("## First") < page.index("## Second")
    assert "| 1 | 2 |" in page
    assert "--scale 0.5" in page
    assert [(effort.scale, effort.seed) for effort in asked] == [(0.5, 3)] * 2


def test_unknown_study_is_refused_with_the_names_of_the_known_ones(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "--only", "tabel1") == 2
    assert "table1" in capsys.readouterr().err


def test_every_study_has_its_module() -> None:
    studies = runpy.run_path(TOOL)["STUDIES"]
    missing = [
        name
        for name, module in studies.items()
        if importlib.util.find_spec(f"amr_slam.studies.{module}") is None
    ]
    assert missing == []
