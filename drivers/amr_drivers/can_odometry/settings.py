"""What the driver ``can`` is told. No bus is needed to read it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from amr_drivers.can_odometry.counting import Limits

NoNumber = Literal["never", "all_ones", "j1939"]
"""Which raw values say that there is none: none does, all bits set, or J1939's upper range."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """The bus, whatever runs on it."""

    interface: str = "socketcan"
    """python-can's name: socketcan, slcan, udp_multicast, pcan, ..."""
    channel: str = "can0"
    """Network interface; serial port or socket://HOST:PORT of an slcan adapter; GROUP or GROUP@PORT
    of udp_multicast."""
    bitrate: Annotated[int, Gt(0), Le(1_000_000)] = 500_000
    """For adapters that are told; a socketcan interface has its own from ``ip link``."""
    open_delay_s: Annotated[float, Ge(0), Le(10)] = 0.0
    """Wait after the port of an slcan adapter is opened: some boards restart then (2 s)."""
    limits: Limits = field(default_factory=Limits)
    """Beyond them, a step is an encoder that started anew, not a motion."""
    silence_s: Annotated[float, Gt(0)] = 0.1
    """Without counts for so long, ``status`` says so: five periods at 50 Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelSettings:
    """Where one wheel's count or speed stands and what it means."""

    message: str = "WheelEncoders"
    """Name of the frame in the DBC file; each wheel may have its own."""
    signal: str
    """Name of the count or speed in that frame."""
    measures: Literal["counts", "speed"] = "counts"
    """A counter (raw, the DBC file's factor is not used), or a speed (by the DBC file's factor)."""
    counts_per_revolution: Annotated[int, Gt(0)] = 4096
    """Counts in one turn of the encoder (four per line of a quadrature encoder)."""
    gear_ratio: Annotated[float, Gt(0)] = 1.0
    """Turns of the encoder in one turn of the wheel."""
    sign: Literal[1, -1] = 1
    """-1 where the count falls when the robot drives forward (mirrored mounting)."""
    modulus_counts: Annotated[int, Ge(0)] = 0
    """After how many counts the counter wraps; 0: at its signal's full width."""
    speed_unit: Literal["rad/s", "rpm", "counts/s", "m/s"] = "rad/s"
    """Of a speed: the encoder's shaft turns so fast; m/s: the wheel rolls so fast."""
    radius_m: Annotated[float, Ge(0)] = 0.0
    """Of a speed in m/s: the wheel's radius by which the sender computed it, in m."""
    no_number: NoNumber = "never"
    """Raw values that mean "not available"; of a J1939 frame its upper range in any case."""

    def __post_init__(self) -> None:
        if self.measures == "speed" and self.speed_unit == "m/s" and not self.radius_m:
            raise ValueError("a speed in m/s needs radius_m, the sender's wheel radius")

    def speed_radps(self, value: float) -> float:
        """The wheel's speed, forward positive, for a speed in ``speed_unit``."""
        if self.speed_unit == "m/s":
            return self.sign * value / self.radius_m
        shaft = shaft_radps(value, self.speed_unit, self.counts_per_revolution)
        return self.sign * shaft / self.gear_ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class SteerSettings:
    """Where the angle of the steered wheel stands and what it means."""

    message: str = "Steering"
    """Name of the frame in the DBC file."""
    signal: str
    """Name of the angle in that frame."""
    unit: Literal["rad", "deg", "counts"] = "rad"
    """By the DBC file's factor; counts: raw, of an absolute encoder."""
    counts_per_revolution: Annotated[int, Gt(0)] = 4096
    """Of an angle in counts: counts in one turn of the encoder."""
    gear_ratio: Annotated[float, Gt(0)] = 1.0
    """Of an angle in counts: turns of the encoder in one turn of the steering."""
    sign: Literal[1, -1] = 1
    """-1 where the value falls when the wheel is steered to the left (counter-clockwise)."""
    no_number: NoNumber = "never"
    """As of a wheel."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings(BusSettings):
    """The bus, the frames on it and the wheels' limits."""

    dbc: str
    """Path of the DBC file that describes the frames."""
    left: WheelSettings = field(default_factory=lambda: WheelSettings(signal="LeftCount"))
    """The left wheel, seen in driving direction."""
    right: WheelSettings = field(default_factory=lambda: WheelSettings(signal="RightCount"))
    """The right wheel."""
    drive: WheelSettings | None = None
    """A tricycle's driven wheel; with ``steer``, and then left and right are not used."""
    steer: SteerSettings | None = None
    """A tricycle's steering angle."""
    sequence_signal: str = ""
    """Name of a frame counter in the wheels' frames, if there is one: tells repeated frames."""

    def __post_init__(self) -> None:
        if (self.drive is None) != (self.steer is None):
            raise ValueError("drive and steer belong together: a tricycle needs both")

    @property
    def signals(self) -> dict[str, WheelSettings | SteerSettings]:
        """What is read, by the joints' names."""
        if self.drive is not None and self.steer is not None:
            return {"drive": self.drive, "steer": self.steer}
        return {"left": self.left, "right": self.right}

    @property
    def joints(self) -> tuple[str, ...]:
        """What samples tell: the ``[drive]`` must be made for it."""
        return tuple(self.signals)


def shaft_radps(value: float, unit: str, counts_per_revolution: int) -> float:
    """A shaft's speed from rad/s, rpm or counts/s. Raises KeyError for another unit."""
    turns = {"rad/s": 0.5 / math.pi, "rpm": 1.0 / 60.0, "counts/s": 1.0 / counts_per_revolution}
    return value * turns[unit] * 2.0 * math.pi
