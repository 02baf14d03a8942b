"""Wheel angles to CAN frames by the same DBC file and settings as the driver's."""

from __future__ import annotations

import math
from typing import Any

from amr_drivers.can_odometry.counting import rad_per_count
from amr_drivers.can_odometry.dbc import Signal, Signals
from amr_drivers.can_odometry.frames import Frame
from amr_drivers.can_odometry.settings import Settings, SteerSettings, WheelSettings


class EmulatedWheels:
    """Encoders and the nodes that send their counts, speeds and angles.

    Raises ValueError as :class:`amr_drivers.can_odometry.dbc.Signals` does.
    """

    def __init__(self, settings: Settings) -> None:
        self._signals = Signals(settings.dbc, settings.signals, settings.sequence_signal)
        self._sequence = 0
        self._zero_rad = dict.fromkeys(settings.signals, 0.0)

    def restart(self, *angles_rad: float) -> None:
        """The node lost its power with its wheels at these angles: counts and sequence from 0."""
        self._zero_rad = dict(zip(self._zero_rad, angles_rad, strict=True))
        self._sequence = 0

    def frames(self, *values: float, stamp_ns: int = 0) -> list[Frame]:
        """The frames that tell these values, one for each joint, in the order of the joints.

        In rad; of a wheel whose speed is measured in rad/s.
        """
        signals = self._signals
        named = dict(zip(signals.joints, values, strict=True))
        frames = []
        for name, message in signals.messages.items():
            told: dict[str, Any] = dict.fromkeys((s.name for s in message.signals), 0)
            for joint, settings in signals.joints.items():
                if settings.message == name:
                    told[settings.signal] = self._raw(joint, settings, named[joint])
            if signals.sequence_signal:
                told[signals.sequence_signal] = self._sequence % signals.sequence_modulus(name)
            frames.append(
                Frame(
                    stamp_ns=stamp_ns,
                    identifier=message.frame_id,
                    data=bytes(message.encode(told, scaling=False, strict=False)),
                    is_extended=message.is_extended_frame,
                )
            )
        self._sequence += 1
        return frames

    def _raw(self, joint: str, settings: WheelSettings | SteerSettings, value: float) -> float:
        signal = self._signals.signals[joint]
        if isinstance(settings, SteerSettings) and settings.unit != "counts":
            angle = settings.sign * value
            physical = math.degrees(angle) if settings.unit == "deg" else angle
            return self._unscaled(signal, physical)
        if isinstance(settings, WheelSettings) and settings.measures == "speed":
            return self._unscaled(signal, value / settings.speed_radps(1.0))
        scale = rad_per_count(settings.counts_per_revolution, settings.gear_ratio, settings.sign)
        modulus = self._signals.moduli.get(joint, 1 << signal.bits)
        # An absolute encoder of a steering knows its angle again.
        zero_rad = self._zero_rad[joint] if isinstance(settings, WheelSettings) else 0.0
        count = round((value - zero_rad) / scale) % modulus
        half = modulus // 2
        return (count + half) % (2 * half) - half if signal.is_signed else count

    @staticmethod
    def _unscaled(signal: Signal, physical: float) -> float:
        raw: float = signal.source.conversion.numeric_scaled_to_raw(physical)
        return raw if signal.is_float else round(raw)
