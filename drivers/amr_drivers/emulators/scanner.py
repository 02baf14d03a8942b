"""What every emulated scanner can do, and suffer."""

from __future__ import annotations

from types import TracebackType
from typing import Literal, Protocol, Self

from amr_slam.geometry import Array
from amr_slam.simulation import ScannerModel


class EmulatedScanner(Protocol):
    """The device's end of a scanner's line, with the faults that real ones have.

    A context manager. One thread calls :meth:`measure`; everything else may come from another.
    """

    silent: bool
    """True: measures and counts on, sends and answers nothing."""
    frozen: bool
    """True: the same scan with the same counter is sent or answered again and again."""

    @property
    def mode(self) -> str:
        """What the device knows of: "measuring" and "standby" at least, more per device."""

    @mode.setter
    def mode(self, mode: Literal["measuring", "standby"], /) -> None: ...

    def measure(self, ranges_m: Array) -> int:
        """A sweep has just ended with these ranges: send it, or keep it for who asks.

        ``ranges_m``: (beams,), m, counter-clockwise from the first beam; inf no return, NaN not
        measured. Returns the truth: ``time.monotonic_ns()`` of its first beam. Never blocks longer
        than the wire time of the telegram (paced models); never waits for a reader.
        """

    def cut_next(self, at_byte: int) -> None:
        """Of the next scan telegram only so many bytes leave; TCP hangs up then."""

    def damage_next(self, seed: int) -> None:
        """The next scan telegram suffers what this line can suffer: bytes flipped where there is
        a checksum; lost, doubled, reordered fragments on UDP; a broken structure else."""

    def send_bytes(self, data: bytes) -> None:
        """Noise on the line."""

    def unplug(self) -> None:
        """The line is gone: a pty is removed, TCP connections are cut and new ones refused."""

    def replug(self) -> None:
        """And back, under the same address."""

    def power_cycle(self) -> None:
        """Counters, device clock, sessions and tokens start anew; TCP connections die."""

    def be_another_device(self, speech: bytes) -> None:
        """From now on something else answers on this line: says ``speech`` on connect and to
        every request."""

    def close(self) -> None:
        """Idempotent."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class StandIn(EmulatedScanner, Protocol):
    """An emulated scanner that a simulated world can be put before."""

    @property
    def optics(self) -> ScannerModel:
        """How it sees: beams, view, range, rounding and sweep."""
