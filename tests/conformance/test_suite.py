"""The suite finds bad drivers out: each is the example's with one fault."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import acme_lidar
from acme_lidar_rig import EmulatedLidar, LidarRig
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.conformance.runner import equal, pattern
from amr_drivers.conformance.scenarios import SCENARIOS
from amr_drivers.errors import DriverError
from amr_slam.geometry import Array
from amr_slam.samples import DeviceInfo, RawBytes, Scan, Scanner, Tap, untapped


class Bad:
    """A :class:`amr_slam.samples.Scanner`: the example's, until a subclass spoils it."""

    def __init__(self, good: Scanner) -> None:
        self.good = good
        self.last: Scan | None = None

    def read(self, timeout_s: float) -> Scan | None:
        return self.good.read(timeout_s)

    def info(self) -> DeviceInfo:
        return self.good.info()

    def status(self) -> tuple[int, str | None]:
        return self.good.status()

    def close(self) -> None:
        self.good.close()


class OneBehind(Bad):
    def read(self, timeout_s: float) -> Scan | None:
        scan = self.good.read(timeout_s)
        if scan is None:
            return None
        behind, self.last = self.last, scan
        return behind


class Repeating(Bad):
    def read(self, timeout_s: float) -> Scan | None:
        self.last = self.good.read(timeout_s) or self.last
        return self.last


class StampedLate(Bad):
    def read(self, timeout_s: float) -> Scan | None:
        scan = self.good.read(timeout_s)
        return None if scan is None else replace(scan, stamp_ns=scan.stamp_ns + 80_000_000)


class StampedWhenRead(Bad):
    def read(self, timeout_s: float) -> Scan | None:
        scan = self.good.read(timeout_s)
        return None if scan is None else replace(scan, stamp_ns=time.monotonic_ns())


class Silent(Bad):
    def read(self, timeout_s: float) -> Scan | None:
        with contextlib.suppress(DriverError):
            return self.good.read(timeout_s)
        time.sleep(timeout_s)
        return None

    def status(self) -> tuple[int, str | None]:
        return 0, None


class Complaining(Bad):
    def status(self) -> tuple[int, str | None]:
        return 0, "standby"


class SlowToClose(Bad):
    times = 1

    def close(self) -> None:
        if SlowToClose.times:
            SlowToClose.times -= 1
            time.sleep(0.8)
        self.good.close()


def rig_of(kind: type[Bad]) -> MakeRig:
    class BadRig(LidarRig):
        def open(self, tap: Tap = untapped) -> Bad:  # type: ignore[override] # bad on purpose
            return kind(super().open(tap))

    return BadRig


def breaches(scenario: str, make: MakeRig, folder: Path) -> str:
    figures = SCENARIOS[scenario](make, folder, "quick")
    return "; ".join((*figures.breaches, *figures.late))


@pytest.mark.parametrize(
    ("scenario", "kind", "breach"),
    [
        ("slow reader", OneBehind, "gives the scan of "),
        ("measuring", Repeating, "given twice"),
        ("measuring", StampedLate, "stamps are off by 0.0"),
        ("measuring", StampedWhenRead, "a scan that ends after it was given"),
        ("measuring", Complaining, "not at work"),
        ("device silent", Silent, "not noticed in "),
        ("wrong device", Silent, "HTTP server: not noticed in "),
        ("unplugged", Silent, "not noticed in "),
        ("stop", SlowToClose, "measuring: close took 0.8"),
    ],
)
def test_a_bad_driver_is_found_out(
    scenario: str, kind: type[Bad], breach: str, tmp_path: Path
) -> None:
    found = breaches(scenario, rig_of(kind), tmp_path)
    assert breach in found


Parsed = tuple[int, bool, Array] | None


