"""One drive as the bus shows it: its joint, its state, its troubles. Pure."""

from __future__ import annotations

import math
from typing import Final

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.settings import NodeSettings
from amr_drivers.can_odometry.counting import (
    JointAngle,
    Limits,
    SpeedIntegral,
    SteerAngle,
    WheelCounter,
    rad_per_count,
)
from amr_drivers.errors import BadTelegram

_COMPARED_RAD: Final = math.pi
"""Position and velocity are compared each time that the wheel has turned by this."""
_AGREE: Final = 0.25
"""By which share they may differ: velocities are filtered and lag."""
_START_AGAIN_NS: Final = 1_000_000_000


class Node:
    """One drive. Raises ValueError for a mapping without what shall be measured."""

    def __init__(self, settings: NodeSettings, limits: Limits, *, steers: bool) -> None:
        self.settings = settings
        self.mapping = objects.Mapping(settings.mapping)
        wanted = self.mapping.position if settings.measures == "position" else self.mapping.velocity
        if wanted is None:
            raise ValueError(f"node {settings.node}: its mapping has no {settings.measures}")
        self._scale = rad_per_count(
            settings.counts_per_revolution, settings.gear_ratio, settings.sign
        )
        self._measured = wanted
        bits = (self.mapping.position or wanted).bits
        if settings.modulus_counts > 1 << bits:
            raise ValueError(
                f"node {settings.node}: {bits} bits cannot wrap at {settings.modulus_counts}"
            )
        modulus = settings.modulus_counts or 1 << bits
        self.joint: JointAngle
        if steers:
            self.joint = SteerAngle(limits)
        elif settings.measures == "velocity":
            self.joint = SpeedIntegral(limits)
        else:
            self.joint = WheelCounter(modulus, self._scale, limits)
        self._limits = limits
        self._comparison = Comparison(modulus, self._scale, limits)
        self._state: int | None = None
        self._has_restarted = False
        self._begin_anew = False
        self._restarts = 0
        self._emergency = 0
        self._statusword = 0
        self._heartbeat_ns: int | None = None
        self._started_ns: int | None = None

    def hear_tpdo(self, stamp_ns: int, data: bytes) -> bool:
        """Take in one TPDO; False when it is not newer. Raises BadTelegram."""
        settings = self.settings
        try:
            values = self.mapping.decode(data)
        except BadTelegram as error:
            raise BadTelegram(f"node {settings.node}: {error}") from error
        # Drives send TPDOs when they are operational only.
        self._state, self._has_restarted = objects.OPERATIONAL, False
        self._statusword = values.get(objects.STATUSWORD, 0)
        segment = self.joint.segment
        newer = self._measure(stamp_ns, values)
        self._begin_anew = self._begin_anew and not newer
        if self.joint.segment != segment:
            self._comparison.begin_anew()
        position, velocity = self.mapping.position, self.mapping.velocity
        if newer and position is not None and velocity is not None:
            speed_radps = settings.velocity_radps(values[velocity.index])
            self._comparison.take(stamp_ns, values[position.index], speed_radps)
        return newer

    def hear_heartbeat(self, stamp_ns: int, data: bytes) -> None:
        """Take in a boot-up or heartbeat message. Raises BadTelegram."""
        if len(data) != 1:
            raise BadTelegram(f"node {self.settings.node}: heartbeat of {len(data)} bytes")
        state = data[0] & objects.STATE_MASK
        self._heartbeat_ns = stamp_ns
        if state == objects.BOOT_UP:
            self._begin_anew = self._has_restarted = True
            self._restarts += 1
            self._emergency = self._statusword = 0
            state = objects.PRE_OPERATIONAL
        if state == objects.OPERATIONAL:
            self._has_restarted = False
        self._state = state

    def hear_emergency(self, data: bytes) -> None:
        """Take in an EMCY message; code 00xx takes the last one back. Raises BadTelegram."""
        if len(data) != 8:
            raise BadTelegram(f"node {self.settings.node}: EMCY of {len(data)} bytes")
        code = int.from_bytes(data[:2], "little")
        self._emergency = code if code >> 8 else 0

    def wants_start(self, stamp_ns: int) -> bool:
        """Whether NMT "start" is to be sent now: it waits, and the last one is a second ago."""
        if self._state != objects.PRE_OPERATIONAL:
            return False
        if self._started_ns is not None and stamp_ns - self._started_ns < _START_AGAIN_NS:
            return False
        self._started_ns = stamp_ns
        return True

    def trouble(self, now_ns: int, heartbeat_s: float) -> str | None:
        """What hinders, or may falsify, its counting; the gravest thing."""
        name = f"node {self.settings.node}"
        if self._state == objects.PRE_OPERATIONAL:
            waits = (
                "has restarted and waits" if self._has_restarted else "is pre-operational: waits"
            )
            return f"{name} {waits} for NMT start, sends no counts"
        if self._state == objects.STOPPED:
            return f"{name} is stopped (NMT), sends no counts"
        if heartbeat_s and self._heartbeat_ns is not None:
            age_s = 1e-9 * (now_ns - self._heartbeat_ns)
            if age_s > heartbeat_s:
                return f"{name}: no heartbeat for {age_s:.1f} s"
        if self._emergency:
            return f"{name}: {objects.emergency_text(self._emergency)}"
        if objects.has_fault(self._statusword):
            state = objects.state_text(self._statusword)
            return f"{name} {state} (status word {self._statusword:04X}h)"
        text = self._comparison.text
        return text and f"{name}: {text}"

    def facts(self) -> list[tuple[str, str]]:
        """(name, value) pairs for the technician."""
        name = f"node {self.settings.node}"
        facts = [(f"{name} restarts", str(self._restarts))]
        if self._statusword:
            facts.append((name, objects.state_text(self._statusword)))
        return facts

    def _measure(self, stamp_ns: int, values: dict[int, int]) -> bool:
        joint, anew = self.joint, self._begin_anew
        value = values[self._measured.index]
        name = f"node {self.settings.node}"
        if isinstance(joint, SpeedIntegral):
            speed_radps = self.settings.velocity_radps(value)
            if abs(speed_radps) > self._limits.max_speed_radps:
                raise BadTelegram(f"{name}: the wheel cannot turn at {speed_radps:.3g} rad/s")
            joint.raw = value
            return joint.update(stamp_ns, speed_radps, restarted=anew)
        modulus = self.settings.modulus_counts
        if modulus and not -modulus <= 2 * value < 2 * modulus:
            raise BadTelegram(f"{name}: position is {value}, but wraps at {modulus}")
        if isinstance(joint, SteerAngle):
            joint.raw = value
            return joint.update(stamp_ns, self._scale * value, restarted=anew)
        assert isinstance(joint, WheelCounter)
        return joint.update(stamp_ns, value, restarted=anew)


