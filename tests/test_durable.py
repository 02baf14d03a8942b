"""What is on disk after a kill, a power cut or a full disk: the old content or the new, whole."""

from __future__ import annotations

import errno
import itertools
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from labs import cloud_at, room
from paths import REPO

from amr_slam import durable
from amr_slam.durable import remove_durably, write_durably
from amr_slam.geometry import Pose2
from amr_slam.map import MapError, MapParams, PointMap, load_map, load_newest, save_map
from amr_slam.map.file import encode

NAMES = {"open", "write", "fsync", "close", "replace", "link", "unlink"}


class Disk:
    """Stands in for ``os``: does what is asked for, tells of it before, and may refuse."""

    def __init__(self, before: Callable[[str, tuple[Any, ...]], None]) -> None:
        self._before = before
        self.done: list[tuple[str, tuple[Any, ...], Any]] = []

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        if name not in NAMES:
            return real

        def call(*arguments: Any) -> Any:
            self._before(name, arguments)
            result = real(*arguments)
            self.done.append((name, arguments, result))
            return result

        return call


def small_map(name: str, scans: int) -> PointMap:
    grown, rng = PointMap(MapParams(), name), np.random.default_rng(1)
    for number in range(scans):
        pose = Pose2(1.0 + 0.3 * number, 2.0, 0.0)
        grown.insert(cloud_at(room(), pose, rng, stamp_ns=number), pose)
    return grown


# -- a power cut at any moment ---------------------------------------------------------------


@dataclass
class Inode:
    synced: bytes = b""
    written: bytes = b""


@dataclass
class Recorded:
    """A folder as a disk may have it when the power goes: names and contents that were synced,
    and of the rest any part."""

    names: dict[str, Inode]
    later: list[dict[str, Inode | None]] = field(default_factory=list)
    """Changes of names that are not synced, in their order."""
    now: dict[str, Inode] = field(default_factory=dict)
    opened: dict[int, Inode] = field(default_factory=dict)

    def take(self, name: str, arguments: tuple[Any, ...], result: Any) -> None:
        if name == "open" and arguments[1] & os.O_CREAT:
            at, inode = Path(arguments[0]).name, Inode()
            self.opened[result] = inode
            self._change({at: inode})
        elif name == "write":
            self.opened[arguments[0]].written += bytes(arguments[1])[:result]
        elif name == "fsync" and arguments[0] in self.opened:
            inode = self.opened[arguments[0]]
            inode.synced = inode.written
        elif name == "fsync":
            self.names, self.later = dict(self.now), []
        elif name == "close":
            self.opened.pop(arguments[0], None)
        elif name == "unlink":
            self._change({Path(arguments[0]).name: None})
        elif name in {"replace", "link"}:
            source, target = (Path(argument).name for argument in arguments)
            change: dict[str, Inode | None] = {target: self.now[source]}
            self._change(change | ({source: None} if name == "replace" else {}))

    def _change(self, change: dict[str, Inode | None]) -> None:
        self.later.append(change)
        _apply(self.now, change)

    def after_a_cut(self) -> list[dict[str, bytes]]:
        """Every folder that the disk may show."""
        found: list[dict[str, bytes]] = []
        for chosen in itertools.product((False, True), repeat=len(self.later)):
            names = dict(self.names)
            for change, kept in zip(self.later, chosen, strict=True):
                if kept:
                    _apply(names, change)
            for part in (0.0, 0.5, 1.0):
                folder = {
                    name: inode.synced
                    + inode.written[len(inode.synced) :][
                        : round(part * (len(inode.written) - len(inode.synced)))
                    ]
                    for name, inode in names.items()
                }
                if folder not in found:
                    found.append(folder)
        return found


def _apply(names: dict[str, Inode], change: dict[str, Inode | None]) -> None:
    for name, inode in change.items():
        if inode is None:
            names.pop(name, None)
        else:
            names[name] = inode


def test_a_power_cut_at_any_call_leaves_the_old_map_or_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "hall.amrmap"
    old_ids = [save_map(small_map("hall", scans), path) for scans in (1, 2)]
    inodes = {one.name: Inode(one.read_bytes(), one.read_bytes()) for one in tmp_path.iterdir()}
    assert set(inodes) == {"hall.amrmap", "hall.amrmap.1"}
    disk = Disk(lambda *_: None)
    monkeypatch.setattr(durable, "os", disk)
    new_id = save_map(small_map("hall", 3), path)
    monkeypatch.undo()
    kinds = [name for name, *_ in disk.done]
    assert kinds.count("fsync") == 2
    model, seen = Recorded(dict(inodes), now=dict(inodes)), 0
    states: list[dict[str, bytes]] = []
    for call in disk.done:
        model.take(*call)
        states += [folder for folder in model.after_a_cut() if folder not in states]
    for folder in states:
        on_disk = tmp_path / f"cut-{seen}"
        on_disk.mkdir()
        for name, content in folder.items():
            (on_disk / name).write_bytes(content)
        seen += 1
        found = load_map(on_disk / "hall.amrmap")[1]
        assert found in {old_ids[1], new_id}, sorted(folder)
    assert seen > 10
    # When the last call has returned, nothing can take the new one away again.
    assert {folder["hall.amrmap"] for folder in model.after_a_cut()} == {path.read_bytes()}
    assert load_map(path)[1] == new_id
    assert load_map(tmp_path / "hall.amrmap.1")[1] == old_ids[1]
    assert load_map(tmp_path / "hall.amrmap.2")[1] == old_ids[0]


