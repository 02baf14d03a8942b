"""All that is done to a localizer, in its order, told to whoever records it.

Samples are told by themselves (they stand in the recording as such); what else moves the state is a
decision: an answer of the registration, a pose that somebody names, a request that was given up,
an instant at which a pose was asked for. From the state at one moment and the decisions after it
the same poses follow, bit for bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from amr_slam.fusion.ekf import Ekf
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer, Sample
from amr_slam.odometry import Odometry
from amr_slam.region import Region
from amr_slam.rerun.state import Plain, taken_apart
from amr_slam.samples import Outcome, PoseEstimate
from amr_slam.seeking import Seek
from amr_slam.slam_request import SlamResult
from amr_slam.states import Mode

SNAPSHOT: Final = "snapshot"
DRIVE: Final = "drive"
EKF: Final = "ekf"
_OWN: Final = frozenset({"_sink", "_known", "_period_ns", "_next_ns"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """One of them."""

    stamp_ns: int
    """When, by the daemon's clock."""
    do: str
    """A method's name, or ``snapshot``."""
    arguments: Plain


Sink = Callable[[Decision], object]


class WitnessedLocalizer(Localizer):
    """Tells of all that is done to it, and now and then of its whole state."""

    _sink: Sink | None = None
    _known: Mapping[type, str]
    _period_ns = _next_ns = 0

    def witness(self, sink: Sink, drive: Odometry, period_s: float) -> None:
        """From now on. ``drive``: the robot's own, which its configuration tells. ``period_s``:
        between two snapshots, what a replay loses of the beginning of a ring."""
        self._sink, self._known = sink, {type(drive): DRIVE, Ekf: EKF}
        self._period_ns = round(1e9 * period_s)

    def handle(self, sample: Sample) -> Outcome:
        """See :class:`Localizer`."""
        self._snapshot()
        if isinstance(sample, SlamResult):
            self._tell("answer", sample)
        return super().handle(sample)

    def drop_request(self) -> None:
        """See :class:`Localizer`."""
        self._tell("drop_request")
        super().drop_request()

    def seek(self, region: Region) -> Seek:
        """See :class:`Localizer`."""
        self._tell("seek", region)
        return super().seek(region)

    def abandon(self, seek: Seek, reason: str) -> None:
        """See :class:`Localizer`."""
        self._tell("abandon", reason)
        super().abandon(seek, reason)

    def place(self, map_from_base: Pose2, covariance: Array) -> None:
        """See :class:`Localizer`."""
        self._tell("place", map_from_base, covariance)
        super().place(map_from_base, covariance)

    def forget(self) -> None:
        """See :class:`Localizer`."""
        self._tell("forget")
        super().forget()

    def restart(self, mode: Mode, keeps_pose: bool = False) -> None:  # noqa: FBT001 - recorded
        """See :class:`Localizer`."""
        self._tell("restart", mode, keeps_pose)
        super().restart(mode, keeps_pose)

    def go_on_mapping(self) -> None:
        """See :class:`Localizer`."""
        self._tell("go_on_mapping")
        super().go_on_mapping()

    def estimate(self, now_ns: int) -> PoseEstimate | None:
        """See :class:`Localizer`."""
        self._tell("estimate", now_ns)
        return super().estimate(now_ns)

    def _tell(self, do: str, *arguments: Any) -> None:
        if self._sink is not None:
            plain = [taken_apart(argument, {}) for argument in arguments]
            self._sink(Decision(stamp_ns=time.monotonic_ns(), do=do, arguments=plain))

    def _snapshot(self) -> None:
        now_ns = time.monotonic_ns()
        if self._sink is None or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._period_ns
        state = {name: part for name, part in vars(self).items() if name not in _OWN}
        plain = taken_apart(state, self._known)
        self._sink(Decision(stamp_ns=now_ns, do=SNAPSHOT, arguments=[plain]))
