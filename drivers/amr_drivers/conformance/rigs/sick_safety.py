"""The microScan3 polled and the nanoScan3 streamed."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self

import numpy as np

from amr_drivers.background import ScanDecoder
from amr_drivers.emulators.safety import MICROSCAN3, NANOSCAN3, EmulatedSafety, SafetyModel
from amr_drivers.sick_safety.blocks import Beams, Header, Instance, Status
from amr_drivers.sick_safety.cola2 import Command, Frame, encode_frame
from amr_drivers.sick_safety.datagrams import fragments
from amr_drivers.sick_safety.driver import Polled, Streamed, open_scanner, scan_decoder
from amr_drivers.sick_safety.instance import encode_instance
from amr_drivers.sick_safety.settings import Settings
from amr_slam.samples import Tap, untapped

_POLL_S: Final = 0.02
"""Twice in a scan period, so that every sweep is fetched and none is old when it is."""
_STAMP_S: Final = {"poll": 0.02, "stream": 0.003}
"""Polled: half a scan period, until the clock has learnt."""


class SafetyRig:
    """An :class:`amr_drivers.conformance.rig.Rig`."""

    tolerance_m = 0.0005

    def __init__(self, mode: Literal["poll", "stream"], model: SafetyModel, _folder: Path) -> None:
        self.name = f"sick_safety, {'polled' if mode == 'poll' else 'streamed'}"
        self.beams = model.derived.beams
        self.period_s = model.period_s
        self.stamp_tolerance_s = _STAMP_S[mode]
        self.telegram_bytes = _telegram_bytes(mode, model)
        self.device = EmulatedSafety(model=model)
        self._settings = Settings(
            host="127.0.0.1", port=self.device.port, mode=mode, poll_interval_s=_POLL_S
        )

    def open(self, tap: Tap = untapped) -> Polled | Streamed:
        """The driver, as the service opens it."""
        return open_scanner("front", self._settings, tap)

    def decoder(self, start_ns: int) -> ScanDecoder:
        """What turns its recorded bytes into scans."""
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


def rigs() -> dict[str, Callable[[Path], SafetyRig]]:
    """The rigs of this driver by name."""
    return {
        "sick_safety, polled": partial(SafetyRig, "poll", MICROSCAN3),
        "sick_safety, streamed": partial(SafetyRig, "stream", NANOSCAN3),
    }


def _telegram_bytes(mode: Literal["poll", "stream"], model: SafetyModel) -> int:
    beams = model.derived.beams
    instance = encode_instance(
        Instance(
            header=Header(
                version=("R", 2, 0, 0),
                serial_number=model.serial_number,
                plug_number=model.plug_number,
                channel=0,
                sequence=0,
                scan_number=0,
                date=0,
                time_ms=0,
            ),
            status=Status(),
            derived=model.derived,
            beams=Beams(
                distance=np.zeros(beams, dtype=np.uint16),
                rssi=np.zeros(beams, dtype=np.uint8),
                status=np.zeros(beams, dtype=np.uint8),
            ),
        ),
        header_bytes=model.header_bytes,
    )
    if mode == "stream":
        return sum(map(len, fragments(instance, 0)))
    payload = bytes(2) + instance
    return len(encode_frame(Frame(session=0, request=0, command=Command.VALUE, payload=payload)))
