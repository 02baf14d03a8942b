from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from paths import REPO

from amr_drivers.can_odometry.counting import Limits, WheelCounter
from amr_drivers.can_odometry.dbc import Signals
from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings, WheelSettings
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_slam.samples import JointSample, WheelSample

DBC = str(REPO / "config/wheels.dbc")
LEFT, RIGHT = WheelSettings(signal="LeftCount"), WheelSettings(signal="RightCount")
TURN_PER_COUNT = 2 * math.pi / 4096
MS = 1_000_000
PERIOD_NS = 20 * MS

TWO_FRAMES = """VERSION ""
BS_:
BU_: Node
BO_ 385 LeftNode: 4 Node
 SG_ Position : 7|32@0- (1,0) [0|0] "" Vector__XXX
BO_ 2147484034 RightNode: 4 Node
 SG_ Position : 0|32@1- (1,0) [0|0] "" Vector__XXX
"""


def robot(left: WheelSettings = LEFT, right: WheelSettings = RIGHT) -> Settings:
    return Settings(dbc=DBC, left=left, right=right, sequence_signal="Sequence")


def decoder(left: WheelSettings = LEFT, right: WheelSettings = RIGHT) -> DbcDecoder:
    return DbcDecoder(robot(left, right), 0)


def counts(stamp_ns: int, data: bytes, identifier: int = 0x200) -> Frame:
    return Frame(stamp_ns=stamp_ns, identifier=identifier, data=data)


Got = list[WheelSample | JointSample]


def fed(frames: DbcDecoder, stamp_ns: int, frame: Frame) -> Got:
    return frames.received(replace(frame, stamp_ns=stamp_ns))


def test_example_dbc_decodes_bytes_worked_out_by_hand() -> None:
    # Left 100, right 200 turns of the wheel in counts, packed in 28 bits each, sequence 7.
    packed = 100 * 4096 | 200 * 4096 << 28 | 7 << 56
    frames = decoder()
    first = frames.received(counts(0, packed.to_bytes(8, "little")))
    assert first == [WheelSample(stamp_ns=0, left_rad=0.0, right_rad=0.0)]
    packed = (100 * 4096 + 41) | (200 * 4096 - 82) << 28 | 8 << 56
    (second,) = frames.received(counts(PERIOD_NS, packed.to_bytes(8, "little")))
    assert isinstance(second, WheelSample)
    assert second.left_rad == pytest.approx(41 * TURN_PER_COUNT)
    assert second.right_rad == pytest.approx(-82 * TURN_PER_COUNT)
    assert second.segment == 0


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    modulus=st.sampled_from([256, 1000, 65536, 2**28, 2**32, 4097]),
    start=st.integers(0, 2**32),
    steps=st.lists(st.integers(-60, 60), min_size=1, max_size=60),
    sign=st.sampled_from([1.0, -1.0]),
)
def test_any_modulus_is_unwrapped(modulus: int, start: int, steps: list[int], sign: float) -> None:
    counter = WheelCounter(modulus, sign * 0.01, Limits())
    total, stamp_ns = start, 0
    assert counter.update(stamp_ns, start % modulus)
    for step in steps:
        total, stamp_ns = total + step, stamp_ns + PERIOD_NS
        assert counter.update(stamp_ns, total % modulus)
        angle_rad = counter.angle_at(stamp_ns)
        assert angle_rad == pytest.approx(sign * 0.01 * (total - start), abs=1e-9)
    assert counter.segment == 0


@pytest.mark.parametrize(
    ("before", "after", "bits", "delta"),
    [(0xFFFFFFFA, 5, 32, 11), (2**31 - 1, -(2**31), 32, 1), (-1, 0, 16, 1), (0, -1, 16, -1)],
)
def test_wraps_of_the_fact_sheet(before: int, after: int, bits: int, delta: int) -> None:
    counter = WheelCounter(2**bits, 1.0, Limits())
    counter.update(0, before)
    counter.update(400 * MS, after)
    assert counter.angle_at(400 * MS) == delta


def test_a_long_gap_and_an_impossible_step_begin_a_segment_without_motion() -> None:
    counter = WheelCounter(2**32, TURN_PER_COUNT, Limits(max_speed_radps=20.0, max_gap_s=0.5))
    counter.update(0, 1000)
    counter.update(PERIOD_NS, 1010)
    angle_rad = counter.angle_at(PERIOD_NS)
    counter.update(2 * PERIOD_NS, 0)  # the encoder was switched off and on
    assert counter.segment == 1
    assert counter.angle_at(2 * PERIOD_NS) == angle_rad
    assert counter.angle_at(2 * PERIOD_NS - 1) is None  # never between two segments
    counter.update(600 * MS, 5)
    assert counter.segment == 2
    counter.update(620 * MS, 15)
    assert counter.segment == 2
    assert counter.angle_at(620 * MS) == pytest.approx(20 * TURN_PER_COUNT)


