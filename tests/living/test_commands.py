"""``amr-slam map diff|accept|rollback`` on real files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from living.places import AFTER, mapped, watching

from amr_slam.cli import main
from amr_slam.living import changes_path, save_changes
from amr_slam.map import load_map, save_map


@pytest.fixture(scope="module")
def watched() -> tuple[bytes, bytes]:
    """A map's bytes, and its changes'."""
    import tempfile  # noqa: PLC0415

    known = mapped()
    day = watching(known)
    for _ in range(2):
        day.visit(AFTER)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hall.amrmap"
        save_changes(day.watcher, known, save_map(known, path), changes_path(path))
        return path.read_bytes(), changes_path(path).read_bytes()


@pytest.fixture
def hall(watched: tuple[bytes, bytes], tmp_path: Path) -> Path:
    path = tmp_path / "hall.amrmap"
    path.write_bytes(watched[0])
    changes_path(path).write_bytes(watched[1])
    return path


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    assert main(["map", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_diff_accept_and_roll_back(hall: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, first = load_map(hall)
    changes = json.loads(told(capsys, "diff", hall, "--json"))["changes"]
    assert [(one["number"], one["kind"], one["passes"]) for one in changes] == [
        (1, "gone", 2),
        (2, "new", 2),
    ]
    listed = told(capsys, "diff", hall, "--out", hall.parent / "diff.png")
    assert "2001-09-09" in listed
    assert (hall.parent / "diff.png").read_bytes().startswith(b"\x89PNG")

    assert "1 gone at x 3.0" in told(capsys, "accept", hall, "--only", "1")
    assert load_map(hall)[1] != first
    left = json.loads(told(capsys, "diff", hall, "--json"))["changes"]
    assert [one["kind"] for one in left] == ["new"]
    older = json.loads(told(capsys, "diff", hall, f"{hall}.1", "--json"))["changes"]
    assert [(one["kind"], one["since_s"]) for one in older] == [("gone", None)]
    told(capsys, "accept", hall, "--all")
    assert "no changes" in told(capsys, "diff", hall)

    told(capsys, "rollback", hall, "--to", "2")
    assert load_map(hall)[1] == first
    assert load_map(hall.with_name("hall.amrmap.1"))[1] != first


def test_policy_of_a_configuration_and_what_cannot_be_done(
    hall: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, status, complaint in (
        (("accept", hall, "--only", "3"), 2, "there are 2 changes"),
        (("accept", hall, "--all", "--keep", "0"), 2, "1 to 9"),
        (("rollback", hall), 1, "hall.amrmap.1"),
        (("diff", hall, hall.parent / "none"), 1, "none"),
    ):
        assert main(["map", *map(str, arguments)]) == status
        assert complaint in capsys.readouterr().err
    changes_path(hall).unlink()
    assert main(["map", "diff", str(hall)]) == 1
    assert "nothing has been watched yet" in capsys.readouterr().err
