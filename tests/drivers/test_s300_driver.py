from __future__ import annotations

import os
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from amr_drivers.emulators.s300 import EmulatedS300, S300Model
from amr_drivers.errors import LinkLost
from amr_drivers.sick_s300.decoder import ContinuousDecoder
from amr_drivers.sick_s300.driver import S300, Settings, open_scanner
from amr_drivers.sick_s300.telegrams import Output, Telegram, encode, encode_words
from amr_drivers.timing import ArrivalClock
from amr_slam.geometry import Array
from amr_slam.samples import Scan

RANGES: Array = np.linspace(1.0, 20.0, 541)
DEADLINE_S = 10.0
MS = 1_000_000
IN_OUT = Telegram(
    address=7,
    version=0x0103,
    status=0,
    scan_number=bytes(4),
    telegram_number=bytes(2),
    output=Output.IO,
    payload=bytes(8),
)


@pytest.fixture
def scanner(tmp_path: Path) -> Iterator[EmulatedS300]:
    with EmulatedS300(tmp_path / "front") as emulated:
        yield emulated


def opened(scanner: EmulatedS300, **changes: object) -> S300:
    settings = replace(Settings(port=scanner.port, latency_limit_s=1.0), **changes)  # type: ignore[arg-type] # any field
    return open_scanner("front", settings)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def next_scan(driver: S300, scanner: EmulatedS300, ranges: Array = RANGES) -> Scan:
    scanner.measure(ranges)
    scan = driver.read(DEADLINE_S)
    assert scan is not None
    return scan


def noise(count: int, seed: int) -> bytes:
    """Random bytes, half of them zero as in headers."""
    dice = random.Random(seed)
    return bytes(dice.choice((0, dice.randrange(256))) for _ in range(count))


def open_files() -> set[str]:
    return {f"{fd}:{os.readlink(f'/proc/self/fd/{fd}')}" for fd in _numbers()}


def _numbers() -> list[str]:
    return [fd for fd in os.listdir("/proc/self/fd") if os.path.exists(f"/proc/self/fd/{fd}")]


@pytest.mark.parametrize(
    "model",
    [
        S300Model(version=0x0102, length_rule=4),
        S300Model(length_rule=8, number_order="big"),
        S300Model(paced=True),
        S300Model(address=8),
    ],
)
def test_scans_arrive_whole_and_stamped(tmp_path: Path, model: S300Model) -> None:
    ranges = RANGES.copy()
    ranges[10], ranges[11] = np.inf, np.nan
    with EmulatedS300(tmp_path / "front", model) as scanner:
        address = "guest" if model.address == 8 else "host"
        driver = opened(scanner, device_address=address)
        scans: list[Scan] = []
        for _ in range(5):
            until(lambda: not scanner.is_sending)
            first_beam_ns = scanner.measure(ranges)
            scan = driver.read(DEADLINE_S)
            received_ns = time.monotonic_ns()
            assert scan is not None
            scans.append(scan)
            # The refined stamp may be earlier than this arrival by the line's delay, here the
            # scheduler's.
            assert scan.stamp_ns + 30 * MS <= received_ns
            assert abs(scan.stamp_ns - first_beam_ns) < 100 * MS
        assert [scan.seq for scan in scans] == [None, 2, 3, 4, 5]
        scan = scans[-1]
        np.testing.assert_allclose(scan.ranges_m, ranges, atol=0.0051)
        assert scan.scanner == "front"
        assert scan.sweep_s == 0.03
        np.testing.assert_allclose(np.rad2deg(scan.angles_rad[[0, 270, -1]]), [-135, 0, 135])
        assert driver.status() == (0, None)
        driver.close()


