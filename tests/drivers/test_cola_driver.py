"""The driver on real sockets, in front of emulated devices."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from paths import REPO

from amr_drivers.emulators.cola import (
    LMS111,
    LMS511,
    MODELS,
    TIM571,
    TIM781,
    ColaModel,
    EmulatedCola,
    emulate,
)
from amr_drivers.errors import LinkLost
from amr_drivers.registry import scanner_module, scanner_names
from amr_drivers.sick_cola.driver import Cola, Settings, open_scanner
from amr_drivers.sick_cola.framing import Dialect
from amr_drivers.sick_cola.messages import FIRMWARE, IDENT, OUTPUT_RANGE, STATE
from amr_slam.config import load
from amr_slam.geometry import Array
from amr_slam.samples import RawBytes, Scan, Scanner, Way

DEADLINE_S = 20.0
STAMP_TOLERANCE_NS = 80_000_000
"""A busy machine delays the first telegrams; figures come from the conformance suite."""


class Sweeping:
    """A thread in which a device measures sweeps that tell their number, and the truth."""

    def __init__(self, device: EmulatedCola) -> None:
        self.device = device
        self.truth: list[tuple[int, Array]] = []
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def matching(self, scan: Scan) -> int:
        """The first beam's true instant."""
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            # A scan may be here before the emulator has said when it was.
            for first_ns, ranges_m in reversed(list(self.truth)):
                if np.allclose(scan.ranges_m, ranges_m, atol=0.0011, equal_nan=True):
                    return first_ns
            time.sleep(0.01)
        raise AssertionError("a scan that was never measured")

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def start(self) -> None:
        self._thread.start()

    def _run(self) -> None:
        rng = np.random.default_rng(1)
        while not self._stopping.wait(self.device.model.period_s):
            ranges = rng.uniform(0.5, 10.0, self.device.model.beams)
            ranges[rng.random(len(ranges)) < 0.1] = np.nan
            self.truth.append((self.device.measure(ranges), ranges))


@contextmanager
def rig(
    model: ColaModel = LMS111,
    speech: Dialect = Dialect.B,
    emulated: dict[str, Any] | None = None,
    **settings: Any,
) -> Iterator[tuple[EmulatedCola, Sweeping, Settings]]:
    with EmulatedCola(model=model, dialect=speech, **(emulated or {})) as device:
        sweeping = Sweeping(device)
        sweeping.start()
        try:
            yield device, sweeping, Settings(host="127.0.0.1", port=device.port, **settings)
        finally:
            sweeping.stop()


@contextmanager
def opened(settings: Settings, **kwargs: Any) -> Iterator[Cola]:
    scanner = open_scanner("front", settings, **kwargs)
    try:
        yield scanner
    finally:
        scanner.close()


def next_scan(scanner: Scanner) -> Scan:
    scan = scanner.read(DEADLINE_S)
    assert scan is not None, scanner.status()
    return scan


