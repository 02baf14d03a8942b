from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from paths import REPO
from safety_rig import Sweeping, next_scan, opened, settings_for, until

from amr_drivers.emulators.safety import MICROSCAN3, NANOSCAN3, EmulatedSafety, emulate
from amr_drivers.errors import DriverError, LinkLost
from amr_drivers.sick_safety import variables
from amr_drivers.sick_safety.driver import Polled, Settings, Streamed, open_scanner, scan_decoder
from amr_drivers.sick_safety.session import Refused, Session
from amr_drivers.transport import TcpStream
from amr_slam.config import load
from amr_slam.samples import RawBytes, Scan, Way

MODES = ("poll", "stream")
MS = 1_000_000


@pytest.fixture
def device() -> Iterator[EmulatedSafety]:
    with EmulatedSafety() as emulated:
        yield emulated


def hindrance(driver: Polled | Streamed) -> str:
    return driver.status()[1] or ""


def lost(driver: Polled | Streamed) -> str:
    """Waits for the LinkLost of a driver; its words."""
    said: list[str] = []

    def gone() -> bool:
        try:
            driver.read(0.05)
        except LinkLost as error:
            said.append(str(error))
        return bool(said)

    until(gone)
    driver.close()
    return said[0]


def open_files() -> set[str]:
    numbers = os.listdir("/proc/self/fd")
    return {n for n in numbers if os.path.exists(f"/proc/self/fd/{n}")}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "model",
    [MICROSCAN3, replace(MICROSCAN3, header_bytes=52), replace(NANOSCAN3, header_bytes=56)],
    ids=["microScan3", "old firmware", "nanoScan3"],
)
def test_scans_arrive_whole_and_stamped(mode: str, model: object) -> None:
    with EmulatedSafety(model=model) as device, Sweeping(device) as sweeping:  # type: ignore[arg-type] # parametrize
        driver = opened(device, mode=mode)
        numbers = []
        for _ in range(10):
            scan = next_scan(driver)
            received_ns = time.monotonic_ns()
            numbers.append(scan.seq)
            truth_ns = sweeping.truth(scan)
            # Polled, a scan is fetched up to one period after it was completed. The rest is the
            # scheduler's.
            assert scan.stamp_ns + round(1e9 * scan.sweep_s) <= received_ns
            assert abs(scan.stamp_ns - truth_ns) < 1000 * MS
        assert numbers == sorted(set(numbers))  # type: ignore[type-var] # all have one
        derived = device.model.derived
        assert len(scan.ranges_m) == derived.beams
        np.testing.assert_allclose(scan.ranges_m[10:], sweeping.ranges(0)[10:], atol=0.00051)
        assert np.isposinf(scan.ranges_m[5])
        assert np.isnan(scan.ranges_m[6])
        # 90 degrees of the device are straight ahead: -47.5 are 137.5 to the right.
        assert np.rad2deg(scan.angle_min_rad) == pytest.approx(-137.5)
        assert np.rad2deg(scan.angle_step_rad) == pytest.approx(derived.step_deg)
        assert scan.sweep_s == pytest.approx(derived.sweep_s)
        assert (scan.scanner, scan.range_max_m) == ("front", 40.0)
        assert driver.status()[1] is None
        driver.close()


