"""SICK S300 and S3000 over a serial line, in continuous mode."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import dataclass
from math import radians
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from amr_drivers.errors import BadTelegram, DriverError, LinkLost
from amr_drivers.sick_s300.telegrams import (
    RANGE_MAX_M,
    Output,
    Telegram,
    TelegramReader,
    is_standby,
    measured_words,
    ranges_from_words,
)
from amr_drivers.sick_s300.timing import ArrivalClock, ScanCounter
from amr_drivers.transport import ByteStream
from amr_slam.samples import DeviceInfo, Scan

_ADDRESSES = {"host": 7, "guest": 8}


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How the scanner is wired and what its own configuration (CDS) says. Nothing is sent to it."""

    port: str
    """Serial port, best as /dev/serial/by-id/..., or socket://host:port of a converter."""
    baud_rate: Annotated[int, Ge(9600), Le(4_000_000)] = 500_000
    """As set in CDS. Below 280 000 the scanner cannot send every scan."""
    device_address: Literal["host", "guest"] = "host"
    """Which of the two scanners of an EFI pair to listen to; a single scanner is the host."""
    beams: Annotated[int, Ge(2), Le(2000)] = 541
    """Values in a telegram: 541 for an S300; 761 or 381 for an S3000. Others are refused."""
    field_of_view_deg: Annotated[float, Gt(0), Le(360)] = 270.0
    """Angle from the first beam to the last, straight ahead in the middle. S3000: 190."""
    sweep_s: Annotated[float, Ge(0), Le(1)] = 0.030
    """Time from the first beam to the last: 270/360 of the S300's 40 ms."""
    transfer_delay_s: Annotated[float, Ge(0), Le(1)] = 0.0
    """Time from the last beam to the telegram's first byte; for what a calibration finds."""
    latency_limit_s: Annotated[float, Gt(0), Le(1)] = 0.1
    """Longest delay of a telegram in adapter and scheduler. Later ones are old and are dropped."""
    silence_s: Annotated[float, Gt(0)] = 0.5
    """Without a telegram for so long, or for 2.5 of its periods where that is more, the scanner
    counts as silent; an older scan is not given."""


def open_scanner(name: str, settings: Settings) -> S300:
    """Open the port and begin to listen; does not wait for the first telegram.

    Raises LinkLost or LinkTimeout when the port cannot be opened.
    """
    return S300(name, settings)


