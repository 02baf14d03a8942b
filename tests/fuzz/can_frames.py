"""CAN frames by a DBC file to wheel samples."""

from __future__ import annotations

import contextlib
import math

from paths import REPO

from amr_drivers.can_odometry.counting import Limits
from amr_drivers.can_odometry.frames import FrameDecoder, Signals, WheelSettings
from amr_drivers.errors import BadTelegram
from amr_slam.samples import WheelSample

SIGNALS = Signals(
    str(REPO / "config/wheels.dbc"),
    WheelSettings(signal="LeftCount"),
    WheelSettings(signal="RightCount"),
    "Sequence",
)
LIMITS = Limits()
IDENTIFIER = 512
STEP_NS = 20_000_000


def target(data: bytes) -> None:
    """Frames one after another: a byte of length and identifier, a byte of time, the content."""
    decoder = FrameDecoder(SIGNALS, LIMITS)
    last: WheelSample | None = None
    stamp_ns = 0
    at = 0
    while at + 2 <= len(data):
        head, delay = data[at], data[at + 1]
        end = at + 2 + (head & 0x0F)
        stamp_ns += delay * STEP_NS // 16
        sample = None
        with contextlib.suppress(BadTelegram):
            sample = decoder.feed(
                stamp_ns,
                IDENTIFIER + (head >> 4 & 1),
                data[at + 2 : end],
                is_extended=bool(head >> 5 & 1),
            )
        if sample is not None:
            assert math.isfinite(sample.left_rad)
            assert math.isfinite(sample.right_rad)
            assert last is None or sample.stamp_ns >= last.stamp_ns
            assert last is None or sample.segment >= last.segment
            last = sample
        at = end
    assert decoder.dropped >= 0
    assert decoder.lost >= 0


def seeds() -> list[bytes]:
    """Rolling wheels; a restart; a repeated frame; a foreign one; a short one."""
    return [
        b"".join(_frame(100 + 5 * n, 200 - 5 * n, n) for n in range(3)),
        _frame(1000, 1000, 250) + _frame(0, 0, 0) + _frame(3, 3, 1),
        2 * _frame(7, 7, 7),
        bytes((0x18, 16)) + bytes(8),
        bytes((0x07, 16)) + bytes(7),
        _frame(2**28 - 1, 0, 1) + _frame(0, 2**28 - 1, 2),
    ]


def _frame(left: int, right: int, sequence: int) -> bytes:
    value = left | right << 28 | sequence << 56
    return bytes((8, 16)) + value.to_bytes(8, "little")
