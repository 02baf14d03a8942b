"""All joints at one instant, also when their values come at several. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

from amr_drivers.can_odometry.counting import JointAngle, SteerAngle
from amr_slam.samples import JointSample, WheelSample

_STUCK_RAD: Final = 4.0 * math.pi
"""Two turns of one wheel about another one that counts nothing: a rare manoeuvre."""


class Pairing:
    """Joints by name to samples: left and right to :class:`WheelSample`, others to
    :class:`JointSample`."""

    def __init__(self, joints: Mapping[str, JointAngle]) -> None:
        self._joints = joints
        self._used_ns: dict[str, int] = {}
        self._newest_ns: int | None = None
        self._segment = 0
        self._angles: dict[str, float] = {}
        self._still_rad = {
            name: 0.0 for name, joint in joints.items() if not isinstance(joint, SteerAngle)
        }

    def sample(self) -> WheelSample | JointSample | None:
        """A sample once every joint has a newer value than in the last sample; else None.

        Its stamp is that of the joint heard first; the others are interpolated to it, so that no
        skew is left. Where the one heard first is due again sooner, its next value is waited for:
        a sample is never later than half a period. A joint without two values about that instant
        gives no sample.
        """
        heard_ns = {
            name: joint.stamp_ns
            for name, joint in self._joints.items()
            if joint.stamp_ns is not None and joint.stamp_ns != self._used_ns.get(name)
        }
        if len(heard_ns) < len(self._joints):
            return None
        oldest = min(heard_ns, key=lambda name: heard_ns[name])
        stamp_ns, skew_ns = heard_ns[oldest], max(heard_ns.values()) - heard_ns[oldest]
        if 2 * skew_ns > self._joints[oldest].interval_ns:
            return None
        if self._newest_ns is not None and stamp_ns <= self._newest_ns:
            return None
        angles: dict[str, float] = {}
        for name, joint in self._joints.items():
            angle_rad = joint.angle_at(stamp_ns)
            if angle_rad is None:
                return None
            steers = isinstance(joint, SteerAngle)
            angles[name] = math.remainder(angle_rad, 2.0 * math.pi) if steers else angle_rad
        segment = sum(joint.segment for joint in self._joints.values())
        self._watch(angles, segment)
        self._newest_ns, self._segment, self._angles = stamp_ns, segment, angles
        self._used_ns = heard_ns
        return _sample(stamp_ns, angles, segment)

    def hint(self) -> str | None:
        """A wheel that seems to be stuck: only the scans can tell whether it is."""
        for name, others_rad in self._still_rad.items():
            if others_rad > _STUCK_RAD:
                return (
                    f"the {name} wheel counts nothing while the other one turned by "
                    f"{others_rad:.0f} rad"
                )
        return None

    def _watch(self, angles: Mapping[str, float], segment: int) -> None:
        if not self._angles or segment != self._segment:
            return
        moved = {name: abs(angles[name] - self._angles[name]) for name in self._still_rad}
        for name, own in moved.items():
            others = max((rad for other, rad in moved.items() if other != name), default=0.0)
            self._still_rad[name] = 0.0 if own else self._still_rad[name] + others


def _sample(stamp_ns: int, angles: Mapping[str, float], segment: int) -> WheelSample | JointSample:
    if tuple(angles) == ("left", "right"):
        return WheelSample(
            stamp_ns=stamp_ns, left_rad=angles["left"], right_rad=angles["right"], segment=segment
        )
    return JointSample(
        stamp_ns=stamp_ns,
        names=tuple(angles),
        angles_rad=tuple(angles.values()),
        segment=segment,
    )
