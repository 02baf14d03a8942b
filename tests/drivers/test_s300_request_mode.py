from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.emulators.s300 import EmulatedS300, S300Model, emulate
from amr_drivers.errors import LinkLost
from amr_drivers.sick_s300.driver import S300, Settings, open_scanner, scan_decoder
from amr_drivers.sick_s300.requests import ERROR_TEXTS, encode_request, get_token
from amr_slam.geometry import Array
from amr_slam.samples import RawBytes, Scan, Way

DEADLINE_S = 20.0
MS = 1_000_000


def ranges(seed: int, beams: int = 541) -> Array:
    drawn: Array = np.random.default_rng(seed).uniform(0.5, 20.0, beams)
    drawn[3], drawn[4] = np.inf, np.nan
    return drawn


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


class Rig:
    """A scanner in request mode at a link, and how it is opened."""

    def __init__(self, folder: Path, model: S300Model | None = None) -> None:
        self.model = model or S300Model(protocol="request")
        self.line = PtyLine(folder / "front")
        self.scanner = EmulatedS300(self.line, self.model)
        self.taped: list[RawBytes] = []

    def open(self, **changes: object) -> S300:
        self.settings = replace(
            Settings(
                port=self.line.port,
                mode="request",
                baud_rate=self.model.baud_rate,
                latency_limit_s=1.0,
            ),
            **changes,  # type: ignore[arg-type] # any field
        )
        self.scanner.measure(ranges(1000, self.settings.beams))
        self.opened_ns = time.monotonic_ns()
        return open_scanner("front", self.settings, self.taped.append)

    def scan_of(self, driver: S300, seed: int, beams: int = 541) -> Scan:
        """Let it sweep until the driver gives that sweep."""
        truth = ranges(seed, beams)
        self.scanner.measure(truth)
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            scan = driver.read(0.1)
            if scan is not None and np.allclose(scan.ranges_m, truth, atol=0.0051, equal_nan=True):
                return scan
        raise AssertionError(f"no scan: {driver.status()}")


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    with rig.scanner:
        yield rig


def test_scans_are_fetched_and_the_token_is_given_back(rig: Rig) -> None:
    driver = rig.open()
    scans = []
    for seed in range(5):
        scans.append(rig.scan_of(driver, seed))
        assert scans[-1].seq is None
        assert scans[-1].stamp_ns + 30 * MS < time.monotonic_ns()
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(scans))
    assert driver.status() == (0, None)
    assert rig.scanner.token_is_taken
    assert ("mode", "request") in driver.info().facts
    driver.close()
    until(lambda: not rig.scanner.token_is_taken)
    # The bytes as they came and went give the same scans again.
    decoder = scan_decoder("front", rig.settings, rig.opened_ns)
    again: list[Scan] = []
    for raw in rig.taped:
        if raw.way is Way.SENT:
            decoder.sent(raw.data, raw.stamp_ns)
        else:
            assert raw.way is Way.RECEIVED
            again += decoder.received(raw.data, raw.stamp_ns)
    assert {scan.stamp_ns for scan in scans} <= {scan.stamp_ns for scan in again}


@pytest.mark.parametrize("beams", [381, 761])
def test_an_s3000_as_guest_of_a_pair(tmp_path: Path, beams: int) -> None:
    rig = Rig(tmp_path, S300Model(protocol="request", pair=True))
    with rig.scanner:
        driver = rig.open(beams=beams, field_of_view_deg=190.0, device_address="guest")
        truth = ranges(1, beams)
        rig.scanner.measure(truth)
        scan = driver.read(DEADLINE_S)
        assert scan is not None
        np.testing.assert_allclose(scan.ranges_m, truth[::-1], atol=0.0051)
        driver.close()


def test_a_scanner_that_has_not_measured_yet_is_asked_again(rig: Rig) -> None:
    driver = rig.open()
    rig.scanner.power_cycle()
    until(lambda: "error 06: busy" in str(driver.status()[1]))
    rig.scan_of(driver, 1)
    until(lambda: driver.status()[1] is None)
    driver.close()


def test_a_token_that_a_dead_program_left_is_taken_over(rig: Rig) -> None:
    rig.scanner.take_token()
    driver = rig.open()
    rig.scan_of(driver, 1)
    assert driver.status() == (0, None)
    rig.scanner.power_cycle()
    rig.scan_of(driver, 2)
    until(lambda: driver.status()[1] is None)
    driver.close()


