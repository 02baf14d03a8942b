"""The device's end of a line: what serial ports and converters have in common."""

from __future__ import annotations

from typing import Protocol


class Line(Protocol):
    """Bytes to and from a host that comes and goes. Writes never block: what nobody reads is
    lost once the line is full."""

    @property
    def port(self) -> str:
        """What a driver opens."""

    def plug(self) -> None:
        """Bring the port (back) into being. Without effect while it exists."""

    def unplug(self) -> None:
        """Hang up and remove the port. Idempotent."""

    def write(self, data: bytes) -> int:
        """Send; how many bytes the line took."""

    def read(self) -> bytes:
        """What the host has sent, without waiting; ``b""`` when there is nothing."""