@pytest.mark.parametrize("mode", MODES)
def test_recorded_bytes_give_the_same_scans(device: EmulatedSafety, mode: str) -> None:
    raw: list[RawBytes] = []
    given: list[Scan] = []
    with Sweeping(device):
        driver = opened(device, raw.append, mode=mode)
        given += [next_scan(driver) for _ in range(5)]
        driver.close()
    decoder = scan_decoder("front", settings_for(device, mode=mode), 0)
    again: dict[int | None, Scan] = {}
    for piece in raw:
        if piece.way is Way.RECEIVED:
            again |= {scan.seq: scan for scan in decoder.received(piece.data, piece.stamp_ns)}
        elif piece.way is Way.SENT:
            decoder.sent(piece.data, piece.stamp_ns)
        else:
            decoder.gap()
    for scan in given:
        twin = again[scan.seq]
        assert (twin.stamp_ns, twin.sweep_s) == (scan.stamp_ns, scan.sweep_s)
        np.testing.assert_array_equal(twin.ranges_m, scan.ranges_m)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("state", "words"),
    [("standby", "standby"), ("contaminated", "clean the front screen"), ("error", "device error")],
)
def test_a_scanner_that_does_not_measure_says_why(
    device: EmulatedSafety, mode: str, state: str, words: str
) -> None:
    with Sweeping(device):
        driver = opened(device, mode=mode)
        next_scan(driver)
        device.mode = state  # type: ignore[assignment] # parametrize knows no Literal
        until(lambda: words in hindrance(driver))
        driver.read(0.0)  # one that was measured before may still lie there
        assert driver.read(0.3) is None
        device.mode = "measuring"
        next_scan(driver)
        until(lambda: driver.status()[1] is None)
        driver.close()


def test_a_dirty_screen_is_named_while_scans_come(device: EmulatedSafety) -> None:
    device.mode = "dirty"
    with Sweeping(device):
        driver = opened(device)
        next_scan(driver)
        assert "contamination warning" in hindrance(driver)
        driver.close()


@pytest.mark.parametrize("mode", MODES)
def test_a_frozen_scanner_gives_no_scan_but_says_so(device: EmulatedSafety, mode: str) -> None:
    with Sweeping(device):
        driver = opened(device, mode=mode)
        next_scan(driver)
        device.frozen = True
        until(lambda: "frozen" in hindrance(driver))
        driver.read(0.0)
        assert driver.read(0.3) is None
        device.frozen = False
        next_scan(driver)
        driver.close()


@pytest.mark.parametrize("mode", MODES)
def test_another_scanner_is_named_and_gives_no_scan(device: EmulatedSafety, mode: str) -> None:
    with Sweeping(device):
        driver = opened(device, mode=mode, serial_number=4711)
        until(lambda: "serial number 17479021, not 4711" in hindrance(driver))
        assert driver.read(0.2) is None
        driver.close()
        driver = opened(device, mode=mode, serial_number=17_479_021)
        next_scan(driver)
        driver.close()


def test_a_channel_that_is_off_is_said(device: EmulatedSafety) -> None:
    device.configure(enabled=frozenset((2,)))
    with Sweeping(device):
        driver = opened(device)
        until(lambda: "channel 0 is not switched on" in hindrance(driver))
        driver.close()
        driver = opened(device, channel=2)
        next_scan(driver)
        driver.close()


@pytest.mark.parametrize("big_endian", [False, True])
def test_an_ended_session_is_opened_anew(device: EmulatedSafety, *, big_endian: bool) -> None:
    device.configure(enabled=frozenset((0,)), big_endian_errors=big_endian)
    with Sweeping(device):
        driver = opened(device)
        for _ in range(3):
            next_scan(driver)
            device.end_sessions()
        next_scan(driver)
        until(lambda: driver.status()[1] is None)
        driver.close()
    assert device.sessions == 0


@pytest.mark.parametrize("mode", MODES)
def test_too_many_sessions_are_said_and_none_is_left_behind(mode: str) -> None:
    with EmulatedSafety(model=replace(MICROSCAN3, sessions=1)) as device, Sweeping(device):
        other = TcpStream("127.0.0.1", device.port)
        session = Session("other", other, answer_s=5.0, stopping=threading.Event()).open(60)
        assert "no session resources" in lost(opened(device, mode=mode))
        session.close()
        other.close()
        for _ in range(3):
            driver = opened(device, mode=mode)
            next_scan(driver)
            driver.close()
            until(lambda: device.sessions == 0)


