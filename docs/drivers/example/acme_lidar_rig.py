"""The ACME text-line scanner's other end, and the driver in front of it: for the suite."""

from __future__ import annotations

import contextlib
import random
import socket
import threading
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import numpy as np

import acme_lidar
from amr_drivers.conformance.rig import Rig
from amr_slam.geometry import Array
from amr_slam.samples import Tap, untapped


class EmulatedLidar:
    """An :class:`amr_drivers.emulators.scanner.EmulatedScanner` that listens on loopback."""

    def __init__(self) -> None:
        self.silent = False
        self.frozen = False
        self.mode: Literal["measuring", "standby"] = "measuring"
        self.port = 0
        self._counter = 0
        self._last = b""
        self._cut_at: int | None = None
        self._damage: random.Random | None = None
        self._speech: bytes | None = None
        self._lock = threading.Lock()
        self._callers: list[socket.socket] = []
        self._closed = threading.Event()
        self._listening: socket.socket | None = None
        self.replug()
        self._thread = threading.Thread(target=self._accept, name="acme-accept", daemon=True)
        self._thread.start()

    def measure(self, ranges_m: Array) -> int:
        first_beam_ns = time.monotonic_ns() - round(1e9 * acme_lidar.SWEEP_S)
        if not self.frozen:
            self._counter += 1
            self._last = line(self._counter, self.mode, ranges_m)
        data, hang_up = self._last, self._cut_at is not None
        if self.silent:
            return first_beam_ns
        if self._damage is not None:
            at = self._damage.randrange(len(data))
            data = data[:at] + bytes((data[at] ^ 1 << self._damage.randrange(8),)) + data[at + 1 :]
            self._damage = None
        self._send(data if self._speech is None else self._speech, self._cut_at)
        self._cut_at = None
        if hang_up:
            self._hang_up()
        return first_beam_ns

    def cut_next(self, at_byte: int) -> None:
        self._cut_at = at_byte

    def damage_next(self, seed: int) -> None:
        self._damage = random.Random(seed)

    def send_bytes(self, data: bytes) -> None:
        self._send(data, None)

    def unplug(self) -> None:
        with self._lock:
            listening, self._listening = self._listening, None
        if listening is not None:
            listening.close()
        self._hang_up()

    def replug(self) -> None:
        with self._lock:
            if self._listening is None:
                self._listening = socket.create_server(("127.0.0.1", self.port))
                self._listening.settimeout(0.02)
                self.port = self._listening.getsockname()[1]

    def power_cycle(self) -> None:
        self._counter = 0
        self._hang_up()

    def be_another_device(self, speech: bytes) -> None:
        self._speech = speech

    def close(self) -> None:
        self._closed.set()
        self._thread.join()
        self.unplug()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _send(self, data: bytes, length: int | None) -> None:
        with self._lock:
            for caller in self._callers:
                # A driver that does not read misses telegrams; nobody waits for it.
                with contextlib.suppress(OSError):
                    caller.send(data[:length])

    def _hang_up(self) -> None:
        with self._lock:
            for caller in self._callers:
                caller.close()
            self._callers.clear()

    def _accept(self) -> None:
        while not self._closed.is_set():
            listening = self._listening
            if listening is None:
                self._closed.wait(0.02)
                continue
            with contextlib.suppress(OSError):
                caller, _ = listening.accept()
                caller.setblocking(False)
                with self._lock:
                    self._callers.append(caller)


def line(counter: int, mode: str, ranges_m: Array) -> bytes:
    """A sweep as the scanner sends it."""
    state = "OK" if mode == "measuring" else "STANDBY"
    values = " ".join(f"{mm:.0f}" for mm in np.rint(1e3 * ranges_m))
    text = f"SCAN {counter} {state} {values}".encode()
    return text + b"*%08x\n" % zlib.crc32(text)


class LidarRig:
    """A :class:`amr_drivers.conformance.rig.Rig`."""

    name = "acme_lidar"
    beams = acme_lidar.BEAMS
    period_s = 0.04
    tolerance_m = 0.0005
    stamp_tolerance_s = 0.005

    def __init__(self, _folder: Path) -> None:
        self.device = EmulatedLidar()
        self.telegram_bytes = len(line(100, "measuring", np.full(self.beams, 9.999)))
        self._settings = acme_lidar.Settings(host="127.0.0.1", port=self.device.port)

    def open(self, tap: Tap = untapped) -> acme_lidar.Lidar:
        return acme_lidar.open_scanner("front", self._settings, tap)

    def decoder(self, start_ns: int) -> acme_lidar.Decoder:
        return acme_lidar.scan_decoder("front", self._settings, start_ns)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.device.close()


def rigs() -> dict[str, Callable[[Path], Rig]]:
    """What the entry point names."""
    return {LidarRig.name: LidarRig}
