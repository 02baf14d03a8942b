"""The S300's stream of telegrams, and the scans in it."""

from __future__ import annotations

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.decoder import ContinuousDecoder
from amr_drivers.sick_s300.settings import Settings
from amr_drivers.sick_s300.telegrams import (
    LENGTH_RULES,
    MAX_LENGTH,
    Output,
    Telegram,
    TelegramReader,
    encode,
    encode_words,
    standby_words,
)

BEAMS = 3
SETTINGS = Settings(port="", beams=BEAMS)


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
    """The pieces in which the bytes come change nothing; memory is bounded."""
    reader, pieces = TelegramReader(BEAMS), TelegramReader(BEAMS)
    parts: list[Telegram] = []
    for start in range(0, len(stream), size):
        parts += pieces.feed(stream[start : start + size])
        assert pieces.position - pieces.pending <= 2 * MAX_LENGTH
    assert parts == reader.feed(stream)
    assert pieces.damaged == reader.damaged


def round_trip(stream: bytes, _size: int) -> None:
    """A telegram is found only where our encoder would have made these bytes of it."""
    for telegram in TelegramReader(BEAMS).feed(stream):
        raw = stream[telegram.offset :]
        assert any(raw.startswith(again) for again in encoded(telegram))


def decoded(stream: bytes, size: int) -> None:
    """Scans have the configured size and hold nothing but distances, inf and NaN."""
    decoder = ContinuousDecoder("front", SETTINGS, 0)
    for n, start in enumerate(range(0, len(stream), size)):
        for scan in decoder.received(stream[start : start + size], n * 1_000_000):
            assert scan.ranges_m.shape == (BEAMS,)
            assert not (scan.ranges_m <= 0.0).any()
    decoder.status(1_000_000)


PROPERTIES = (in_pieces, round_trip, decoded, in_pieces)


def encoded(telegram: Telegram) -> list[bytes]:
    """The telegram by each of its version's length rules."""
    found = []
    for rule in LENGTH_RULES[telegram.version]:
        try:
            found.append(encode(telegram, rule))
        except BadTelegram:
            continue
    return found


def with_checksum(fields: bytes) -> bytes:
    """A telegram with these fields, as far as they go, and the rest of the bytes after it."""
    head, values, rest = fields[:8], fields[8 : 8 + 2 * BEAMS], fields[8 + 2 * BEAMS :]
    head = head.ljust(8, b"\0")
    telegram = Telegram(
        address=7 + (head[0] & 1),
        version=0x0102 + (head[0] >> 1 & 1),
        status=head[1],
        scan_number=bytes(head[2:6]),
        telegram_number=bytes(head[6:8]),
        output=(Output.IO, Output.MEASURED, Output.REFLECTORS)[(head[0] >> 2) % 3],
        payload=b"\x11\x11" + values.ljust(2 * BEAMS, b"\0"),
    )
    return (
        encode(telegram, LENGTH_RULES[telegram.version][head[0] >> 7 & telegram.version & 1]) + rest
    )


def seeds() -> list[bytes]:
    """Telegrams of each kind, alone, two in a row, cut, and as fields."""
    telegrams = [
        encode(
            Telegram(
                address=7,
                version=version,
                status=0,
                scan_number=bytes((n, 0, 0, 0)),
                telegram_number=bytes((n, 0)),
                output=Output.MEASURED,
                payload=encode_words(words),
            ),
            rule,
        )
        for version, rules in LENGTH_RULES.items()
        for rule in rules
        for n, words in enumerate((np.array((50, 2950, 0), np.uint16), standby_words(BEAMS)))
    ]
    streams = [*telegrams, b"".join(telegrams[:2]), telegrams[2][:20] + telegrams[3]]
    fields = [bytes((4, 0, 1, 0, 0, 0, 1, 0, 50, 0, 134, 11, 0, 0))]
    return [
        bytes((0xF8 | kind << 1 | wrapped,)) + stream
        for wrapped, some in ((0, streams), (1, fields))
        for stream in some
        for kind in range(3)
    ]
