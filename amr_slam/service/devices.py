"""One thread a device: opens it, reads it, opens it anew when it was lost; knows its health."""

from __future__ import annotations

import logging
import random
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Final, Generic, TypeVar

from amr_drivers import registry
from amr_drivers.errors import DriverError
from amr_slam.config import OdometrySettings, ScannerSettings
from amr_slam.samples import (
    WHEELS,
    DeviceInfo,
    DriveSample,
    Health,
    Link,
    OdometrySource,
    Raw,
    RawBytes,
    Scan,
    Scanner,
    Way,
    untapped,
)
from amr_slam.service.line_quality import LineQuality

_log = logging.getLogger(__name__)
_SampleT = TypeVar("_SampleT", Scan, DriveSample)

_READ_TIMEOUT_S: Final = 0.2
_WHEELS_READ_TIMEOUT_S: Final = 0.05
_STATUS_PERIOD_NS: Final = 50_000_000
"""With the wheels' reads: a bus that is off stands in the health within 0.1 s."""
_FIRST_RETRY_S: Final = 0.5
_JITTER: Final = 0.2
"""Of a waiting time: devices that were lost together are not tried together."""
_RATE_SAMPLES: Final = 50
_STALE_PERIODS: Final = 2.5
_SCANS_STALE_S: Final = 0.5
"""A scanner that is connected and gives nothing for this long is stale; slower ones later."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceEnded:
    """A device's thread has ended and nobody had asked it to."""

    name: str
    unusable: str | None
    """Settings that can never work, in the driver's words; None: a fault of the program, told by
    the thread's own traceback."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Seen:
    """What the thread knows of its device: replaced as a whole, so that no lock is needed."""

    connected: bool = False
    newest_ns: int | None = None
    """When the newest sample was received."""
    rate_hz: float = 0.0
    samples: int = 0
    errors: int = 0
    detail: str | None = "not connected yet"
    info: DeviceInfo | None = None


class DeviceThread(ABC, Generic[_SampleT]):
    """What scanners and wheels have in common."""

    def __init__(
        self,
        name: str,
        sink: Callable[[_SampleT | DeviceEnded], object],
        reconnect_max_s: float,
        stale_s: float,
        tap: Callable[[Raw], object],
    ) -> None:
        self.name = name
        self._tap = tap
        self._sink: Callable[[_SampleT | DeviceEnded], object] = sink
        self._reconnect_max_s = reconnect_max_s
        self._stale_s = stale_s
        self._seen = _Seen()
        self._received: deque[int] = deque(maxlen=_RATE_SAMPLES)
        self._errors_before = 0
        self._quality = LineQuality()
        self._lost = False
        self._stopping = threading.Event()
        # A daemon: a driver that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name=f"device-{name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def ask_to_stop(self) -> None:
        self._stopping.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the device to be closed."""
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            _log.warning("%s: the driver does not return; left behind", self.name)

    def health(self, now_ns: int) -> Health:
        """As seen at ``now_ns``; may be called from any thread."""
        seen = self._seen
        age_s = None if seen.newest_ns is None else max(0.0, 1e-9 * (now_ns - seen.newest_ns))
        patience_s = self._stale_s
        if seen.rate_hz > 0.0:
            patience_s = max(patience_s, _STALE_PERIODS / seen.rate_hz)
        fresh = age_s is not None and age_s <= patience_s
        link = (Link.OK if fresh else Link.STALE) if seen.connected else Link.LOST
        return Health(
            link=link,
            age_s=age_s,
            rate_hz=seen.rate_hz if link is Link.OK else 0.0,
            samples=seen.samples,
            errors=seen.errors,
            detail=seen.detail,
        )

    @property
    def info(self) -> DeviceInfo | None:
        """What the device says of itself; None while it was never connected."""
        return self._seen.info

    @abstractmethod
    def _open(self) -> Scanner | OdometrySource: ...

    @abstractmethod
    def _read(self) -> _SampleT | None: ...

    @abstractmethod
    def _selected(self, sample: _SampleT) -> _SampleT | None:
        """What the localizer gets of a sample."""

    # -- the thread ------------------------------------------------------------------------

    def _run(self) -> None:
        unusable = None
        try:
            self._keep_connected()
        except _UnusableError as error:
            unusable = str(error)
        finally:
            # Anything unexpected goes on as this thread's traceback; the loop then stops all.
            if not self._stopping.is_set():
                self._sink(DeviceEnded(name=self.name, unusable=unusable))

    def _keep_connected(self) -> None:
        wait_s = _FIRST_RETRY_S
        while not self._stopping.is_set():
            samples_before = self._seen.samples
            try:
                self._serve_one_connection()
            except DriverError as error:
                self._note_loss(str(error))
            if self._seen.samples > samples_before:
                wait_s = _FIRST_RETRY_S
            self._stopping.wait(wait_s * random.uniform(1.0 - _JITTER, 1.0))
            wait_s = min(2.0 * wait_s, self._reconnect_max_s)

    def _serve_one_connection(self) -> None:
        self._quality.restart()
        stamp_ns = time.monotonic_ns()
        self._tap(RawBytes(device=self.name, stamp_ns=stamp_ns, way=Way.OPENED))
        try:
            source = self._open()
        except DriverError:
            raise
        except ValueError as error:  # by the drivers' rules: settings that can never work
            raise _UnusableError(str(error)) from error
        self._errors_before = self._seen.errors
        self._received.clear()
        with closing(source):
            self._seen = replace(self._seen, connected=True, detail=None, info=source.info())
            asked_ns = 0
            while not self._stopping.is_set():
                sample = self._read()
                now_ns = time.monotonic_ns()
                if sample is not None:
                    self._note_sample(now_ns)
                if now_ns - asked_ns >= _STATUS_PERIOD_NS:
                    asked_ns = now_ns
                    self._note_status(source)
                selected = None if sample is None else self._selected(sample)
                if selected is not None:
                    self._sink(selected)

    def _note_sample(self, now_ns: int) -> None:
        self._quality.sample_came()
        self._received.append(now_ns)
        span_s = 1e-9 * (now_ns - self._received[0])
        self._seen = replace(
            self._seen,
            newest_ns=now_ns,
            samples=self._seen.samples + 1,
            rate_hz=(len(self._received) - 1) / span_s if span_s > 0.0 else 0.0,
        )
        if self._lost:
            self._lost = False
            _log.info("%s: back", self.name, extra={"amr_device": self.name})

    def _note_status(self, source: Scanner | OdometrySource) -> None:
        errors, detail = source.status()
        complaint = self._quality.complaint(time.monotonic_ns(), errors)
        detail = detail or complaint  # the driver knows its device better
        self._seen = replace(
            self._seen, errors=self._errors_before + errors, detail=detail, info=source.info()
        )

    def _note_loss(self, reason: str) -> None:
        self._seen = replace(
            self._seen, connected=False, rate_hz=0.0, detail=reason, errors=self._seen.errors + 1
        )
        # Said once for each loss, not at every attempt.
        level, fields = logging.DEBUG if self._lost else logging.WARNING, {"amr_device": self.name}
        _log.log(level, "%s: %s", self.name, reason, extra=fields)
        self._lost = True


