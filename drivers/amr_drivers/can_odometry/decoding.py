"""What the decoders of all kinds of frames have in common. Pure."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Final

from amr_drivers.can_odometry.counting import JointAngle
from amr_drivers.can_odometry.frames import Filter, Frame
from amr_drivers.can_odometry.pairing import Pairing
from amr_drivers.errors import BadTelegram
from amr_slam.samples import JointSample, WheelSample

# Linux: include/uapi/linux/can/error.h. The gravest first.
_BUS_OFF: Final = 0x040
_CLASS_OF_ERROR: Final = (
    (0x020, "no acknowledgement"),
    (0x010, "transceiver error"),
    (0x080, "bus errors"),
    (0x008, "protocol errors"),
    (0x001, "sending timed out"),
)
_CONTROLLER_ERROR: Final = 0x004
_CONTROLLER_STATES: Final = (
    (0x30, "error-passive: the bus is about to be lost"),
    (0x03, "frames lost: the interface's buffer ran over"),
    (0x0C, "many errors on the bus (error-warning)"),
)


class JointsDecoder(ABC):
    """A :class:`FrameDecoder` but for its filters: error frames, samples, health.

    A subclass feeds the joints, and raises BadTelegram for what it cannot read.
    """

    def __init__(self, joints: Mapping[str, JointAngle], silence_s: float, start_ns: int) -> None:
        """``start_ns``: since when frames could have come."""
        self._joints = joints
        self._pairing = Pairing(joints)
        self._silence_s = silence_s
        self._start_ns = start_ns
        self._errors = 0
        self._dropped = 0
        self._hindrance: str | None = None

    @property
    @abstractmethod
    def filters(self) -> list[Filter]: ...

    @abstractmethod
    def _feed(self, frame: Frame) -> bool | None:
        """Take in one data frame: True when a joint has a newer value, False when the frame came
        twice or late, None when it is about something else."""

    def received(self, frame: Frame) -> list[WheelSample | JointSample]:
        """See :meth:`FrameDecoder.received`."""
        # First of all: an error frame's id looks like that of a common frame.
        if frame.is_error:
            self._errors += 1
            self._hindrance = _error_text(frame) or self._hindrance
            return []
        if frame.is_remote:
            return []
        try:
            newer = self._feed(frame)
        except BadTelegram as reason:
            self._errors += 1
            self._hindrance = str(reason)
            return []
        if newer is None:
            return []
        if not newer:
            self._dropped += 1
            return []
        self._hindrance = None
        sample = self._pairing.sample()
        return [] if sample is None else [sample]

    def to_send(self) -> list[Frame]:
        """See :meth:`FrameDecoder.to_send`; nothing, unless a subclass says otherwise."""
        return []

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :meth:`FrameDecoder.status`."""
        texts = (
            self._hindrance,
            self._device_text(now_ns),
            self._silence_text(now_ns),
            self._pairing.hint(),
        )
        return self._errors + self._dropped, next(filter(None, texts), None)

    def facts(self) -> tuple[tuple[str, str], ...]:
        """See :meth:`FrameDecoder.facts`."""
        frames = ", ".join(f"{wanted.identifier:#x}" for wanted in self.filters)
        raw = [
            (f"{name} value", f"{j.raw:g}") for name, j in self._joints.items() if j.raw is not None
        ]
        anew = sum(joint.segment for joint in self._joints.values())
        return (("frames", frames), *raw, ("counting started anew", str(anew)))

    def _device_text(self, _now_ns: int) -> str | None:
        """What the senders say of themselves, where they can."""
        return None

    def _silence_text(self, now_ns: int) -> str | None:
        ages_s = {
            name: (now_ns - (self._start_ns if joint.stamp_ns is None else joint.stamp_ns)) * 1e-9
            for name, joint in self._joints.items()
        }
        silent = [name for name, age_s in ages_s.items() if age_s > self._silence_s]
        if not silent:
            return None
        oldest_s = max(ages_s[name] for name in silent)
        return f"no {' and '.join(silent)} wheel counts for {oldest_s:.1f} s"


def _error_text(frame: Frame) -> str | None:
    """None: nothing that goes on, as lost arbitration or a bus that was restarted."""
    if frame.identifier & _BUS_OFF:
        return "bus-off"
    if frame.identifier & _CONTROLLER_ERROR and len(frame.data) > 1:
        for bits, text in _CONTROLLER_STATES:
            if frame.data[1] & bits:
                return text
    for bit, text in _CLASS_OF_ERROR:
        if frame.identifier & bit:
            return text
    return None
