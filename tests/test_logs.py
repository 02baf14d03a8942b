"""The journal's datagrams on a real socket, and lines that repeat themselves."""

from __future__ import annotations

import logging
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from amr_slam.cli.logs import JournalHandler, Repeats


def fields(datagram: bytes) -> dict[str, str]:
    """As journald reads them."""
    found: dict[str, str] = {}
    while datagram:
        line, _, datagram = datagram.partition(b"\n")
        name, equals, value = line.partition(b"=")
        if not equals:
            (length,) = struct.unpack_from("<Q", datagram)
            value, datagram = datagram[8 : 8 + length], datagram[8 + length + 1 :]
        found[name.decode()] = value.decode()
    return found


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as bound:
        bound.bind(str(tmp_path / "journal"))
        bound.settimeout(10.0)
        yield bound


@pytest.fixture
def log(tmp_path: Path) -> Iterator[logging.Logger]:
    logger = logging.Logger("amr_slam.test")
    handler = JournalHandler(tmp_path / "journal")
    logger.addHandler(handler)
    yield logger
    handler.close()


def test_a_line_carries_its_fields(journal: socket.socket, log: logging.Logger) -> None:
    log.warning("%s: lost", "front", extra={"amr_device": "front"})
    found = fields(journal.recv(65536))
    assert found["MESSAGE"] == "front: lost"
    assert found["PRIORITY"] == "4"
    assert found["LOGGER"] == "amr_slam.test"
    assert found["AMR_DEVICE"] == "front"
    assert found["CODE_FUNC"] == "test_a_line_carries_its_fields"
    assert found["SYSLOG_IDENTIFIER"] == "amr-slam"


def test_tracebacks_keep_their_lines(journal: socket.socket, log: logging.Logger) -> None:
    try:
        int("MESSAGE=forged\nPRIORITY=0")
    except ValueError as error:
        log.exception("%s", str(error).replace("\\n", "\n"))
    found = fields(journal.recv(65536))
    assert found["PRIORITY"] == "3"
    assert "Traceback" in found["MESSAGE"]
    assert "MESSAGE=forged\nPRIORITY=0" in found["MESSAGE"]


def test_a_journal_that_hangs_or_is_away_holds_nobody_up(
    journal: socket.socket, log: logging.Logger, tmp_path: Path
) -> None:
    begun_s = time.monotonic()
    for number in range(2000):  # more than its queue takes
        log.info("%d %s", number, "x" * 200)
    (tmp_path / "journal").unlink()
    log.info("nobody hears it")
    assert time.monotonic() - begun_s < 10.0
    assert fields(journal.recv(65536))["MESSAGE"].startswith("0 x")


def test_only_the_number_of_a_line_that_repeats_itself_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = 0.0
    monkeypatch.setattr("amr_slam.cli.logs.time.monotonic", lambda: now_s)
    told: list[str] = []
    repeats = Repeats()
    for tick in range(700):
        now_s = 0.1 * tick
        for text in ("%s: lost", "something else"):
            record = logging.LogRecord("a", logging.INFO, "f", 1, text, None, None)
            if (text == "%s: lost" or tick % 100 == 0) and repeats.filter(record):
                told.append(record.msg)
    lost = [text for text in told if "lost" in text]
    assert len(lost) == 20
    assert lost[10] == "%s: lost (and 590 more like it before)"
    assert told.count("something else") == 7
