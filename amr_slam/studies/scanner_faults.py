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
from amr_slam.states import Mode
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
        mapping: bool = False,
        people: int = 0,
        beside: Disturb | None = None,
        now: World | None = None,
    ) -> None:
        """``located``: the localizer is told where it begins. ``now``: the world as it has become
        since it was mapped. ``beside``: what else happens to each scan. ``mapping``: a new map is
        made, ``known`` is not used."""
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
        self._mapping = mapping
        mode: Mode = "mapping" if mapping else "localization"
        self.engine = SlamEngine(params, PointMap(params.map) if mapping else known, mode)
        begin = (tour.world_from_map, np.diag([1e-4, 1e-4, 1e-5]))
        self.localizer = Localizer(
            LocalizerParams(), FilterParams(), params.clouds, _DRIVE,
            {m.name: Mounting(base_from_lidar=m.base_from_lidar) for m in pair},
            mode, begin if located and not mapping else None,
        )  # fmt: skip
        self.worst_m = 0.0
        """Worst true error of a pose that was offered for driving."""

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
            yield Moment(said=said, truth=self.truth, inspected=inspected)

    @property
    def truth(self) -> Pose2:
        """Where the robot is, in the frame of the map."""
        return self.robot.map_from_base if self._mapping else self.robot.world_from_base

    def _judge(self) -> None:
        said = self.localizer.estimate(self.robot.stamp_ns)
        if said is not None and said.state in {State.LOCALIZED, State.MAPPING}:
            self.worst_m = max(self.worst_m, said.map_from_base.distance_to(self.truth))

    def _take(self, sample: Scan | WheelSample) -> str | None:
        """The fault that a scan alone names, where one was registered now."""
        seen = self._as_received(sample) if isinstance(sample, Scan) else [sample]
        for one in seen:
            self.localizer.handle(one)
        request = self.localizer.take_request()
        if request is None:
            return None
        result = self.engine.update(request)
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
    right: bool
    """It named this fault."""
    worst_m: float
    """Of poses offered for driving while it lasted."""
    back_after: int | None
    """Scan periods from the repair until localized without a fault; None: not within the drive."""
    scans: int
    """Mapping: scans in the map when the fault was named."""


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
    mapping: bool = False,
    periods: int = 12,
) -> Found:
    """One drive with one fault: from the start, or from the third scan of a robot that is located;
    repaired after ``periods``."""
    run = Run(*known, fault, located=not at_start, mapping=mapping, seed=seed)
    if not at_start:
        for _ in run.periods(DRIVING):
            pass
    run.worst_m = 0.0
    run.begin_fault()
    after, named, scans = None, "", 0
    for number, moment in enumerate(run.periods(periods), 1):
        told = [part for part in (moment.said.fault or "").split("; ") if _tells(part)]
        if told and after is None:
            after, named, scans = number, told[0], len(run.engine.map.path)
    worst_m = run.worst_m
    run.repair()
    back = None
    for number, moment in enumerate(run.periods(0 if mapping else periods), 1):
        if moment.said.state is State.LOCALIZED and not moment.said.fault:
            back = number
            break
    return Found(
        after=after, named=named, right=fault.word in named, worst_m=worst_m, back_after=back,
        scans=scans if after is not None else len(run.engine.map.path),
    )  # fmt: skip


def _tells(part: str) -> bool:
    return part.startswith("scanner configuration") or " scanner " in part


def false_alarms(run: Run, periods: int) -> tuple[int, int, int]:
    """(registered scans at most, scans that alone named a fault, periods in which one was told) of
    a drive on which no scanner has a fault."""
    alone = told = 0
    for moment in run.periods(periods):
        alone += moment.inspected is not None
        told += any(_tells(part) for part in (moment.said.fault or "").split("; "))
    return periods, alone, told


def clean(kind: str, seed: int, disturbed: str, *, located: bool, scanners: int) -> Run:
    """A drive without a fault, disturbed by ``people``, ``furniture`` (half of it moved),
    ``blocked`` (40 % of the beams) or ``everything``."""
    known = scene(kind, seed)
    world, now, beside = known[0], None, None
    rng = np.random.default_rng(seed)
    if disturbed in {"furniture", "everything"}:
        now = moved_furniture(world, rng, 0.5)
    if disturbed in {"blocked", "everything"}:
        beside = lambda scan: blocked(scan, rng, 0.4, 0.01)  # noqa: E731
    people = 6 if disturbed in {"people", "everything"} else 0
    alone = None
    if scanners == 1:
        alone = Fault(name="none", word="", source=_plain, pair=PAIR[:1])
    tour = plan_tour(now) if now is not None else known[2]
    return Run(
        world, known[1], tour, alone, located=located, seed=seed, people=people, beside=beside,
        now=now,
    )  # fmt: skip
