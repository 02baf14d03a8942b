"""CiA 402 drives and the faults of their bus, in logical time: stamps are what the frames say."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.decoder import Cia402Decoder
from amr_drivers.can_odometry.cia402.settings import NodeSettings, Settings
from amr_drivers.can_odometry.counting import Limits
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.emulators.can_faults import BUS_OFF, NO_ACKNOWLEDGEMENT, RESTARTED, FaultyWire
from amr_drivers.emulators.cia402 import EmulatedDrives
from amr_slam.samples import JointSample, WheelSample

MS = 1_000_000
PERIOD_NS = 20 * MS
COUNT_RAD = 2 * 3.141592653589793 / (65536 * 20)
WHEEL = NodeSettings(node=1, counts_per_revolution=65536, gear_ratio=20.0)
SETTINGS = Settings(left=WHEEL, right=replace(WHEEL, node=2, sign=-1))
SYNCED = replace(SETTINGS, sync=True)


class Robot:
    """Drives, a bus and the decoder at its end; 10 and 5 rad/s."""

    def __init__(self, told: Settings = SETTINGS, *, started: bool = True) -> None:
        self.drives = EmulatedDrives(told, started=started)
        self.decoder = Cia402Decoder(told, 0)
        self.samples: list[WheelSample | JointSample] = []
        self.bus = FaultyWire(self._hear)
        self.now_ns = 0

    def _hear(self, frame: Frame) -> None:
        self.samples += self.decoder.received(frame)
        for sent in self.decoder.to_send():
            for answer in self.drives.hear(sent):
                self._hear(answer)

    def frames(self) -> list[Frame]:
        """The next period's."""
        self.now_ns += PERIOD_NS
        angles = {"left": 10e-9 * self.now_ns, "right": 5e-9 * self.now_ns}
        return self.drives.cycle(self.now_ns, angles, 1e-9 * PERIOD_NS)

    def drive(self, periods: int) -> WheelSample | None:
        """The newest sample afterwards."""
        for _ in range(periods):
            self.bus.send(self.frames())
        newest = self.samples[-1] if self.samples else None
        assert newest is None or isinstance(newest, WheelSample)
        return newest

    def text(self, after_ns: int = 0) -> str | None:
        return self.decoder.status(self.now_ns + after_ns)[1]


@pytest.mark.parametrize("told", [SETTINGS, SYNCED], ids=["free", "synchronous"])
def test_both_wheels_turn_as_their_drives_say(told: Settings) -> None:
    robot = Robot(told)
    robot.drive(2)
    first, before = robot.samples[-1], len(robot.samples)
    last = robot.drive(100)
    assert len(robot.samples) == before + 100
    assert isinstance(first, WheelSample)
    assert last is not None
    elapsed_s = 1e-9 * (last.stamp_ns - first.stamp_ns)
    # Without SYNC each angle is told 0.3 ms late: evenly, so that the differences are right.
    assert last.left_rad - first.left_rad == pytest.approx(10.0 * elapsed_s, abs=3 * COUNT_RAD)
    assert last.right_rad - first.right_rad == pytest.approx(5.0 * elapsed_s, abs=3 * COUNT_RAD)
    assert last.segment == 0
    assert robot.text() is None


def test_synchronous_telegrams_have_the_stamp_of_their_sync() -> None:
    robot = Robot(SYNCED)
    robot.drive(10)
    assert [s.stamp_ns for s in robot.samples] == [n * PERIOD_NS for n in range(1, 11)]
    last = robot.samples[-1]
    assert isinstance(last, WheelSample)
    assert last.left_rad == pytest.approx(1.8, abs=2 * COUNT_RAD)
    assert last.right_rad == pytest.approx(0.9, abs=2 * COUNT_RAD)


