"""Wheel angles to CAN frames by the same DBC file and settings as the driver's."""

from __future__ import annotations

from amr_drivers.can_odometry.frames import Signals, WheelSettings


class EmulatedWheels:
    """Two wheel encoders and the node that sends their counts.

    Raises ValueError as :class:`amr_drivers.can_odometry.frames.Signals` does.
    """

    def __init__(
        self,
        dbc: str,
        left: WheelSettings | None = None,
        right: WheelSettings | None = None,
        sequence_signal: str = "",
    ) -> None:
        self._signals = Signals(
            dbc,
            left or WheelSettings(signal="LeftCount"),
            right or WheelSettings(signal="RightCount"),
            sequence_signal,
        )
        self._sequence = 0

    def frames(self, left_rad: float, right_rad: float) -> list[tuple[int, bool, bytes]]:
        """(arbitration id, is extended, data) of the frames that tell these wheel angles."""
        signals = self._signals
        frames = []
        for name, message in signals.messages.items():
            values = dict.fromkeys((signal.name for signal in message.signals), 0)
            for index, angle_rad in enumerate((left_rad, right_rad)):
                wheel = signals.wheels[index]
                if wheel.message == name:
                    count = round(angle_rad / signals.scale(index)) % signals.moduli[index]
                    signed = message.get_signal_by_name(wheel.signal).is_signed
                    half = signals.moduli[index] // 2
                    values[wheel.signal] = (count + half) % (2 * half) - half if signed else count
            if signals.sequence_signal:
                values[signals.sequence_signal] = self._sequence % signals.sequence_modulus(name)
            data = bytes(message.encode(values, scaling=False, strict=False))
            frames.append((message.frame_id, message.is_extended_frame, data))
        self._sequence += 1
        return frames
