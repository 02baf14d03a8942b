"""A scanner that is listened to all the time, by a thread of its own.

A line that is read only when somebody wants a scan hands out old ones, and when bytes arrived is
known only to who is there. So each driver has a thread that drains its line, a decoder that turns
bytes into scans, and this: the newest scan, kept for who wants it while it is not old.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from typing import Protocol

from amr_drivers.errors import DriverError, LinkLost
from amr_slam.samples import RawBytes, Scan, Tap, Way


class ScanDecoder(Protocol):
    """Bytes of one device to scans. Pure: the same calls give the same scans, so that a recording
    of the bytes (:class:`amr_slam.samples.RawBytes`) gives the scans again."""

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """Take in the next bytes of the stream, or the next datagram; the scans they complete."""

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """The driver has sent these bytes: what comes next may be the answer."""

    def gap(self) -> None:
        """Bytes were lost or thrown away: an unfinished telegram will not be completed."""

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """(damaged, refused and late telegrams so far, what hinders measuring now or None)."""


class BackgroundScanner(ABC):
    """A :class:`amr_slam.samples.Scanner` but for ``info``. A subclass opens its line, then calls
    :meth:`_start`."""

    def __init__(self, name: str, decoder: ScanDecoder, tap: Tap) -> None:
        self._name = name
        self._decoder = decoder
        self._tap = tap
        self._news = threading.Condition()
        self._newest: Scan | None = None
        self._fault: DriverError | None = None
        self._thread = threading.Thread(target=self._listen, name=f"scanner-{name}", daemon=True)

    def read(self, timeout_s: float) -> Scan | None:
        """The newest scan not yet given, or None when none came in time. Raises LinkLost."""
        with self._news:
            self._news.wait_for(lambda: self._newest is not None or self._fault, timeout_s)
            if self._fault is not None:
                raise LinkLost(str(self._fault)) from self._fault
            scan, self._newest = self._newest, None
        if scan is None:
            return None
        age_s = 1e-9 * (time.monotonic_ns() - scan.stamp_ns)
        return scan if age_s <= self._max_age_s() else None

    def status(self) -> tuple[int, str | None]:
        """See :meth:`ScanDecoder.status`; a line that is gone hinders most of all."""
        errors, hindrance = self._decoder.status(time.monotonic_ns())
        return errors, hindrance if self._fault is None else str(self._fault)

    def close(self) -> None:
        """Idempotent."""
        self._hang_up()
        if self._thread.is_alive():
            self._thread.join()

    @abstractmethod
    def _turn(self) -> None:
        """One turn of the thread: wait at most 0.1 s for bytes, :meth:`_take` them, ask for more
        where the device must be asked. Raises DriverError when the line is gone."""

    @abstractmethod
    def _hang_up(self) -> None:
        """Close the line; a turn that is under way then ends with LinkLost. Idempotent."""

    @abstractmethod
    def _max_age_s(self) -> float:
        """A scan whose first beam is older than this is not given any more."""

    def _start(self) -> None:
        self._thread.start()

    def _take(self, data: bytes, stamp_ns: int) -> None:
        """Bytes came in."""
        self._tap(RawBytes(device=self._name, stamp_ns=stamp_ns, way=Way.RECEIVED, data=data))
        scans = self._decoder.received(data, stamp_ns)
        if scans:
            with self._news:
                self._newest = scans[-1]
                self._news.notify_all()

    def _note_sent(self, data: bytes) -> None:
        """Bytes went out."""
        stamp_ns = time.monotonic_ns()
        self._tap(RawBytes(device=self._name, stamp_ns=stamp_ns, way=Way.SENT, data=data))
        self._decoder.sent(data, stamp_ns)

    def _note_gap(self) -> None:
        """Bytes were thrown away."""
        stamp_ns = time.monotonic_ns()
        self._tap(RawBytes(device=self._name, stamp_ns=stamp_ns, way=Way.GAP))
        self._decoder.gap()

    def _listen(self) -> None:
        fault: DriverError = LinkLost(f"{self._name}: the listening thread failed")
        try:
            while True:
                self._turn()
        except DriverError as reason:
            fault = reason
        finally:
            with self._news:
                self._fault = fault
                self._news.notify_all()