@pytest.mark.parametrize("code", sorted(ERROR_TEXTS))
def test_every_refusal_is_named_and_survived(rig: Rig, code: int) -> None:
    driver = rig.open()
    rig.scan_of(driver, 1)
    said: set[str | None] = set()
    deadline = time.monotonic() + DEADLINE_S
    while not any(ERROR_TEXTS[code] in str(text) for text in said):
        assert time.monotonic() < deadline
        rig.scanner.fail_next(code)
        said.add(driver.status()[1])
        time.sleep(0.005)
    assert driver.status()[0] > 0
    # What was ordered in vain is used up, then it measures again.
    until(lambda: (driver.status()[1] is None, rig.scanner.measure(ranges(2)))[0])
    driver.close()


def test_standby_frozen_and_silence_are_named(rig: Rig) -> None:
    driver = rig.open(latency_limit_s=0.1)
    rig.scan_of(driver, 1)
    rig.scanner.mode = "standby"
    until(lambda: driver.status()[1] == "standby")
    rig.scanner.mode = "measuring"
    until(lambda: "frozen" in str(driver.status()[1]))  # nothing new is measured
    driver.read(0.0)
    assert driver.read(0.05) is None
    rig.scan_of(driver, 2)
    rig.scanner.silent = True
    errors = driver.status()[0]
    until(lambda: "no answer for" in str(driver.status()[1]))
    until(lambda: driver.status()[0] > errors + 1)  # asked again and again
    rig.scanner.silent = False
    rig.scan_of(driver, 3)
    driver.close()


def test_a_scanner_that_sends_by_itself_is_named(tmp_path: Path) -> None:
    rig = Rig(tmp_path, S300Model())
    with rig.scanner:
        driver = rig.open(latency_limit_s=0.1)
        until(
            lambda: (
                rig.scanner.measure(ranges(1)),
                "it is in continuous mode" in str(driver.status()[1]),
            )[1]
        )
        assert driver.read(0.0) is None
        driver.close()


def test_cut_and_damaged_answers_are_asked_for_again(rig: Rig) -> None:
    driver = rig.open(latency_limit_s=0.1)
    for seed in range(6):
        rig.scanner.cut_next(seed * 150)
        rig.scan_of(driver, 2 * seed)
        rig.scanner.damage_next(seed)
        rig.scan_of(driver, 2 * seed + 1)
    assert driver.status()[0] >= 1
    driver.close()


def test_the_interval_between_requests_is_kept(rig: Rig) -> None:
    driver = rig.open(poll_interval_s=0.15)
    for seed in range(4):
        rig.scan_of(driver, seed)
    driver.close()
    token = encode_request(get_token(7))[:4]
    asked_ns = [raw.stamp_ns for raw in rig.taped if raw.way is Way.SENT and raw.data[:4] != token]
    assert len(asked_ns) >= 4
    assert np.diff(asked_ns).min() >= 150 * MS


def test_close_is_quick_and_frees_the_token_in_the_midst_of_an_answer(tmp_path: Path) -> None:
    rig = Rig(tmp_path, S300Model(protocol="request", baud_rate=9600))
    with rig.scanner:
        threads = threading.active_count()
        durations_s = []
        for _ in range(3):
            rig.scanner.measure(ranges(1))
            driver = rig.open()
            until(lambda: rig.scanner.token_is_taken)
            begun_s = time.monotonic()
            driver.close()
            durations_s.append(time.monotonic() - begun_s)
            with pytest.raises(LinkLost, match="closed"):
                driver.read(0.0)
            until(lambda: not rig.scanner.token_is_taken)
        assert min(durations_s) < 0.5
        assert threading.active_count() == threads


def test_unplugging_is_link_lost(rig: Rig) -> None:
    driver = rig.open()
    rig.scan_of(driver, 1)
    rig.scanner.unplug()
    with pytest.raises(LinkLost):
        until(lambda: driver.read(0.1) is not None and False)
    driver.close()
    rig.scanner.replug()
    driver = rig.open()
    rig.scan_of(driver, 2)
    driver.close()


def test_an_emulator_stands_in_for_settings(tmp_path: Path) -> None:
    settings = Settings(port=str(tmp_path / "by-id/front"), mode="request", latency_limit_s=1.0)
    with emulate(settings) as scanner:
        driver = open_scanner("front", settings)
        scanner.measure(ranges(1))
        assert driver.read(DEADLINE_S) is not None
        driver.close()
    with pytest.raises(ValueError, match="neither socket"):
        emulate(replace(settings, port="gopher://x:1"))
