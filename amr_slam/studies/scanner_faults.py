"""Scanners that are dead, frozen, mirrored, swapped or turned: are they found, and nothing else?

A simulated robot with its two scanners drives through a known room. At some scan the fault begins
(or it is there from the start), later it is repaired. Clean drives count the false alarms.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer, LocalizerParams
from amr_slam.map import PointMap
from amr_slam.mounting import Mounting
from amr_slam.odometry import DifferentialDrive
from amr_slam.params import SlamParams
from amr_slam.samples import PoseEstimate, Scan, State, WheelSample
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Tour,
    World,
    blocked,
    hall,
    laboratory,
    mapping_poses,
    moved_furniture,
    odd,
    offices,
    opposite_scanners,
    plan_tour,
)
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.scenes import Scene

WORLDS: Final[dict[str, Callable[[int], World]]] = {
    "laboratory": laboratory,
    "hall": lambda seed: hall(seed, 200.0),
    "offices": lambda seed: offices(seed, 200.0),
    "odd": lambda seed: odd(seed, 200.0),
}
SCANNER: Final = ScannerModel(sigma_range_m=0.01)
PAIR: Final = opposite_scanners(SCANNER)
UNLIKE: Final = (
    replace(PAIR[0], base_from_lidar=Pose2(0.35, 0.0, 0.0)),
    replace(PAIR[1], base_from_lidar=Pose2(-0.2, 0.25, math.radians(150.0))),
)
"""A pair that is not the half turn of itself: swapped, it fits nowhere."""
_DRIVE: Final = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
_TURNED: Final = "-turned"
"""Scanners of this name stand where their namesake does, turned."""

Disturb = Callable[[Scan], Scan | None]
"""What becomes of a scan; None: it does not come."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One kind of fault."""

    name: str
    word: str
    """Must stand in the fault text."""
    source: Callable[[str], str]
    """Whose measurement comes under a scanner's name."""
    disturb: Callable[[], Disturb] = lambda: lambda scan: scan
    pair: tuple[ScannerModel, ...] = PAIR
    turn_deg: float = 180.0
    """Of the turned twins."""


def _plain(name: str) -> str:
    return name


def _other(name: str) -> str:
    return "rear" if name == "front" else "front"


def _dead() -> Disturb:
    return lambda scan: None if scan.scanner == "rear" else scan


def _frozen() -> Disturb:
    first: list[Scan] = []

    def disturb(scan: Scan) -> Scan:
        if scan.scanner != "rear":
            return scan
        first.append(scan)
        return replace(scan, ranges_m=first[0].ranges_m)

    return disturb


def _mirrored(*names: str) -> Disturb:
    return lambda s: replace(s, ranges_m=s.ranges_m[::-1]) if s.scanner in names else s


def _turn(*names: str) -> Callable[[str], str]:
    return lambda name: name + _TURNED if name in names else name


