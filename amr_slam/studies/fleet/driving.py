"""Robots on their rounds through a simulated hall, as a view shows them: ``driving ENDPOINT``.

Poses are those of the round itself, scans those of two scanners at these poses, the map is made of
such scans: what a page draws can be held to what is true. ``--scene`` puts robots among them that
need a look. Several share a process; each has a session of its own.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap, save_map
from amr_slam.map.layers import LayerKind
from amr_slam.publishing import RobotPublisher
from amr_slam.samples import State
from amr_slam.serving import Asked, ChangesWanted, MapFile, MapWanted
from amr_slam.simulation import (
    ScannerModel,
    World,
    hall,
    laboratory,
    opposite_scanners,
    plan_tour,
    take_scan,
)
from amr_slam.studies.fleet.programs import ready, wait_for_end
from amr_slam.studies.fleet.troubles import WELL, troubled
from amr_slam.wire import (
    ChangePart,
    ChangesPart,
    MapChanges,
    MapPart,
    OdomPose,
    PoseMessage,
    ScanMessage,
    StatusMessage,
    ZenohSettings,
)

_MAP_EVERY_M: Final = 2.5
_SCAN_POINTS: Final = 360
_SCANS_EVERY_S: Final = 0.5
_KEPT_POSES: Final = 300
_LABORATORY_M2: Final = 250.0

Answer = Callable[[Asked], None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Course:
    """A hall, a closed round through it, and its map with a zone; the map's frame is the
    world's."""

    world: World
    path_m: Array
    """(n, 2)."""
    along_m: Array
    """(n,) way from the first point to each."""
    map_path: Path
    map_id: str

    @classmethod
    def laid(cls, folder: Path, *, seed: int = 3, area_m2: float = 200.0) -> Course:
        """In a laboratory, or in a hall where that is too small. The map is saved in ``folder``."""
        world = laboratory(seed) if area_m2 <= _LABORATORY_M2 else hall(seed, area_m2)
        path_m = np.array(plan_tour(world).path_m)
        steps_m = np.hypot(*np.diff(path_m, axis=0).T)
        along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        course = cls(
            world=world, path_m=path_m, along_m=along_m, map_path=folder / "hall.amrmap", map_id=""
        )
        known = PointMap(MapParams(), "hall")
        for way_m in np.arange(0.0, course.length_m, _MAP_EVERY_M):
            known.insert(course.seen(pose := course.pose(float(way_m))), pose)
        middle = course.pose(0.45 * course.length_m)
        square_m = np.array([[-1.2, -0.8], [1.2, -0.8], [1.2, 0.8], [-1.2, 0.8]])
        zone = (LayerKind.ZONE, "pallets", square_m + middle.translation)
        known.edit(known.layers.with_drawn([zone], "a simulation", 0))
        return replace(course, map_id=str(save_map(known, course.map_path)))

    @property
    def length_m(self) -> float:
        return float(self.along_m[-1])

    def pose(self, way_m: float) -> Pose2:
        """After so much of the round, looking ahead."""
        x_m, y_m = self._point(way_m)
        ahead_x_m, ahead_y_m = self._point(way_m + 0.3)
        return Pose2(x_m, y_m, math.atan2(ahead_y_m - y_m, ahead_x_m - x_m))

    def seen(self, world_from_base: Pose2) -> Cloud:
        """What two scanners see from there, in the base frame."""
        rng = np.random.default_rng(1)
        model = ScannerModel(sigma_range_m=0.01, sweep_s=0.0)
        clouds = []
        for mounted in opposite_scanners(model):
            scan = take_scan(mounted, self.world, world_from_base, rng)
            clouds.append(
                (cloud_from_scan(scan, mounted.base_from_lidar, CloudParams()), Pose2.identity())
            )
        return merge(clouds)

    def _point(self, way_m: float) -> tuple[float, float]:
        way_m %= self.length_m
        x_m, y_m = (float(np.interp(way_m, self.along_m, axis)) for axis in self.path_m.T)
        return x_m, y_m


