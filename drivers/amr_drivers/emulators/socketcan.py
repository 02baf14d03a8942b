"""The other nodes on a CAN interface of this computer: virtual (vcan), or a second controller."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct
from types import TracebackType
from typing import Final, Self

from amr_drivers.can_odometry.frames import Frame

_FORMAT: Final = struct.Struct("=IB3x8s")
"""struct can_frame of linux/can.h: identifier with flags, length, padding, data."""
_PASSING: Final = frozenset(
    {errno.ENETDOWN, errno.ENOBUFS, errno.EAGAIN, errno.ENODEV, errno.ENXIO}
)
"""What a node on a bus meets: the interface is down or gone, or its queue is full."""


class EmulatedNodes:
    """Sends to the bus what others than the host send, and hears what is sent there.

    One thread uses it; a context manager. Raises OSError when there is no such interface.
    """

    def __init__(self, interface: str) -> None:
        self.port = interface
        """What the driver opens (python-can's channel)."""
        self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            self._socket.setblocking(False)
            self._socket.bind((interface,))
        except OSError:
            self._socket.close()
            raise

    def send(self, frame: Frame) -> bool:
        """Send one frame; False when the bus is down or busy."""
        flags = socket.CAN_EFF_FLAG if frame.is_extended else 0
        flags |= socket.CAN_ERR_FLAG if frame.is_error else 0
        flags |= socket.CAN_RTR_FLAG if frame.is_remote else 0
        packed = _FORMAT.pack(frame.identifier | flags, len(frame.data), frame.data)
        try:
            self._socket.send(packed)
        except OSError as error:
            if error.errno not in _PASSING:
                raise
            return False
        return True

    def heard(self) -> list[Frame]:
        """The data frames that others have sent since the last call; stamped 0."""
        frames: list[Frame] = []
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    identifier, length, data = _FORMAT.unpack(self._socket.recv(_FORMAT.size))
                except OSError as error:
                    if error.errno not in _PASSING - {errno.EAGAIN}:
                        raise
                    return frames
                extended = bool(identifier & socket.CAN_EFF_FLAG)
                mask = socket.CAN_EFF_MASK if extended else socket.CAN_SFF_MASK
                if not identifier & (socket.CAN_ERR_FLAG | socket.CAN_RTR_FLAG):
                    frames.append(
                        Frame(
                            stamp_ns=0,
                            identifier=identifier & mask,
                            data=data[:length],
                            is_extended=extended,
                        )
                    )
        return frames

    def close(self) -> None:
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
