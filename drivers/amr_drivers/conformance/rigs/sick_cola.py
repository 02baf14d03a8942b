"""LMS and TiM in both dialects, polled and streamed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self

import numpy as np

from amr_drivers.conformance.rig import Rig
from amr_drivers.emulators.cola import LMS111, LMS511, TIM571, TIM781, ColaModel, EmulatedCola
from amr_drivers.emulators.cola.device import ColaDevice
from amr_drivers.sick_cola.decoder import ColaDecoder
from amr_drivers.sick_cola.driver import Cola, Settings, open_scanner, scan_decoder
from amr_drivers.sick_cola.framing import Dialect
from amr_slam.samples import Tap, untapped

_NO_RETURN_M: Final = 28.0
"""Real devices say 0 for "nothing there" and for "not measured" alike, and the driver takes it for
the latter. The suite tells one from the other, so that these devices see an echo from beyond."""
_RANGE_MAX_M: Final = 25.0
_POLL_S: Final = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kind:
    """A scanner and how it is listened to."""

    model: ColaModel
    dialect: Dialect
    delivery: Literal["streamed", "polled"]
    told_dialect: Literal["auto", "a", "b"] = "auto"
    mute_after_wrong_dialect: bool = False

    @property
    def name(self) -> str:
        model = next(iter(self.model.ident))
        told = "" if self.told_dialect == "auto" else ", dialect set"
        return f"sick_cola, {model}, CoLa {self.dialect.upper()}, {self.delivery}{told}"


_KINDS: Final = (
    _Kind(model=LMS111, dialect=Dialect.B, delivery="streamed"),
    _Kind(model=TIM781, dialect=Dialect.B, delivery="polled"),
    _Kind(model=LMS511, dialect=Dialect.B, delivery="polled", told_dialect="b"),
    _Kind(model=TIM571, dialect=Dialect.A, delivery="streamed", mute_after_wrong_dialect=True),
    _Kind(model=TIM571, dialect=Dialect.A, delivery="polled", told_dialect="a"),
)


class _ColaRig:
    """One of the kinds in front of its emulator."""

    tolerance_m = 0.0005

    def __init__(self, kind: _Kind, _folder: Path) -> None:
        model = replace(kind.model, range_max_m=_RANGE_MAX_M)
        self.name = kind.name
        self.beams = model.beams
        self.period_s = model.period_s
        # A polled scan's age is known to what lies between two questions.
        self.stamp_tolerance_s = 0.005 if kind.delivery == "streamed" else 0.010
        self.telegram_bytes = _length(kind)
        self.device = EmulatedCola(
            model=model,
            dialect=kind.dialect,
            mute_after_wrong_dialect=kind.mute_after_wrong_dialect,
            no_return_m=_NO_RETURN_M,
        )
        self._settings = Settings(
            host="127.0.0.1",
            port=self.device.port,
            dialect=kind.told_dialect,
            delivery=kind.delivery,
            poll_interval_s=_POLL_S,
            range_max_m=_RANGE_MAX_M,
        )

    def open(self, tap: Tap = untapped) -> Cola:
        return open_scanner("front", self._settings, tap)

    def decoder(self, start_ns: int) -> ColaDecoder:
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


def _length(kind: _Kind) -> int:
    device = ColaDevice(kind.model, kind.dialect, started_us=0, no_return_m=None)
    device.measure(np.full(kind.model.beams, 10.0))
    return len(device.scan("sSN"))


def rigs() -> dict[str, Callable[[Path], Rig]]:
    """The rigs of this driver by name."""

    def of(kind: _Kind) -> Callable[[Path], Rig]:
        return lambda folder: _ColaRig(kind, folder)

    return {kind.name: of(kind) for kind in _KINDS}
