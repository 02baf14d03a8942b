"""What may stand in a frame beside counts: speeds, angles, floats, multiplexers, no numbers."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import REPO

from amr_drivers.can_odometry.counting import Limits, SpeedIntegral, SteerAngle
from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings, SteerSettings, WheelSettings
from amr_drivers.emulators.can_faults import FaultyWire
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_slam.samples import JointSample, WheelSample

MS = 1_000_000
PERIOD_NS = 20 * MS
TRICYCLE = str(REPO / "config/tricycle.dbc")

SPEEDS = """VERSION ""
BS_:
BU_: Node
BO_ 256 Float: 8 Node
 SG_ Left : 0|32@1- (1,0) [0|0] "rad/s" Vector__XXX
 SG_ Right : 39|32@0- (1,0) [0|0] "rad/s" Vector__XXX
BO_ 257 Whole: 5 Node
 SG_ Left : 0|16@1- (0.5,0) [0|0] "rpm" Vector__XXX
 SG_ Right : 23|16@0+ (0.5,-1000) [0|0] "rpm" Vector__XXX
 SG_ Sequence : 32|8@1+ (1,0) [0|0] "" Vector__XXX
BO_ 2566848254 WheelSpeed: 8 Node
 SG_ Left : 0|16@1+ (0.001,-30) [0|0] "m/s" Vector__XXX
 SG_ Right : 16|16@1+ (0.001,-30) [0|0] "m/s" Vector__XXX
BO_ 258 Multiplexed: 8 Node
 SG_ Which M : 0|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ LeftCount m1 : 8|24@1+ (1,0) [0|0] "" Vector__XXX
 SG_ RightCount m1 : 32|24@1+ (1,0) [0|0] "" Vector__XXX
 SG_ Volts m2 : 8|16@1+ (1,0) [0|0] "" Vector__XXX