class Comparison:
    """Does the position move as the velocity says? Tells wrong units from right ones."""

    def __init__(self, modulus: int, rad_per_count: float, limits: Limits) -> None:
        self._modulus = modulus
        self._rad_per_count = rad_per_count
        self._max_step_ns = round(1e9 * limits.max_speed_gap_s)
        self._last: tuple[int, int, float] | None = None
        self._moved_rad = self._said_rad = 0.0
        self.text: str | None = None
        """What is wrong, as long as it is."""

    def begin_anew(self) -> None:
        """The position has jumped: it says nothing about the way there."""
        self._last = None

    def take(self, stamp_ns: int, position: int, velocity_radps: float) -> None:
        """Both at one instant."""
        last, self._last = self._last, (stamp_ns, position, velocity_radps)
        if last is None or not 0 < stamp_ns - last[0] <= self._max_step_ns:
            return
        half = self._modulus // 2
        delta = (position - last[1] + half) % self._modulus - half
        self._moved_rad += delta * self._rad_per_count
        self._said_rad += 0.5e-9 * (stamp_ns - last[0]) * (velocity_radps + last[2])
        most = max(abs(self._moved_rad), abs(self._said_rad))
        if most < _COMPARED_RAD:
            return
        agree = abs(self._moved_rad - self._said_rad) <= _AGREE * most
        self.text = (
            None
            if agree
            else (
                f"the wheel turned by {self._moved_rad:+.2f} rad by its position and by "
                f"{self._said_rad:+.2f} rad by its velocity: check counts_per_revolution, "
                "velocity_unit, velocity_scale and the signs"
            )
        )
        self._moved_rad = self._said_rad = 0.0
