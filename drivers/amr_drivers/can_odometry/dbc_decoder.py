"""Frames that a DBC file describes to samples. Pure: no bus, no clock."""

from __future__ import annotations

import math
from typing import Any, Final

import cantools

from amr_drivers.can_odometry.counting import (
    JointAngle,
    Limits,
    SpeedIntegral,
    SteerAngle,
    WheelCounter,
    rad_per_count,
)
from amr_drivers.can_odometry.dbc import Signals
from amr_drivers.can_odometry.decoding import JointsDecoder
from amr_drivers.can_odometry.frames import Filter, Frame
from amr_drivers.can_odometry.settings import Settings, SteerSettings, WheelSettings
from amr_drivers.errors import BadTelegram

_MAX_BACKWARDS: Final = 8
"""Frames that a queue can swap. A sequence that falls by more has started anew."""
_MAX_STEER_RAD: Final = 4.0 * math.pi
"""Some count several turns of the steering; beyond it, a unit is wrong."""


class DbcDecoder(JointsDecoder):
    """Frames in, wheel samples out; keeps the joints' history. Raises ValueError as Signals."""

    def __init__(self, settings: Settings, start_ns: int, signals: Signals | None = None) -> None:
        """``signals``: those of ``settings``, where they were read from the file already."""
        self._settings = settings
        self._signals = signals or Signals(settings.dbc, settings.signals, settings.sequence_signal)
        self._filters = self._signals.filters()
        joints = {name: self._joint(name, settings.limits) for name in self._signals.joints}
        super().__init__(joints, settings.silence_s, start_ns)
        self._sequences: dict[str, int] = {}
        self._lost = 0

    @property
    def filters(self) -> list[Filter]:
        return list(self._filters.values())

    def facts(self) -> tuple[tuple[str, str], ...]:
        """See :meth:`FrameDecoder.facts`."""
        own = (("DBC file", self._settings.dbc), ("lost frames", str(self._lost)))
        return (*own, *super().facts())

    def _joint(self, name: str, limits: Limits) -> JointAngle:
        joint = self._signals.joints[name]
        if isinstance(joint, SteerSettings):
            return SteerAngle(limits)
        if joint.measures == "speed":
            return SpeedIntegral(limits)
        scale = rad_per_count(joint.counts_per_revolution, joint.gear_ratio, joint.sign)
        return WheelCounter(self._signals.moduli[name], scale, limits)

    def _feed(self, frame: Frame) -> bool | None:
        for name, wanted in self._filters.items():
            if wanted.lets_pass(frame):
                return self._take(frame, self._signals.messages[name])
        return None

    def _take(self, frame: Frame, message: Any) -> bool | None:
        values = _decoded(frame, message)
        own = [
            name
            for name, joint in self._signals.joints.items()
            if joint.message == message.name and joint.signal in values
        ]
        if not own:  # a multiplexed frame with another part of its signals
            return None
        restarted = self._restarted(message.name, values)
        if restarted is None:
            return False
        newer = False
        for name in own:
            raw = values[self._signals.joints[name].signal]
            newer |= self._update(name, frame.stamp_ns, raw, restarted=restarted)
        return newer

    def _update(self, name: str, stamp_ns: int, raw: float, *, restarted: bool) -> bool:
        joint, signal = self._joints[name], self._signals.signals[name]
        settings = self._signals.joints[name]
        if isinstance(joint, WheelCounter):
            count, modulus = int(signal.number(raw)), self._signals.moduli[name]
            if not -modulus <= 2 * count < 2 * modulus:
                raise BadTelegram(f"{signal.name} is {count}, but wraps at {modulus}")
            return joint.update(stamp_ns, count, restarted=restarted)
        if isinstance(joint, SpeedIntegral) and isinstance(settings, WheelSettings):
            speed_radps = settings.speed_radps(signal.scaled(raw))
            if not abs(speed_radps) <= self._settings.limits.max_speed_radps:
                raise BadTelegram(
                    f"{signal.name}: the wheel cannot turn at {speed_radps:.3g} rad/s"
                )
            joint.raw = raw
            return joint.update(stamp_ns, speed_radps, restarted=restarted)
        assert isinstance(joint, SteerAngle)
        assert isinstance(settings, SteerSettings)
        joint.raw = raw
        return joint.update(stamp_ns, _steer_rad(settings, signal, raw), restarted=restarted)

    def _restarted(self, name: str, values: dict[str, Any]) -> bool | None:
        """What the sequence counter says: True started anew, None repeated or out of order."""
        if not self._signals.sequence_signal or self._signals.sequence_signal not in values:
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


def _decoded(frame: Frame, message: Any) -> dict[str, Any]:
    """Raw values by the signals' names."""
    if len(frame.data) != message.length:
        raise BadTelegram(
            f"{message.name} has {len(frame.data)} bytes, the DBC file says {message.length}"
        )
    try:
        values: dict[str, Any] = message.decode(frame.data, decode_choices=False, scaling=False)
    except cantools.Error as error:
        raise BadTelegram(f"{message.name}: {error}") from error
    return values


def _steer_rad(settings: SteerSettings, signal: Any, raw: float) -> float:
    if settings.unit == "counts":
        scale = rad_per_count(settings.counts_per_revolution, settings.gear_ratio, settings.sign)
        return scale * int(signal.number(raw))
    angle = settings.sign * signal.scaled(raw)
    angle_rad = math.radians(angle) if settings.unit == "deg" else angle
    if not abs(angle_rad) <= _MAX_STEER_RAD:
        raise BadTelegram(f"{signal.name}: no wheel is steered by {angle_rad:.3g} rad")
    return angle_rad
