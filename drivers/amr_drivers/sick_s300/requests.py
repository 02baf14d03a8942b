"""Telegrams of SICK S300 and S3000 in request mode (RK512): bytes to values and back, no I/O.

Source: protocol fact sheet, section A.6. Block numbers and CRCs are little-endian, sizes are
big-endian words. A *send* telegram carries data (the token), a *fetch* telegram asks for a block.
The CRC of a send covers its repeated header and data, that of a block all from byte 4 on.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.telegrams import crc16
from amr_slam.geometry import readonly

TOKEN_BLOCK: Final = 25
SCAN_BLOCK: Final = 12
MAX_SIZE: Final = 2048
"""Longest block believed, in words: an S3000 at 0.25 degrees needs 766."""
FETCH_BYTES: Final = 10
ANSWER_HEAD_BYTES: Final = 4
"""Three zeros and the error code: all of an answer but that to a fetch that is granted."""
_HEADER_BYTES: Final = 6
_CRC_BYTES: Final = 2
_TAKE: Final = b"\x07\x0f"
_RELEASE: Final = b"\x00\x00"
_OVERHEAD_WORDS: Final = 5
"""Words of block 12 that are no values: header 3, monitoring data 1, CRC 1."""
_MONITORING: Final = b"\x00\x08"
"""Monitoring data as they were always seen; their meaning is not known."""

TOKEN_TAKEN: Final = 0x04
BUSY: Final = 0x06
ERROR_TEXTS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0x01: "the device status does not allow it",
        0x02: "access not allowed",
        0x03: "password wrong",
        TOKEN_TAKEN: "token already taken",
        0x05: "invalid argument",
        BUSY: "busy or internal error",
        0x07: "access not supported",
        0x0A: "communication error",
        0x0C: "address invalid: check device_address",
        0x10: "telegram id invalid",
        0x14: "block number invalid",
        0x16: "command type invalid",
        0x34: "telegram format error",
        0x36: "command telegram error",
        0xFF: "unknown error",
    }
)


class Command(enum.IntEnum):
    """What a request wants."""

    SEND = 0x41
    FETCH = 0x45


@dataclass(frozen=True, slots=True, kw_only=True)
class Request:
    """One telegram to the scanner."""

    command: Command
    block: int
    address: int
    """7: host or stand-alone scanner, 8: guest."""
    size: int
    """Of the block in words, with its header and CRC."""
    data: bytes = b""
    """What a SEND carries."""

    @property
    def answer_bytes(self) -> int:
        """Length of the answer when the request is granted."""
        fetched = 2 * self.size if self.command is Command.FETCH else 0
        return ANSWER_HEAD_BYTES + fetched

    @property
    def takes_token(self) -> bool:
        """True for what :func:`get_token` makes."""
        return self.command is Command.SEND and self.data == _TAKE

    @property
    def releases_token(self) -> bool:
        """True for what :func:`release_token` makes."""
        return self.command is Command.SEND and self.data == _RELEASE


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block that was fetched, its CRC right."""

    number: int
    address: int
    payload: bytes
    """All between header and CRC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What the scanner says to one request."""

    code: int
    """0: granted; else one of ERROR_TEXTS, or one that nobody documents."""
    block: Block | None = None
    """Of a fetch that was granted."""


def error_text(code: int) -> str:
    """An error code in words. Example: ``error 04: token already taken``."""
    return f"error {code:02X}: {ERROR_TEXTS.get(code, 'not documented')}"


def get_token(address: int) -> Request:
    """The first request: without the token nothing is answered."""
    return _token(address, _TAKE)


def release_token(address: int) -> Request:
    """The last request, so that others get the token."""
    return _token(address, _RELEASE)


def _token(address: int, data: bytes) -> Request:
    return Request(command=Command.SEND, block=TOKEN_BLOCK, address=address, size=5, data=data)


def fetch_scan(address: int, beams: int) -> Request:
    """Ask for the newest scan: block 12 of so many values."""
    size = beams + _OVERHEAD_WORDS
    return Request(command=Command.FETCH, block=SCAN_BLOCK, address=address, size=size)


def encode_request(request: Request) -> bytes:
    """The bytes of a request."""
    header = _header(request.block, request.size, request.address)
    first = bytes((0, 0, request.command, 0x44)) + header
    if request.command is Command.FETCH:
        return first
    checked = header + request.data
    return first + checked + crc16(checked).to_bytes(_CRC_BYTES, "little")


