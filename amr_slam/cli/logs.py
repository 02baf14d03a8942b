"""Where the log goes: to standard error, or under systemd to the journal with its fields.

The journal's protocol (https://systemd.io/JOURNAL_NATIVE_PROTOCOL/) is one datagram an entry,
``FIELD=value`` a line, and a length before a value of several lines: twenty lines here, against a
compiled library on every robot.
"""

from __future__ import annotations

import logging
import os
import struct
import sys
import time
from collections.abc import Iterator
from logging.handlers import DatagramHandler
from pathlib import Path
from typing import Final

_SOCKET: Final = Path("/run/systemd/journal/socket")
_PRIORITIES: Final = {"DEBUG": 7, "INFO": 6, "WARNING": 4, "ERROR": 3, "CRITICAL": 2}
_MAX_BYTES: Final = 48 << 10
_OFTEN: Final = 10
"""So many lines of one kind, by logger, level and words ..."""
_PERIOD_S: Final = 60.0
"""... in this time; of more, their number alone is told."""
_MOST_KINDS: Final = 500


def set_up() -> None:
    """For the whole program."""
    handler: logging.Handler
    if "JOURNAL_STREAM" in os.environ and _SOCKET.exists():
        handler = JournalHandler(_SOCKET)
    else:
        handler = logging.StreamHandler(sys.stderr)
        # The journal writes its own time beside each line.
        asctime = "" if "JOURNAL_STREAM" in os.environ else "%(asctime)s "
        handler.setFormatter(logging.Formatter(f"{asctime}%(levelname)s %(name)s: %(message)s"))
    handler.addFilter(Repeats())
    logging.basicConfig(level=logging.INFO, handlers=[handler])


class Repeats(logging.Filter):
    """Lets the first lines of a kind pass in each minute, and says how many it has kept back."""

    def __init__(self) -> None:
        super().__init__()
        self._kinds: dict[tuple[str, int, str], tuple[float, int]] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        kind = record.name, record.levelno, str(record.msg)
        now_s = time.monotonic()
        since_s, count = self._kinds.get(kind, (now_s, 0))
        if now_s - since_s >= _PERIOD_S:
            if count > _OFTEN:
                record.msg = f"{record.msg} (and {count - _OFTEN} more like it before)"
            since_s, count = now_s, 0
        if kind not in self._kinds and len(self._kinds) >= _MOST_KINDS:
            self._kinds.clear()
        self._kinds[kind] = since_s, count + 1
        return count < _OFTEN


class JournalHandler(DatagramHandler):
    """Entries with ``PRIORITY``, ``LOGGER``, ``CODE_FILE``, ``THREAD`` and what a line's ``extra``
    names as ``amr_...``. Never waits: an entry that a hanging journal does not take is dropped."""

    def __init__(self, path: Path) -> None:
        super().__init__(str(path), None)

    def emit(self, record: logging.LogRecord) -> None:
        """Send it, or drop it."""
        try:
            if self.sock is None:
                self.sock = self.makeSocket()
                self.sock.setblocking(False)
            self.sock.sendto(entry(record, self.format(record)), self.address)
        except OSError:
            return


def entry(record: logging.LogRecord, message: str) -> bytes:
    """The datagram of a record."""
    return b"".join(
        _field(name, value) for name, value in _fields(record, message[: _MAX_BYTES // 2])
    )


def _fields(record: logging.LogRecord, message: str) -> Iterator[tuple[str, str]]:
    yield "MESSAGE", message
    yield "PRIORITY", str(_PRIORITIES.get(record.levelname, 6))
    yield "SYSLOG_IDENTIFIER", "amr-slam"
    yield "LOGGER", record.name
    yield "CODE_FILE", record.pathname
    yield "CODE_LINE", str(record.lineno)
    yield "CODE_FUNC", record.funcName
    yield "THREAD", record.threadName or ""
    for name, value in vars(record).items():
        if name.startswith("amr_"):
            yield name.upper(), str(value)


def _field(name: str, value: str) -> bytes:
    data = value.encode("utf-8", "replace")
    if b"\n" not in data:
        return name.encode() + b"=" + data + b"\n"
    return name.encode() + b"\n" + struct.pack("<Q", len(data)) + data + b"\n"