def no_checksum(data: bytes, parse: Callable[[bytes], Parsed] = acme_lidar._parse) -> Parsed:
    body = data[: acme_lidar.BODY.size]
    with np.errstate(invalid="ignore"):  # damaged ranges may be signalling NaNs
        return parse(body + zlib.crc32(body).to_bytes(4, "little")) if data[len(body) :] else None


def no_state(data: bytes, parse: Callable[[bytes], Parsed] = acme_lidar._parse) -> Parsed:
    parsed = parse(data)
    return None if parsed is None else (parsed[0], True, parsed[2])


def no_counter(
    data: bytes,
    parse: Callable[[bytes], Parsed] = acme_lidar._parse,
    numbers: Iterator[int] = itertools.count(),  # noqa: B008 - one count for all datagrams
) -> Parsed:
    parsed = parse(data)
    return None if parsed is None else (next(numbers), *parsed[1:])


@pytest.mark.parametrize(
    ("scenario", "parse", "breach"),
    [
        ("telegram damaged", no_checksum, "a scan that no sweep was like"),
        ("standby", no_state, "not noticed in "),
        ("frozen", no_counter, "given twice"),
    ],
)
def test_a_bad_parser_is_found_out(
    scenario: str,
    parse: Callable[[bytes], Parsed],
    breach: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(acme_lidar, "_parse", parse)
    assert breach in breaches(scenario, LidarRig, tmp_path)


def test_a_buffer_without_end_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[bytes] = []
    received = acme_lidar.Decoder.received

    def keeping(self: acme_lidar.Decoder, data: bytes, stamp_ns: int) -> list[Scan]:
        kept.append(data)
        return received(self, data, stamp_ns)

    monkeypatch.setattr(acme_lidar.Decoder, "received", keeping)
    assert "memory grew by " in breaches("50 MB of noise", LidarRig, tmp_path)


def test_files_left_open_are_found_out(tmp_path: Path) -> None:
    left: list[int] = []

    class Leaking(LidarRig):
        def open(self, tap: Tap = untapped) -> acme_lidar.Lidar:
            left.append(os.open("/dev/null", os.O_RDONLY))
            return super().open(tap)

    try:
        assert "10 open file(s) left behind: /dev/null" in breaches(
            "open and close", Leaking, tmp_path
        )
    finally:
        for file in left:
            os.close(file)


def test_bytes_that_the_recording_lacks_are_found_out(tmp_path: Path) -> None:
    class Forgetful(LidarRig):
        def open(self, tap: Tap = untapped) -> acme_lidar.Lidar:
            def forget(raw: RawBytes) -> None:
                if raw.stamp_ns % 5:
                    tap(raw)

            return super().open(forget)

    assert "scans given are not in the recording's replay" in breaches(
        "measuring", Forgetful, tmp_path
    )


def test_an_emulator_that_fails_is_no_verdict_on_the_driver(tmp_path: Path) -> None:
    class BrokenLidar(EmulatedLidar):
        def measure(self, ranges_m: Array) -> int:
            raise RuntimeError(f"the emulator is broken, with {len(ranges_m)} ranges")

    class Broken(LidarRig):
        def __init__(self, folder: Path) -> None:
            super().__init__(folder)
            self.device.close()
            self.device = BrokenLidar(self._settings.port)

    with pytest.raises(RuntimeError, match="the emulator is broken"):
        SCENARIOS["measuring"](Broken, tmp_path, "quick")


def test_patterns_tell_torn_scans_from_true_ones() -> None:
    one, other = pattern(7, 541), pattern(8, 541)
    assert equal(one + 0.004, one, 0.005)
    assert not equal(one + 0.006, one, 0.005)
    for seam in (1, 270, 540):
        assert not equal(np.concatenate((one[:seam], other[seam:])), one, 0.005)
        assert not equal(np.concatenate((one[:seam], other[seam:])), other, 0.005)
    assert not equal(one[:-1], one, 0.005)
    assert not equal(np.where(np.isnan(one), np.inf, one), one, 0.005)