def test_a_write_that_is_not_synced_would_be_noticed() -> None:
    """The model itself: without the file's fsync a cut leaves half of it."""
    model = Recorded({}, now={})
    model.take("open", ("/d/.x.tmp", os.O_CREAT), 3)
    model.take("write", (3, b"content"), 7)
    model.take("close", (3,), None)
    model.take("replace", ("/d/.x.tmp", "/d/x"), None)
    model.take("fsync", (4,), None)
    assert {folder.get("x") for folder in model.after_a_cut()} == {b"", b"cont", b"content"}


def test_new_folders_and_removals_are_on_the_disk_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Disk(lambda *_: None)
    monkeypatch.setattr(durable, "os", disk)
    path = tmp_path / "a" / "b" / "x"
    write_durably(path, b"content")
    assert _synced(disk) >= {tmp_path, tmp_path / "a", tmp_path / "a" / "b"}
    disk.done.clear()
    remove_durably(path)
    assert [name for name, *_ in disk.done] == ["unlink", "open", "fsync", "close"]
    assert _synced(disk) == {path.parent}


def _synced(disk: Disk) -> set[Path]:
    """What was synced, and that nothing stays open."""
    found: set[Path] = set()
    opened: dict[int, Path] = {}
    for name, arguments, result in disk.done:
        if name == "open":
            opened[result] = Path(arguments[0])
        elif name == "fsync":
            found.add(opened[arguments[0]])
        elif name == "close":
            del opened[arguments[0]]
    assert not opened
    return found


def test_a_disk_that_takes_a_few_bytes_at_a_time_gets_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = os.write
    monkeypatch.setattr(os, "write", lambda to, data: real(to, bytes(data[:3])))
    write_durably(tmp_path / "x", b"0123456789")
    monkeypatch.undo()
    assert (tmp_path / "x").read_bytes() == b"0123456789"


# -- a full disk -----------------------------------------------------------------------------


def test_a_disk_that_is_full_at_any_call_keeps_the_good_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "hall.amrmap"
    old, new = small_map("hall", 1), small_map("hall", 2)
    save_map(old, path)
    old_id, new_id = save_map(old, path), encode(new)[1]
    refused = []
    for call in itertools.count():
        left = call

        def full_at(name: str, arguments: tuple[Any, ...]) -> None:
            nonlocal left
            left -= 1
            if left == -1:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patched:
            patched.setattr(durable, "os", Disk(full_at))
            try:
                save_map(new, path)
            except MapError as error:
                refused.append(str(error))
        assert load_map(path)[1] in {old_id, new_id}
        assert load_newest(path).complaint is None
        if left >= 0:
            break  # there was no such call any more
        # It goes on as soon as there is room.
        assert save_map(old, path) == old_id
        assert not list(tmp_path.glob(".*.tmp"))
    assert len(refused) >= 6
    assert all("No space left on device" in reason for reason in refused)


# -- kills -----------------------------------------------------------------------------------


def test_kills_while_saving_leave_whole_maps() -> None:
    """tools/kill_saves.py: in full with --count 500."""
    told = subprocess.run(
        [sys.executable, "tools/kill_saves.py", "--count", "25"],
        cwd=REPO,
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert told.returncode == 0, told.stderr
    found = re.match(r"25 of 25 kills left a whole map; (\d+) cut a save short", told.stdout)
    assert found is not None
    assert int(found[1]) > 5


def test_what_a_killed_writer_left_behind_is_cleared_away(tmp_path: Path) -> None:
    gone = subprocess.run([sys.executable, "-c", ""], check=True)
    assert gone.returncode == 0
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    left, running = tmp_path / f".x.{dead.pid}.tmp", tmp_path / f".x.{os.getppid()}.tmp"
    others = [tmp_path / ".x.notes.tmp", tmp_path / f".x.{10**30}.tmp"]
    for file in (left, running, *others):
        file.write_bytes(b"half")
    for content in (b"older", b"whole"):
        write_durably(tmp_path / "x", content)
    # Nobody asked for older versions.
    names = {"x", running.name, *(one.name for one in others)}
    assert {one.name for one in tmp_path.iterdir()} == names
    assert (tmp_path / "x").read_bytes() == b"whole"
    remove_durably(tmp_path / "x")
    remove_durably(tmp_path / "x")
    assert not (tmp_path / "x").exists()


# -- damaged maps ----------------------------------------------------------------------------


def test_the_newest_version_that_is_whole_stands_in_for_a_damaged_map(tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    ids = [save_map(small_map("hall", scans), path) for scans in (1, 2, 3)]
    assert load_newest(path).map_id == ids[2]
    path.write_bytes(path.read_bytes()[:-40])
    loaded = load_newest(path)
    assert loaded.map_id == ids[1]
    assert loaded.path == tmp_path / "hall.amrmap.1"
    assert loaded.complaint is not None
    assert "checksum" in loaded.complaint
    assert loaded.complaint.endswith("using hall.amrmap.1, an older map")
    loaded.path.write_bytes(b"")
    path.unlink()
    assert load_newest(path).map_id == ids[0]
    (tmp_path / "hall.amrmap.2").unlink()
    with pytest.raises(MapError, match="No such file"):
        load_newest(path)