class S300:
    """A :class:`amr_slam.samples.Scanner`.

    A thread of its own drains the port all the time: a port that is read only when somebody wants
    a scan hands out old ones, and arrival times are known only to who is there.
    """

    def __init__(self, name: str, settings: Settings) -> None:
        self._name = name
        self._settings = settings
        self._reader = TelegramReader(settings.beams)
        self._counter = ScanCounter()
        self._clock = ArrivalClock(round(1e9 * settings.latency_limit_s))
        self._news = threading.Condition()
        self._newest: Scan | None = None
        self._fault: DriverError | None = None
        self._hindrance: str | None = None
        self._heard_ns = time.monotonic_ns()
        self._heard: Telegram | None = None
        self._other: tuple[str, int] | None = None
        self._refused = 0
        self._late = 0
        self._arrivals: deque[tuple[int, int]] = deque()
        self._stream = ByteStream(settings.port, settings.baud_rate)
        self._thread = threading.Thread(target=self._listen, name=f"scanner-{name}", daemon=True)
        self._thread.start()

    def read(self, timeout_s: float) -> Scan | None:
        """The newest scan not yet given, or None when none came in time. Raises LinkLost."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._fault, timeout_s)
            if self._fault is not None:
                raise LinkLost(str(self._fault)) from self._fault
            scan, self._newest = self._newest, None
        if scan is None:
            return None
        age_s = (time.monotonic_ns() - scan.stamp_ns) * 1e-9
        return scan if age_s <= self._settings.sweep_s + self._silence_s else None

    def info(self) -> DeviceInfo:
        settings, heard, period_s = self._settings, self._heard, self._clock.period_s
        facts = [
            ("baud rate", str(settings.baud_rate)),
            ("beams", str(settings.beams)),
            ("field of view", f"{settings.field_of_view_deg:g} deg"),
            ("device address", settings.device_address),
        ]
        if heard is not None:
            facts.append(("protocol version", f"{heard.version >> 8}.{heard.version & 0xFF:02d}"))
        if period_s is not None:
            facts.append(("scan period", f"{1e3 * period_s:.1f} ms"))
        return DeviceInfo(model="SICK S300/S3000", address=settings.port, facts=tuple(facts))

    def status(self) -> tuple[int, str | None]:
        """(damaged, refused and late telegrams so far, what hinders measuring now or None)."""
        errors = self._reader.damaged + self._refused + self._late
        if self._fault is not None:
            return errors, str(self._fault)
        now_ns, limit_s, other = time.monotonic_ns(), self._silence_s, self._other
        silent_s = (now_ns - self._heard_ns) * 1e-9
        if silent_s <= limit_s:
            return errors, self._hindrance
        recent = other is not None and now_ns - other[1] < 1e9 * limit_s
        only = f"; only {other[0]} come" if other and recent else ""
        return errors, f"no measured values for {silent_s:.1f} s{only}"

    def close(self) -> None:
        self._stream.close()
        self._thread.join()

    @property
    def _silence_s(self) -> float:
        """The setting and twice the wire time of a telegram, or more from a slower scanner."""
        bits = 10 * (2 * self._settings.beams + 26)
        set_s = self._settings.silence_s + 2.0 * bits / self._settings.baud_rate
        return max(set_s, 2.5 * (self._clock.period_s or 0.0))

    def _listen(self) -> None:
        """The thread: bytes -> telegrams -> the newest scan, until the port is gone or closed."""
        fault: DriverError = LinkLost(f"{self._settings.port}: the listening thread failed")
        try:
            back_ns = time.monotonic_ns()
            while True:
                data = self._stream.read(0.0)
                now_ns = time.monotonic_ns()
                # A read lasts 0.1 s at most. Who was away for longer finds bytes of unknown age.
                if now_ns - back_ns > 1e8 + 1e9 * self._settings.latency_limit_s:
                    self._stream.discard_input()
                    self._reader.reset()
                elif data:
                    self._take(data, now_ns)
                back_ns = time.monotonic_ns()
        except DriverError as reason:
            fault = reason
        finally:
            with self._news:
                self._fault = fault
                self._news.notify_all()

    def _take(self, data: bytes, now_ns: int) -> None:
        self._arrivals.append((self._reader.position, now_ns))
        for telegram in self._reader.feed(data):
            if telegram.address != _ADDRESSES[self._settings.device_address]:
                self._other = f"telegrams of device address {telegram.address:02d}", now_ns
            elif telegram.output is not Output.MEASURED:
                self._other = f"telegrams of {telegram.output.name.lower()}", now_ns
            else:
                self._heard, self._heard_ns = telegram, now_ns
                self._hear(telegram, self._arrival_ns(telegram.offset))
        self._arrival_ns(self._reader.pending)

    def _arrival_ns(self, offset: int) -> int:
        """When the byte at ``offset`` of the stream arrived; forgets what came before it."""
        while len(self._arrivals) > 1 and self._arrivals[1][0] <= offset:
            self._arrivals.popleft()
        return self._arrivals[0][1]

    def _hear(self, telegram: Telegram, arrival_ns: int) -> None:
        try:
            scan = self._scan(telegram, arrival_ns)
        except BadTelegram as reason:
            self._refused += 1
            self._hindrance = str(reason)
            return
        if scan is not None:
            with self._news:
                self._newest = scan
                self._news.notify_all()

    def _scan(self, telegram: Telegram, arrival_ns: int) -> Scan | None:
        """The scan in a telegram, or None when it holds none that is new and true."""
        settings = self._settings
        words = measured_words(telegram, settings.beams)
        repeated = self._counter.repeats(telegram.scan_number)
        number = self._counter.read(telegram.scan_number)
        self._hindrance = (
            _status_text(telegram.status)
            or ("standby" if is_standby(words) else None)
            or ("frozen: the scan number stands still" if repeated else None)
        )
        if self._hindrance is not None:
            return None
        first_byte_ns = arrival_ns
        if number is not None:
            refined_ns = self._clock.refine(number, arrival_ns)
            if refined_ns is None:
                self._late += 1
                return None
            first_byte_ns = refined_ns
        before_s = settings.sweep_s + settings.transfer_delay_s
        return Scan(
            scanner=self._name,
            stamp_ns=first_byte_ns - round(1e9 * before_s),
            ranges_m=ranges_from_words(words),
            angle_min_rad=-0.5 * radians(settings.field_of_view_deg),
            angle_step_rad=radians(settings.field_of_view_deg) / (settings.beams - 1),
            sweep_s=settings.sweep_s,
            range_max_m=RANGE_MAX_M,
            seq=number,
        )


def _status_text(status: int) -> str | None:
    if status == 0:
        return None
    return "lock-out: reset the scanner" if status == 1 else f"unknown status {status:#06x}"