def test_a_telegram_far_from_its_sync_or_twice_after_it_is_dropped() -> None:
    robot = Robot(SYNCED)
    robot.drive(3)
    sync, left, right = robot.frames()
    robot.bus.send([sync, left, left, replace(right, stamp_ns=sync.stamp_ns + 11 * MS)])
    assert robot.decoder.status(robot.now_ns)[0] == 2
    assert len(robot.samples) == 3
    robot.drive(1)
    assert len(robot.samples) == 4
    assert robot.samples[-1].segment == 0


def test_no_sync_is_named() -> None:
    robot = Robot(SYNCED)
    robot.drive(2)
    for _ in range(10):
        robot.bus.send(robot.frames()[1:])
    assert len(robot.samples) == 2
    assert robot.text() == "no SYNC for 0.2 s"


def test_a_position_worked_out_by_hand() -> None:
    """6041h + 6064h in TPDO 2 of node 5, and an extra byte that nobody asked for."""
    mapping = (0x60410010, 0x60640020, 0x60610008)
    node = NodeSettings(node=5, tpdo_cob_id=0x285, mapping=mapping, counts_per_revolution=1000)
    told = Settings(left=node, right=replace(node, node=6, tpdo_cob_id=0x286))
    decoder = Cia402Decoder(told, 0)
    first = bytes.fromhex("3706 F0FFFFFF 08")  # enabled, -16
    second = bytes.fromhex("3706 09000000 08")  # 25 counts on
    for stamp_ns, data in ((0, first), (PERIOD_NS, second)):
        for identifier in (0x285, 0x286):
            got = decoder.received(Frame(stamp_ns=stamp_ns, identifier=identifier, data=data))
    (sample,) = got
    assert isinstance(sample, WheelSample)
    assert sample.left_rad == pytest.approx(25 * 2 * 3.141592653589793 / 1000)
    assert dict(decoder.facts())["node 5"] == "operation enabled"
    assert decoder.received(Frame(stamp_ns=1, identifier=0x285, data=first[:6])) == []
    assert decoder.status(0)[1] == "node 5: TPDO has 6 bytes, the mapping says 7"


def test_a_drive_that_restarts_is_named_and_nothing_is_integrated_across() -> None:
    robot = Robot()
    before = robot.drive(20)
    assert before is not None
    left = robot.drives.drives["left"]
    robot.bus.send(left.reboot(robot.now_ns))
    robot.drive(3)
    assert robot.text() == "node 1 has restarted and waits for NMT start, sends no counts"
    robot.bus.send(left.heartbeat(robot.now_ns))
    assert "waits for NMT start" in str(robot.text())
    robot.bus.send(left.hear(Frame(stamp_ns=0, identifier=0, data=bytes([1, 1]))))
    after = robot.drive(2)
    assert after is not None
    assert robot.text() is None
    assert after.segment == 1
    # What was counted after it; no jump back.
    assert after.left_rad - before.left_rad == pytest.approx(0.2, abs=0.01)
    assert dict(robot.decoder.facts())["node 1 restarts"] == "1"


def test_a_restart_that_keeps_the_position_begins_a_segment_all_the_same() -> None:
    robot = Robot()
    robot.drive(20)
    left = robot.drives.drives["left"]
    robot.bus.send(left.reboot(robot.now_ns, keeps_position=True))
    left.state = objects.OPERATIONAL
    after = robot.drive(2)
    assert after is not None
    assert after.segment == 1


def test_drives_are_started_where_that_is_wanted() -> None:
    robot = Robot(replace(SETTINGS, start_nodes=True), started=False)
    assert robot.decoder.to_send() == [
        Frame(stamp_ns=0, identifier=0, data=bytes([1, node])) for node in (1, 2)
    ]
    robot.bus.send(robot.drives.heartbeats(robot.now_ns))
    assert robot.drive(5) is not None
    robot.bus.send(robot.drives.drives["right"].reboot(robot.now_ns))
    newest = robot.drive(1)
    assert newest is not None
    assert robot.drives.drives["right"].state == objects.PRE_OPERATIONAL  # at most once a second
    robot.now_ns += 1_000 * MS
    robot.bus.send(robot.drives.heartbeats(robot.now_ns))
    assert robot.drives.drives["right"].state == objects.OPERATIONAL