def decode_request(data: bytes) -> Request:
    """The request in exactly these bytes. Raises BadTelegram."""
    if len(data) < FETCH_BYTES or data[:2] != b"\0\0" or data[3] != 0x44 or data[8] != 0xFF:
        raise BadTelegram("not the beginning of a request")
    if data[2] not in tuple(Command):
        raise BadTelegram(f"command type {data[2]:02x} is unknown")
    request = Request(
        command=Command(data[2]),
        block=int.from_bytes(data[4:6], "little"),
        size=int.from_bytes(data[6:8], "big"),
        address=data[9],
        data=data[FETCH_BYTES + _HEADER_BYTES : -_CRC_BYTES],
    )
    if encode_request(request) != data:
        raise BadTelegram("a request with another length, repeated header or CRC")
    return request


def request_bytes(head: bytes) -> int:
    """How long the request is that begins with these FETCH_BYTES bytes."""
    size = int.from_bytes(head[6:8], "big")
    return FETCH_BYTES + (2 * size if head[2] == Command.SEND else 0)


def scan_block(words: NDArray[np.uint16], address: int) -> Block:
    """Block 12 with these value words."""
    payload = _MONITORING + words.astype("<u2").tobytes()
    return Block(number=SCAN_BLOCK, address=address, payload=payload)


def scan_words(block: Block, beams: int) -> NDArray[np.uint16]:
    """The (beams,) value words of block 12. Raises BadTelegram for anything else."""
    if block.number != SCAN_BLOCK:
        raise BadTelegram(f"block {block.number} holds no scan")
    words: NDArray[np.uint16] = readonly(
        np.frombuffer(block.payload[len(_MONITORING) :], dtype="<u2"), np.uint16
    )
    if len(words) != beams:
        raise BadTelegram(f"{len(words)} values instead of {beams}: check the field of view")
    return words


def encode_answer(answer: Answer) -> bytes:
    """The bytes of an answer."""
    head = bytes((0, 0, 0, answer.code))
    block = answer.block
    if block is None:
        return head
    size = (_HEADER_BYTES + len(block.payload) + _CRC_BYTES) // 2
    checked = _header(block.number, size, block.address) + block.payload
    return head + checked + crc16(checked).to_bytes(_CRC_BYTES, "little")


def decode_block(data: bytes) -> Block:
    """The block in exactly these bytes of a granted answer. Raises BadTelegram."""
    size = int.from_bytes(data[6:8], "big")
    if data[:ANSWER_HEAD_BYTES] != bytes(ANSWER_HEAD_BYTES) or data[8:9] != b"\xff":
        raise BadTelegram("not the beginning of a block")
    if size < _OVERHEAD_WORDS or len(data) != ANSWER_HEAD_BYTES + 2 * size:
        raise BadTelegram(f"{len(data)} bytes are no block of {size} words")
    if crc16(data[ANSWER_HEAD_BYTES:-_CRC_BYTES]) != int.from_bytes(data[-_CRC_BYTES:], "little"):
        raise BadTelegram("CRC is wrong")
    return Block(
        number=int.from_bytes(data[4:6], "little"),
        address=data[9],
        payload=data[FETCH_BYTES:-_CRC_BYTES],
    )


class AnswerReader:
    """Puts the answer to one request together, whatever the pieces in which it comes.

    The first byte must be the answer's: what was on the line before it belongs to nobody. Keeps
    no more than the answer's length.
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        self._header = _header(request.block, request.size, request.address)
        self._buffer = bytearray()

    @property
    def held(self) -> bytes:
        """The bytes so far."""
        return bytes(self._buffer)

    def feed(self, data: bytes) -> Answer | None:
        """Take in the next bytes; the answer when they complete it, None while they do not.

        What comes after the answer is not looked at. Raises BadTelegram: this becomes no answer.
        """
        buffer, request = self._buffer, self._request
        buffer += data[: request.answer_bytes - len(buffer)]
        if any(buffer[: ANSWER_HEAD_BYTES - 1]):
            raise BadTelegram("not the beginning of an answer")
        if len(buffer) < ANSWER_HEAD_BYTES:
            return None
        code = buffer[ANSWER_HEAD_BYTES - 1]
        if code or request.command is Command.SEND:
            return Answer(code=code)
        repeated = bytes(buffer[ANSWER_HEAD_BYTES:FETCH_BYTES])
        if not self._header.startswith(repeated):
            raise BadTelegram("an answer to another request")
        if len(buffer) < request.answer_bytes:
            return None
        return Answer(code=0, block=decode_block(bytes(buffer)))


def _header(block: int, size: int, address: int) -> bytes:
    return block.to_bytes(2, "little") + size.to_bytes(2, "big") + bytes((0xFF, address))
