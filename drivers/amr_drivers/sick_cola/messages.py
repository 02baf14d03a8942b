"""Command words, refusals and the small answers of CoLa devices, both ways. No I/O.

Source: fact sheet, B.2 and B.3. The driver reads and subscribes, nothing else: a login stops the
measurement on some devices, and writing is for whoever sets the scanner up.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.fields import fields, writer
from amr_drivers.sick_cola.framing import Dialect, framed

SCAN = "LMDscandata"
IDENT = "DeviceIdent"
STATE = "SCdevicestate"
FIRMWARE = "FirmwareVersion"
SERIAL = "SerialNumber"
OUTPUT_RANGE = "LMPoutputRange"

WORDS = ("sRN", "sRA", "sWN", "sWA", "sMN", "sAN", "sEN", "sEA", "sSN", "sFA")
_LONGEST_NAME = 64

REFUSALS = {
    0x01: "method access denied: wrong user level",
    0x02: "unknown method",
    0x03: "unknown variable",
    0x04: "local condition failed: value out of range",
    0x05: "invalid data",
    0x06: "unknown error",
    0x07: "buffer overflow",
    0x08: "buffer underflow: arguments are missing",
    0x09: "unknown type",
    0x0A: "write access denied",
    0x0B: "unknown name-server command",
    0x0C: "unknown CoLa command",
    0x0D: "method server busy",
    0x0E: "array out of bounds",
    0x0F: "unknown event",
    0x10: "value overflow",
    0x11: "invalid character",
    0x12: "no message",
    0x13: "no answer message",
    0x14: "internal error",
    0x15: "hub address corrupted",
    0x16: "hub decoding error",
    0x17: "hub address exceeded",
    0x18: "hub blank expected",
    0x19: "asynchronous methods suppressed",
    0x20: "complex arrays not supported",
    0x21: "no session resources",
    0x22: "unknown session",
    0x23: "cannot connect",
}
"""Code of an ``sFA`` -> its meaning. It does not say which request was refused."""

STATES = {0: "busy", 1: "ready", 2: "error", 3: "standby"}
"""What SCdevicestate answers."""


@dataclass(frozen=True, slots=True)
class Message:
    """A telegram's command word, the name it is about, and its arguments as sent."""

    word: str
    name: str
    body: bytes


@dataclass(frozen=True, slots=True)
class Refusal:
    """``sFA``: the device has not done what the last request asked for."""

    code: int

    def __str__(self) -> str:
        return f"sFA {self.code:X} ({REFUSALS.get(self.code, 'unknown code')})"


def parse_message(payload: bytes, dialect: Dialect) -> Message | Refusal:
    """What a frame's payload says. Raises BadTelegram."""
    word = payload[:3].decode("latin-1")
    if word not in WORDS:
        raise BadTelegram(f"{payload[:16]!r} is no command")
    if word == "sFA":
        return _refusal(payload, dialect)
    blank, _, rest = payload[3:].partition(b" ")
    name, _, body = rest.partition(b" ")
    if blank or not 0 < len(name) <= _LONGEST_NAME or not name.isalnum():
        raise BadTelegram(f"{payload[:16]!r} has no name")
    return Message(word, name.decode("ascii"), body)


def _refusal(payload: bytes, dialect: Dialect) -> Refusal:
    # CoLa B has no blank between the word and the code.
    body = payload[4:] if dialect is Dialect.A else payload[3:]
    if dialect is Dialect.A and payload[3:4] != b" ":
        raise BadTelegram(f"{payload[:16]!r} has no code")
    code = fields(body, dialect)
    refusal = Refusal(code.unsigned(16))
    code.end()
    return refusal


def message(word: str, name: str, body: bytes, dialect: Dialect) -> bytes:
    """The bytes of a telegram with a name."""
    # Requests without arguments end with the name, answers keep their blank.
    joined = f"{word} {name}".encode("ascii") + (b" " + body if body else b"")
    return framed(joined, dialect)


def refusal(code: int, dialect: Dialect) -> bytes:
    """The bytes of an ``sFA``."""
    out = writer(dialect)
    out.unsigned(code, 16)
    return framed(b"sFA" + (b" " if dialect is Dialect.A else b"") + out.data(), dialect)


def read_request(name: str, dialect: Dialect) -> bytes:
    """Asks for a variable."""
    return message("sRN", name, b"", dialect)


def event_request(name: str, dialect: Dialect, *, on: bool) -> bytes:
    """Subscribes to an event or ends the subscription."""
    out = writer(dialect)
    out.unsigned(int(on), 8)
    return message("sEN", name, out.data(), dialect)


def number_body(value: int, bits: Literal[8, 16, 32], dialect: Dialect) -> bytes:
    """The arguments of an answer that is one unsigned number."""
    out = writer(dialect)
    out.unsigned(value, bits)
    return out.data()


def number(body: bytes, bits: Literal[8, 16, 32], dialect: Dialect) -> int:
    """One unsigned number. Raises BadTelegram."""
    read = fields(body, dialect)
    value = read.unsigned(bits)
    read.end()
    return value


def texts_body(texts: tuple[str, ...], dialect: Dialect) -> bytes:
    """The arguments of an answer that is one or several texts."""
    out = writer(dialect)
    for text in texts:
        out.text(text)
    return out.data()


def texts(body: bytes, count: int, dialect: Dialect) -> tuple[str, ...]:
    """So many texts, each with its length before it. Raises BadTelegram."""
    read = fields(body, dialect)
    found = tuple(read.text() for _ in range(count))
    read.end()
    return found


@dataclass(frozen=True, slots=True)
class OutputRange:
    """What LMPoutputRange answers, in 1/10000 degree."""

    step: int
    start: int
    stop: int


def output_range_body(value: OutputRange, dialect: Dialect) -> bytes:
    """The arguments of the answer."""
    out = writer(dialect)
    out.unsigned(1, 16)
    out.unsigned(value.step, 32)
    out.signed(value.start, 32)
    out.signed(value.stop, 32)
    return out.data()


def output_range(body: bytes, dialect: Dialect) -> OutputRange:
    """Of one sector; raises BadTelegram for several."""
    read = fields(body, dialect)
    if (sectors := read.unsigned(16)) != 1:
        raise BadTelegram(f"{sectors} sectors instead of 1")
    value = OutputRange(read.unsigned(32), read.signed(32), read.signed(32))
    read.end()
    return value