def test_a_listener_sends_nothing() -> None:
    robot = Robot(started=False)
    robot.bus.send(robot.drives.heartbeats(0))
    robot.bus.send(robot.drives.drives["left"].reboot(0))
    assert robot.decoder.to_send() == []
    assert robot.text() == (
        "node 1 has restarted and waits for NMT start, sends no counts; "
        "node 2 is pre-operational: waits for NMT start, sends no counts"
    )


def test_stopped_drives_and_missing_heartbeats_are_named() -> None:
    robot = Robot()
    robot.drive(1)
    robot.bus.send(robot.drives.heartbeats(robot.now_ns))
    assert robot.text(after_ns=90 * MS) is None
    assert "node 1: no heartbeat for 1.1 s" in str(robot.text(after_ns=1100 * MS))
    robot.drives.hear(Frame(stamp_ns=0, identifier=0, data=bytes([2, 2])))
    robot.bus.send(robot.drives.heartbeats(robot.now_ns))
    assert robot.text() == "node 2 is stopped (NMT), sends no counts"


def test_emergencies_and_faults_are_named_until_they_are_taken_back() -> None:
    mapping = (0x60410010, 0x60640020)
    told = Settings(left=replace(WHEEL, mapping=mapping), right=replace(WHEEL, node=2))
    robot = Robot(told)
    robot.drive(2)
    left = robot.drives.drives["left"]
    robot.bus.send(left.fail(robot.now_ns, 0x7305))
    assert robot.text() == "node 1: EMCY 7305h, incremental encoder 1"
    robot.bus.send(left.fail(robot.now_ns, 0x3210))
    assert robot.text() == "node 1: EMCY 3210h, voltage"
    samples = len(robot.samples)
    robot.drive(1)
    assert len(robot.samples) == samples + 1  # its encoder counts on
    left._emergency = 1  # a drive that sends no EMCY
    robot.bus.send([Frame(stamp_ns=1, identifier=0x81, data=bytes(8))])
    robot.drive(1)
    assert robot.text() == "node 1 has a fault (status word 0218h)"
    robot.bus.send(left.fail(robot.now_ns, 0))
    robot.drive(1)
    assert robot.text() is None


@pytest.mark.parametrize(
    ("state", "text"),
    [
        (0x0000, "not ready to switch on"),
        (0x0240, "switch-on disabled"),
        (0x0231, "ready to switch on"),
        (0x0233, "switched on"),
        (0x0237, "operation enabled"),
        (0x0217, "quick stop"),
        (0x021F, "reacts to a fault"),
        (0x0218, "has a fault"),
    ],
)
def test_status_words(state: int, text: str) -> None:
    assert objects.state_text(state) == text
    assert objects.has_fault(state) == ("fault" in text)