def wait_for_words(scanner: Scanner, words: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while words not in (scanner.status()[1] or ""):
        assert time.monotonic() < deadline, scanner.status()
        scanner.read(0.02)


def read_all(scanner: Scanner) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while time.monotonic() < deadline:
        scanner.read(0.1)


def wait_until_lost(scanner: Scanner, words: str) -> None:
    with pytest.raises(LinkLost, match=words):
        read_all(scanner)


def test_it_is_registered() -> None:
    assert "sick_cola" in scanner_names()
    assert scanner_module("sick_cola").Settings is Settings


@pytest.mark.parametrize("delivery", ["streamed", "polled"])
@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize("model", MODELS)
def test_every_model_gives_true_scans(model: str, dialect: Dialect, delivery: Any) -> None:
    settings: dict[str, Any] = {"delivery": delivery, "poll_interval_s": 0.02}
    with rig(MODELS[model], dialect, dialect=dialect.value, **settings) as (device, truth, wanted):
        device.describe(name="not defined", comment="north gate", dated=True)
        with opened(wanted) as scanner:
            scans = [next_scan(scanner) for _ in range(4)]
            for scan in scans:
                first_ns = truth.matching(scan)
                assert abs(scan.stamp_ns - first_ns) < STAMP_TOLERANCE_NS
                assert scan.sweep_s == pytest.approx(device.model.sweep_s)
            assert len({scan.seq for scan in scans}) == 4
            info = scanner.info()
            facts = dict(info.facts)
            assert info.model == f"SICK {' '.join(device.model.ident)}"
            assert facts["serial number"] == str(device.model.serial_number)
            assert facts["firmware"] == device.model.firmware
            assert facts["device name"] == "not defined"
            assert facts["time of a scan"] == f"the {device.model.told} of its sweep"


def test_the_dialect_is_found_on_a_device_that_goes_mute() -> None:
    mute = {"mute_after_wrong_dialect": True}
    with rig(TIM571, Dialect.A, mute) as (_, truth, settings), opened(settings) as scanner:
        truth.matching(next_scan(scanner))
        assert dict(scanner.info().facts)["dialect"] == "CoLa A"


def test_the_wrong_dialect_is_said() -> None:
    with rig(LMS111, Dialect.B, dialect="a") as (_, _, settings), opened(settings) as scanner:
        wait_until_lost(scanner, "no answer in CoLa A")


def test_a_device_that_knows_nothing_but_its_scans_is_enough() -> None:
    model = replace(LMS111, unknown=frozenset({IDENT, FIRMWARE, STATE, OUTPUT_RANGE}))
    with rig(model) as (_, truth, settings), opened(settings) as scanner:
        truth.matching(next_scan(scanner))
        assert scanner.info().model == "SICK LMS/TiM"


def test_nothing_is_written_and_the_stream_is_ended() -> None:
    passed: list[RawBytes] = []
    with rig() as (_, _, settings):
        with opened(settings, tap=passed.append) as scanner:
            next_scan(scanner)
        sent = [raw.data[8:-1] for raw in passed if raw.way is Way.SENT]
        assert {data[:3] for data in sent} == {b"sRN", b"sEN"}
        assert sent[-1] == b"sEN LMDscandata \x00"
        assert sent.count(b"sEN LMDscandata \x01") == 1


def test_repeated_telegrams_are_given_once() -> None:
    with rig() as (device, _, settings), opened(settings) as scanner:
        device.repeated = 1
        numbers = [next_scan(scanner).seq for _ in range(10)]
        assert len(set(numbers)) == 10
        assert "repeated scans" in dict(scanner.info().facts)


@pytest.mark.parametrize("delivery", ["streamed", "polled"])
@pytest.mark.parametrize(
    ("mode", "words"),
    [("standby", "standby"), ("contaminated", "contaminated"), ("error", "device error")],
)
def test_what_hinders_is_named_and_passes(delivery: Any, mode: Any, words: str) -> None:
    told = {"delivery": delivery, "poll_interval_s": 0.02}
    with rig(**told) as (device, truth, settings), opened(settings) as scanner:
        next_scan(scanner)
        device.mode = mode
        wait_for_words(scanner, words)
        device.mode = "measuring"
        truth.matching(next_scan(scanner))


def test_a_dirty_screen_is_said_while_it_measures() -> None:
    with rig() as (device, truth, settings), opened(settings) as scanner:
        device.mode = "dirty"
        wait_for_words(scanner, "clean the front screen")
        truth.matching(next_scan(scanner))


def test_another_device_behind_the_address_is_named() -> None:
    with rig(serial_number=4711) as (_, _, settings), opened(settings) as scanner:
        wait_for_words(scanner, "serial number 18090362 instead of 4711")
        assert scanner.read(0.2) is None


def test_a_power_cycle_is_lived_through_by_opening_anew() -> None:
    with rig(TIM781) as (device, truth, settings):
        with opened(settings) as scanner:
            next_scan(scanner)
            device.power_cycle()
            wait_until_lost(scanner, "hung up|reset|pipe")
        with opened(settings) as scanner:
            truth.matching(next_scan(scanner))


def test_the_device_clock_may_wrap() -> None:
    wraps = {"started_us": 2**32 - 300_000}
    with rig(LMS511, Dialect.B, wraps) as (_, truth, settings), opened(settings) as scanner:
        deadline = time.monotonic() + 1.0
        while time.monotonic() < deadline:
            scan = next_scan(scanner)
            assert abs(scan.stamp_ns - truth.matching(scan)) < STAMP_TOLERANCE_NS
        assert "device starts seen" not in dict(scanner.info().facts)


def test_nobody_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(LinkLost, match=str(port)):
        open_scanner("front", Settings(host="127.0.0.1", port=port))


@pytest.mark.parametrize(
    ("file", "model"), [("sick_lms1xx", LMS111), ("sick_lms5xx", LMS511), ("sick_tim", TIM571)]
)
def test_example_robots_name_devices_that_can_be_emulated(file: str, model: ColaModel) -> None:
    config = load(REPO / f"config/{file}.toml")
    (scanner,) = config.scanners
    options = scanner.options
    assert isinstance(options, Settings)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with emulate(replace(options, port=port)) as device:
        assert device.model == model


def test_the_emulator_is_the_device_that_the_settings_name() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    for settings, model in (
        (Settings(host="127.0.0.1", port=port, range_max_m=80.0), LMS511),
        (Settings(host="127.0.0.1", port=port, range_max_m=25.0, dialect="a"), TIM571),
        (Settings(host="127.0.0.1", port=port, range_max_m=33.0), LMS111),
    ):
        with emulate(settings) as device:
            assert device.model == model
            assert device.port == port
    with emulate(Settings(host="127.0.0.1", port=port, serial_number=7), TIM781) as device:
        assert device.model == replace(TIM781, serial_number=7)
