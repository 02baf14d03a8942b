"""CAN frames to wheel samples by a DBC file. Pure: no bus, no clock.

Source: protocol fact sheet, sections E.2 and E.3.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cantools
from annotated_types import Ge, Gt

from amr_drivers.can_odometry.counting import Limits, WheelCounter, WheelPair, rad_per_count
from amr_drivers.errors import BadTelegram
from amr_slam.samples import WheelSample

MAX_DBC_BYTES = 4_000_000
_MAX_BACKWARDS = 8
"""Frames that a queue can swap. A sequence that falls by more has started anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSettings:
    """Where one wheel's count stands and what it means."""

    message: str = "WheelEncoders"
    """Name of the frame in the DBC file; each wheel may have its own."""
    signal: str
    """Name of the count in that frame."""
    counts_per_revolution: Annotated[int, Gt(0)] = 4096
    """Counts in one turn of the encoder (four per line of a quadrature encoder)."""
    gear_ratio: Annotated[float, Gt(0)] = 1.0
    """Turns of the encoder in one turn of the wheel."""
    sign: Literal[1, -1] = 1
    """-1 where the count falls when the robot drives forward (mirrored mounting)."""
    modulus_counts: Annotated[int, Ge(0)] = 0
    """After how many counts the counter wraps; 0: at its signal's full width."""


class Signals:
    """The parts of a DBC file that the wheels need, checked once.

    Raises ValueError that names the file: unreadable, no such message or signal, a signal that is
    no whole number, a modulus that does not fit its signal.
    """

    def __init__(
        self, dbc: str, left: WheelSettings, right: WheelSettings, sequence_signal: str = ""
    ) -> None:
        self._dbc = dbc
        database = _load(dbc)
        self.wheels = (left, right)
        names = [message.name for message in database.messages]
        self.messages: dict[str, Any] = {}
        self.moduli: list[int] = []
        for wheel in self.wheels:
            self._demand("message", wheel.message, names)
            message = database.get_message_by_name(wheel.message)
            self.messages[wheel.message] = message
            self.moduli.append(self._modulus(wheel, self._whole_number(message, wheel.signal)))
            if sequence_signal:
                self._whole_number(message, sequence_signal)
        self.sequence_signal = sequence_signal

    def scale(self, index: int) -> float:
        """rad per count of the left (0) or right (1) wheel."""
        wheel = self.wheels[index]
        return rad_per_count(wheel.counts_per_revolution, wheel.gear_ratio, wheel.sign)

    def sequence_modulus(self, message: str) -> int:
        """After how many frames this message's sequence counter wraps."""
        bits: int = self.messages[message].get_signal_by_name(self.sequence_signal).length
        return 1 << bits

    def _whole_number(self, message: Any, name: str) -> Any:
        self._demand(f"signal in {message.name}", name, [s.name for s in message.signals])
        signal = message.get_signal_by_name(name)
        if signal.is_float or signal.length < 2:
            raise ValueError(f"{self._dbc}: signal {name} is no counter of whole numbers")
        return signal

    def _modulus(self, wheel: WheelSettings, signal: Any) -> int:
        full = 2 ** int(signal.length)
        if wheel.modulus_counts > full:
            raise ValueError(
                f"{self._dbc}: signal {wheel.signal} has {signal.length} bits and cannot wrap at "
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


class FrameDecoder:
    """Frames in, wheel samples out; keeps the counts' history."""

    def __init__(self, signals: Signals, limits: Limits) -> None:
        self._signals = signals
        self._counters = [
            WheelCounter(modulus, signals.scale(index), limits)
            for index, modulus in enumerate(signals.moduli)
        ]
        self._pair = WheelPair(*self._counters)
        self._messages = {
            (message.frame_id, message.is_extended_frame): message
            for message in signals.messages.values()
        }
        self._sequences: dict[str, int] = {}
        self._dropped = 0
        self._lost = 0

    @property
    def identifiers(self) -> list[tuple[int, bool]]:
        """(arbitration id, is extended) of the frames that are wanted."""
        return list(self._messages)

    @property
    def dropped(self) -> int:
        """Frames that came twice or in the wrong order."""
        return self._dropped

    @property
    def lost(self) -> int:
        """Frames that the sequence counter shows to be missing."""
        return self._lost

    @property
    def segment(self) -> int:
        """How often a wheel's counting had to start anew."""
        return sum(counter.segment for counter in self._counters)

    @property
    def stamps_ns(self) -> tuple[int | None, int | None]:
        """Of the newest left and right count."""
        return self._counters[0].stamp_ns, self._counters[1].stamp_ns

    def feed(
        self, stamp_ns: int, arbitration_id: int, data: bytes, *, is_extended: bool
    ) -> WheelSample | None:
        """Take in one frame; a sample when it completes one. Foreign frames are ignored.

        Raises BadTelegram for a frame that is not as the DBC file says.
        """
        message = self._messages.get((arbitration_id, is_extended))
        if message is None:
            return None
        if len(data) != message.length:
            raise BadTelegram(
                f"{message.name} has {len(data)} bytes, the DBC file says {message.length}"
            )
        try:
            values = message.decode(data, decode_choices=False, scaling=False)
        except cantools.Error as error:
            raise BadTelegram(f"{message.name}: {error}") from error
        restarted = self._restarted(message.name, values)
        if restarted is None:
            self._dropped += 1
            return None
        newer = False
        for index, (wheel, counter) in enumerate(
            zip(self._signals.wheels, self._counters, strict=True)
        ):
            if wheel.message == message.name and wheel.signal in values:
                count = self._count(wheel, index, values)
                newer |= counter.update(stamp_ns, count, restarted=restarted)
        if not newer:
            self._dropped += 1
            return None
        return self._pair.sample()

    def _count(self, wheel: WheelSettings, index: int, values: dict[str, Any]) -> int:
        count, modulus = int(values[wheel.signal]), self._signals.moduli[index]
        if not -modulus <= 2 * count < 2 * modulus:
            raise BadTelegram(f"{wheel.signal} is {count}, but wraps at {modulus}")
        return count

    def _restarted(self, name: str, values: dict[str, Any]) -> bool | None:
        """What the sequence counter says: True started anew, None repeated or out of order."""
        if not self._signals.sequence_signal:
            return False
        modulus = self._signals.sequence_modulus(name)
        number = int(values[self._signals.sequence_signal]) % modulus
        last = self._sequences.get(name)
        step = 1 if last is None else (number - last) % modulus
        if step == 0 or modulus - step <= min(_MAX_BACKWARDS, modulus // 4):
            return None
        self._sequences[name] = number
        if step > modulus // 2:
            return True
        self._lost += step - 1
        return False
