"""What the driver ``cia402`` is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from amr_drivers.can_odometry.settings import BusSettings, shaft_radps


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """One drive, its TPDO and its units."""

    node: Annotated[int, Ge(1), Le(127)]
    """Its CANopen node number."""
    tpdo_cob_id: Annotated[int, Ge(0), Le(0x7FF)] = 0
    """Identifier of the TPDO that is read (1800h:01); 0: 180h + node, the first one's."""
    mapping: tuple[int, ...] = (0x6064_0020, 0x606C_0020)
    """What the TPDO holds, as in 1A00h: index, subindex, bits. 6064h, 6063h, 6004h: position;
    606Ch, 6044h: velocity; 6041h: status word; the bits of others are skipped."""
    measures: Literal["position", "velocity"] = "position"
    """What is counted; the other one, if it is mapped, is compared with it."""
    counts_per_revolution: Annotated[int, Gt(0)] = 4096
    """Position units in one turn of the motor, as 608Fh, 6091h and the gear settings make them."""
    gear_ratio: Annotated[float, Gt(0)] = 1.0
    """Turns of the motor in one turn of the wheel."""
    sign: Literal[1, -1] = 1
    """-1 where the position falls when the robot drives forward (mirrored mounting)."""
    modulus_counts: Annotated[int, Ge(0)] = 0
    """After how many units the position wraps (607Bh, 6002h); 0: at its mapped bits."""
    velocity_unit: Literal["counts/s", "rpm", "rad/s"] = "counts/s"
    """Of the motor."""
    velocity_scale: Annotated[float, Gt(0)] = 1.0
    """What one unit of 606Ch is in ``velocity_unit``: 0.0001 where 10000 are 1 rpm."""
    velocity_sign: Literal[1, -1] = 1
    """-1 where the velocity has another sign than the position."""

    @property
    def cob_id(self) -> int:
        return self.tpdo_cob_id or 0x180 + self.node

    def velocity_radps(self, value: int) -> float:
        """The wheel's speed, forward positive, for a velocity as the TPDO has it."""
        shaft = shaft_radps(
            value * self.velocity_scale, self.velocity_unit, self.counts_per_revolution
        )
        return self.sign * self.velocity_sign * shaft / self.gear_ratio


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings(BusSettings):
    """The bus, the drives on it and how they are watched."""

    left: NodeSettings = field(default_factory=lambda: NodeSettings(node=1))
    """The left wheel's drive, seen in driving direction."""
    right: NodeSettings = field(default_factory=lambda: NodeSettings(node=2))
    """The right wheel's."""
    drive: NodeSettings | None = None
    """A tricycle's traction drive; with ``steer``, and then left and right are not used."""
    steer: NodeSettings | None = None
    """A tricycle's steering drive: its position is the absolute angle."""
    sync: bool = False
    """TPDOs are synchronous (1800h:02 = 1): stamped with the SYNC that they follow."""
    sync_cob_id: Annotated[int, Ge(1), Le(0x7FF)] = 0x80
    """Identifier of SYNC (1005h)."""
    sync_window_s: Annotated[float, Gt(0), Le(1)] = 0.01
    """A TPDO that comes later after its SYNC may belong to another one: dropped."""
    heartbeat_s: Annotated[float, Ge(0), Le(60)] = 1.0
    """A drive that gave heartbeats and gives none for so long is named; 0: not watched."""
    start_nodes: bool = False
    """Send NMT "start" to drives that wait pre-operational. Off: the driver only listens."""

    def __post_init__(self) -> None:
        if (self.drive is None) != (self.steer is None):
            raise ValueError("drive and steer belong together: a tricycle needs both")
        if self.steer is not None and self.steer.measures != "position":
            raise ValueError("steer: a steering angle is a position")
        nodes = list(self.nodes.values())
        if len({n.node for n in nodes}) < len(nodes) or len({n.cob_id for n in nodes}) < len(nodes):
            raise ValueError("two drives have the same node number or TPDO identifier")

    @property
    def nodes(self) -> dict[str, NodeSettings]:
        """The drives by the joints' names."""
        if self.drive is not None and self.steer is not None:
            return {"drive": self.drive, "steer": self.steer}
        return {"left": self.left, "right": self.right}

    @property
    def joints(self) -> tuple[str, ...]:
        """What samples tell: the ``[drive]`` must be made for it."""
        return tuple(self.nodes)
