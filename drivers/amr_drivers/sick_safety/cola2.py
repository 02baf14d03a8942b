"""CoLa 2 telegrams: bytes to values and back, no I/O.

Source: protocol fact sheet, section C.1. The frame is big-endian, indices and data are
little-endian. There is no checksum: TCP's is all that guards the bytes.
"""

from __future__ import annotations

import enum
import struct
from dataclasses import dataclass
from typing import Final

from amr_drivers.errors import BadTelegram

_START: Final = b"\x02\x02\x02\x02"
_PREFIX: Final = len(_START) + 4
"""Start and length, which the length does not count."""
_FIXED: Final = struct.Struct(">BB")
_HEAD: Final = struct.Struct(">IHcc")
_ADDRESS: Final = 4
"""Further bytes of an address, where the second byte of the frame is not 0."""
_SHORTEST: Final = _FIXED.size + _HEAD.size
_LEAST: Final = _PREFIX + _SHORTEST
MAX_LENGTH: Final = 65_536
"""Longest frame believed, in bytes: a telegram of 2751 beams and all blocks needs 20 000."""
_COMMANDS: Final = frozenset(b"ORWMCAFS")
_ANSWERS: Final = frozenset(b"AXI")

ERRORS: Final = {
    0x00: "no error",
    0x01: "access to the method denied: wrong user level",
    0x02: "unknown method",
    0x03: "unknown variable",
    0x04: "local condition failed: a value is out of range",
    0x05: "invalid data",
    0x06: "unknown error",
    0x07: "buffer overflow",
    0x08: "buffer underflow: arguments are missing",
    0x09: "unknown type",
    0x0A: "writing denied: not logged in, or read only",
    0x0B: "unknown command for the name server",
    0x0C: "unknown CoLa command",
    0x0D: "the method server is busy",
    0x0E: "array index out of bounds",
    0x0F: "unknown event",
    0x10: "value overflow",
    0x11: "invalid character",
    0x12: "no message",
    0x13: "no answer message",
    0x14: "internal error",
    0x15: "hub address corrupted",
    0x16: "hub decoding failed",
    0x17: "hub address exceeded",
    0x18: "hub: blank expected",
    0x19: "asynchronous methods are suppressed",
    0x20: "complex arrays are not supported",
    0x21: "no session resources: too many others are connected to the scanner",
    0x22: "unknown session id",
    0x23: "cannot connect",
}
"""Error codes (B.2)."""
NO_SESSION_LEFT: Final = 0x21
UNKNOWN_SESSION: Final = 0x22
_LARGEST_ERROR: Final = 0x27


class Command(enum.StrEnum):
    """Command and mode: what a frame asks for, or answers."""

    OPEN = "OX"
    OPENED = "OA"
    CLOSE = "CX"
    CLOSED = "CA"
    READ = "RI"
    VALUE = "RA"
    WRITE = "WI"
    WRITTEN = "WA"
    CALL = "MI"
    RESULT = "AI"
    FAILED = "FA"


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One telegram."""

    session: int
    request: int
    command: str
    """Command and mode, two letters: a :class:`Command`, or what else a device says."""
    payload: bytes = b""
    hub: int = 0
    address: bytes = b""
    """Four bytes where a hub is in between, else none."""

    @property
    def index(self) -> int | None:
        """Which variable or method it is about; None where it names none."""
        if self.command not in _INDEXED or len(self.payload) < 2:
            return None
        return int.from_bytes(self.payload[:2], "little")

    @property
    def data(self) -> bytes:
        """What follows the index."""
        return self.payload[2:]


_INDEXED: Final = frozenset(
    (
        Command.READ,
        Command.VALUE,
        Command.WRITE,
        Command.WRITTEN,
        Command.CALL,
        Command.RESULT,
    )
)


def encode_frame(frame: Frame) -> bytes:
    """The bytes of a telegram. Raises BadTelegram where it is longer than any can be."""
    command, mode = frame.command.encode("latin-1")
    body = b"".join(
        (
            _FIXED.pack(frame.hub, 1 if frame.address else 0),
            frame.address,
            _HEAD.pack(frame.session, frame.request, bytes((command,)), bytes((mode,))),
            frame.payload,
        )
    )
    if _PREFIX + len(body) > MAX_LENGTH or len(frame.address) not in (0, _ADDRESS):
        raise BadTelegram(f"no frame has {len(body)} bytes")
    return _START + len(body).to_bytes(4, "big") + body


def decode_frame(data: bytes) -> Frame:
    """The telegram that these bytes are. Raises BadTelegram unless they are exactly one."""
    frame, length = begun_frame(data)
    if len(data) != length:
        raise BadTelegram(f"{len(data)} bytes of a CoLa 2 telegram of {length}")
    return frame


def begun_frame(data: bytes) -> tuple[Frame, int]:
    """The telegram at the beginning of these bytes with as much of its payload as is there, and
    the length in bytes that it should have. Raises BadTelegram where none begins."""
    length = _announced(data)
    if length is None:
        raise BadTelegram(f"no CoLa 2 telegram begins with {data[:_PREFIX].hex()}")
    address = _ADDRESS if len(data) > _PREFIX + 1 and data[_PREFIX + 1] else 0
    head = _PREFIX + _FIXED.size + address
    if not head + _HEAD.size <= min(len(data), length):
        raise BadTelegram(f"{len(data)} bytes are no CoLa 2 telegram")
    session, request, command, mode = _HEAD.unpack_from(data, head)
    frame = Frame(
        session=session,
        request=request,
        command=(command + mode).decode("latin-1"),
        payload=bytes(data[head + _HEAD.size : length]),
        hub=data[_PREFIX],
        address=bytes(data[head - address : head]),
    )
    return frame, length


def _announced(data: bytes | bytearray) -> int | None:
    """Length of the frame that begins here, in bytes; None when none does."""
    if len(data) < _PREFIX or not data.startswith(_START):
        return None
    length = _PREFIX + int.from_bytes(data[len(_START) : _PREFIX], "big")
    return length if _LEAST <= length <= MAX_LENGTH else None


def error_code(frame: Frame) -> int:
    """The code of a FAILED frame. The sources disagree about its byte order: little-endian where
    that is a code, else big-endian. Raises BadTelegram when there is none."""
    if frame.command != Command.FAILED or len(frame.payload) < 2:
        raise BadTelegram(f"{frame.command} with {len(frame.payload)} bytes holds no error code")
    little = int.from_bytes(frame.payload[:2], "little")
    return little if little <= _LARGEST_ERROR else int.from_bytes(frame.payload[:2], "big")


def error_text(code: int) -> str:
    """An error code in words."""
    return ERRORS.get(code, f"unknown error code {code:#06x}")


def open_session(request: int, idle_s: int) -> Frame:
    """Asks for a session that ends by itself when nothing is asked for ``idle_s`` (1..255)."""
    # Behind the time-out follows the client's name as a string with a length of 2 bytes: none.
    payload = bytes((idle_s, 0, 0))
    return Frame(session=0, request=request, command=Command.OPEN, payload=payload)


def close_session(session: int, request: int) -> Frame:
    """Gives the session back."""
    return Frame(session=session, request=request, command=Command.CLOSE)


def read_variable(session: int, request: int, index: int) -> Frame:
    """Asks for a variable's value."""
    payload = index.to_bytes(2, "little")
    return Frame(session=session, request=request, command=Command.READ, payload=payload)


