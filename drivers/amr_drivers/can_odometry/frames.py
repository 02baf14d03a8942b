"""What turns CAN frames into samples. Pure: no bus, no clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from amr_slam.samples import CanFrame as Frame
from amr_slam.samples import JointSample, WheelSample

__all__ = ["Filter", "Frame", "FrameDecoder"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Filter:
    """Which frames are wanted: those that equal ``identifier`` in the bits of ``mask``."""

    identifier: int
    mask: int
    is_extended: bool = False

    def lets_pass(self, frame: Frame) -> bool:
        return (
            frame.is_extended == self.is_extended
            and (frame.identifier ^ self.identifier) & self.mask == 0
        )


class FrameDecoder(Protocol):
    """Frames of one bus to samples. Pure: the same frames give the same samples, so that a
    recording of them gives the samples again. Time is that of the frames' stamps."""

    @property
    def filters(self) -> list[Filter]:
        """The frames that are wanted; others may be given and are ignored."""

    def received(self, frame: Frame) -> list[WheelSample | JointSample]:
        """Take in the next frame; the samples that it completes. Damage is counted."""

    def to_send(self) -> list[Frame]:
        """What is to be sent now; each frame is handed out once."""

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """(unusable frames so far, what hinders counting at ``now_ns`` or None)."""

    def facts(self) -> tuple[tuple[str, str], ...]:
        """(name, value) pairs for the technician."""
