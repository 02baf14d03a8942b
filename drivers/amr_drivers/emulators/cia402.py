"""Two drives that speak CANopen by the CiA 402 profile, as far as a listener can tell.

No bus here: frames in, frames out, all by the stamps that the caller gives.
"""

from __future__ import annotations

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.settings import NodeSettings, Settings
from amr_drivers.can_odometry.counting import rad_per_count
from amr_drivers.can_odometry.frames import Frame

_ENABLED = 0x0237
_FAULT = 0x0218


class EmulatedDrive:
    """One drive. It starts pre-operational, as after power-on, and counts from 0."""

    def __init__(self, settings: NodeSettings) -> None:
        self.settings = settings
        self._mapping = objects.Mapping(settings.mapping)
        self._scale = rad_per_count(
            settings.counts_per_revolution, settings.gear_ratio, settings.sign
        )
        self._zero_rad = 0.0
        self._angle_rad = self._speed_radps = 0.0
        self._emergency = 0
        self.state = objects.PRE_OPERATIONAL
        self.silent = False
        """True: it is cut off the bus and hears and sends nothing."""

    def turn(self, angle_rad: float, dt_s: float) -> None:
        """Its wheel has turned evenly to this angle within the last ``dt_s``."""
        self._speed_radps = (angle_rad - self._angle_rad) / dt_s
        self._angle_rad = angle_rad

    def hear(self, frame: Frame) -> list[Frame]:
        """A frame on the bus: NMT commands are obeyed, the rest is not for it."""
        data = frame.data
        if self.silent or frame.identifier != objects.NMT or len(data) != 2:
            return []
        if data[1] not in {0, self.settings.node}:
            return []
        if data[0] in {0x81, 0x82}:
            return self.reboot(frame.stamp_ns)
        states = {
            objects.START: objects.OPERATIONAL,
            0x02: objects.STOPPED,
            0x80: objects.PRE_OPERATIONAL,
        }
        self.state = states.get(data[0], self.state)
        return []

    def tpdo(self, stamp_ns: int) -> list[Frame]:
        """Its TPDO, when it is operational."""
        if self.silent or self.state != objects.OPERATIONAL:
            return []
        settings = self.settings
        speed = self._speed_radps / settings.velocity_radps(1)
        modulus = settings.modulus_counts or 1 << 64
        count = round((self._angle_rad - self._zero_rad) / self._scale) % modulus
        values = dict.fromkeys(objects.POSITIONS, count)
        values |= dict.fromkeys(objects.VELOCITIES, round(speed))
        values[objects.STATUSWORD] = _FAULT if self._emergency else _ENABLED
        data = self._mapping.encode(values)
        return [Frame(stamp_ns=stamp_ns, identifier=settings.cob_id, data=data)]

    def heartbeat(self, stamp_ns: int) -> list[Frame]:
        """The state that it is in."""
        return self._tell(stamp_ns, objects.HEARTBEAT, bytes([self.state]))

    def reboot(self, stamp_ns: int, *, keeps_position: bool = False) -> list[Frame]:
        """Power lost and back: boot-up message, then it waits pre-operational; counts from 0 again
        unless its encoder is absolute."""
        self.state = objects.PRE_OPERATIONAL
        self._emergency = 0
        self._zero_rad = self._zero_rad if keeps_position else self._angle_rad
        return self._tell(stamp_ns, objects.HEARTBEAT, bytes([objects.BOOT_UP]))

    def fail(self, stamp_ns: int, code: int) -> list[Frame]:
        """An emergency, and a fault in the status word; code 0 takes both back."""
        self._emergency = code
        data = code.to_bytes(2, "little") + bytes([1 if code else 0]) + bytes(5)
        return self._tell(stamp_ns, objects.EMCY, data)

    def _tell(self, stamp_ns: int, service: int, data: bytes) -> list[Frame]:
        if self.silent:
            return []
        identifier = service + self.settings.node
        return [Frame(stamp_ns=stamp_ns, identifier=identifier, data=data)]


class EmulatedDrives:
    """All drives of a robot, and a master that sends SYNC where the drives want it."""

    def __init__(self, settings: Settings, *, started: bool = True) -> None:
        """``started``: a master has started them already."""
        self._settings = settings
        self.drives = {name: EmulatedDrive(node) for name, node in settings.nodes.items()}
        for drive in self.drives.values():
            drive.state = objects.OPERATIONAL if started else drive.state

    def hear(self, frame: Frame) -> list[Frame]:
        """A frame from the host; the answers."""
        return [answer for drive in self.drives.values() for answer in drive.hear(frame)]

    def cycle(self, stamp_ns: int, angles_rad: dict[str, float], dt_s: float) -> list[Frame]:
        """One period: the wheels have come to these angles. SYNC and all TPDOs, each of the latter
        0.3 ms after the one before it."""
        frames = []
        if self._settings.sync:
            frames.append(Frame(stamp_ns=stamp_ns, identifier=self._settings.sync_cob_id))
        for place, (name, drive) in enumerate(self.drives.items(), start=1):
            drive.turn(angles_rad[name], dt_s)
            frames += drive.tpdo(stamp_ns + 300_000 * place)
        return frames

    def heartbeats(self, stamp_ns: int) -> list[Frame]:
        """One heartbeat of each."""
        return [frame for drive in self.drives.values() for frame in drive.heartbeat(stamp_ns)]