def test_a_gap_in_which_a_small_counter_could_alias_is_not_integrated() -> None:
    counter = WheelCounter(4096, TURN_PER_COUNT, Limits(max_speed_radps=40.0, max_gap_s=0.5))
    counter.update(0, 0)
    counter.update(100 * MS, 10)  # half a turn takes 79 ms at full speed
    assert counter.segment == 1


@settings(derandomize=True, deadline=None, max_examples=100)
@given(st.data())
def test_duplicates_losses_and_swaps_never_falsify_the_angle(data: st.DataObject) -> None:
    wheels = EmulatedWheels(robot())
    sent = [(n, wheels.frames(0.1 * n, -0.2 * n)[0]) for n in range(30)]
    order = [n for n in range(30) if n < 2 or data.draw(st.integers(0, 9)) < 9]  # losses
    assume(len(order) > 5)
    for at in data.draw(st.lists(st.integers(2, len(order) - 2), max_size=4)):
        order[at], order[at + 1] = order[at + 1], order[at]
    for at in data.draw(st.lists(st.integers(0, len(order) - 1), max_size=4)):
        order.insert(at, order[at])
    frames = decoder()
    samples: list[tuple[int, WheelSample]] = []
    for arrival, n in enumerate(order):
        for sample in fed(frames, arrival * PERIOD_NS, sent[n][1]):
            assert isinstance(sample, WheelSample)
            samples.append((n, sample))
    assert [n for n, _ in samples] == sorted({n for n, _ in samples}), "a step taken twice"
    assert len(samples) + frames.status(0)[0] == len(order)
    for n, sample in samples:
        if sample.segment == 0:
            assert sample.left_rad == pytest.approx(0.1 * n, abs=TURN_PER_COUNT)
            assert sample.right_rad == pytest.approx(-0.2 * n, abs=TURN_PER_COUNT)
    assert all(a.stamp_ns < b.stamp_ns for (_, a), (_, b) in pairwise(samples))


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    modulus=st.sampled_from([1000, 65536, 2**28, 100_003]),
    order=st.permutations(range(12)),
    steps=st.lists(st.integers(-20, 20), min_size=12, max_size=12),
)
def test_any_order_of_stamped_frames_gives_the_same_sum(
    modulus: int, order: list[int], steps: list[int]
) -> None:
    totals = [sum(steps[: n + 1]) for n in range(12)]
    left = WheelSettings(signal="LeftCount", modulus_counts=modulus)
    frames = DbcDecoder(
        Settings(dbc=DBC, left=left, limits=Limits(max_gap_s=5.0, max_speed_radps=2.0)), 0
    )
    samples: Got = []
    for n in order:
        packed = totals[n] % modulus | (totals[n] % 2**28) << 28
        samples += frames.received(counts(n * PERIOD_NS, packed.to_bytes(8, "little")))
    newest, first = samples[-1], order[0]
    assert isinstance(newest, WheelSample)
    assert newest.stamp_ns == 11 * PERIOD_NS
    moved_rad = (totals[11] - totals[first]) * TURN_PER_COUNT
    assert newest.left_rad == pytest.approx(moved_rad, abs=1e-9)
    assert newest.right_rad == pytest.approx(moved_rad, abs=1e-9)


@pytest.mark.parametrize("periods", [50, 200])  # the sequence seems to fall, and to jump ahead
def test_a_node_that_restarts_begins_a_segment(periods: int) -> None:
    wheels, frames = EmulatedWheels(robot()), decoder()
    samples: list[WheelSample] = []
    for n in range(2 * periods):
        if n == periods:
            before = samples[-1]
            wheels.restart(0.1 * n, 0.05 * n)
        (frame,) = wheels.frames(0.1 * n, 0.05 * n)
        for sample in fed(frames, n * PERIOD_NS, frame):
            assert isinstance(sample, WheelSample)
            samples.append(sample)
    assert len(samples) == 2 * periods
    assert [sample.segment for sample in samples] == periods * [0] + periods * [2]
    # Nothing is taken for a motion at the restart, and all is afterwards.
    assert samples[periods].left_rad == before.left_rad
    moved_rad = samples[-1].left_rad - samples[periods].left_rad
    assert moved_rad == pytest.approx(0.1 * (periods - 1), abs=2 * TURN_PER_COUNT)


