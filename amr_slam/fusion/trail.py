"""The wheels' path over the last seconds: any two instants in it give one composed motion.

The steps are kept as the wheels told them and composed anew for each question under the
calibration that the asker believes in: what is learned today also puts right what was driven
before the fix that taught it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from amr_slam.fusion.composing import NOMINAL, Composed, composed
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Motion

_ROOM = 256
_COLUMNS = ("_stamps", "_twists", "_noises", "_sums", "_doubted")
# The speed that goes on after the newest sample is the mean over this time: one step's quotient is
# counting noise.
_LATEST_NS = 100_000_000
# What a lag does is told by the speeds at both ends, means over this time to either side. Noise in
# them would be taken for something to learn from: short enough for a robot that accelerates.
_HALF_WINDOW_NS = 200_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Reported:
    """What the wheels have reported in all, forth and back summed."""

    travel_m: float
    turn_rad: float

    def since(self, earlier: Reported) -> Reported:
        """What was reported after ``earlier``."""
        return Reported(
            travel_m=self.travel_m - earlier.travel_m, turn_rad=self.turn_rad - earlier.turn_rad
        )


class Trail:
    """Successive motions of the base frame.

    A motion that a question cuts is cut at constant twist, its covariance in proportion to time.
    Before the first sample the robot stood; after the newest one it goes on as it last went.
    """

    def __init__(self, stamp_ns: int) -> None:
        # Row k ends at stamp k; row 0 is the beginning. Sums run from the filter's start.
        self._stamps = np.full(_ROOM, stamp_ns, dtype=np.int64)
        self._twists = np.zeros((_ROOM, 3))
        self._noises = np.zeros((_ROOM, 3, 3))
        self._sums = np.zeros((_ROOM, 6))  # twist, way, turn, gaps
        self._doubted = np.zeros(_ROOM, dtype=np.bool_)
        self._size = 1

    @property
    def start_ns(self) -> int:
        """The oldest instant that queries reach."""
        return int(self._stamps[0])

    @property
    def end_ns(self) -> int:
        """The newest wheel sample."""
        return int(self._stamps[self._size - 1])

    def append(self, motion: Motion) -> None:
        """Add the newest motion. Raises ValueError unless it starts where the trail ends."""
        if motion.start_ns != self.end_ns or motion.end_ns <= motion.start_ns:
            raise ValueError(
                f"motion {motion.start_ns}..{motion.end_ns} ns does not continue {self.end_ns} ns"
            )
        row = self._size
        if row == len(self._stamps):
            self._grow()
        twist = motion.delta.log()
        self._stamps[row], self._twists[row], self._noises[row] = (
            motion.end_ns,
            twist,
            motion.covariance,
        )
        self._sums[row] = self._sums[row - 1]
        self._sums[row, :3] += twist
        way = motion.delta.distance_to(Pose2.identity())
        self._sums[row, 3:] += (way, abs(motion.delta.theta_rad), motion.gap)
        self._size += 1

    def compose(
        self,
        start_ns: int,
        end_ns: int,
        calibration: Array = NOMINAL,
        pull: Array | None = None,
    ) -> Composed:
        """From one instant of the scans to another, either of which may be the earlier.

        ``calibration``: (4,) as :data:`NOMINAL`; its lag is the way from the scans' stamps to the
        wheels'. ``pull``: (3,) in the end's frame, what a fix there says of the motion:
        its residual over the residual's covariance. ``by_calibration`` is then taken along the way
        that the robot most likely went, and not along that of the noisy wheels.
        """
        if end_ns < start_ns:
            return self.compose(end_ns, start_ns, calibration).reversed()
        lag_ns = round(1e9 * float(calibration[3]))
        start_ns, end_ns = start_ns + lag_ns, end_ns + lag_ns
        change = self._sum_at(end_ns) - self._sum_at(start_ns)
        return composed(
            self._pieces(start_ns, end_ns),
            (self._rate(start_ns), self._rate(end_ns)),
            travel_m=float(change[3]),
            calibration=calibration,
            pull=pull,
        )

    def between(self, start_ns: int, end_ns: int) -> Motion:
        """What the wheels as they are say from one instant to another, on their own clock.

        Either may be the earlier. Raises ValueError outside the trail.
        """
        for stamp_ns in (start_ns, end_ns):
            if not self.start_ns <= stamp_ns <= self.end_ns:
                raise ValueError(
                    f"{stamp_ns} ns is outside the trail {self.start_ns}..{self.end_ns} ns"
                )
        motion = self.compose(start_ns, end_ns)
        return Motion(
            start_ns=start_ns,
            end_ns=end_ns,
            delta=motion.delta,
            covariance=motion.noise,
            gap=self.has_gap(*sorted((start_ns, end_ns))),
        )

    def has_gap(self, early_ns: int, late_ns: int) -> bool:
        """Whether the wheels could not tell somewhere between two instants of theirs."""
        stamps = self._stamps[: self._size]
        first = max(0, int(np.searchsorted(stamps, early_ns, side="right")) - 1)
        last = min(self._size - 1, int(np.searchsorted(stamps, late_ns, side="left")))
        return bool(self._sums[last, 5] > self._sums[first, 5])

    def reported(self, stamp_ns: int) -> Reported:
        """Way and turn up to an instant of the wheels, since the trail was begun."""
        sums = self._sum_at(stamp_ns)
        return Reported(travel_m=float(sums[3]), turn_rad=float(sums[4]))

    def twist_rate(self, start_ns: int, end_ns: int) -> Array:
        """(3,) mean twist per second between two instants of the wheels."""
        change: Array = (self._sum_at(end_ns) - self._sum_at(start_ns))[:3]
        return change / (1e-9 * (end_ns - start_ns))

    def samples_since(self, stamp_ns: int) -> int:
        """Number of wheel samples after an instant."""
        stamps = self._stamps[: self._size]
        return self._size - int(np.searchsorted(stamps, stamp_ns, side="right"))

    def node_before(self, stamp_ns: int) -> int:
        """Stamp of the last wheel sample at or before an instant, the oldest one at least."""
        row = int(np.searchsorted(self._stamps[: self._size], stamp_ns, side="right")) - 1
        return int(self._stamps[max(0, row)])

    def forget_before(self, stamp_ns: int) -> None:
        """Drop what is older than the last wheel sample at or before an instant."""
        cut = int(np.searchsorted(self._stamps[: self._size], stamp_ns, side="right")) - 1
        if cut <= 0:
            return
        for name in _COLUMNS:
            rows = getattr(self, name)
            rows[: self._size - cut] = rows[cut : self._size].copy()
        self._size -= cut

    def doubt_since(self, stamp_ns: int, factor: float) -> None:
        """Raise the noise of the steps that ended after an instant by a factor, each step once."""
        first = max(1, int(np.searchsorted(self._stamps[: self._size], stamp_ns, side="right")))
        fresh = np.flatnonzero(~self._doubted[first : self._size]) + first
        self._noises[fresh] *= factor
        self._doubted[fresh] = True

    def _grow(self) -> None:
        for name in _COLUMNS:
            rows = getattr(self, name)
            setattr(self, name, np.concatenate([rows, np.zeros_like(rows)]))

    def _pieces(self, start_ns: int, end_ns: int) -> tuple[Array, Array]:
        """(n, 3) twists and (n, 3, 3) noises of the steps between two instants of the wheels."""
        stamps = self._stamps[: self._size]
        newest_ns = int(stamps[-1])
        first = int(np.searchsorted(stamps, start_ns, side="right"))
        last = min(int(np.searchsorted(stamps, end_ns, side="left")), self._size - 1)
        rows = slice(max(first, 1), last + 1)
        lows, highs = stamps[rows.start - 1 : last], stamps[rows]
        cut = np.minimum(highs, end_ns) - np.maximum(lows, start_ns)
        share = cut / (highs - lows)
        twists = self._twists[rows] * share[:, None]
        noises = self._noises[rows] * share[:, None, None]
        if end_ns > newest_ns and self._size > 1:
            ahead_s = 1e-9 * (end_ns - max(newest_ns, start_ns))
            begin_ns = self.node_before(newest_ns - _LATEST_NS)
            since = int(np.searchsorted(stamps, begin_ns, side="right"))
            rate = ahead_s / (1e-9 * (newest_ns - begin_ns))
            twists = np.vstack([twists, rate * self._twists[since : self._size].sum(axis=0)])
            noise = rate * self._noises[since : self._size].sum(axis=0)
            noises = np.concatenate([noises, noise[None]])
        return twists, noises

    def _rate(self, stamp_ns: int) -> Array:
        """(3,) twist per second about an instant."""
        early_ns = max(self.start_ns, min(stamp_ns, self.end_ns) - _HALF_WINDOW_NS)
        late_ns = min(self.end_ns, max(stamp_ns, self.start_ns) + _HALF_WINDOW_NS)
        if late_ns <= early_ns:
            return np.zeros(3)
        return self.twist_rate(early_ns, late_ns)

    def _sum_at(self, stamp_ns: int) -> Array:
        """(6,) sums up to an instant; the last ones after the newest sample."""
        stamps = self._stamps[: self._size]
        after = int(np.searchsorted(stamps, stamp_ns, side="right"))
        if after in {0, self._size}:
            total: Array = self._sums[max(after - 1, 0)]
            return total
        before = after - 1
        share = (stamp_ns - stamps[before]) / (stamps[after] - stamps[before])
        between: Array = self._sums[before] + share * (self._sums[after] - self._sums[before])
        return between
