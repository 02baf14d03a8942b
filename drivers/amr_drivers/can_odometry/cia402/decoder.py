"""CANopen frames of the drives to samples. Pure: no bus, no clock."""

from __future__ import annotations

from amr_drivers.can_odometry.cia402 import objects
from amr_drivers.can_odometry.cia402.node import Node
from amr_drivers.can_odometry.cia402.settings import Settings
from amr_drivers.can_odometry.decoding import JointsDecoder
from amr_drivers.can_odometry.frames import Filter, Frame

_MASK = 0x7FF


class Cia402Decoder(JointsDecoder):
    """Frames in, wheel samples out; watches the nodes. Raises ValueError for a mapping that cannot
    be used."""

    def __init__(self, settings: Settings, start_ns: int) -> None:
        self._settings = settings
        self._nodes = [
            Node(node, settings.limits, steers=name == "steer")
            for name, node in settings.nodes.items()
        ]
        joints = {name: node.joint for name, node in zip(settings.nodes, self._nodes, strict=True)}
        super().__init__(joints, settings.silence_s, start_ns)
        self._by_tpdo = {node.settings.cob_id: node for node in self._nodes}
        self._by_number = {node.settings.node: node for node in self._nodes}
        self._sync_ns: int | None = None
        self._outgoing: list[Frame] = []
        if settings.start_nodes:
            self._outgoing = [_start(node.settings.node, start_ns) for node in self._nodes]

    @property
    def filters(self) -> list[Filter]:
        identifiers = list(self._by_tpdo)
        for number in self._by_number:
            identifiers += [objects.EMCY + number, objects.HEARTBEAT + number]
        if self._settings.sync:
            identifiers.append(self._settings.sync_cob_id)
        return [Filter(identifier=identifier, mask=_MASK) for identifier in identifiers]

    def to_send(self) -> list[Frame]:
        """NMT "start" for nodes that wait, where that is wanted."""
        frames, self._outgoing = self._outgoing, []
        return frames

    def facts(self) -> tuple[tuple[str, str], ...]:
        """See :meth:`FrameDecoder.facts`."""
        own = [fact for node in self._nodes for fact in node.facts()]
        return (*super().facts(), *own)

    def _feed(self, frame: Frame) -> bool | None:
        if frame.is_extended:
            return None
        identifier, stamp_ns = frame.identifier, frame.stamp_ns
        if identifier in self._by_tpdo:
            return self._take_tpdo(self._by_tpdo[identifier], frame)
        if self._settings.sync and identifier == self._settings.sync_cob_id:
            if self._sync_ns is None or stamp_ns > self._sync_ns:
                self._sync_ns = stamp_ns
            return None
        node = self._by_number.get(identifier & 0x7F)
        if node is None:
            return None
        if identifier & ~0x7F == objects.HEARTBEAT:
            node.hear_heartbeat(stamp_ns, frame.data)
            if self._settings.start_nodes and node.wants_start(stamp_ns):
                self._outgoing.append(_start(node.settings.node, stamp_ns))
        elif identifier & ~0x7F == objects.EMCY:
            node.hear_emergency(frame.data)
        return None

    def _take_tpdo(self, node: Node, frame: Frame) -> bool:
        stamp_ns = frame.stamp_ns
        if self._settings.sync:
            window_ns = round(1e9 * self._settings.sync_window_s)
            if self._sync_ns is None or not 0 <= stamp_ns - self._sync_ns <= window_ns:
                return False
            # A second one after the same SYNC is not newer, and dropped.
            stamp_ns = self._sync_ns
        return node.hear_tpdo(stamp_ns, frame.data)

    def _device_text(self, now_ns: int) -> str | None:
        troubles = [node.trouble(now_ns, self._settings.heartbeat_s) for node in self._nodes]
        if found := [text for text in troubles if text is not None]:
            return "; ".join(found)
        if self._settings.sync:
            since_ns = self._start_ns if self._sync_ns is None else self._sync_ns
            age_s = 1e-9 * (now_ns - since_ns)
            if age_s > self._settings.silence_s:
                return f"no SYNC for {age_s:.1f} s"
        return None


def _start(node: int, stamp_ns: int) -> Frame:
    return Frame(stamp_ns=stamp_ns, identifier=objects.NMT, data=bytes([objects.START, node]))