SIG_VALTYPE_ 256 Left : 1;
SIG_VALTYPE_ 256 Right : 1;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566848254 3;
"""


@pytest.fixture(scope="module")
def dbc(tmp_path_factory: pytest.TempPathFactory) -> str:
    file = tmp_path_factory.mktemp("dbc") / "speeds.dbc"
    file.write_text(SPEEDS)
    return str(file)


def speeds(dbc: str, message: str, **options: object) -> Settings:
    left = WheelSettings(message=message, signal="Left", measures="speed", **options)  # type: ignore[arg-type]
    return Settings(dbc=dbc, left=left, right=replace(left, signal="Right", sign=-1))


def frame(number: int, data: bytes, n: int = 0, *, is_extended: bool = False) -> Frame:
    return Frame(stamp_ns=n * PERIOD_NS, identifier=number, data=data, is_extended=is_extended)


def only(samples: list[WheelSample | JointSample]) -> WheelSample:
    (sample,) = samples
    assert isinstance(sample, WheelSample)
    return sample


def test_floats_of_both_byte_orders(dbc: str) -> None:
    decoder = DbcDecoder(speeds(dbc, "Float"), 0)
    decoder.received(frame(256, struct.pack("<f", 2.0) + struct.pack(">f", -4.0)))
    last = only(decoder.received(frame(256, struct.pack("<f", 4.0) + struct.pack(">f", -4.0), 1)))
    assert (last.left_rad, last.right_rad) == pytest.approx((0.06, 0.08))
    for value in (math.nan, math.inf):
        data = struct.pack("<f", value) + struct.pack(">f", 1.0)
        assert decoder.received(frame(256, data, 2)) == []
        assert decoder.status(2 * PERIOD_NS)[1] == "Left is not available"
    data = struct.pack("<f", 1e9) + struct.pack(">f", 1.0)
    assert decoder.received(frame(256, data, 2)) == []
    assert decoder.status(2 * PERIOD_NS)[1] == "Left: the wheel cannot turn at 1e+09 rad/s"
    after = only(decoder.received(frame(256, struct.pack("<f", 4.0) + struct.pack(">f", -4.0), 3)))
    assert after.segment == 0
    assert after.left_rad == pytest.approx(0.06 + 0.16)


def test_rpm_of_the_motor_with_factor_offset_and_gear(dbc: str) -> None:
    told = speeds(dbc, "Whole", speed_unit="rpm", gear_ratio=20.0)
    decoder = DbcDecoder(told, 0)
    # 600 rpm: raw 1200; -600 rpm with the offset of -1000: raw 800, big-endian.
    data = struct.pack("<h", 1200) + struct.pack(">H", 800) + b"\x00"
    decoder.received(frame(257, data))
    last = only(decoder.received(frame(257, data, 1)))
    assert last.left_rad == last.right_rad == pytest.approx(math.pi * 0.02)


def test_j1939_speeds_whatever_priority_and_source(dbc: str) -> None:
    told = speeds(dbc, "WheelSpeed", speed_unit="m/s", radius_m=0.2)
    decoder = DbcDecoder(told, 0)
    # 1 m/s: raw 31000; -1 m/s: raw 29000. Priority 3 and source 0x27 instead of 6 and "any".
    data = struct.pack("<HH", 31000, 29000) + bytes(4)
    for n, number in enumerate((0x18FEFEFE, 0x0CFEFE27)):
        samples = decoder.received(frame(number, data, n, is_extended=True))
    last = only(samples)
    assert (last.left_rad, last.right_rad) == pytest.approx((0.1, 0.1))
    for raw in (0xFFFF, 0xFE00, 0xFB00):
        data = struct.pack("<HH", raw, 29000) + bytes(4)
        assert decoder.received(frame(0x18FEFE27, data, 2, is_extended=True)) == []
        assert decoder.status(2 * PERIOD_NS)[1] == "Left is not available"
    assert decoder.received(frame(0x18FEFF27, data, 2, is_extended=True)) == []
    assert decoder.received(frame(0x18FEFE27 & 0x7FF, data, 2)) == []
    assert decoder.status(0)[0] == 3


def test_multiplexed_counts(dbc: str) -> None:
    told = Settings(
        dbc=dbc,
        left=WheelSettings(message="Multiplexed", signal="LeftCount"),
        right=WheelSettings(message="Multiplexed", signal="RightCount"),
    )
    decoder = DbcDecoder(told, 0)
    for n in range(3):
        counts = (100 * n).to_bytes(3, "little") + (200 * n).to_bytes(3, "little")
        samples = decoder.received(frame(258, b"\x01" + counts + b"\x00", 2 * n))
        assert decoder.received(frame(258, b"\x02" + bytes(7), 2 * n + 1)) == []
    last = only(samples)
    assert last.left_rad == pytest.approx(200 * 2 * math.pi / 4096)
    assert last.right_rad == pytest.approx(400 * 2 * math.pi / 4096)
    assert decoder.status(5 * PERIOD_NS) == (0, None)
    # A selector that the file does not know.
    assert decoder.received(frame(258, b"\x09" + bytes(7), 6)) == []
    assert "Multiplexed" in str(decoder.status(6 * PERIOD_NS)[1])


def test_all_ones_are_a_count_unless_they_are_said_to_be_none() -> None:
    for no_number, expected in (("never", None), ("all_ones", "LeftCount is not available")):
        left = WheelSettings(signal="LeftCount", no_number=no_number)  # type: ignore[arg-type]
        decoder = DbcDecoder(Settings(dbc=str(REPO / "config/wheels.dbc"), left=left), 0)
        decoder.received(frame(0x200, (2**28 - 1).to_bytes(8, "little")))
        assert decoder.status(0)[1] == expected


@pytest.mark.parametrize(
    ("bits", "raw", "is_number"),
    [(2, 1, True), (2, 2, False), (4, 13, True), (4, 14, False), (8, 250, True), (8, 251, False)],
)
def test_short_j1939_fields(tmp_path: Path, bits: int, raw: int, is_number: bool) -> None:
    file = tmp_path / "short.dbc"
    file.write_text(
        'VERSION ""\nBS_:\nBU_: Node\nBO_ 256 Frame: 2 Node\n'
        f' SG_ L : 0|{bits}@1+ (1,0) [0|0] "" Vector__XXX\n'
        ' SG_ R : 8|8@1+ (1,0) [0|0] "" Vector__XXX\n'
    )
    left = WheelSettings(message="Frame", signal="L", no_number="j1939")
    told = Settings(dbc=str(file), left=left, right=replace(left, signal="R"))
    decoder = DbcDecoder(told, 0)
    decoder.received(frame(256, bytes([raw, 0])))
    assert (decoder.status(0)[1] is None) == is_number


def tricycle(**drive: object) -> Settings:
    return Settings(
        dbc=TRICYCLE,
        drive=WheelSettings(message="Traction", signal="DriveCount", **drive),  # type: ignore[arg-type]
        steer=SteerSettings(signal="SteerAngle", unit="deg"),
        sequence_signal="Sequence",
    )


def test_a_tricycle_gives_drive_and_steer_at_one_instant() -> None:
    told = tricycle(gear_ratio=25.0)
    wheels, decoder = EmulatedWheels(told), DbcDecoder(told, 0)
    samples: list[WheelSample | JointSample] = []
    for n in range(20):
        for late_ns, one in zip((0, 4 * MS), wheels.frames(-0.2 * n, -1.0 + 0.05 * n), strict=True):
            samples += decoder.received(replace(one, stamp_ns=n * PERIOD_NS + late_ns))
    last = samples[-1]
    assert isinstance(last, JointSample)
    assert last.names == told.joints == ("drive", "steer")
    assert last.stamp_ns == 19 * PERIOD_NS
    # At the drive's instant the steering, told 4 ms later each time, was a fifth of a step less.
    assert last.angles_rad == pytest.approx((-0.2 * 19, -1.0 + 0.05 * 18.8), abs=2e-4)
    assert last.segment == 0
    assert dict(decoder.facts())["steer value"] == f"{round(math.degrees(-0.05) * 100):g}"


def test_a_steering_in_counts_and_one_that_is_absurd() -> None:
    told = replace(
        tricycle(),
        steer=SteerSettings(
            signal="SteerAngle", unit="counts", counts_per_revolution=1000, gear_ratio=4.0, sign=-1
        ),
    )
    decoder = DbcDecoder(told, 0)
    drive = frame(513, bytes(8))
    assert decoder.received(drive) == []
    (sample,) = decoder.received(frame(514, struct.pack(">h", 500) + bytes(2)))
    assert isinstance(sample, JointSample)
    assert sample.angles_rad[1] == pytest.approx(-math.pi / 4)
    radians = replace(tricycle(), steer=SteerSettings(signal="SteerAngle", unit="rad"))
    decoder = DbcDecoder(radians, 0)
    decoder.received(frame(514, struct.pack(">h", 9000) + bytes(2)))
    assert decoder.status(0)[1] == "SteerAngle: no wheel is steered by 90 rad"


def test_a_steering_lost_for_long_begins_a_segment() -> None:
    told = tricycle()
    wheels, decoder = EmulatedWheels(told), DbcDecoder(told, 0)
    samples: list[WheelSample | JointSample] = []
    for n in range(80):
        drive, steer = wheels.frames(0.1 * n, 0.3)
        samples += decoder.received(replace(drive, stamp_ns=n * PERIOD_NS))
        if not 20 <= n < 50:
            samples += decoder.received(replace(steer, stamp_ns=n * PERIOD_NS))
    assert samples[-1].segment == 1
    assert [s for s in samples if 20 * PERIOD_NS <= s.stamp_ns < 50 * PERIOD_NS] == []


@settings(derandomize=True, deadline=None, max_examples=50)
@given(speeds=st.lists(st.floats(-30.0, 30.0), min_size=2, max_size=50))
def test_speeds_that_change_evenly_are_integrated_exactly(speeds: list[float]) -> None:
    """A trapezoid is exact for what is linear between the frames."""
    wheel, total = SpeedIntegral(Limits()), 0.0
    for n, speed in enumerate(speeds):
        assert wheel.update(n * PERIOD_NS, speed)
        assert not wheel.update(n * PERIOD_NS, 0.0), "a frame that comes twice"
        total += 0.01 * (speeds[n - 1] + speed) if n else 0.0
    assert wheel.segment == 0
    assert wheel.angle_at((len(speeds) - 1) * PERIOD_NS) == pytest.approx(total, abs=1e-9)


def test_a_steering_goes_the_short_way_round() -> None:
    steer = SteerAngle(Limits())
    steer.update(0, 3.1)
    steer.update(PERIOD_NS, -3.1)
    middle = steer.angle_at(PERIOD_NS // 2)
    assert middle is not None
    assert math.remainder(middle - math.pi, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_speeds_with_doubled_and_late_frames(dbc: str, seed: int) -> None:
    """The sequence counter sorts them out; a late one is bridged by its neighbours."""
    left = WheelSettings(message="Whole", signal="Left", measures="speed", speed_unit="rpm")
    told = Settings(
        dbc=dbc, left=left, right=replace(left, signal="Right"), sequence_signal="Sequence"
    )
    wheels, decoder = EmulatedWheels(told), DbcDecoder(told, 0)
    samples: list[WheelSample | JointSample] = []
    bus = FaultyWire(lambda one: samples.extend(decoder.received(one)))
    for n in range(100):
        (one,) = wheels.frames(10.0, -10.0, stamp_ns=n * PERIOD_NS)
        if (n + seed) % 5 == 4:
            bus.hold([one])
        elif (n + seed) % 5 == 2:
            bus.send_twice([one])
        else:
            bus.send([one])
    last = samples[-1]
    assert isinstance(last, WheelSample)
    assert last.segment == 0
    first = samples[0].stamp_ns
    assert last.left_rad == pytest.approx(10e-9 * (last.stamp_ns - first), rel=2e-3)


def test_settings_that_cannot_work_are_named(dbc: str) -> None:
    with pytest.raises(ValueError, match="needs radius_m"):
        speeds(dbc, "WheelSpeed", speed_unit="m/s")
    with pytest.raises(ValueError, match="drive and steer belong together"):
        Settings(dbc=dbc, drive=WheelSettings(signal="DriveCount"))
    counted = WheelSettings(message="Float", signal="Left")
    with pytest.raises(ValueError, match="Left is no counter of whole numbers"):
        DbcDecoder(Settings(dbc=dbc, left=counted, right=counted), 0)
