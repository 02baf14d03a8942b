"""CAN frames by a DBC file to wheel samples."""

from __future__ import annotations

import math

from paths import REPO

from amr_drivers.can_odometry.dbc import Signals
from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings
from amr_slam.samples import WheelSample

SETTINGS = Settings(dbc=str(REPO / "config/wheels.dbc"), sequence_signal="Sequence")
SIGNALS = Signals(SETTINGS.dbc, SETTINGS.signals, SETTINGS.sequence_signal)
IDENTIFIER = 512
STEP_NS = 20_000_000


def target(data: bytes) -> None:
    """Frames one after another: a byte of length and identifier, a byte of time, the content."""
    decoder = DbcDecoder(SETTINGS, 0, SIGNALS)
    last: WheelSample | None = None
    stamp_ns = 0
    at = 0
    while at + 2 <= len(data):
        head, delay = data[at], data[at + 1]
        end = at + 2 + (head & 0x0F)
        stamp_ns += delay * STEP_NS // 16
        frame = Frame(
            stamp_ns=stamp_ns,
            identifier=IDENTIFIER + (head >> 4 & 1),
            data=data[at + 2 : end],
            is_extended=bool(head >> 5 & 1),
            is_error=bool(head >> 6 & 1),
            is_remote=bool(head >> 7 & 1),
        )
        for sample in decoder.received(frame):
            assert isinstance(sample, WheelSample)
            assert math.isfinite(sample.left_rad)
            assert math.isfinite(sample.right_rad)
            assert last is None or sample.stamp_ns > last.stamp_ns
            assert last is None or sample.segment >= last.segment
            last = sample
        at = end
    assert decoder.status(stamp_ns)[0] >= 0


def seeds() -> list[bytes]:
    """Rolling wheels; a restart; a repeated frame; a foreign one; a short one; an error frame."""
    return [
        b"".join(_frame(100 + 5 * n, 200 - 5 * n, n) for n in range(3)),
        _frame(1000, 1000, 250) + _frame(0, 0, 0) + _frame(3, 3, 1),
        2 * _frame(7, 7, 7),
        bytes((0x18, 16)) + bytes(8),
        bytes((0x07, 16)) + bytes(7),
        _frame(2**28 - 1, 0, 1) + _frame(0, 2**28 - 1, 2),
        bytes((0x48, 16)) + bytes(8),
    ]


def _frame(left: int, right: int, sequence: int) -> bytes:
    value = left | right << 28 | sequence << 56
    return bytes((8, 16)) + value.to_bytes(8, "little")