def test_wrong_units_are_seen_and_right_ones_not() -> None:
    right = replace(WHEEL, velocity_unit="rpm", velocity_scale=0.0001)
    robot = Robot(Settings(left=right, right=replace(right, node=2)))
    robot.drive(200)
    assert robot.text() is None
    for wrong in (
        replace(right, counts_per_revolution=10_000),
        replace(right, velocity_scale=1.0),
        replace(right, velocity_sign=-1),
    ):
        robot = Robot(Settings(left=right, right=replace(right, node=2)))
        robot.decoder = Cia402Decoder(
            Settings(left=wrong, right=replace(right, node=2), limits=Limits(max_speed_radps=400)),
            0,
        )
        robot.drive(200)
        assert "node 1: the wheel turned by" in str(robot.text())


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    modulus=st.sampled_from([0, 1_048_576, 1_000_003, 65_536]),
    start=st.integers(-(2**31), 2**31 - 1),
    steps=st.lists(st.integers(-5000, 5000), min_size=2, max_size=30),
)
def test_positions_wrap_at_any_modulus(modulus: int, start: int, steps: list[int]) -> None:
    node = replace(WHEEL, modulus_counts=modulus, mapping=(0x60640020,))
    decoder = Cia402Decoder(
        Settings(
            left=node,
            right=replace(node, node=2),
            limits=Limits(max_speed_radps=3.0),
        ),
        0,
    )
    wrap = modulus or 2**32
    total = start
    samples: list[WheelSample | JointSample] = []
    for n, step in enumerate([0, *steps]):
        total += step
        position = total % wrap if modulus else (total + 2**31) % 2**32 - 2**31
        for identifier in (0x181, 0x182):
            data = position.to_bytes(4, "little", signed=not modulus)
            frame = Frame(stamp_ns=n * PERIOD_NS, identifier=identifier, data=data)
            samples += decoder.received(frame)
    last = samples[-1]
    assert isinstance(last, WheelSample)
    assert last.left_rad == last.right_rad == pytest.approx((total - start) * COUNT_RAD, abs=1e-9)
    assert last.segment == 0


def test_velocities_are_integrated_and_never_carried_on() -> None:
    node = replace(WHEEL, mapping=(0x606C0020,), measures="velocity")
    robot = Robot(Settings(left=node, right=replace(node, node=2), sync=True))
    last = robot.drive(101)
    assert last is not None
    assert last.left_rad == pytest.approx(20.0, abs=0.01)
    robot.bus.silent = True
    robot.drive(4)
    robot.bus.silent = False
    assert robot.drive(1) is not None
    assert robot.samples[-1].segment == 0  # 100 ms are bridged by the trapezoid
    robot.bus.silent = True
    silent = robot.drive(6)
    robot.bus.silent = False
    resumed = robot.drive(1)
    assert silent is not None
    assert resumed is not None
    assert resumed.segment == 2  # both wheels anew
    assert resumed.left_rad == silent.left_rad


@pytest.mark.parametrize("told", [SETTINGS, SYNCED], ids=["free", "synchronous"])
def test_error_frames_and_silence_are_named_within_their_deadlines(told: Settings) -> None:
    robot = Robot(told)
    robot.drive(5)
    robot.bus.fail(robot.now_ns, BUS_OFF)
    assert robot.text() == "bus-off"
    samples = len(robot.samples)
    robot.bus.silent = True
    robot.drive(6)
    robot.bus.silent = False
    assert len(robot.samples) == samples
    robot.bus.fail(robot.now_ns, RESTARTED)
    assert robot.text() == "bus-off"  # until counts come
    robot.drive(1)
    assert robot.text() is None
    assert robot.text(after_ns=90 * MS) is None
    assert robot.text(after_ns=121 * MS) is not None  # five periods, and the pair's own skew
    for error_class, detail, text in (
        (NO_ACKNOWLEDGEMENT, bytes(8), "no acknowledgement"),
        (0x004, bytes([0, 0x20, 0, 0, 0, 0, 0, 0]), "error-passive: the bus is about to be lost"),
        (0x004, bytes([0, 0x01]), "frames lost: the interface's buffer ran over"),
        (0x084, bytes([0, 0x08]), "many errors on the bus (error-warning)"),
        (0x088, bytes(8), "bus errors"),
    ):
        robot.bus.fail(robot.now_ns, error_class, detail)
        assert robot.text() == text
    robot.drive(1)
    robot.bus.fail(robot.now_ns, 0x002)  # lost arbitration is no fault
    assert robot.text() is None


