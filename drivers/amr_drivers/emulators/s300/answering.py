"""The S300's side of request mode: requests in, answers out, the token between. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.requests import (
    BUSY,
    FETCH_BYTES,
    SCAN_BLOCK,
    TOKEN_BLOCK,
    TOKEN_TAKEN,
    Answer,
    Command,
    Request,
    decode_request,
    encode_answer,
    request_bytes,
    scan_block,
)

_NOT_ALLOWED = 0x02
_INVALID_ARGUMENT = 0x05
_ADDRESS_INVALID = 0x0C
_BLOCK_INVALID = 0x14
_COMMAND_INVALID = 0x16
_FORMAT_ERROR = 0x34
_LONGEST_REQUEST = 64

Words = Callable[[int], NDArray[np.uint16] | None]
"""Values of the newest scan of a device address; None while there is none."""


class Answering:
    """Answers requests for the scanners of one line, by their device addresses."""

    def __init__(self, addresses: tuple[int, ...], words: Words) -> None:
        self._words = words
        self._taken = dict.fromkeys(addresses, False)
        self._buffer = bytearray()
        self._failures: deque[int] = deque()
        self.answered = 0
        """Requests so far."""

    def is_taken(self, address: int) -> bool:
        """Whether somebody holds the token of this scanner."""
        return self._taken[address]

    def take(self, address: int) -> None:
        """Somebody else takes the token, or somebody took it and died."""
        self._taken[address] = True

    def fail_next(self, code: int) -> None:
        """The next request is answered with this error code; may be called again for the one
        after it."""
        self._failures.append(code)

    def restart(self) -> None:
        """As after power was off: nobody has the token."""
        self._taken = dict.fromkeys(self._taken, False)
        self._buffer.clear()

    def feed(self, data: bytes) -> list[bytes]:
        """Take in what the host sent; the answers to the requests that it completes."""
        self._buffer += data
        answers = []
        while (answer := self._next()) is not None:
            self.answered += 1
            answers.append(encode_answer(answer))
        return answers

    def _next(self) -> Answer | None:
        buffer = self._buffer
        while len(buffer) >= FETCH_BYTES:
            if buffer[:2] != b"\0\0" or buffer[3] != 0x44 or buffer[8] != 0xFF:
                del buffer[0]
                continue
            length = request_bytes(bytes(buffer[:FETCH_BYTES]))
            if length > _LONGEST_REQUEST:
                del buffer[0]
                continue
            if len(buffer) < length:
                return None
            raw = bytes(buffer[:length])
            del buffer[:length]
            return self._answer(raw)
        return None

    def _answer(self, raw: bytes) -> Answer:
        if self._failures:
            return Answer(code=self._failures.popleft())
        if raw[2] not in tuple(Command):
            return Answer(code=_COMMAND_INVALID)
        try:
            request = decode_request(raw)
        except BadTelegram:
            return Answer(code=_FORMAT_ERROR)
        if request.address not in self._taken:
            return Answer(code=_ADDRESS_INVALID)
        if request.command is Command.SEND:
            return Answer(code=self._obey(request))
        return self._fetched(request)

    def _obey(self, request: Request) -> int:
        if request.block != TOKEN_BLOCK:
            return _BLOCK_INVALID
        if request.takes_token:
            code = TOKEN_TAKEN if self._taken[request.address] else 0
            self._taken[request.address] = True
            return code
        if request.releases_token:
            self._taken[request.address] = False
            return 0
        return _INVALID_ARGUMENT

    def _fetched(self, request: Request) -> Answer:
        if not self._taken[request.address]:
            return Answer(code=_NOT_ALLOWED)
        if request.block != SCAN_BLOCK:
            return Answer(code=_BLOCK_INVALID)
        words = self._words(request.address)
        if words is None:
            return Answer(code=BUSY)
        answer = Answer(code=0, block=scan_block(words, request.address))
        if len(encode_answer(answer)) != request.answer_bytes:
            return Answer(code=_INVALID_ARGUMENT)
        return answer