def test_an_idle_session_ends(device: EmulatedSafety) -> None:
    stream = TcpStream("127.0.0.1", device.port)
    session = Session("front", stream, answer_s=5.0, stopping=threading.Event()).open(60)
    assert device.sessions == 1
    assert variables.decode_text(session.read(variables.TYPE_CODE)).startswith("MICS3")
    with pytest.raises(Refused, match="unknown variable"):
        session.read(9999)
    with pytest.raises(Refused, match="unknown method"):
        session.call(9999, b"")
    device.end_sessions()
    with pytest.raises(Refused, match="unknown session id"):
        session.read(variables.TYPE_CODE)
    session.close()
    stream.close()


@pytest.mark.parametrize("mode", MODES)
def test_a_dead_line_without_hang_up_is_link_lost(device: EmulatedSafety, mode: str) -> None:
    with Sweeping(device):
        driver = opened(device, mode=mode, silence_s=1.0)
        next_scan(driver)
        device.silent = True  # as after a pulled cable: no FIN comes
        words = lost(driver)
        assert "no answer in 1 s" in words
        assert str(device.port) in words
        device.silent = False
        driver = opened(device, mode=mode)
        next_scan(driver)
        driver.close()


def test_unplugging_while_polling_is_link_lost(device: EmulatedSafety) -> None:
    with Sweeping(device):
        driver = opened(device)
        next_scan(driver)
        device.unplug()
        lost(driver)
        with pytest.raises(LinkLost):
            opened(device)
        device.replug()
        driver = opened(device)
        next_scan(driver)
        driver.close()


def test_a_stream_survives_a_short_break_and_is_lost_in_a_long_one(device: EmulatedSafety) -> None:
    with Sweeping(device):
        driver = opened(device, mode="stream", silence_s=1.0)
        next_scan(driver)
        device.firewalled = True
        until(lambda: "no measurement data" in hindrance(driver))
        device.firewalled = False
        next_scan(driver)
        until(lambda: driver.status()[1] is None)
        device.unplug()
        lost(driver)
        device.replug()


def test_a_firewall_is_named(device: EmulatedSafety) -> None:
    device.firewalled = True
    with Sweeping(device):
        driver = opened(device, mode="stream", silence_s=1.0)
        until(lambda: "TCP works" in hindrance(driver))
        words = hindrance(driver)
        assert f"127.0.0.1:{device.streams[0]}" in words
        assert "firewall" in words
        device.firewalled = False
        next_scan(driver)
        until(lambda: driver.status()[1] is None)
        driver.close()


def test_a_rebooted_scanner_is_told_anew_where_to_send(device: EmulatedSafety) -> None:
    with Sweeping(device):
        driver = opened(device, mode="stream", silence_s=1.0)
        next_scan(driver)
        device.power_cycle()
        assert device.streams == {}
        scan = next_scan(driver)
        until(lambda: device.streams)
        assert next_scan(driver).stamp_ns > scan.stamp_ns
        driver.close()


def test_two_scanners_have_ports_of_their_own() -> None:
    with (
        EmulatedSafety() as front,
        EmulatedSafety(model=replace(MICROSCAN3, serial_number=2)) as rear,
        Sweeping(front),
        Sweeping(rear),
    ):
        drivers = [opened(front, mode="stream"), opened(rear, mode="stream")]
        for driver, serial in zip(drivers, ("17479021", "2"), strict=True):
            next_scan(driver)
            assert dict(driver.info().facts)["serial number"] == serial
        assert front.streams[0] != rear.streams[0]
        with pytest.raises(LinkLost, match="udp"):
            opened(rear, mode="stream", udp_port=front.streams[0])
        for driver in drivers:
            driver.close()


