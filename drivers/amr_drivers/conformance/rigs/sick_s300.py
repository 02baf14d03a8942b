"""The S300 in continuous mode."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self

from amr_drivers.conformance.rig import Rig
from amr_drivers.emulators.s300 import EmulatedS300
from amr_drivers.sick_s300.decoder import ContinuousDecoder
from amr_drivers.sick_s300.driver import S300, Settings, open_scanner, scan_decoder
from amr_slam.geometry import Array
from amr_slam.samples import Tap, untapped

_TELEGRAM_BYTES: Final = 1108


class _Device:
    """An EmulatedS300 in the shape of :class:`amr_drivers.emulators.scanner.EmulatedScanner`."""

    def __init__(self, link: Path, sweep_s: float) -> None:
        self.silent = False
        self.frozen = False
        self.mode: Literal["measuring", "standby", "lock-out"] = "measuring"
        self._s300 = EmulatedS300(link)
        self._sweep_ns = round(1e9 * sweep_s)
        self._frozen: tuple[Array, int] | None = None
        self._damage: int | None = None
        self._speech: bytes | None = None

    def measure(self, ranges_m: Array) -> int:
        self._s300.silent, self._s300.mode = self.silent, self.mode
        if self._speech is not None:
            self.send_bytes(self._speech)
            return time.monotonic_ns() - self._sweep_ns
        if self._damage is not None:
            dice = random.Random(self._damage)
            self._damage = None
            self._s300.send(ranges_m, self._s300.scan_number + 1) if False else None
            data = bytearray(self._next(ranges_m))
            data[dice.randrange(len(data))] ^= 1 << dice.randrange(8)
            first_ns = time.monotonic_ns()
            self._s300.send_bytes(bytes(data))
            return first_ns - self._sweep_ns
        if self.frozen:
            self._frozen = self._frozen or (ranges_m, self._s300.scan_number)
            return self._s300.send(*self._frozen) - self._sweep_ns
        self._frozen = None
        return self._s300.send(ranges_m) - self._sweep_ns

    def _next(self, ranges_m: Array) -> bytes:
        silent, self._s300.silent = self._s300.silent, True
        self._s300.send(ranges_m)
        self._s300.silent = silent
        return self._s300.telegram(ranges_m)

    def cut_next(self, at_byte: int) -> None:
        self._s300.cut_next(at_byte)

    def damage_next(self, seed: int) -> None:
        self._damage = seed

    def send_bytes(self, data: bytes) -> None:
        self._s300.send_bytes(data)

    def unplug(self) -> None:
        self._s300.unplug()

    def replug(self) -> None:
        self._s300.replug()

    def power_cycle(self) -> None:
        silent, self._s300.silent = self._s300.silent, True
        self._s300.send(ranges_m=_NOTHING, scan_number=0)
        self._s300.silent = silent

    def be_another_device(self, speech: bytes) -> None:
        self._speech = speech

    def close(self) -> None:
        self._s300.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


import numpy as np  # noqa: E402

_NOTHING: Final = np.full(541, np.inf)


class _S300Rig:
    name = "sick_s300, continuous"
    beams = 541
    period_s = 0.04
    tolerance_m = 0.005
    stamp_tolerance_s = 0.005
    telegram_bytes = _TELEGRAM_BYTES

    def __init__(self, folder: Path) -> None:
        self._settings = Settings(port=str(folder / "front"), latency_limit_s=0.1)
        self.device = _Device(folder / "front", self._settings.sweep_s)

    def open(self, tap: Tap = untapped) -> S300:
        return open_scanner("front", self._settings, tap)

    def decoder(self, start_ns: int) -> ContinuousDecoder:
        return scan_decoder("front", self._settings, start_ns)

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
    """The rigs of this driver by name."""
    return {_S300Rig.name: _S300Rig}
