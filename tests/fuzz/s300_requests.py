"""Request mode: answers to each kind of request, requests, and the decoder behind them."""

from __future__ import annotations

import contextlib

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.request_decoder import RequestDecoder
from amr_drivers.sick_s300.requests import (
    Answer,
    AnswerReader,
    Request,
    decode_block,
    decode_request,
    encode_answer,
    encode_request,
    fetch_scan,
    get_token,
    release_token,
    scan_block,
)
from amr_drivers.sick_s300.settings import Settings
from amr_drivers.sick_s300.telegrams import standby_words

BEAMS = 2
_SETTINGS = Settings(port="x", mode="request", beams=BEAMS)
_REQUESTS = (fetch_scan(7, BEAMS), get_token(7))


def target(data: bytes) -> None:
    """The same answer whatever the pieces, and its own bytes; requests too; bounded memory."""
    for request in _REQUESTS:
        answer = _read(request, [data])
        assert _read(request, [bytes((byte,)) for byte in data[: request.answer_bytes]]) == answer
        if answer is not None:
            assert data.startswith(encode_answer(answer))
    with contextlib.suppress(BadTelegram):
        assert encode_answer(Answer(code=0, block=decode_block(data))) == data
    with contextlib.suppress(BadTelegram):
        assert encode_request(decode_request(data)) == data
    _decode(data)


def _read(request: Request, pieces: list[bytes]) -> Answer | None:
    reader = AnswerReader(request)
    for piece in pieces:
        try:
            answer = reader.feed(piece)
        except BadTelegram:
            return None
        assert len(reader.held) <= request.answer_bytes
        if answer is not None:
            return answer
    return None


def _decode(data: bytes) -> None:
    """Each half of the data is the answer to what the decoder asks."""
    decoder = RequestDecoder("front", _SETTINGS, 0)
    half = len(data) // 2
    for piece in (data[:half], data[half:], data):
        decoder.sent(encode_request(decoder.dialogue.next_request), 0)
        for scan in decoder.received(piece, 0):
            assert scan.ranges_m.shape == (BEAMS,)
            assert not (scan.ranges_m < 0.0).any()
    decoder.status(10**9)


def seeds() -> list[bytes]:
    """Answers of all kinds, also two in a row, and requests."""
    granted = encode_answer(Answer(code=0))
    words = np.arange(100, 100 + BEAMS, dtype=np.uint16)
    scans = [
        encode_answer(Answer(code=0, block=scan_block(each, address)))
        for each in (words, words[:1], standby_words(BEAMS))
        for address in (7, 8)
    ]
    requests = [
        encode_request(request)
        for address in (7, 8)
        for request in (get_token(address), release_token(address), fetch_scan(address, BEAMS))
    ]
    errors = [encode_answer(Answer(code=code)) for code in (2, 4, 6)]
    return [granted, *errors, *scans, *requests, granted + bytes(len(scans[0]) - 4) + scans[0]]
