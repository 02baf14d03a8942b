"""LMDscandata telegrams for tests, and what must hold for any bytes fed to a CoLa reader."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.framing import Dialect, Frame, FrameReader
from amr_drivers.sick_cola.messages import (
    IDENT,
    OUTPUT_RANGE,
    SCAN,
    STATE,
    OutputRange,
    Refusal,
    event_request,
    message,
    number_body,
    output_range_body,
    parse_message,
    read_request,
    refusal,
    texts_body,
)
from amr_drivers.sick_cola.scandata import (
    Channel,
    DeviceTime,
    Encoder,
    Event,
    Position,
    ScanData,
    decode_scan,
    encode_scan,
)

_SHORT = 32
"""Bytes that are fed one by one; more are fed in pieces, to keep fuzzing fast."""
_PIECE = 13


def channel(**changes: Any) -> Channel:
    """Three beams of an LMS111, but for the changes."""
    fields: dict[str, Any] = {
        "name": "DIST1",
        "bits": 16,
        "scale": 1.0,
        "offset": 0.0,
        "start_angle": -450_000,
        "angle_step": 5000,
        "values": np.array([1000, 2000, 3000], dtype=np.uint16),
    }
    return Channel(**(fields | changes))


def scan_data(**changes: Any) -> ScanData:
    """A telegram of an LMS111, but for the changes."""
    fields: dict[str, Any] = {
        "version": 1,
        "device_number": 1,
        "serial_number": 18090362,
        "status": (0, 0),
        "telegram_counter": 10,
        "scan_counter": 20,
        "start_up_us": 1_000_000,
        "transmission_us": 1_000_100,
        "inputs": (0, 0),
        "outputs": (7, 0),
        "layer_angle": 0,
        "scan_frequency": 5000,
        "measurement_frequency": 360,
        "channels": (channel(),),
    }
    return ScanData(**(fields | changes))


def everything() -> ScanData:
    """Every block that a telegram can have."""
    few = np.array([0, 15, 255], dtype=np.uint16)
    return scan_data(
        layer_angle=-500,
        encoders=(Encoder(4_000_000_000, 65_535), Encoder(1, 2)),
        channels=(
            channel(),
            channel(name="DIST2", scale=2.0, offset=-1.5),
            channel(name="RSSI1", bits=8, values=few),
        ),
        position=Position(1.0, -2.5, 0.0, 0.5, 0.25, -0.125, 3),
        device_name="not defined",
        comment="",
        time=DeviceTime(1970, 1, 1, 2, 55, 34, 889_000),
        event=Event("FDIN", 1, 2, -3),
    )


def telegram(scan: ScanData, dialect: Dialect, word: str = "sSN") -> bytes:
    """The bytes on the line."""
    return message(word, SCAN, encode_scan(scan, dialect), dialect)


def seeds_of(dialect: Dialect) -> list[bytes]:
    """Short valid telegrams of all kinds."""
    kinds = [
        telegram(scan_data(), dialect),
        telegram(everything(), dialect, "sRA"),
        telegram(scan_data(channels=()), dialect),
        message("sRA", IDENT, texts_body(("LMS10x", "V1.80"), dialect), dialect),
        message("sRA", STATE, number_body(1, 8, dialect), dialect),
        message("sRA", OUTPUT_RANGE, output_range_body(OutputRange(5000, -1, 2), dialect), dialect),
        read_request(SCAN, dialect),
        event_request(SCAN, dialect, on=True),
        refusal(3, dialect),
    ]
    return [*kinds, kinds[0] + kinds[-1] + kinds[0]]


def check_reader(make: Callable[[], FrameReader], data: bytes, longest: int) -> None:
    """In one piece or in many the same frames, bounded memory, and what is read can be written.

    The pieces, which cost most, are a fourth of the inputs' turn: four times as many are tried.
    """
    whole = make()
    frames = whole.feed(data)
    if zlib.crc32(data) & 3 == 0:
        pieces = make()
        size = 1 if len(data) <= _SHORT else _PIECE
        again: list[Frame] = []
        for start in range(0, len(data), size):
            again += pieces.feed(data[start : start + size])
        assert again == frames
        assert (whole.damaged, whole.pending) == (pieces.damaged, pieces.pending)
    assert whole.position == len(data)
    assert whole.position - whole.pending <= 2 * longest
    for frame in frames:
        _check_frame(frame)


def _check_frame(frame: Frame) -> None:
    try:
        said = parse_message(frame.payload, frame.dialect)
        if isinstance(said, Refusal) or said.name != SCAN or said.word not in ("sRA", "sSN"):
            return
        scan = decode_scan(said.body, frame.dialect)
    except BadTelegram:
        return
    for length_bits in (16, 8):
        texts = (scan.device_name or "", scan.comment or "")
        if length_bits == 8 and any(len(text) > 255 for text in texts):
            continue
        body = encode_scan(scan, frame.dialect, length_bits)
        assert encode_scan(decode_scan(body, frame.dialect), frame.dialect, length_bits) == body