class _UnusableError(Exception):
    """The driver cannot ever be opened with these settings."""


class ScannerThread(DeviceThread[Scan]):
    """A scanner, thinned to one scan a period."""

    def __init__(
        self,
        settings: ScannerSettings,
        sink: Callable[[Scan | DeviceEnded], object],
        reconnect_max_s: float,
        tap: Callable[[Raw], object] = untapped,
    ) -> None:
        super().__init__(settings.name, sink, reconnect_max_s, _SCANS_STALE_S, tap)
        self._settings = settings
        self._thinning = Thinning(settings.poll_period_s)

    def _open(self) -> Scanner:
        module = registry.scanner_module(self._settings.driver)
        self._scanner = module.open_scanner(
            self._settings.name, self._settings.options, self._passed
        )
        return self._scanner

    def _passed(self, raw: RawBytes) -> None:
        if raw.way is Way.RECEIVED:
            self._quality.bytes_came(len(raw.data), raw.stamp_ns)
        self._tap(raw)

    def _read(self) -> Scan | None:
        return self._scanner.read(_READ_TIMEOUT_S)

    def _selected(self, scan: Scan) -> Scan | None:
        return scan if self._thinning.takes(scan.stamp_ns) else None


class Thinning:
    """At most one scan a period.

    Fast scanners are all taken at the whole multiples of the period, so that two of them give
    one pair; of a scanner that is as slow as the period itself every scan is taken.
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = round(1e9 * period_s)
        self._last_ns: int | None = None
        self._due_ns = 0

    def takes(self, stamp_ns: int) -> bool:
        """Whether the scan of this stamp is the period's."""
        last_ns, self._last_ns = self._last_ns, stamp_ns
        if self._period_ns == 0 or last_ns is None:
            self._due_ns = self._next_multiple(stamp_ns)
            return True
        interval_ns = stamp_ns - last_ns
        # A slow scanner's own jitter must not cost every second scan.
        early_ns = min(interval_ns // 2, self._period_ns // 10)
        if stamp_ns < self._due_ns - early_ns:
            return False
        if 4 * interval_ns > self._period_ns:
            self._due_ns = stamp_ns + self._period_ns
        else:
            self._due_ns = self._next_multiple(stamp_ns + early_ns)
        return True

    def _next_multiple(self, stamp_ns: int) -> int:
        if self._period_ns == 0:
            return stamp_ns
        return (stamp_ns // self._period_ns + 1) * self._period_ns


class WheelsThread(DeviceThread[DriveSample]):
    """The wheels; nothing is integrated across a reconnection."""

    def __init__(
        self,
        settings: OdometrySettings,
        sink: Callable[[DriveSample | DeviceEnded], object],
        reconnect_max_s: float,
        stale_s: float,
        tap: Callable[[Raw], object] = untapped,
    ) -> None:
        super().__init__(WHEELS, sink, reconnect_max_s, stale_s, tap)
        self._settings = settings
        self._first_segment = 0
        self._segment = -1

    def _open(self) -> OdometrySource:
        module = registry.odometry_module(self._settings.driver)
        self._source = module.open_odometry(self._settings.options, self._tap)
        self._first_segment = self._segment + 1
        return self._source

    def _read(self) -> DriveSample | None:
        return self._source.read(_WHEELS_READ_TIMEOUT_S)

    def _selected(self, sample: DriveSample) -> DriveSample:
        # A driver that is opened anew counts its angles and segments from 0 again.
        self._segment = self._first_segment + sample.segment
        return replace(sample, segment=self._segment)
