"""A TCP port that nobody uses."""

from __future__ import annotations

import socket


def free_port() -> int:
    """On the loopback interface, at this moment."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
        return port