@pytest.mark.parametrize("address", ["host", "guest"])
@pytest.mark.parametrize("beams", [381, 541, 761])
def test_one_of_a_pair_is_listened_to_among_other_telegrams(
    tmp_path: Path, address: str, beams: int
) -> None:
    """S300 and S3000; I/O data and reflectors come between the scans."""
    others = [
        encode(replace(IN_OUT, output=output, payload=bytes(10)), rule)
        for output in (Output.IO, Output.REFLECTORS)
        for rule in (8, 14)
    ]
    ranges = np.linspace(1.0, 20.0, beams)
    with EmulatedS300(tmp_path / "front", S300Model(pair=True)) as scanner:
        driver = opened(
            scanner, device_address=address, beams=beams, field_of_view_deg=0.25 * (beams - 1)
        )
        for other in others:
            scanner.send_bytes(other)
            scan = next_scan(driver, scanner, ranges)
            truth = ranges if address == "host" else ranges[::-1]
            np.testing.assert_allclose(scan.ranges_m, truth, atol=0.0051)
        assert driver.status() == (0, None)
        driver.close()


@pytest.mark.parametrize("period_ms", [40, 80])
def test_the_scan_period_is_found(period_ms: int) -> None:
    """On a clock of its own: 40 ms is the S300's, some scanners take 80."""
    decoder = ContinuousDecoder("front", Settings(port="x"), 0)
    scans: list[Scan] = []
    for number in range(1, 30):
        telegram = replace(
            IN_OUT,
            scan_number=number.to_bytes(4, "big"),
            output=Output.MEASURED,
            payload=encode_words(np.full(541, 200, dtype=np.uint16)),
        )
        scans += decoder.received(encode(telegram), number * period_ms * MS)
    assert decoder.status(29 * period_ms * MS) == (0, None)
    assert [scan.stamp_ns for scan in scans] == [
        number * period_ms * MS - 30 * MS for number in range(1, 30)
    ]
    assert ("scan period", f"{period_ms}.0 ms") in decoder.facts()


