"""Request mode: answers, blocks, requests, and the decoder that hears the answers."""

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
from amr_drivers.sick_s300.telegrams import crc16, standby_words

BEAMS = 3
SETTINGS = Settings(port="", mode="request", beams=BEAMS)
REQUESTS = (fetch_scan(7, BEAMS), get_token(7))


def target(data: bytes) -> None:
    """First byte: which property, whether what follows gets a valid CRC, size of the pieces.

    One property an execution: the same bytes reach the others by another first byte.
    """
    if not data:
        return
    first, stream = data[0], data[1:]
    if first & 1:
        stream = with_checksum(stream)
    PROPERTIES[first >> 1 & 3](stream, 1 + (first >> 3))


def in_pieces(stream: bytes, size: int) -> None:
    """The pieces in which an answer comes change nothing; memory is bounded."""
    pieces = [stream[start : start + size] for start in range(0, len(stream), size)]
    for request in REQUESTS:
        answer = read(request, [stream])
        assert read(request, pieces) == answer
        assert answer is None or stream.startswith(encode_answer(answer))


def blocks(stream: bytes, _size: int) -> None:
    """A block is read only where our encoder would have made these bytes of it."""
    with contextlib.suppress(BadTelegram):
        assert encode_answer(Answer(code=0, block=decode_block(stream))) == stream


def requests(stream: bytes, _size: int) -> None:
    """The same of requests."""
    with contextlib.suppress(BadTelegram):
        assert encode_request(decode_request(stream)) == stream


def decoded(stream: bytes, size: int) -> None:
    """Whatever answers, scans hold nothing but distances, inf and NaN, and it is asked on."""
    decoder = RequestDecoder("front", SETTINGS, 0)
    for n, start in enumerate(range(0, len(stream), 4 * size)):
        now_ns = n * 40_000_000
        decoder.sent(encode_request(decoder.dialogue.next_request), now_ns)
        for scan in decoder.received(stream[start : start + 4 * size], now_ns):
            assert scan.ranges_m.shape == (BEAMS,)
            assert not (scan.ranges_m < 0.01).any()
        decoder.status(now_ns)


PROPERTIES = (in_pieces, blocks, requests, decoded)


def read(request: Request, pieces: list[bytes]) -> Answer | None:
    """The answer that the pieces are; None when they are none."""
    reader = AnswerReader(request)
    with contextlib.suppress(BadTelegram):
        for piece in pieces:
            if (answer := reader.feed(piece)) is not None:
                return answer
            assert len(reader.held) <= request.answer_bytes
    return None


def with_checksum(stream: bytes) -> bytes:
    """The last two bytes made the CRC of a block in the rest."""
    body = stream[:-2]
    return body + crc16(body[4:]).to_bytes(2, "little")


def seeds() -> list[bytes]:
    """Answers of all kinds, also two in a row, and requests; each for every property."""
    granted = encode_answer(Answer(code=0))
    words = np.arange(100, 100 + BEAMS, dtype=np.uint16)
    scans = [
        encode_answer(Answer(code=0, block=scan_block(each, address)))
        for each in (words, words[:2], standby_words(BEAMS))
        for address in (7, 8)
    ]
    asked = [
        encode_request(request)
        for address in (7, 8)
        for request in (get_token(address), release_token(address), fetch_scan(address, BEAMS))
    ]
    refused = [encode_answer(Answer(code=code)) for code in (2, 4, 6)]
    size = len(scans[0])
    turns = granted.ljust(size, b"\0") + scans[0] + refused[0].ljust(size, b"\0") + scans[4]
    streams = [granted, *refused, *scans, *asked, turns]
    # Pieces of `size` bytes for `decoded`: each is one turn of the dialogue.
    first = (size // 4 - 1) << 3
    return [bytes((first | each << 1,)) + stream for stream in streams for each in range(4)]