def call_method(session: int, request: int, index: int, data: bytes) -> Frame:
    """Calls a method."""
    payload = index.to_bytes(2, "little") + data
    return Frame(session=session, request=request, command=Command.CALL, payload=payload)


class FrameReader:
    """Finds telegrams in a byte stream, whatever the pieces in which it comes.

    What is no telegram is skipped and counted. Memory stays below twice MAX_LENGTH.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._damaged = 0
        self._skipping = False
        self._wanted = _LEAST  # bytes that must be there before anything can be told

    @property
    def damaged(self) -> int:
        """Runs of bytes that were skipped, and frames left unfinished."""
        return self._damaged

    def feed(self, data: bytes) -> list[Frame]:
        """Take in the next bytes; the telegrams that they complete, in order."""
        found: list[Frame] = []
        for start in range(0, len(data), MAX_LENGTH):
            self._buffer += data[start : start + MAX_LENGTH]
            while len(self._buffer) >= self._wanted and (frame := self._next()) is not None:
                found.append(frame)
        return found

    def reset(self) -> None:
        """Forget an unfinished telegram: what comes next does not belong to it."""
        if self._buffer and not self._skipping:
            self._damaged += 1
        self._buffer.clear()
        self._skipping = False
        self._wanted = _LEAST

    def _next(self) -> Frame | None:
        buffer = self._buffer
        while True:
            at = buffer.find(_START)
            if at < 0:
                # The last bytes may be the beginning of a start.
                self._skip(len(buffer) - _trailing_start(buffer))
                self._wanted = _LEAST
                return None
            self._skip(at)
            if len(buffer) < _LEAST:
                self._wanted = _LEAST
                return None
            length = _announced(buffer)
            if length is None:
                self._skip(1)
                continue
            if len(buffer) < min(length, _LEAST + _ADDRESS):
                self._wanted = min(length, _LEAST + _ADDRESS)
                return None
            if not self._is_credible(length):
                self._skip(1)
                continue
            if len(buffer) < length:
                self._wanted = length
                return None
            frame = decode_frame(bytes(buffer[:length]))
            del buffer[:length]
            self._skipping = False
            self._wanted = _LEAST
            return frame

    def _is_credible(self, length: int) -> bool:
        """Whether command and mode are letters that a telegram has, for lengths prove nothing."""
        buffer = self._buffer
        address = _ADDRESS if buffer[_PREFIX + 1] else 0
        at = _PREFIX + _FIXED.size + address + 6
        if at + 2 > length:
            return False
        return buffer[at] in _COMMANDS and buffer[at + 1] in _ANSWERS

    def _skip(self, count: int) -> None:
        if count > 0:
            if not self._skipping:
                self._damaged += 1
            self._skipping = True
            del self._buffer[:count]


def _trailing_start(buffer: bytearray) -> int:
    """How many of the last bytes may belong to the next start."""
    return len(buffer) - len(buffer.rstrip(_START[:1])) if buffer.endswith(_START[:1]) else 0