def test_a_sleeping_reader_gets_the_newest_scan(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    for distance in range(2, 30):
        scanner.measure(np.full(541, float(distance)))
        until(lambda d=distance: driver._newest is not None and driver._newest.seq == d)  # type: ignore[misc] # mypy cannot infer a lambda's default
    scan = driver.read(DEADLINE_S)
    assert scan is not None
    assert scan.ranges_m[0] == 29.0
    assert driver.read(0.01) is None
    driver.close()


def test_an_old_scan_is_not_given_after_silence(scanner: EmulatedS300) -> None:
    driver = opened(scanner, silence_s=0.05)
    scanner.measure(RANGES)
    until(lambda: driver._newest is not None)
    until(lambda: driver.status()[1] is not None)
    assert driver.read(0.01) is None
    assert "no measured values for" in str(driver.status()[1])
    assert next_scan(driver, scanner).scanner == "front"
    assert driver.status()[1] is None
    driver.close()


@pytest.mark.parametrize("mode", ["standby", "lock-out"])
def test_standby_and_lock_out_give_no_scan_but_say_so(scanner: EmulatedS300, mode: str) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    scanner.mode = mode  # type: ignore[assignment] # parametrize knows no Literal
    scanner.measure(RANGES)
    until(lambda: driver.status()[1] is not None)
    assert str(driver.status()[1]).startswith(mode)
    assert driver.read(0.01) is None
    scanner.mode = "measuring"
    next_scan(driver, scanner)
    assert driver.status() == (0, None)
    driver.close()


def test_a_frozen_scanner_gives_no_scan_but_says_so(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    next_scan(driver, scanner)
    scanner.frozen = True
    scanner.measure(RANGES)
    until(lambda: "frozen" in str(driver.status()[1]))
    assert driver.read(0.01) is None
    driver.close()


def test_other_telegrams_are_named_instead_of_scans(scanner: EmulatedS300) -> None:
    def said_while(send: Callable[[], object], text: str) -> Callable[[], bool]:
        return lambda: (send(), text in str(driver.status()[1]))[1]

    driver = opened(scanner, silence_s=0.05, device_address="guest")
    until(said_while(lambda: scanner.measure(RANGES), "only telegrams of device address 07"))
    until(lambda: "only" not in str(driver.status()[1]))
    driver.close()
    driver = opened(scanner, silence_s=0.05)
    until(said_while(lambda: scanner.send_bytes(encode(IN_OUT)), "only telegrams of io"))
    driver.close()
    driver = opened(scanner, beams=381, field_of_view_deg=190.0)
    scanner.measure(RANGES)
    until(lambda: "541 values instead of 381" in str(driver.status()[1]))
    assert driver.status()[0] == 1
    driver.close()


def test_damage_is_skipped_and_counted(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    scanner.cut_next(at_byte=500)
    scanner.measure(RANGES)
    scanner.send_bytes(noise(3000, seed=1))
    scan = next_scan(driver, scanner)
    assert scan.seq == 3
    assert driver.status()[0] >= 1
    driver.close()


def test_unplugging_is_link_lost_and_the_same_path_works_again(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    scanner.unplug()
    with pytest.raises(LinkLost):
        driver.read(DEADLINE_S)
    assert driver.status()[1] is not None
    driver.close()
    with pytest.raises(LinkLost, match="front"):
        opened(scanner)
    scanner.replug()
    driver = opened(scanner)
    next_scan(driver, scanner)
    driver.close()


def test_a_second_driver_on_the_same_port_is_refused(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    with pytest.raises(LinkLost):
        opened(scanner)
    next_scan(driver, scanner)
    driver.close()


def test_close_ends_a_waiting_read_and_leaves_nothing_behind(scanner: EmulatedS300) -> None:
    files, threads = open_files(), threading.active_count()
    durations_s = []
    for _ in range(3):
        driver = opened(scanner)
        ended: list[BaseException] = []

        def wait(driver: S300 = driver, ended: list[BaseException] = ended) -> None:
            try:
                driver.read(60.0)
            except LinkLost as error:
                ended.append(error)

        reader = threading.Thread(target=wait)
        reader.start()
        start_s = time.monotonic()
        driver.close()
        driver.close()
        reader.join(DEADLINE_S)
        durations_s.append(time.monotonic() - start_s)
        assert len(ended) == 1
    assert min(durations_s) < 0.5
    assert open_files() == files
    assert threading.active_count() == threads


def test_info_says_what_the_device_is(scanner: EmulatedS300) -> None:
    driver = opened(scanner)
    next_scan(driver, scanner)
    facts = dict(driver.info().facts)
    assert facts["protocol version"] == "1.03"
    assert driver.info().address == scanner.port
    driver.close()


def test_the_emulator_never_waits_for_a_reader(scanner: EmulatedS300) -> None:
    for _ in range(100):
        scanner.measure(RANGES)  # 110 kB: many times what the kernel keeps
    driver = opened(scanner)
    until(lambda: (scanner.measure(RANGES), driver.read(0.1))[1] is not None)
    driver.close()


def test_clock_takes_the_delays_out() -> None:
    dice = np.random.default_rng(3)
    clock = ArrivalClock(100 * MS)
    errors_ms = []
    for n in range(400):
        truth_ns = 5_000_000_000 + 40 * MS * n
        arrival_ns = truth_ns + int(dice.exponential(4 * MS))
        refined_ns = clock.refine((2**32 - 50 + n) % 2**32, arrival_ns)
        assert refined_ns is not None
        assert refined_ns <= arrival_ns
        errors_ms.append((refined_ns - truth_ns) / MS)
    assert np.abs(errors_ms[100:]).max() < 2.0  # the raw arrivals are up to 25 ms late
    assert clock.period_s == pytest.approx(0.04, abs=1e-4)


def test_clock_refuses_a_backlog_and_follows_a_restart() -> None:
    clock = ArrivalClock(100 * MS)
    for n in range(50):
        assert clock.refine(n, 40 * MS * n) == 40 * MS * n
    stall_ns = 40 * MS * 70
    for n in range(50, 66):  # measured during a stall, read in one go after it
        assert clock.refine(n, stall_ns + n) is None
    assert clock.refine(71, 40 * MS * 71) == 40 * MS * 71
    assert clock.refine(3, 40 * MS * 90) is None  # the scanner was switched off and on
    assert clock.refine(4, 40 * MS * 91) == 40 * MS * 91
