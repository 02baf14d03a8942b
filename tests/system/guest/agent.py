"""The hand of the system test in its machine: runs one shell command after the other.

A command is a line of JSON on the virtio port ``agent``: ``{"run": ..., "limit_s": ...}``; so is
the answer: ``status`` (None: not done in time), ``output``, and when it began and ended on this
machine's CLOCK_MONOTONIC. Standard library only.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path

_PORT = Path("/dev/virtio-ports/agent")


def serve() -> None:
    """Answer until the power goes."""
    while not _PORT.exists():  # udev makes it while the others start
        time.sleep(0.1)
    port = os.open(_PORT, os.O_RDWR)  # it may be opened once only
    while True:
        answer = json.dumps(_answer(json.loads(_line(port)))).encode() + b"\n"
        while answer:
            answer = answer[os.write(port, answer) :]


def _line(port: int) -> bytes:
    line = b""
    while not line.endswith(b"\n"):
        piece = os.read(port, 4096)
        if not piece:  # nobody is at the other end yet
            time.sleep(0.05)
        line += piece
    return line


def _answer(request: dict[str, object]) -> dict[str, object]:
    began_s = time.monotonic()
    with subprocess.Popen(
        ["/bin/sh", "-c", str(request["run"])],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        start_new_session=True,
    ) as process:
        try:
            output, _ = process.communicate(timeout=float(str(request["limit_s"])))
            status: int | None = process.returncode
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # with all that the shell has started
            output, _ = process.communicate()
            status = None
    ended_s = time.monotonic()
    return {"status": status, "output": output, "began_s": began_s, "ended_s": ended_s}


if __name__ == "__main__":
    serve()