def test_datagrams_of_strangers_are_dropped(device: EmulatedSafety) -> None:
    with Sweeping(device), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        driver = opened(device, mode="stream")
        next_scan(driver)
        stranger.bind(("127.0.0.2", 0))
        for _ in range(50):
            stranger.sendto(b"MS3 MD" + bytes(100), ("127.0.0.1", device.streams[0]))
        next_scan(driver)
        assert isinstance(driver, Streamed)
        until(lambda: driver._datagrams.foreign == 50)
        until(lambda: driver.status()[1] is None)
        driver.close()


@pytest.mark.parametrize("mode", MODES)
def test_damage_gives_no_false_scan_and_is_survived(mode: str) -> None:
    model = replace(NANOSCAN3, header_bytes=56)
    with EmulatedSafety(model=model) as device, Sweeping(device) as sweeping:
        driver = opened(device, mode=mode, silence_s=0.3, poll_interval_s=0.03)
        for seed in range(24):
            device.damage_next(seed)
            for _ in range(2):
                try:
                    scan = driver.read(2.0)
                except LinkLost:
                    driver.close()
                    driver = opened(device, mode=mode, silence_s=0.3, poll_interval_s=0.03)
                    continue
                if scan is not None:
                    sweeping.truth(scan)  # a KeyError where the first beam is not true
                    whole = sweeping.ranges(0)[7:]
                    np.testing.assert_allclose(scan.ranges_m[7:], whole, atol=0.00051)
        driver.close()
        driver = opened(device, mode=mode)
        next_scan(driver)
        driver.close()


@pytest.mark.parametrize("mode", MODES)
def test_another_device_is_named(device: EmulatedSafety, mode: str) -> None:
    device.be_another_device(b"HTTP/1.1 400 Bad Request\r\n\r\n")
    assert "no answer in CoLa 2 but b'HTTP/1.1" in lost(opened(device, mode=mode, silence_s=1.0))


@pytest.mark.parametrize("mode", MODES)
def test_close_is_quick_and_leaves_nothing_behind(device: EmulatedSafety, mode: str) -> None:
    with Sweeping(device):
        driver = opened(device, mode=mode)
        next_scan(driver)
        driver.close()
        until(lambda: not device._server.connections())
        files, threads = open_files(), threading.active_count()
        durations_s = []
        for silent in (False, True, False):
            device.silent = silent
            driver = opened(device, mode=mode)
            start_s = time.monotonic()
            driver.close()
            driver.close()
            durations_s.append(time.monotonic() - start_s)
        assert min(durations_s) < 0.5
        until(lambda: not device._server.connections())
        assert open_files() == files
        assert threading.active_count() == threads


def test_settings_that_can_never_work_are_refused(device: EmulatedSafety) -> None:
    with pytest.raises(ValueError, match="robot-pc") as refused:
        opened(device, mode="stream", receiver="robot-pc")
    assert not isinstance(refused.value, DriverError)


def test_the_emulator_is_what_the_settings_name() -> None:
    with EmulatedSafety() as free:
        port = free.port
    settings = Settings(host="127.0.0.1", port=port, mode="stream", serial_number=5, channel=1)
    with emulate(settings) as device, Sweeping(device):
        assert device.model.serial_number == 5
        driver = opened(device, mode="stream", serial_number=5, channel=1)
        next_scan(driver)
        assert driver.info().model == "SICK nanoScan3"
        assert list(device.streams) == [1]
        driver.close()


@pytest.mark.parametrize("name", ["sick_microscan3", "sick_nanoscan3"])
def test_the_example_robots_have_scanners_of_this_driver(name: str) -> None:
    config = load(REPO / f"config/{name}.toml")
    ports = [scanner.options.port for scanner in config.scanners]
    assert len(set(ports)) == len(ports)
    for scanner in config.scanners:
        patient = replace(scanner.options, silence_s=5.0, latency_limit_s=1.0)
        with emulate(scanner.options) as device, Sweeping(device):
            driver = open_scanner(scanner.name, patient)
            next_scan(driver)
            driver.close()
