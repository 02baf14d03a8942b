"""Continuous mode: the finder of telegrams in a stream, and the decoder behind it."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

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

BEAMS = 2
_SETTINGS = Settings(port="x", beams=BEAMS)
_BYTEWISE = 32
"""Longer inputs are fed in two pieces: byte by byte they would be slow."""


def target(data: bytes) -> None:
    """The same telegrams whatever the pieces, each the bytes that it stood in; bounded memory."""
    reader, pieces = TelegramReader(BEAMS), TelegramReader(BEAMS)
    found = reader.feed(data)
    assert reader.position == len(data)
    assert reader.position - reader.pending <= 2 * MAX_LENGTH
    cuts = range(1, len(data)) if len(data) <= _BYTEWISE else (data[0],)
    again: list[Telegram] = []
    for start, end in pairwise((0, *cuts, len(data))):
        again += pieces.feed(data[start:end])
    assert again == found
    assert pieces.damaged == reader.damaged
    for telegram in found:
        assert _written(telegram, data)
    decoder = ContinuousDecoder("front", _SETTINGS, 0)
    for scan in decoder.received(data, 0):
        assert scan.ranges_m.shape == (BEAMS,)
        assert not (scan.ranges_m < 0.0).any()
    assert decoder.status(0)[0] >= reader.damaged


def _written(telegram: Telegram, data: bytes) -> bool:
    """Whether the telegram's own bytes are what stood there."""
    for rule in LENGTH_RULES[telegram.version]:
        try:
            raw = encode(replace(telegram, offset=0), rule)
        except BadTelegram:
            continue
        if data[telegram.offset :].startswith(raw):
            return True
    return False


def seeds() -> list[bytes]:
    """Telegrams of all versions, rules and outputs, host and guest, standby, two in a row."""
    words = np.arange(100, 100 + BEAMS, dtype=np.uint16)
    telegrams = [
        (_telegram(encode_words(words), version=version), rule)
        for version, rules in LENGTH_RULES.items()
        for rule in rules
    ]
    telegrams += [
        (_telegram(encode_words(words), address=8, status=1), 8),
        (_telegram(encode_words(standby_words(BEAMS))), 14),
        (_telegram(bytes(8), output=Output.IO), 14),
        (_telegram(bytes(10), output=Output.REFLECTORS), 8),
        (_telegram(encode_words(words[:1])), 14),
    ]
    raw = [encode(telegram, rule) for telegram, rule in telegrams]
    return [*raw, raw[0] + raw[1], b"\xff" + raw[0][:30] + raw[2]]


def _telegram(
    payload: bytes,
    *,
    version: int = 0x0103,
    address: int = 7,
    status: int = 0,
    output: Output = Output.MEASURED,
) -> Telegram:
    return Telegram(
        address=address,
        version=version,
        status=status,
        scan_number=bytes((1, 0, 0, 0)),
        telegram_number=bytes((1, 0)),
        output=output,
        payload=payload,
    )
