"""A serial-line CAN adapter (slcan, LAWICEL), on a pseudo-terminal or behind TCP."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from amr_drivers.can_odometry.frames import Frame
from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.emulators.tcp_line import TcpLine

_MAX_COMMAND = 64


class Line(Protocol):
    """The adapter's end of its line to the host. Nothing in it waits."""

    @property
    def port(self) -> str: ...

    def plug(self) -> None: ...

    def unplug(self) -> None: ...

    def write(self, data: bytes) -> int: ...

    def read(self) -> bytes: ...


class EmulatedSlcan:
    """The adapter's end of the line: answers the host, sends frames while the channel is open.

    Commands: S0..S8 (bit rate), O and L (open), C (close), t and T (frames to the bus). Others are
    answered with BEL. One thread uses it; a context manager.
    """

    def __init__(self, link: Path | None = None, *, line: Line | None = None) -> None:
        self._line = line or PtyLine(link)
        self._pending = b""
        self._is_open = False
        self._heard: list[Frame] = []

    @classmethod
    def over_tcp(cls, tcp_port: int = 0) -> Self:
        """Behind a TCP port of this machine; 0: any that is free."""
        return cls(line=TcpLine(tcp_port))

    @property
    def port(self) -> str:
        """What the driver opens (python-can's channel): a path or a socket:// URL."""
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
            self._line.write(self._reply(command))

    def send(self, frame: Frame) -> bool:
        """Send one data frame (8 bytes at most); False when the channel is closed or the line
        full."""
        self.answer()
        if not self._is_open:
            return False
        head = f"T{frame.identifier:08X}" if frame.is_extended else f"t{frame.identifier:03X}"
        text = f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode()
        return self._line.write(text) == len(text)

    def heard(self) -> list[Frame]:
        """The frames that the host has sent to the bus since the last call; stamped 0."""
        self.answer()
        frames, self._heard = self._heard, []
        return frames

    def send_bytes(self, data: bytes) -> None:
        """Send anything: a line cut short, noise."""
        self._line.write(data)

    def unplug(self) -> None:
        """Pull the adapter: the port hangs up and disappears."""
        self._line.unplug()
        self._is_open = False
        self._pending = b""

    def replug(self) -> None:
        """Put it back: the port returns at the same place, the channel closed."""
        self._line.plug()

    def close(self) -> None:
        self.unplug()

    def _reply(self, command: bytes) -> bytes:
        if command in (b"O", b"L"):
            self._is_open = True
        elif command == b"C":
            self._is_open = False
        elif command[:1] in (b"t", b"T"):
            frame = _frame(command)
            if frame is None or not self._is_open:
                return b"\a"
            self._heard.append(frame)
            return b"z\r" if command[:1] == b"t" else b"Z\r"
        elif command and not (command[:1] == b"S" and command[1:] in _BIT_RATES):
            return b"\a"
        return b"\r"

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


def _frame(command: bytes) -> Frame | None:
    """The frame that a t or T command sends; None: it is none."""
    digits = 3 if command[:1] == b"t" else 8
    try:
        identifier = int(command[1 : 1 + digits], 16)
        length = int(command[1 + digits : 2 + digits])
        data = bytes.fromhex(command[2 + digits :].decode("ascii"))
    except ValueError:
        return None
    if length > 8 or len(data) != length:
        return None
    return Frame(stamp_ns=0, identifier=identifier, data=data, is_extended=digits == 8)
