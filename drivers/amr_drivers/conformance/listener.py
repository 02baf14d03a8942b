"""Who uses the driver: opens it, reads it, asks for its status, opens it anew when it was lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final, Self

from amr_drivers.conformance.rig import Rig
from amr_drivers.conformance.runner import Runner, Sweep
from amr_drivers.errors import DriverError
from amr_slam.samples import RawBytes, Scan, Scanner

_READ_S: Final = 0.02
"""Shorter than the service's 0.2 s: when a fault was known is wanted to the hundredth."""
_REOPEN_S: Final = 0.1
"""The service waits 0.5 s and more."""

_LOOK_S: Final = 0.01
"""How often a condition is looked at that other threads make true."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Given:
    """A scan that the driver gave."""

    scan: Scan
    received_ns: int
    sweep: Sweep | None
    """The sweep that its ranges are; None: no sweep was like that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What the driver began to say: what hinders measuring, or None."""

    stamp_ns: int
    text: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """From one opening of the driver to its closing: what its tap was given, and its scans."""

    opened_ns: int
    raw: list[RawBytes] = field(default_factory=list)
    scans: list[Scan] = field(default_factory=list)


class Listener:
    """The service's device thread in small, with a memory of everything; a context manager."""

    def __init__(self, rig: Rig, runner: Runner, *, recorded: bool = True) -> None:
        """``recorded`` False: what passes on the line is not kept (a flood would fill memory)."""
        self._rig = rig
        self._runner = runner
        self._recorded = recorded
        self._news = threading.Condition()
        self.given: list[Given] = []
        self.said: list[Said] = []
        self.sessions: list[Session] = []
        self.closing_s: list[float] = []
        self.errors = 0
        """Errors that the present session's driver counted."""
        self._stopping = threading.Event()
        self._free = threading.Event()
        self._free.set()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="conformance-listener", daemon=True)

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until something that this thread noted makes the condition true."""
        deadline = time.monotonic() + timeout_s
        with self._news:
            while not (true := condition()) and (left_s := deadline - time.monotonic()) > 0.0:
                self._news.wait(min(left_s, _LOOK_S))
                self._check()
        return true

    @contextmanager
    def busy_elsewhere(self) -> Iterator[None]:
        """Within, the driver is open and nobody reads it."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def trouble_after(self, stamp_ns: int) -> Said | None:
        """The first complaint that was made, or still stood, at or after this instant."""
        standing: Said | None = None
        for said in list(self.said):
            if said.stamp_ns >= stamp_ns:
                break
            standing = said
        if standing is not None and standing.text is not None:
            return Said(stamp_ns=stamp_ns, text=standing.text)
        later = (said for said in list(self.said) if said.stamp_ns >= stamp_ns)
        return next((said for said in later if said.text is not None), None)

    @property
    def complaint(self) -> str | None:
        """What the driver says now."""
        return self.said[-1].text if self.said else "not opened yet"

    def scan_of_sweep(self, first: int) -> Given | None:
        """The first scan given of sweep ``first`` or a later one."""
        return next(
            (g for g in list(self.given) if g.sweep is not None and g.sweep.number >= first), None
        )

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stopping.set()
        self._thread.join()
        if error is None:
            self._check()

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure
        self._runner.check()

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                try:
                    self._serve()
                except DriverError as fault:
                    self._say(str(fault))
                    self._stopping.wait(_REOPEN_S)
        except BaseException as failure:  # noqa: BLE001 - handed to the scenario by _check()
            self._failure = failure

    def _serve(self) -> None:
        session = Session(opened_ns=time.monotonic_ns())
        scanner = self._rig.open(session.raw.append if self._recorded else lambda _raw: None)
        self.sessions.append(session)
        try:
            while not self._stopping.is_set():
                self._free.wait()
                self._take(scanner.read(_READ_S), session)
                self.errors, complaint = scanner.status()
                self._say(complaint)
        finally:
            self._close(scanner)

    def _take(self, scan: Scan | None, session: Session) -> None:
        received_ns = time.monotonic_ns()
        if scan is None:
            return
        sweep = self._runner.matching(scan.ranges_m, self._rig.tolerance_m)
        with self._news:
            session.scans.append(scan)
            self.given.append(Given(scan=scan, received_ns=received_ns, sweep=sweep))
            self._news.notify_all()

    def _say(self, text: str | None) -> None:
        with self._news:
            if not self.said or self.said[-1].text != text:
                self.said.append(Said(stamp_ns=time.monotonic_ns(), text=text))
                self._news.notify_all()

    def _close(self, scanner: Scanner) -> None:
        begun_s = time.monotonic()
        scanner.close()
        self.closing_s.append(time.monotonic() - begun_s)
