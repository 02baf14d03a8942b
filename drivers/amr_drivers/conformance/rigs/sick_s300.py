"""The S300: continuous mode on a serial line and behind a converter, and request mode."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from amr_drivers.background import ScanDecoder
from amr_drivers.conformance.rig import MakeRig
from amr_drivers.emulators.converter import EmulatedConverter
from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.emulators.s300 import EmulatedS300, S300Model
from amr_drivers.sick_s300.driver import S300, Settings, open_scanner, scan_decoder
from amr_slam.samples import Tap, untapped

_BEAMS = 541
_CONTINUOUS_BYTES = 1108
_ANSWER_BYTES = 1096
_ASKED_PERIOD_S = 0.08
"""Some scanners' time between two sweeps; an answer is on the wire for 22 ms of it."""


class S300Rig:
    """A :class:`amr_drivers.conformance.rig.Rig`."""

    beams = _BEAMS
    tolerance_m = 0.005

    def __init__(
        self,
        name: str,
        settings: Settings,
        device: EmulatedS300,
        *,
        telegram_bytes: int,
        stamp_tolerance_s: float,
    ) -> None:
        self.name = name
        self.period_s = settings.scan_period_s
        self.stamp_tolerance_s = stamp_tolerance_s
        self.telegram_bytes = telegram_bytes
        self.device = device
        self._settings = settings

    def open(self, tap: Tap = untapped) -> S300:
        return open_scanner("front", self._settings, tap)

    def decoder(self, start_ns: int) -> ScanDecoder:
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


def _continuous(folder: Path) -> S300Rig:
    line = PtyLine(folder / "front")
    return S300Rig(
        "sick_s300, continuous",
        Settings(port=line.port),
        EmulatedS300(line, S300Model(paced=True)),
        telegram_bytes=_CONTINUOUS_BYTES,
        stamp_tolerance_s=0.005,
    )


def _converted(_folder: Path) -> S300Rig:
    line = EmulatedConverter("socket")
    return S300Rig(
        "sick_s300, continuous over TCP",
        Settings(port=line.port),
        EmulatedS300(line, S300Model(paced=True)),
        telegram_bytes=_CONTINUOUS_BYTES,
        stamp_tolerance_s=0.005,
    )


def _asked(folder: Path) -> S300Rig:
    line = PtyLine(folder / "front")
    return S300Rig(
        "sick_s300, request",
        Settings(
            port=line.port,
            mode="request",
            scan_period_s=_ASKED_PERIOD_S,
        ),
        EmulatedS300(line, S300Model(protocol="request")),
        telegram_bytes=_ANSWER_BYTES,
        # Half of the time between two requests: any age up to that is as likely.
        stamp_tolerance_s=0.02,
    )


def rigs() -> dict[str, MakeRig]:
    """The rigs of this driver by name."""
    return {
        "sick_s300, continuous": _continuous,
        "sick_s300, continuous over TCP": _converted,
        "sick_s300, request": _asked,
    }