FAULTS: Final = (
    Fault(name="rear dead", word="rear scanner missing", source=_plain, disturb=_dead),
    Fault(name="rear frozen", word="rear scanner frozen", source=_plain, disturb=_frozen),
    Fault(name="rear mirrored", word="rear scanner looks mirrored", source=_plain,
          disturb=lambda: _mirrored("rear")),
    Fault(name="both mirrored", word="scanner look mirrored", source=_plain,
          disturb=lambda: _mirrored("front", "rear")),
    Fault(name="front turned by 180 deg", word="front scanner looks turned by 180 deg",
          source=_turn("front")),
    Fault(name="rear turned by 90 deg", word="rear scanner looks turned by 90 deg",
          source=_turn("rear"), turn_deg=90.0),
    Fault(name="swapped, unlike mountings", word="look swapped", source=_other, pair=UNLIKE),
    Fault(name="swapped, mountings half a turn apart", word="look swapped", source=_other),
    Fault(name="one scanner, mirrored", word="front scanner looks mirrored", source=_plain,
          disturb=lambda: _mirrored("front"), pair=PAIR[:1]),
    Fault(name="one scanner, turned by 180 deg", word="front scanner looks turned by 180 deg",
          source=_turn("front"), pair=PAIR[:1]),
)  # fmt: skip
DRIVING: Final = 2
"""The fault begins with this scan after the robot is located."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """After one registered cloud, or in the end of a scan period without one."""

    said: PoseEstimate
    truth: Pose2
    inspected: str | None
    """The fault that this scan alone would name."""

    @property
    def error_m(self) -> float:
        return self.said.map_from_base.distance_to(self.truth)


class Run:
    """One robot in a known world; time passes in :meth:`periods`."""

    def __init__(
        self,
        world: World,
        known: PointMap,
        tour: Tour,
        fault: Fault | None,
        *,
        located: bool,
        seed: int,
        people: int = 0,
        beside: Disturb | None = None,
        now: World | None = None,
    ) -> None:
        """``located``: the localizer is told where it begins. ``now``: the world as it has become
        since it was mapped. ``beside``: what else happens to each scan."""
        pair = PAIR if fault is None else fault.pair
        turn = Pose2(0.0, 0.0, math.radians(180.0 if fault is None else fault.turn_deg))
        twins = [
            replace(m, name=m.name + _TURNED, base_from_lidar=m.base_from_lidar @ turn)
            for m in pair
        ]
        self._fault = fault
        self._disturb: Disturb | None = None
        self._beside = beside
        self.robot = SimulatedRobot(
            world=now or world,
            world_from_map=tour.world_from_map,
            scanners=(*pair, *twins),
            people=people,
            seed=seed,
        )
        self._follower = PathFollower(tour.path_in_map_m)
        self._names = {m.name for m in pair}
        params = SlamParams()
        self._engine = SlamEngine(params, known, "localization")
        begin = (tour.world_from_map, np.diag([1e-4, 1e-4, 1e-5])) if located else None
        self.localizer = Localizer(
            LocalizerParams(), FilterParams(), params.clouds, _DRIVE,
            {m.name: Mounting(base_from_lidar=m.base_from_lidar) for m in pair},
            "localization", begin,
        )  # fmt: skip
        self.worst_m = 0.0
        """Worst true error of a pose that was offered as localized."""

    def begin_fault(self) -> None:
        assert self._fault is not None
        self._disturb = self._fault.disturb()

    def repair(self) -> None:
        self._disturb = None

    def periods(self, count: int, *, stand: bool = False) -> Iterator[Moment]:
        """Drive for scan periods of 2 s along the tour."""
        for _ in range(count):
            inspected: str | None = None
            for _ in range(100):
                command = (0.0, 0.0)
                if not stand:
                    command = self._follower.steer(self.robot.map_from_base)
                for sample in self.robot.advance(*command):
                    inspected = self._take(sample) or inspected
                self._judge()
            said = self.localizer.estimate(self.robot.stamp_ns)
            assert said is not None
            yield Moment(said=said, truth=self.robot.world_from_base, inspected=inspected)

    def _judge(self) -> None:
        said = self.localizer.estimate(self.robot.stamp_ns)
        if said is not None and said.state is State.LOCALIZED:
            error_m = said.map_from_base.distance_to(self.robot.world_from_base)
            self.worst_m = max(self.worst_m, error_m)

    def _take(self, sample: Scan | WheelSample) -> str | None:
        """The fault that a scan alone names, where one was registered now."""
        seen = self._as_received(sample) if isinstance(sample, Scan) else [sample]
        for one in seen:
            self.localizer.handle(one)
        request = self.localizer.take_request()
        if request is None:
            return None
        result = self._engine.update(request)
        self.localizer.handle(result)
        return result.inspection.fault

    def _as_received(self, scan: Scan) -> list[Scan]:
        """The scans that the localizer gets of one measurement."""
        for name in sorted(self._names):
            faulty = self._fault is not None and self._disturb is not None
            source = self._fault.source(name) if faulty and self._fault is not None else name
            if source != scan.scanner:
                continue
            own: Scan | None = replace(scan, scanner=name)
            if self._beside is not None and own is not None:
                own = self._beside(own)
            if self._disturb is not None and own is not None:
                own = self._disturb(own)
            return [] if own is None else [own]
        return []


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What became of one fault."""

    after: int | None
    """Scan periods until it was named; None: never."""
    named: str
    """What the fault text said."""
    worst_m: float
    """Of poses offered as localized while it lasted."""
    back_after: int | None
    """Scan periods from the repair to localized again without a fault."""


def scene(kind: str, seed: int) -> tuple[World, PointMap, Tour]:
    """A world, its map in the world's frame, and the way through it."""
    world = WORLDS[kind](seed)
    known = Scene.of(world, kind, mapping_poses(world)).map_at_truth(SCANNER, SlamParams())
    return world, known, plan_tour(world)


def find(
    fault: Fault,
    known: tuple[World, PointMap, Tour],
    *,
    at_start: bool,
    seed: int,
    periods: int = 12,
) -> Found:
    """One drive with one fault."""
    run = Run(*known, fault, located=not at_start, seed=seed)
    if not at_start:
        for _ in run.periods(DRIVING):
            pass
    run.worst_m = 0.0
    run.begin_fault()
    after, named = None, ""
    for number, moment in enumerate(run.periods(periods), 1):
        text = moment.said.fault or ""
        if after is None and ("scanner" in text or "swapped" in text):
            after, named = number, text
    worst_m = run.worst_m
    run.repair()
    back = None
    for number, moment in enumerate(run.periods(periods), 1):
        healthy = moment.said.state is State.LOCALIZED and not moment.said.fault
        back = number if healthy and back is None else back
    return Found(after=after, named=named, worst_m=worst_m, back_after=back)
