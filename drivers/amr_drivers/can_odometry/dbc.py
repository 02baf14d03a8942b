"""The parts of a DBC file that the wheels need, checked once.

Source: protocol fact sheet, section E.2; SAE J1939-21 (identifiers), J1939-71 (no numbers).
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cantools

from amr_drivers.can_odometry.frames import Filter
from amr_drivers.can_odometry.settings import NoNumber, SteerSettings, WheelSettings
from amr_drivers.errors import BadTelegram

MAX_DBC_BYTES: Final = 4_000_000
_STANDARD_MASK: Final = 0x7FF
_EXTENDED_MASK: Final = 0x1FFFFFFF
_PRIORITY: Final = 0x1C000000
_ANY_SOURCE: Final = 0xFE
_PEER_TO_PEER: Final = 240
"""PDU formats below it carry the receiver's address where others have more of their number."""
_J1939_LARGEST: Final = 0xFA
"""First byte of the largest number; above it stand errors and "not available"."""


@dataclass(frozen=True, slots=True)
class Signal:
    """One signal of the file and what its raw value may be."""

    name: str
    bits: int
    is_float: bool
    is_signed: bool
    no_number: NoNumber
    source: Any
    """cantools' own, which knows the factor."""

    def number(self, raw: float) -> float:
        """``raw`` itself. Raises BadTelegram for a value that says that there is none."""
        if not self._is_number(raw):
            raise BadTelegram(f"{self.name} is not available")
        return raw

    def scaled(self, raw: float) -> float:
        """By the file's factor and offset. Raises BadTelegram as :meth:`number`."""
        return float(self.source.conversion.raw_to_scaled(self.number(raw), False))

    def _is_number(self, raw: float) -> bool:
        if self.is_float:
            return math.isfinite(raw)
        bits = int(raw) % (1 << self.bits)
        if self.no_number == "all_ones":
            return bits != (1 << self.bits) - 1
        if self.no_number == "j1939":
            if self.bits < 8:
                return bits < (1 << self.bits) - 2
            return bits >> (self.bits - 8) <= _J1939_LARGEST
        return True


class Signals:
    """The frames and signals of all joints.

    Raises ValueError that names the file: unreadable, no such message or signal, a signal that is
    no whole number where counts are expected, a modulus that does not fit its signal.
    """

    def __init__(
        self,
        dbc: str,
        joints: Mapping[str, WheelSettings | SteerSettings],
        sequence_signal: str = "",
    ) -> None:
        self._dbc = dbc
        database = _load(dbc)
        names = [message.name for message in database.messages]
        self.joints = dict(joints)
        self.sequence_signal = sequence_signal
        self.messages: dict[str, Any] = {}
        self.signals: dict[str, Signal] = {}
        self.moduli: dict[str, int] = {}
        for name, joint in joints.items():
            self._demand("message", joint.message, names)
            message = database.get_message_by_name(joint.message)
            self.messages[joint.message] = message
            self.signals[name] = self._signal(message, joint)
            if isinstance(joint, WheelSettings) and joint.measures == "counts":
                self.moduli[name] = self._modulus(joint, self.signals[name])
            if sequence_signal:
                self._whole_number(self._named(message, sequence_signal))

    def filters(self) -> dict[str, Filter]:
        """By the message's name, which frames carry it."""
        return {name: _filter(message) for name, message in self.messages.items()}

    def sequence_modulus(self, message: str) -> int:
        """After how many frames this message's sequence counter wraps."""
        bits: int = self.messages[message].get_signal_by_name(self.sequence_signal).length
        return 1 << bits

    def _signal(self, message: Any, joint: WheelSettings | SteerSettings) -> Signal:
        source = self._named(message, joint.signal)
        is_count = (
            joint.measures == "counts"
            if isinstance(joint, WheelSettings)
            else joint.unit == "counts"
        )
        if is_count:
            self._whole_number(source)
        is_j1939 = message.protocol == "j1939"
        return Signal(
            name=source.name,
            bits=source.length,
            is_float=source.is_float,
            is_signed=source.is_signed,
            no_number="j1939" if is_j1939 else joint.no_number,
            source=source,
        )

    def _named(self, message: Any, name: str) -> Any:
        self._demand(f"signal in {message.name}", name, [s.name for s in message.signals])
        return message.get_signal_by_name(name)

    def _whole_number(self, signal: Any) -> None:
        if signal.is_float or signal.length < 2:
            raise ValueError(f"{self._dbc}: signal {signal.name} is no counter of whole numbers")

    def _modulus(self, wheel: WheelSettings, signal: Signal) -> int:
        full = 2**signal.bits
        if wheel.modulus_counts > full:
            raise ValueError(
                f"{self._dbc}: signal {wheel.signal} has {signal.bits} bits and cannot wrap at "
                f"{wheel.modulus_counts}"
            )
        return wheel.modulus_counts or full

    def _demand(self, kind: str, name: str, names: Iterable[str]) -> None:
        known = sorted(names)
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise ValueError(f"{self._dbc}: no {kind} is named {name!r}{hint}")


def _load(dbc: str) -> Any:
    path = Path(dbc)
    try:
        if path.stat().st_size > MAX_DBC_BYTES:
            raise ValueError(f"{dbc}: larger than {MAX_DBC_BYTES} bytes")
        database = cantools.database.load_file(path, database_format="dbc", strict=True)
    except OSError as error:
        raise ValueError(f"{dbc}: {error.strerror}") from error
    except (cantools.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{dbc}: no DBC file: {error}") from error
    return database


def _filter(message: Any) -> Filter:
    """The whole identifier; of J1939 without priority, receiver, and a source left open."""
    identifier, is_extended = int(message.frame_id), bool(message.is_extended_frame)
    mask = _EXTENDED_MASK if is_extended else _STANDARD_MASK
    if is_extended and message.protocol == "j1939":
        mask &= ~_PRIORITY
        if (identifier >> 16) & 0xFF < _PEER_TO_PEER:
            mask &= ~0xFF00
        if identifier & 0xFF == _ANY_SOURCE:
            mask &= ~0xFF
    return Filter(identifier=identifier, mask=mask, is_extended=is_extended)
