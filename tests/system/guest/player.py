"""The robot's devices in the test's machine: plays what tests/system/drive.py has written.

Scanners speak on the virtio ports ``front`` and ``rear``, which the host connects to USB serial
adapters; wheels on the CAN interface can1. ``player.py FILE STARTED`` writes CLOCK_MONOTONIC in s
of the start to STARTED. Standard library only.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import sys
import time
from pathlib import Path

_PIECE = struct.Struct("<IBH")
_PORTS = ("/dev/virtio-ports/front", "/dev/virtio-ports/rear")
_CAN, _TRUTH = 2, 3


def main(file: str, started: str) -> None:
    """Play to the end."""
    content, at = Path(file).read_bytes(), 0
    ports = [os.open(port, os.O_WRONLY | os.O_NONBLOCK) for port in _PORTS]
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind(("can1",))
        began_s = time.monotonic()
        Path(started).write_text(f"{began_s}\n", encoding="ascii")
        while at < len(content):
            ms, kind, length = _PIECE.unpack_from(content, at)
            at += _PIECE.size + length
            if kind == _TRUTH:
                continue
            time.sleep(max(0.0, began_s + 1e-3 * ms - time.monotonic()))
            data = content[at - length : at]
            with contextlib.suppress(OSError):  # a bus that is off, an adapter that is pulled
                if kind == _CAN:
                    bus.send(data, socket.MSG_DONTWAIT)
                else:
                    os.write(ports[kind], data)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
