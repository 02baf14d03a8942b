"""CANopen frames of CiA 402 drives to wheel samples."""

from __future__ import annotations

import math

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.decoder import Cia402Decoder
from amr_drivers.can_odometry.cia402.settings import NodeSettings, Settings
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_slam.samples import WheelSample

MAPPING = (0x6041_0010, 0x6064_0020, 0x6044_0010)
LEFT = NodeSettings(node=1, mapping=MAPPING)
SETTINGS = (
    Settings(left=LEFT, right=NodeSettings(node=2, mapping=MAPPING, modulus_counts=100_003)),
    Settings(
        left=NodeSettings(node=1, mapping=MAPPING, measures="velocity"),
        right=NodeSettings(node=2, sign=-1, velocity_unit="rpm"),
        sync=True,
        start_nodes=True,
    ),
)
SERVICES = (objects.TPDO1, objects.EMCY, objects.HEARTBEAT, 0x000, 0x280, 0x580, 0x600, 0x7FF)
STEP_NS = 20_000_000


def target(data: bytes) -> None:
    """A byte that chooses the settings; then frames: a byte of length, node and kind, a byte of
    service and time, the content."""
    decoder = Cia402Decoder(SETTINGS[data[0] & 1 if data else 0], 0)
    last: WheelSample | None = None
    stamp_ns, at, frames = 0, 1, 0
    while at + 2 <= len(data):
        head, next_byte = data[at], data[at + 1]
        end = at + 2 + min(head & 0x0F, 8)
        stamp_ns += ((next_byte >> 3) - 2) * STEP_NS // 16  # stamps may go back a little
        frame = Frame(
            stamp_ns=stamp_ns,
            identifier=SERVICES[next_byte & 7] + (head >> 4 & 3),
            data=data[at + 2 : end],
            is_extended=head >> 6 == 1,
            is_error=head >> 6 == 2,
            is_remote=head >> 6 == 3,
        )
        for sample in decoder.received(frame):
            assert isinstance(sample, WheelSample)
            assert math.isfinite(sample.left_rad)
            assert math.isfinite(sample.right_rad)
            assert last is None or sample.stamp_ns > last.stamp_ns
            assert last is None or sample.segment >= last.segment
            last = sample
        for sent in decoder.to_send():
            assert sent.identifier == objects.NMT
        at, frames = end, frames + 1
    assert 0 <= decoder.status(stamp_ns)[0] <= frames
    assert decoder.facts()


def seeds() -> list[bytes]:
    """Drives that turn; a restart; an emergency; short frames; an error frame."""
    drives = EmulatedDrives(SETTINGS[0])
    turning = [drives.cycle(0, {"left": 0.1 * n, "right": 0.1 * n}, 0.02) for n in range(4)]
    left = drives.drives["left"]
    seeds = [
        b"\x00" + b"".join(_told(frame) for frames in turning for frame in frames),
        b"\x00" + b"".join(map(_told, left.reboot(0) + left.heartbeat(0) + left.fail(0, 0x7305))),
        b"\x01" + bytes((0x11, 0x10, 0x00)),
        b"\x01" + bytes((0x98, 0x10)) + bytes(8),
    ]
    return [*seeds, seeds[0][:-3], b""]


def _told(frame: Frame) -> bytes:
    service = max((s for s in SERVICES if s <= frame.identifier), key=lambda s: s)
    head = len(frame.data) | (frame.identifier - service) << 4
    return bytes((head, SERVICES.index(service) | 6 << 3)) + frame.data
