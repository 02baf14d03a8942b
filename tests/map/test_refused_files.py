"""Map files that cannot be used: one line each, with the file's name and what to do."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from amr_slam.cli import main
from amr_slam.map import MapParams, PointMap, load_map, load_newest, save_map
from amr_slam.map.file import MAGIC, MAX_FILE_BYTES, VERSION, encode

GOOD = encode(PointMap(MapParams(), "hall"))[0]


def rewritten(**header: object) -> bytes:
    """The good file with other words in its header and a right checksum."""
    (length,) = struct.unpack_from("<I", GOOD, len(MAGIC))
    start = len(MAGIC) + 4
    told = json.loads(GOOD[start : start + length]) | header
    text = json.dumps(told).encode()
    body = MAGIC + struct.pack("<I", len(text)) + text + GOOD[start + length : -32]
    return body + hashlib.sha256(body).digest()


def claiming(rows: int) -> bytes:
    """2 GB and more of walls, says the header; zeros that unpack to as much are there."""
    packed = zlib.compress(bytes(2**24), 9)
    (length,) = struct.unpack_from("<I", GOOD, len(MAGIC))
    start = len(MAGIC) + 4
    header = json.loads(GOOD[start : start + length])
    header["rows"]["wall_sums"] = rows
    text = json.dumps(header).encode()
    body = MAGIC + struct.pack("<I", len(text)) + text + packed
    return body + hashlib.sha256(body).digest()


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (lambda: b"", "not a map file"),
        (lambda: b"P5\n2 2\n255\n", "not a map file"),
        (lambda: GOOD.replace(b"\r\n", b"\n", 1), "not a map file"),
        (lambda: GOOD[:20], "cut short"),
        (lambda: GOOD[:-1], "damaged (checksum); use an older version (NAME.amrmap.1)"),
        (lambda: GOOD[:200] + b"\0" + GOOD[201:], "damaged"),
        (lambda: rewritten(version=VERSION + 1), f"version {VERSION + 1}, this program reads 1 to"),
        (lambda: rewritten(version="new"), "version 'new'"),
        (lambda: claiming(2**28), "the header claims 171"),
        (lambda: claiming(2**62), "the header claims"),
        (lambda: claiming(33_554_431), "the header claims 214"),
        (lambda: MAGIC + struct.pack("<I", 2**31) + GOOD[12:], "header length"),
        (lambda: rewritten(params={"cell_m": 0.0}), "makes no sense"),
    ],
)
def test_files_that_cannot_be_used_are_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], data: Callable[[], bytes], complaint: str
) -> None:
    path = tmp_path / "hall.amrmap"
    path.write_bytes(data())
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for command in (["info"], ["edit", "undo"], ["render", "--out", str(tmp_path / "x.png")]):
        arguments = ["map", command[0], str(path), *command[1:]]
        assert main(arguments) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert f"{path}: " in line
        assert complaint in line
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 100_000


def test_files_that_are_too_large_or_none_are_not_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "hall.amrmap"
    path.write_bytes(GOOD)
    os.truncate(path, MAX_FILE_BYTES + 1)
    os.mkfifo(tmp_path / "pipe.amrmap")
    for name, complaint in (
        ("hall.amrmap", "more than a map may have"),
        ("pipe.amrmap", "is no file"),
        ("absent.amrmap", "No such file"),
        (".", "is no file"),
    ):
        assert main(["map", "info", str(tmp_path / name)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert complaint in line


SAVES = """
import sys
from pathlib import Path
from amr_slam.map import load_map, save_map
known, _ = load_map(Path(sys.argv[1]))
print("saving", flush=True)
for i in range(10**6):
    known.name = f"hall {i}"
    save_map(known, Path(sys.argv[1]))
"""


def test_a_process_killed_while_it_saves_leaves_a_whole_map(tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    save_map(PointMap(MapParams(), "hall"), path)
    command = [sys.executable, "-c", SAVES, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "saving\n"
        first = path.stat().st_ino
        deadline_s = time.monotonic() + 20.0
        while path.stat().st_ino == first and time.monotonic() < deadline_s:
            pass  # until it is in the middle of its saves
        process.send_signal(signal.SIGKILL)
    assert load_map(path)[0].name.startswith("hall ")
    # ... and where the newest is damaged afterwards, the daemon takes the one before and says so.
    path.write_bytes(path.read_bytes()[:-5])
    loaded = load_newest(path)
    assert loaded.path.name == "hall.amrmap.1"
    assert "damaged" in str(loaded.complaint)
    save_map(loaded.map, path)
    assert not list(tmp_path.glob(".*.tmp"))