def test_sign_gear_and_counts_per_revolution() -> None:
    left = WheelSettings(signal="LeftCount", sign=-1, gear_ratio=25.0, counts_per_revolution=2000)
    right = WheelSettings(signal="RightCount", modulus_counts=100_003)
    wheels, frames = EmulatedWheels(robot(left, right)), decoder(left, right)
    assert wheels.frames(1.0, 0.0)[0].data[:4] != wheels.frames(-1.0, 0.0)[0].data[:4]
    wheels = EmulatedWheels(robot(left, right))
    for n in range(200):
        (frame,) = wheels.frames(0.5 * n, 0.3 * n)
        (sample,) = fed(frames, n * PERIOD_NS, frame)
    assert isinstance(sample, WheelSample)
    assert sample.segment == 0
    assert sample.left_rad == pytest.approx(0.5 * 199, abs=1e-3)
    assert sample.right_rad == pytest.approx(0.3 * 199, abs=1e-3 + TURN_PER_COUNT)


def test_wheels_in_two_frames_are_brought_to_one_instant(tmp_path: Path) -> None:
    dbc = tmp_path / "two.dbc"
    dbc.write_text(TWO_FRAMES)
    left = WheelSettings(message="LeftNode", signal="Position")
    right = WheelSettings(message="RightNode", signal="Position", sign=-1)
    told = Settings(dbc=str(dbc), left=left, right=right)
    wheels, frames = EmulatedWheels(told), DbcDecoder(told, 0)
    assert [(f.identifier, f.is_extended) for f in frames.filters] == [(385, False), (386, True)]
    samples: list[WheelSample] = []
    for n in range(40):
        left_ns, right_ns = n * PERIOD_NS, n * PERIOD_NS + 5 * MS
        if n == 10:
            continue  # both lost once
        for stamp_ns, index in ((left_ns, 0), (right_ns, 1)):
            angle_rad = 5e-9 * stamp_ns  # 5 rad/s
            frame = wheels.frames(angle_rad, angle_rad)[index]
            if n == 20 and index == 1:
                continue
            for sample in fed(frames, stamp_ns, frame):
                assert isinstance(sample, WheelSample)
                samples.append(sample)
    assert len(samples) >= 36
    for sample in samples[1:]:
        assert sample.segment == 0
        # From the first pair on (0 and 5 ms) both wheels' sums began 25 mrad apart.
        assert sample.left_rad == pytest.approx(5e-9 * sample.stamp_ns, abs=2 * TURN_PER_COUNT)
        assert sample.right_rad == pytest.approx(
            5e-9 * sample.stamp_ns - 0.025, abs=2 * TURN_PER_COUNT
        )
    # The same id as a standard and as an extended frame are two different frames.
    foreign = Frame(stamp_ns=10**12, identifier=385, data=bytes(4), is_extended=True)
    assert frames.received(foreign) == []


def test_frames_not_as_the_dbc_says_are_refused_and_named() -> None:
    frames = decoder()
    assert frames.received(counts(0, bytes(2))) == []
    assert frames.status(0) == (1, "WheelEncoders has 2 bytes, the DBC file says 8")
    limited = decoder(left=WheelSettings(signal="LeftCount", modulus_counts=1000))
    limited.received(counts(0, (1000).to_bytes(8, "little")))
    assert limited.status(0) == (1, "LeftCount is 1000, but wraps at 1000")
    limited.received(counts(1, (999 | 1 << 56).to_bytes(8, "little")))
    assert limited.status(1) == (1, None)
    assert frames.received(counts(0, bytes(8), identifier=0x201)) == []
    assert frames.status(0)[0] == 1


@pytest.mark.parametrize(
    ("wheel", "message"),
    [
        (WheelSettings(signal="LeftCont"), "did you mean 'LeftCount'"),
        (WheelSettings(message="Wheels", signal="LeftCount"), "did you mean 'WheelEncoders'"),
        (WheelSettings(signal="LeftCount", modulus_counts=2**29), "28 bits and cannot wrap at"),
    ],
)
def test_settings_that_do_not_fit_the_dbc_are_named(wheel: WheelSettings, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        decoder(wheel)


def test_a_dbc_that_is_absent_or_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"absent\.dbc: No such file"):
        Signals(str(tmp_path / "absent.dbc"), robot().signals)
    noise = tmp_path / "noise.dbc"
    noise.write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=r"noise\.dbc: no DBC file"):
        Signals(str(noise), robot().signals)
