"""What stands in the drives' telegrams: mapped objects, status words, error codes.

Pure. Source: protocol fact sheet, section E.1; CiA 301 (NMT, EMCY, PDO), CiA 402 (6041h, 6064h).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from amr_drivers.errors import BadTelegram

STATUSWORD: Final = 0x6041
POSITIONS: Final = {0x6064: True, 0x6063: True, 0x6004: False}
"""Object: whether it is signed. Position in user units, in increments; CiA 406 encoders."""
VELOCITIES: Final = {0x606C: True, 0x6044: True}
"""Velocity actual value; of the velocity mode."""

NMT: Final = 0x000
SYNC: Final = 0x080
EMCY: Final = 0x080
TPDO1: Final = 0x180
HEARTBEAT: Final = 0x700
START: Final = 0x01
BOOT_UP: Final = 0x00
STOPPED: Final = 0x04
OPERATIONAL: Final = 0x05
PRE_OPERATIONAL: Final = 0x7F
STATE_MASK: Final = 0x7F
"""The eighth bit of a heartbeat is node guarding's toggle."""

_STATES: Final = (
    (0x4F, 0x0F, "reacts to a fault"),
    (0x4F, 0x08, "has a fault"),
    (0x6F, 0x07, "quick stop"),
    (0x6F, 0x27, "operation enabled"),
    (0x6F, 0x23, "switched on"),
    (0x6F, 0x21, "ready to switch on"),
    (0x4F, 0x40, "switch-on disabled"),
    (0x4F, 0x00, "not ready to switch on"),
)
_EMERGENCIES: Final = {
    0x8110: "CAN overrun, frames lost",
    0x8120: "CAN error-passive",
    0x8130: "heartbeat or life guard of its master is missing",
    0x8140: "back from bus-off",
    0x8611: "following error",
    0x7300: "sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x1000: "generic error",
}
_CLASSES: Final = {
    0x10: "generic error",
    0x20: "current",
    0x30: "voltage",
    0x40: "temperature",
    0x50: "drive hardware",
    0x60: "drive software",
    0x70: "additional module",
    0x80: "monitoring",
    0x90: "external error",
    0xF0: "additional function",
    0xFF: "manufacturer's own",
}


@dataclass(frozen=True, slots=True)
class Field:
    """One mapped object: where its bits are."""

    index: int
    offset: int
    bits: int
    is_signed: bool


class Mapping:
    """What one TPDO holds: entries as in 1A00h, ``index << 16 | subindex << 8 | bits``.

    Raises ValueError for an entry without bits, more than 64 bits, or no position or velocity.
    """

    def __init__(self, entries: Sequence[int]) -> None:
        self._fields: dict[int, Field] = {}
        offset = 0
        for entry in entries:
            index, bits = entry >> 16, entry & 0xFF
            if not (0 < index <= 0xFFFF and 0 < bits <= 64):
                raise ValueError(f"mapping: {entry:#x} is not index << 16 | subindex << 8 | bits")
            is_signed = POSITIONS.get(index, False) or VELOCITIES.get(index, False)
            self._fields[index] = Field(index, offset, bits, is_signed)
            offset += bits
        if offset > 64:
            raise ValueError(f"mapping: {offset} bits do not fit into 8 bytes")
        self.length = (offset + 7) // 8
        """Bytes of the TPDO."""
        self.position = next((f for i, f in self._fields.items() if i in POSITIONS), None)
        self.velocity = next((f for i, f in self._fields.items() if i in VELOCITIES), None)
        if self.position is None and self.velocity is None:
            raise ValueError("mapping: neither a position (6064h) nor a velocity (606Ch)")

    def decode(self, data: bytes) -> dict[int, int]:
        """Values by the objects' indices. Raises BadTelegram for another length."""
        if len(data) != self.length:
            raise BadTelegram(f"TPDO has {len(data)} bytes, the mapping says {self.length}")
        packed = int.from_bytes(data, "little")
        values = {}
        for index, field in self._fields.items():
            value = packed >> field.offset & ((1 << field.bits) - 1)
            if field.is_signed and value >> (field.bits - 1):
                value -= 1 << field.bits
            values[index] = value
        return values

    def encode(self, values: dict[int, int]) -> bytes:
        """The TPDO with these values, cut to their bits; objects without a value are 0."""
        packed = 0
        for index, field in self._fields.items():
            packed |= (values.get(index, 0) & ((1 << field.bits) - 1)) << field.offset
        return packed.to_bytes(self.length, "little")


def state_text(statusword: int) -> str:
    """The power state machine's state."""
    return next((text for mask, value, text in _STATES if statusword & mask == value), "unknown")


def has_fault(statusword: int) -> bool:
    """Whether the drive has a fault or reacts to one."""
    return statusword & 0x48 == 0x08


def emergency_text(code: int) -> str:
    """What an emergency's code means."""
    meaning = _EMERGENCIES.get(code) or _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0)
    return f"EMCY {code:04X}h" + (f", {meaning}" if meaning else "")