class DrivingRobot:
    """One robot on a session of its own. A context manager; used in one thread."""

    def __init__(
        self,
        name: str,
        course: Course,
        *,
        start_m: float,
        connect: Sequence[str] = (),
        speed_mps: float = 0.6,
        answer: Answer | None = None,
        changes: Mapping[str, Any] | None = None,
        scans: bool = True,
    ) -> None:
        """``answer``: does commands; ``changes``: of what its messages would say otherwise."""
        self.name = name
        self.poses: list[PoseMessage] = []
        """The newest few that went out."""
        self._course = course
        self.speed_mps = speed_mps
        self.way_m = start_m
        self._changes = dict(changes or {})
        self._seen: tuple[ChangePart, ...] = self._changes.get("changes", ())
        self._begun_s = self._moved_s = time.monotonic()
        self._scanned_s = -math.inf if scans else math.inf
        self._told_s = -math.inf
        self._seq = 0
        self._answer_command = answer
        self._publisher = RobotPublisher(
            ZenohSettings(listen=(), connect=tuple(connect), fleet_every=1), name
        )
        self._publisher.serve(self._answer)

    def publish(self) -> None:
        """What is due now: a pose, and status and scan at their own rates."""
        now_s = time.monotonic()
        self._seq += 1
        self.way_m += self.speed_mps * (now_s - self._moved_s)
        self._moved_s = now_s
        pose = self._course.pose(self.way_m)
        message = self._pose(pose)
        self._publisher.publish_pose(message)
        self.poses = [*self.poses[1 - _KEPT_POSES :], message]
        if now_s - self._told_s >= 1.0:
            self._told_s = now_s
            self._publisher.publish_status(self._status())
        if now_s - self._scanned_s >= _SCANS_EVERY_S and message.state is State.LOCALIZED:
            self._scanned_s = now_s
            points = pose @ self._course.seen(pose).points_m
            points = points[:: max(1, -(-len(points) // _SCAN_POINTS))]
            self._publisher.publish_scan(
                ScanMessage(
                    robot=self.name,
                    seq=self._seq,
                    stamp=time.time(),
                    map=self._course.map_id,
                    epoch=0,
                    points=tuple((round(float(x), 3), round(float(y), 3)) for x, y in points),
                )
            )

    def close(self) -> None:
        self._publisher.close()

    def __enter__(self) -> DrivingRobot:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _answer(self, asked: Asked) -> None:
        if isinstance(asked.request, MapWanted):
            asked.done(MapFile(path=self._course.map_path, map_id=self._course.map_id))
        elif isinstance(asked.request, ChangesWanted) and self._seen:
            map_id, seen = self._course.map_id, self._seen
            asked.done(MapChanges(map=map_id, total=len(seen), changes=seen))
        elif self._answer_command is not None:
            self._answer_command(asked)
        else:
            asked.not_done("this robot only drives")

    def _pose(self, pose: Pose2) -> PoseMessage:
        sigma_m = float(self._changes.get("sigma_m", 0.012))
        c, s = math.cos(pose.theta_rad), math.sin(pose.theta_rad)
        along, across = (1.8 * sigma_m) ** 2, sigma_m**2
        xx, yy = c * c * along + s * s * across, s * s * along + c * c * across
        xy = c * s * (along - across)
        return PoseMessage(
            robot=self.name,
            seq=self._seq,
            stamp=time.time(),
            age_s=0.004,
            map=self._course.map_id,
            epoch=0,
            x=pose.x_m,
            y=pose.y_m,
            theta=pose.theta_rad,
            vx=self.speed_mps,
            omega=0.0,
            covariance=(xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, 1e-4),
            error95_m=2.2 * sigma_m,
            state=self._changes.get("state", State.LOCALIZED),
            since_fix_s=self._changes.get("since_fix_s", 0.4),
            since_fix_m=0.2,
            odom=OdomPose(x=0.0, y=0.0, theta=0.0),
            fault=self._changes.get("fault"),
        )

    def _status(self) -> StatusMessage:
        state = self._changes.get("state", State.LOCALIZED)
        return StatusMessage(
            robot=self.name,
            seq=self._seq,
            stamp=time.time(),
            state=state,
            mode="localization",
            map=MapPart(id=self._course.map_id, name="hall", version=1),
            scanners=self._changes.get("scanners", {"front": WELL, "rear": WELL}),
            wheels=WELL.model_copy(update={"rate_hz": 50.0}),
            slam=WELL.model_copy(update={"rate_hz": 2.0}),
            version="simulated",
            uptime_s=time.monotonic() - self._begun_s,
            cpu_percent=14.0,
            memory_mb=380.0,
            candidates=self._changes.get("candidates", ()),
            explained=self._changes.get("explained", 0.94),
            changes=self._counts(),
        )

    def _counts(self) -> ChangesPart | None:
        if not self._seen:
            return None
        new = sum(one.what == "new" for one in self._seen)
        since = min(one.since for one in self._seen if one.since is not None)
        return ChangesPart(new=new, gone=len(self._seen) - new, oldest_since=since)


def main(argv: Sequence[str] | None = None) -> int:
    """Drive until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("endpoint", help="of the router")
    parser.add_argument("folder", type=Path, help="for the map")
    parser.add_argument("--count", type=int, default=3)
    parser.add_argument("--hz", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--area", metavar="M2", type=float, default=200.0)
    parser.add_argument("--scanning", type=int, help="so many of them tell scans (default: all)")
    parser.add_argument("--scene", action="store_true", help="with robots that need a look")
    arguments = parser.parse_args(argv)
    course = Course.laid(arguments.folder, seed=arguments.seed, area_m2=arguments.area)
    changes = troubled(course.pose, course.length_m) if arguments.scene else ()
    with ExitStack() as opened:
        robots = [
            opened.enter_context(
                DrivingRobot(
                    f"amr{number + 1:02d}",
                    course,
                    start_m=course.length_m * number / arguments.count,
                    connect=(arguments.endpoint,),
                    changes=changes[number] if number < len(changes) else {},
                    scans=arguments.scanning is None or number < arguments.scanning,
                )
            )
            for number in range(arguments.count)
        ]
        ended = wait_for_end()
        ready()
        turns, begun_s = 0, time.monotonic()
        while not ended.is_set():
            due_s = begun_s + turns / (arguments.hz * len(robots))
            ended.wait(max(0.0, due_s - time.monotonic()))
            robots[turns % len(robots)].publish()
            turns += 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
