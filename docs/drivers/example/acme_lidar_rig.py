"""The ACME datagram scanner's other end, and the driver in front of it: for the suite."""

from __future__ import annotations

import contextlib
import random
import socket
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

import acme_lidar
from amr_drivers.conformance.rig import Rig
from amr_slam.geometry import Array
from amr_slam.samples import Tap, untapped

_LARGEST = 60_000


class EmulatedLidar:
    """An :class:`amr_drivers.emulators.scanner.EmulatedScanner` that sends to a loopback port."""

    def __init__(self, port: int) -> None:
        self.silent = False
        self.frozen = False
        self.mode: Literal["measuring", "standby"] = "measuring"
        self._unplugged = False
        self._counter = 0
        self._last = b""
        self._cut_at: int | None = None
        self._damage: random.Random | None = None
        self._speech: bytes | None = None
        self._line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._line.connect(("127.0.0.1", port))

    def measure(self, ranges_m: Array) -> int:
        first_beam_ns = time.monotonic_ns() - round(1e9 * acme_lidar.SWEEP_S)
        if not self.frozen:
            self._counter += 1
            self._last = datagram(self._counter, self.mode, ranges_m)
        if self.silent:
            return first_beam_ns
        data = self._last
        if self._damage is not None:
            at = self._damage.randrange(len(data))
            data = data[:at] + bytes((data[at] ^ 1 << self._damage.randrange(8),)) + data[at + 1 :]
        self.send_bytes((data if self._speech is None else self._speech)[: self._cut_at])
        self._cut_at, self._damage = None, None
        return first_beam_ns

    def cut_next(self, at_byte: int) -> None:
        self._cut_at = at_byte

    def damage_next(self, seed: int) -> None:
        self._damage = random.Random(seed)

    def send_bytes(self, data: bytes) -> None:
        for start in range(0, 0 if self._unplugged else len(data), _LARGEST):
            # Nobody listens at the port: the datagram gets lost.
            with contextlib.suppress(OSError):
                self._line.send(data[start : start + _LARGEST])

    def unplug(self) -> None:
        self._unplugged = True

    def replug(self) -> None:
        self._unplugged = False

    def power_cycle(self) -> None:
        self._counter = 0

    def be_another_device(self, speech: bytes) -> None:
        self._speech = speech

    def close(self) -> None:
        self._line.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def datagram(counter: int, mode: str, ranges_m: Array) -> bytes:
    """A sweep as the scanner sends it."""
    ranges = ranges_m.astype("<f4").tobytes()
    body = acme_lidar.BODY.pack(counter, mode == "measuring", ranges)
    return body + zlib.crc32(body).to_bytes(4, "little")


def free_port() -> int:
    """A UDP port of loopback that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class LidarRig:
    """A :class:`amr_drivers.conformance.rig.Rig`."""

    name = "acme_lidar"
    beams = acme_lidar.BEAMS
    period_s = 0.04
    tolerance_m = 1e-5
    stamp_tolerance_s = 0.005
    telegram_bytes = acme_lidar.BODY.size + 4

    def __init__(self, _folder: Path) -> None:
        self._settings = acme_lidar.Settings(port=free_port())
        self.device = EmulatedLidar(self._settings.port)

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
