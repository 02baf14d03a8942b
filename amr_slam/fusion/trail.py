"""The wheels' path over the last seconds: any two instants in it give one composed motion.

Positions and summed noise are kept at each wheel sample in one common frame, so that a query is
two look-ups and a difference, whatever the number of samples between.
"""

from __future__ import annotations

import bisect

import numpy as np

from amr_slam.geometry import Array, Pose2, interpolate
from amr_slam.samples import Motion


class Trail:
    """Successive motions of the base frame.

    A motion that a query cuts is cut at constant twist, its covariance in proportion to time. The
    sum of the noise in a common frame is that of the composed motion to first order, exactly what
    the EKF would reach stepwise (covariances propagated along the same path).
    """

    def __init__(self, stamp_ns: int) -> None:
        self._stamps_ns = [stamp_ns]
        self._trail_from_base = [Pose2.identity()]
        self._noise: list[Array] = [np.zeros((3, 3))]  # left perturbation: in the trail frame
        self._travel_m = [0.0]
        self._gaps = [0]

    @property
    def start_ns(self) -> int:
        """The oldest instant that queries reach."""
        return self._stamps_ns[0]

    @property
    def end_ns(self) -> int:
        """The newest wheel sample."""
        return self._stamps_ns[-1]

    def append(self, motion: Motion) -> None:
        """Add the newest motion. Raises ValueError unless it starts where the trail ends."""
        if motion.start_ns != self.end_ns or motion.end_ns <= motion.start_ns:
            raise ValueError(
                f"motion {motion.start_ns}..{motion.end_ns} ns does not continue {self.end_ns} ns"
            )
        end = self._trail_from_base[-1] @ motion.delta
        carry = end.adjoint()
        self._stamps_ns.append(motion.end_ns)
        self._trail_from_base.append(end)
        self._noise.append(self._noise[-1] + carry @ motion.covariance @ carry.T)
        self._travel_m.append(self._travel_m[-1] + motion.delta.distance_to(Pose2.identity()))
        self._gaps.append(self._gaps[-1] + motion.gap)

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """The motion from one instant to another (either may be the earlier).

        Raises ValueError outside the trail.
        """
        start, start_noise, _ = self._at(start_ns)
        end, end_noise, _ = self._at(end_ns)
        carry = end.inverse().adjoint()
        noise = end_noise - start_noise if end_ns >= start_ns else start_noise - end_noise
        return Motion(
            start_ns=start_ns,
            end_ns=end_ns,
            delta=start.inverse() @ end,
            covariance=carry @ noise @ carry.T,
            gap=self._gap_between(*sorted((start_ns, end_ns))),
        )

    def travelled_m(self, stamp_ns: int) -> float:
        """Length of the path up to an instant, since the trail was begun.

        Raises ValueError outside the trail.
        """
        return self._at(stamp_ns)[2]

    def node_before(self, stamp_ns: int) -> int:
        """Stamp of the last wheel sample at or before an instant, the oldest one at least."""
        return self._stamps_ns[max(0, bisect.bisect_right(self._stamps_ns, stamp_ns) - 1)]

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what is older than a wheel sample's stamp and move the common frame there.

        The frame stays near the robot: far from its origin the differences would lose digits.
        """
        cut = bisect.bisect_left(self._stamps_ns, stamp_ns)
        new_from_trail = self._trail_from_base[cut].inverse()
        carry = new_from_trail.adjoint()
        noise = np.stack(self._noise[cut:])
        self._noise = list(carry @ (noise - noise[0]) @ carry.T)
        self._trail_from_base = [new_from_trail @ pose for pose in self._trail_from_base[cut:]]
        del self._stamps_ns[:cut], self._travel_m[:cut], self._gaps[:cut]

    def _at(self, stamp_ns: int) -> tuple[Pose2, Array, float]:
        """Pose, summed noise and travel at an instant."""
        if stamp_ns == self._stamps_ns[-1]:
            return self._trail_from_base[-1], self._noise[-1], self._travel_m[-1]
        after = bisect.bisect_right(self._stamps_ns, stamp_ns)
        if not 0 < after < len(self._stamps_ns):
            raise ValueError(
                f"{stamp_ns} ns is outside the trail {self.start_ns}..{self.end_ns} ns"
            )
        before = after - 1
        begin_ns = self._stamps_ns[before]
        if stamp_ns == begin_ns:
            return self._trail_from_base[before], self._noise[before], self._travel_m[before]
        share = (stamp_ns - begin_ns) / (self._stamps_ns[after] - begin_ns)
        return (
            interpolate(self._trail_from_base[before], self._trail_from_base[after], share),
            self._noise[before] + share * (self._noise[after] - self._noise[before]),
            self._travel_m[before] + share * (self._travel_m[after] - self._travel_m[before]),
        )

    def _gap_between(self, early_ns: int, late_ns: int) -> bool:
        first = bisect.bisect_right(self._stamps_ns, early_ns) - 1
        last = bisect.bisect_left(self._stamps_ns, late_ns)
        return self._gaps[last] > self._gaps[first]
