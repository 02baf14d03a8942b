"""Frames that no sound drive sends, or that are for somebody else: refused by a line
that says why, or let pass, and what comes after them is understood."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.decoder import Cia402Decoder
from amr_drivers.can_odometry.cia402.settings import NodeSettings
from amr_drivers.can_odometry.cia402.settings import Settings as Cia402Settings
from amr_drivers.can_odometry.counting import Limits, SteerAngle
from amr_drivers.can_odometry.dbc import MAX_DBC_BYTES
from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings as DbcSettings
from amr_drivers.can_odometry.settings import WheelSettings
from amr_drivers.emulators.cia402 import EmulatedDrives

MS = 1_000_000


NODE = NodeSettings(node=1, counts_per_revolution=65536, gear_ratio=20.0)
DRIVES = Cia402Settings(left=NODE, right=replace(NODE, node=2, sign=-1))


def frame(identifier: int, data: bytes, **more: object) -> Frame:
    return replace(Frame(stamp_ns=MS, identifier=identifier, data=data), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("bad", "why"),
    [
        (frame(objects.HEARTBEAT + 1, b""), "node 1: heartbeat of 0 bytes"),
        (frame(objects.EMCY + 2, b"\x10\x23\0"), "node 2: EMCY of 3 bytes"),
    ],
)
def test_a_drives_message_of_another_length_is_refused(bad: Frame, why: str) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    assert decoder.received(bad) == []
    assert decoder.status(MS) == (1, why)


@pytest.mark.parametrize(
    "other",
    [
        frame(objects.HEARTBEAT + 5, b"\x05"),
        frame(0x580 + 1, bytes(8)),
        frame(objects.HEARTBEAT + 1, b"", is_extended=True),
        frame(0x181, b"", is_remote=True),
    ],
    ids=["another node", "SDO", "29 bits", "remote"],
)
def test_frames_about_something_else_are_no_errors(other: Frame) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    assert decoder.received(other) == []
    assert decoder.status(MS)[0] == 0


def test_drives_that_say_what_no_wheel_can_do_are_not_believed() -> None:
    turning = replace(NODE, measures="velocity")
    told = Cia402Settings(left=turning, right=replace(turning, node=2))
    drives, decoder = EmulatedDrives(told, started=True), Cia402Decoder(told, 0)
    samples, angles = [], {"left": 0.0, "right": 0.0}
    for n in range(1, 6):
        angles = {name: angle + 0.02 * (400.0 if n > 3 else 4.0) for name, angle in angles.items()}
        for one in drives.cycle(n * 20 * MS, angles, 0.02):
            samples += decoder.received(one)
    assert "the wheel cannot turn at 400 rad/s" in str(decoder.status(100 * MS)[1])
    assert samples
    assert all(sample.stamp_ns <= 60 * MS + MS for sample in samples)


def test_a_position_beyond_its_modulus_is_refused() -> None:
    drives = EmulatedDrives(DRIVES, started=True)
    wrapping = replace(NODE, modulus_counts=4096)
    decoder = Cia402Decoder(replace(DRIVES, left=wrapping), 0)
    for one in drives.cycle(20 * MS, {"left": 2.0, "right": 0.0}, 0.02)[:1]:
        decoder.received(one)
    assert "wraps at 4096" in str(decoder.status(20 * MS)[1])


def test_a_steering_angle_is_a_position() -> None:
    with pytest.raises(ValueError, match="a steering angle is a position"):
        Cia402Settings(drive=NODE, steer=replace(NODE, node=2, measures="velocity"))


def test_a_steering_angle_of_the_same_instant_is_not_newer() -> None:
    steering = SteerAngle(Limits())
    assert steering.update(MS, 0.1)
    assert not steering.update(MS, 0.2)
    assert steering.angle_at(MS) == 0.1
    assert steering.update(2 * MS, 0.1 + 2.0 * math.pi)
    assert steering.angle_at(2 * MS) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("identifier", "data", "text"),
    [
        (0x004, b"\0\0", None),
        (0x004 | 0x080, b"\0\0", "bus errors"),
        (0x004, b"\0\x01", "frames lost: the interface's buffer ran over"),
        (0x002, b"\0\0", None),
    ],
    ids=["no trouble", "another class", "overflow", "arbitration"],
)
def test_error_frames_tell_what_goes_on(identifier: int, data: bytes, text: str | None) -> None:
    decoder = Cia402Decoder(DRIVES, 0)
    decoder.received(frame(0x20000000 | identifier, data, is_error=True, is_extended=True))
    assert decoder.status(MS) == (1, text)


J1939 = """VERSION ""
BS_:
BU_: Node
BO_ 2566848254 Broadcast: 8 Node
 SG_ Left : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Right : 16|16@1+ (1,0) [0|0] "" Vector__XXX
BO_ 2565804065 ToOne: 8 Node
 SG_ LeftOne : 0|16@1+ (1,0) [0|0] "" Vector__XXX
 SG_ RightOne : 16|16@1+ (1,0) [0|0] "" Vector__XXX
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566848254 3;
BA_ "VFrameFormat" BO_ 2565804065 3;
"""


@pytest.mark.parametrize(
    ("message", "suffix", "identifier", "same", "others"),
    [
        # To all, its source left open (0xFE): of any priority, from anybody.
        ("Broadcast", "", 0x18FEFEFE, (0x1C000000, 0xFF), (0x100, 0x10000)),
        # To one from one: of any priority, to anybody, from this source only.
        ("ToOne", "One", 0x18EF1021, (0x1C000000, 0xFF00), (0x1, 0x10000)),
    ],
)
def test_which_frames_of_j1939_are_meant(
    tmp_path: Path,
    message: str,
    suffix: str,
    identifier: int,
    same: tuple[int, ...],
    others: tuple[int, ...],
) -> None:
    dbc = tmp_path / "j1939.dbc"
    dbc.write_text(J1939)
    left, right = (
        WheelSettings(message=message, signal=f"{side}{suffix}") for side in ("Left", "Right")
    )
    settings = DbcSettings(channel="can0", dbc=str(dbc), left=left, right=right)
    decoder = DbcDecoder(settings, 0)
    (wanted,) = decoder.filters
    own = frame(identifier, bytes(8), is_extended=True)
    for bits in (0, *same):
        assert wanted.lets_pass(replace(own, identifier=identifier & ~bits))
    for bits in others:
        assert not wanted.lets_pass(replace(own, identifier=identifier ^ bits))


def test_a_dbc_file_too_large_to_be_one_is_not_read(tmp_path: Path) -> None:
    large = tmp_path / "large.dbc"
    with large.open("wb") as stream:
        stream.truncate(MAX_DBC_BYTES + 1)
    told = DbcSettings(
        channel="can0",
        dbc=str(large),
        left=WheelSettings(signal="Left"),
        right=WheelSettings(signal="Right"),
    )
    with pytest.raises(ValueError, match=rf"large.dbc: larger than {MAX_DBC_BYTES} bytes"):
        DbcDecoder(told, 0)
