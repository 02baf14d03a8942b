"""What a CAN bus and its interface do to frames on a bad day."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from amr_drivers.can_odometry.frames import Frame

BUS_OFF = 0x040
NO_ACKNOWLEDGEMENT = 0x020
RESTARTED = 0x100


class FaultyWire:
    """Between frames and who takes them, a bus or a decoder."""

    def __init__(self, take: Callable[[Frame], object]) -> None:
        self._take = take
        self._held: list[Frame] = []
        self.silent = False
        """True: nothing comes through, and nothing of it later."""

    def send(self, frames: Iterable[Frame]) -> None:
        """Pass frames on; those held back come after the first of them."""
        for frame in frames:
            if not self.silent:
                self._take(frame)
            held, self._held = self._held, []
            for late in held:
                self._take(late)

    def send_twice(self, frames: Iterable[Frame]) -> None:
        """Each frame comes two times: its acknowledgement was lost."""
        for frame in frames:
            self.send([frame, frame])

    def hold(self, frames: Iterable[Frame]) -> None:
        """These come late: after the next frame that is sent."""
        self._held += frames

    def fail(self, stamp_ns: int, error_class: int, detail: bytes = bytes(8)) -> None:
        """The interface tells of an error on the bus by an error frame."""
        self._take(
            Frame(
                stamp_ns=stamp_ns,
                identifier=error_class,
                data=detail,
                is_extended=True,
                is_error=True,
            )
        )
