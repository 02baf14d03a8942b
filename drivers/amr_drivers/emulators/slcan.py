"""A serial-line CAN adapter (slcan, LAWICEL) on a pseudo-terminal."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from amr_drivers.emulators.pty_line import PtyLine

_MAX_COMMAND = 64


class EmulatedSlcan:
    """The adapter's end of the line: answers the host, sends frames while the channel is open.

    Commands: S0..S8 (bit rate), O and L (open), C (close). Others are answered with BEL. One
    thread uses it; a context manager.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._line = PtyLine(link)
        self._pending = b""
        self._is_open = False

    @property
    def port(self) -> str:
        """The path that the driver opens (python-can's channel)."""
        return self._line.port

    @property
    def is_open(self) -> bool:
        """Whether the host has opened the channel, as far as its commands were read."""
        self.answer()
        return self._is_open

    def answer(self) -> None:
        """Read and answer the host's commands so far; ``send`` does it, too."""
        *commands, rest = (self._pending + self._line.read()).split(b"\r")
        self._pending = rest[-_MAX_COMMAND:]
        for command in commands:
            self._line.write(b"\r" if self._obey(command) else b"\a")

    def send(self, arbitration_id: int, data: bytes, *, is_extended: bool = False) -> bool:
        """Send one frame (at most 8 bytes); False when the channel is closed or the line full."""
        self.answer()
        if not self._is_open:
            return False
        head = f"T{arbitration_id:08X}" if is_extended else f"t{arbitration_id:03X}"
        text = f"{head}{len(data)}{data.hex().upper()}\r".encode()
        return self._line.write(text) == len(text)

    def send_bytes(self, data: bytes) -> None:
        """Send anything: a line cut short, noise."""
        self._line.write(data)

    def unplug(self) -> None:
        """Pull the adapter: the port hangs up and disappears."""
        self._line.unplug()
        self._is_open = False
        self._pending = b""

    def replug(self) -> None:
        """Put it back: the port returns under the same link, the channel closed."""
        self._line.plug()

    def close(self) -> None:
        self.unplug()

    def _obey(self, command: bytes) -> bool:
        if command in (b"O", b"L"):
            self._is_open = True
        elif command == b"C":
            self._is_open = False
        else:
            return command == b"" or (command[:1] == b"S" and command[1:] in _BIT_RATES)
        return True

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


_BIT_RATES = tuple(str(n).encode() for n in range(9))
