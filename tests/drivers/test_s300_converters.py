from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from amr_drivers.emulators.converter import EmulatedConverter
from amr_drivers.emulators.s300 import EmulatedS300, S300Model
from amr_drivers.errors import LinkLost
from amr_drivers.sick_s300.driver import S300, Settings, open_scanner
from amr_drivers.transport import ByteStream
from amr_slam.geometry import Array
from amr_slam.samples import Scan

# pyserial's RFC 2217 client still calls threads by these.
pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")

RANGES: Array = np.linspace(1.0, 20.0, 541)
DEADLINE_S = 20.0


@pytest.fixture(params=["socket", "rfc2217"])
def converter(request: pytest.FixtureRequest) -> Iterator[EmulatedConverter]:
    converter = EmulatedConverter(request.param)
    yield converter
    converter.unplug()


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def opened(converter: EmulatedConverter, **changes: object) -> S300:
    settings = replace(Settings(port=converter.port, latency_limit_s=1.0), **changes)  # type: ignore[arg-type] # any field
    driver = open_scanner("front", settings)
    until(lambda: converter.is_connected)
    return driver


def next_scan(driver: S300, scanner: EmulatedS300) -> Scan:
    scanner.measure(RANGES)
    scan = driver.read(DEADLINE_S)
    assert scan is not None
    return scan


def test_every_byte_passes_both_ways(converter: EmulatedConverter) -> None:
    stream = ByteStream(converter.port, 19_200)
    until(lambda: converter.is_connected)
    sent = bytes(range(256)) * 4
    stream.write(sent)
    arrived = bytearray()

    def pump() -> bool:
        arrived.extend(converter.read())
        return len(arrived) >= len(sent)

    until(pump)
    assert arrived == sent
    assert converter.write(sent) == len(sent)
    got = bytearray()
    deadline = time.monotonic() + DEADLINE_S
    while len(got) < len(sent):
        assert time.monotonic() < deadline
        got += stream.read(0.1)
    assert got == sent
    stream.discard_input()
    converter.write(b"new")
    assert stream.read(DEADLINE_S)[:1] == b"n"
    stream.close()
    if converter.port.startswith("rfc2217"):
        assert converter.baud_rate == 19_200


@pytest.mark.parametrize("protocol", ["continuous", "request"])
def test_scans_through_a_converter(converter: EmulatedConverter, protocol: str) -> None:
    model = S300Model(protocol=protocol)  # type: ignore[arg-type] # parametrize knows no Literal
    with EmulatedS300(converter, model) as scanner:
        driver = opened(converter, mode=protocol)
        for distance in range(1, 4):
            scanner.measure(np.full(541, float(distance)))
            scan = driver.read(DEADLINE_S)
            assert scan is not None
            np.testing.assert_allclose(scan.ranges_m, distance)
        begun_s = time.monotonic()
        driver.close()
        assert time.monotonic() - begun_s < 5.0
        assert scanner.token_is_taken is False or protocol == "continuous"


def test_a_converter_that_hangs_up_is_link_lost_and_may_be_opened_anew(
    converter: EmulatedConverter,
) -> None:
    with EmulatedS300(converter) as scanner:
        driver = opened(converter)
        next_scan(driver, scanner)
        scanner.cut_next(500)
        scanner.measure(RANGES)
        converter.hang_up()
        with pytest.raises(LinkLost):
            driver.read(DEADLINE_S)
        driver.close()
        driver = opened(converter)
        next_scan(driver, scanner)
        scanner.unplug()
        with pytest.raises(LinkLost):
            driver.read(DEADLINE_S)
        driver.close()
        with pytest.raises(LinkLost):
            opened(converter)
        scanner.replug()
        driver = opened(converter)
        next_scan(driver, scanner)
        driver.close()


def test_a_connection_that_died_without_a_word_is_said_and_then_given_up(
    converter: EmulatedConverter,
) -> None:
    with EmulatedS300(converter) as scanner:
        driver = opened(converter)
        next_scan(driver, scanner)
        scanner.silent = True
        until(lambda: "no measured values for" in str(driver.status()[1]))
        with pytest.raises(LinkLost, match="nothing came for"):
            until(lambda: driver.read(0.1) is not None and False)
        driver.close()
        scanner.silent = False
        driver = opened(converter)
        next_scan(driver, scanner)
        driver.close()


def test_the_newest_connection_counts(converter: EmulatedConverter) -> None:
    with EmulatedS300(converter) as scanner:
        first = opened(converter)
        next_scan(first, scanner)
        second = opened(converter)
        with pytest.raises(LinkLost):
            first.read(DEADLINE_S)
        first.close()
        next_scan(second, scanner)
        second.close()