def test_an_error_frame_is_never_a_count() -> None:
    """Class bits 0x080 look like SYNC, 0x181 like the first drive's TPDO."""
    robot = Robot(SYNCED)
    robot.drive(2)
    for error_class in (0x080, 0x181, 0x701):
        robot.bus.fail(robot.now_ns + 5 * MS, error_class)
    assert len(robot.samples) == 2
    last = robot.drive(1)
    assert last is not None
    assert last.stamp_ns == 3 * PERIOD_NS
    assert last.segment == 0


def test_doubled_and_late_frames_change_nothing() -> None:
    clean, faulty = Robot(SYNCED), Robot(SYNCED)
    for n in range(60):
        clean.bus.send(clean.frames())
        frames = faulty.frames()
        if n % 7 == 3:
            faulty.bus.send_twice(frames)
        elif n % 7 == 5:
            faulty.bus.hold(frames[1:])  # both TPDOs after the next SYNC
            faulty.bus.send(frames[:1])
        else:
            faulty.bus.send(frames)
    last, same = clean.samples[-1], faulty.samples[-1]
    assert last == same
    assert faulty.decoder.status(faulty.now_ns)[0] > 0


def test_a_silent_drive_is_named_and_back_with_a_new_segment() -> None:
    robot = Robot()
    robot.drive(10)
    robot.drives.drives["right"].silent = True
    robot.drive(6)
    assert robot.text() == "no right wheel counts for 0.1 s"
    robot.drive(24)
    robot.drives.drives["right"].silent = False
    last = robot.drive(2)
    assert last is not None
    assert last.segment == 1
    assert robot.text() is None


def test_a_wheel_that_counts_nothing_while_the_other_turns_is_a_hint() -> None:
    robot = Robot()

    def drive(periods: int, right_radps: float) -> None:
        for _ in range(periods):
            robot.now_ns += PERIOD_NS
            angles["left"] += 0.2
            angles["right"] += 0.02 * right_radps
            robot.bus.send(robot.drives.cycle(robot.now_ns, angles, 0.02))

    angles = {"left": 0.0, "right": 0.0}
    drive(80, 0.0)
    assert robot.text() == ("the right wheel counts nothing while the other one turned by 16 rad")
    assert len(robot.samples) == 79
    drive(2, 1.0)
    assert robot.text() is None


def test_a_steered_drive_gives_its_angle_from_the_first_sample_on() -> None:
    told = Settings(
        sync=True,
        drive=replace(WHEEL, node=3),
        steer=NodeSettings(
            node=4, mapping=(0x60640020,), counts_per_revolution=3600, gear_ratio=10.0
        ),
    )
    drives, decoder = EmulatedDrives(told), Cia402Decoder(told, 0)
    samples: list[WheelSample | JointSample] = []
    for n in range(20):
        stamp_ns = n * PERIOD_NS
        angles = {"drive": 0.1 * n, "steer": 0.5 + 0.01 * n}
        for frame in drives.cycle(stamp_ns, angles, 0.02):
            samples += decoder.received(frame)
    assert told.joints == ("drive", "steer")
    first, last = samples[0], samples[-1]
    assert isinstance(first, JointSample)
    assert isinstance(last, JointSample)
    assert first.names == ("drive", "steer")
    assert first.angles_rad == pytest.approx((0.0, 0.5), abs=1e-3)
    assert last.angles_rad == pytest.approx((1.9, 0.69), abs=2e-3)


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"mapping": (0x60410010,)}, "neither a position"),
        ({"mapping": (0x606C0020,)}, "no position"),
        ({"mapping": (0x60640000,)}, "is not index"),
        ({"mapping": (0x60640020, 0x606C0020, 0x60410010)}, "80 bits do not fit"),
        ({"modulus_counts": 2**33}, "32 bits cannot wrap"),
        ({"node": 2}, "same node number"),
    ],
)
def test_settings_that_can_never_work_are_named(wrong: dict[str, object], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Cia402Decoder(replace(SETTINGS, left=replace(WHEEL, **wrong)), 0)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="drive and steer belong together"):
        Settings(drive=WHEEL)
