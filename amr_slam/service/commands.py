"""What people and controllers may ask of the daemon, done on its loop without waiting."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.config import Config
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer
from amr_slam.region import Region
from amr_slam.reporting import map_changes
from amr_slam.samples import State
from amr_slam.seeking import Seek
from amr_slam.service.recorder import Recorder
from amr_slam.service.tasks import Tasks
from amr_slam.service.worker import SlamWorker
from amr_slam.serving import Asked, ChangesWanted, ImageWanted, MapFile, MapWanted, Picture
from amr_slam.slam_messages import (
    Compare,
    Compared,
    Draw,
    Drawn,
    Grow,
    SlamJob,
    Store,
    Stored,
    Switch,
    Switched,
    TaskAnswer,
)
from amr_slam.wire import (
    CommandReply,
    LoadMap,
    MapImage,
    MapPart,
    Relocalize,
    ResumePose,
    SaveMap,
    SaveRecording,
    SetPose,
    StartMapping,
)
from amr_slam.wire.commands import FoundPose

_log = logging.getLogger(__name__)

_HEADING_RAD: Final = math.radians(60.0)
"""A pose to search around is right in its heading by this much. Halls repeat themselves by half
and quarter turns: those are told apart by what the person saw."""
_MOST_RADIUS_M: Final = 10.0
"""The search in the region takes as long as one in the whole map then."""
_RESUMED: Final = np.diag([0.25**2, 0.25**2, math.radians(5.0) ** 2])
"""Covariance of a pose that is taken as is: of what was known before the robot was switched off."""
_SEEK_LIMIT_NS: Final = 20_000_000_000
"""Three scans at 0.5 Hz, searched on a slow computer, twice."""


class Commands:
    """All methods are for the loop's thread."""

    def __init__(
        self,
        config: Config,
        localizer: Localizer,
        worker: SlamWorker,
        tasks: Tasks,
        recorder: Recorder,
    ) -> None:
        self._config = config
        self._localizer = localizer
        self._worker = worker
        self._tasks = tasks
        self._recorder = recorder
        self._seeking: tuple[Asked, Seek, int] | None = None

    def take(self, asked: Asked, now_ns: int) -> None:
        """Do it, or begin to."""
        match request := asked.request:
            case MapWanted():
                self._map(asked)
            case ImageWanted():
                self._tasks.add(
                    asked, Draw(resolution_m=request.resolution_m), lambda a: self._drawn(asked, a)
                )
            case ChangesWanted():
                self._tasks.add(asked, Compare(), lambda answer: self._compared(asked, answer))
            case SetPose() | ResumePose() | Relocalize():
                objection = self._localizer.objection()
                if objection is not None:
                    asked.not_done(objection)
                else:
                    self._pose(asked, request, now_ns)
            case StartMapping() if request.extend:
                self._extend(asked, request, now_ns)
            case StartMapping():
                self._switch(asked, self._mapping_job(request.name))
            case LoadMap():
                self._switch(asked, self._localizing_job(request.name))
            case SaveMap():
                task = Store(target=self._path(request.name), name=request.name)
                self._tasks.add(asked, task, lambda answer: _stored(asked, request.name, answer))
            case SaveRecording():
                self._save_recording(asked, request.reason)
            case _:
                asked.not_done("this robot does not know how")

    def turn(self, now_ns: int) -> None:
        """Answer a search that has ended, or end one that nobody waits for."""
        if self._seeking is None:
            return
        asked, seek, deadline_ns = self._seeking
        if not seek.ended and asked.answer.cancelled():
            self._localizer.abandon(seek, "nobody waits for it any more")
        if not seek.ended and now_ns > deadline_ns:
            reason = f"no two scans confirmed it within {1e-9 * _SEEK_LIMIT_NS:g} s"
            self._localizer.abandon(seek, reason)
        if not seek.ended:
            return
        self._seeking = None
        if seek.pose is None:
            asked.not_done(seek.reason or "nothing fits")
        else:
            asked.done(_at(seek.pose))

    # -- poses

    def _pose(self, asked: Asked, request: SetPose | ResumePose | Relocalize, now_ns: int) -> None:
        if isinstance(request, Relocalize):
            self._localizer.forget()
            asked.done(CommandReply(ok=True))
            return
        if isinstance(request, SetPose) and request.radius > _MOST_RADIUS_M:
            asked.not_done(
                f"radius: at most {_MOST_RADIUS_M:g} m; relocalize searches the whole map"
            )
            return
        pose = Pose2(request.x, request.y, request.theta)
        if isinstance(request, ResumePose):
            self._localizer.place(pose, _RESUMED)
            asked.done(_at(pose))
            return
        region = Region(
            map_from_base=pose, radius_m=request.radius, heading_rad=_HEADING_RAD
        )  # fmt: skip
        self._seeking = asked, self._localizer.seek(region), now_ns + _SEEK_LIMIT_NS

    # -- maps

    def _extend(self, asked: Asked, request: StartMapping, now_ns: int) -> None:
        """A map never forgets a wrong pose: nothing joins it before the robot is found in it."""
        path, active = self._path(request.name), self._worker.active_map
        is_active = active is not None and active.path is not None and active.path == path
        if not is_active or self._worker.mode == "mapping":
            asked.not_done(f"{request.name} is not the map that is localized in: load_map first")
            return
        estimate = self._localizer.estimate(now_ns)
        if estimate is None or estimate.state is not State.LOCALIZED:
            asked.not_done("not before the robot is localized in it")
            return
        job = replace(self._mapping_job(request.name), source=path, hold=request.hold)
        self._tasks.add(asked, Grow(job=job), lambda answer: self._grown(asked, answer))

    def _grown(self, asked: Asked, answer: TaskAnswer) -> None:
        """The pose goes on: its frame is the same."""
        assert isinstance(answer, Switched)
        self._localizer.go_on_mapping()
        self._tell_map(asked)

    def _mapping_job(self, name: str) -> SlamJob:
        return replace(
            self._worker.job,
            mode="mapping",
            source=None,
            target=self._path(name),
            name=name,
            saved_before=False,
        )

    def _localizing_job(self, name: str) -> SlamJob:
        return replace(
            self._worker.job,
            mode="localization",
            source=self._path(name),
            target=None,
            name=name,
            saved_before=False,
        )

    def _path(self, name: str) -> Path:
        """``name`` has no separators: :mod:`amr_slam.wire` has checked it."""
        return self._config.map.directory / f"{name}.amrmap"

    def _switch(self, asked: Asked, job: SlamJob) -> None:
        self._tasks.add(asked, Switch(job=job), lambda answer: self._switched(asked, answer))

    def _switched(self, asked: Asked, answer: TaskAnswer) -> None:
        """In the same turn the poses' map, frame and epoch change."""
        assert isinstance(answer, Switched)
        self._localizer.restart(answer.job.mode, answer.same_frame)
        self._tell_map(asked)

    def _tell_map(self, asked: Asked) -> None:
        active = self._worker.active_map
        assert active is not None
        asked.done(
            CommandReply(
                ok=True,
                map=MapPart(id=active.map_id, name=active.name, version=active.scans),
            )
        )

    def _map(self, asked: Asked) -> None:
        """A map that grows is written first; another one has its file."""
        job, active = self._worker.job, self._worker.active_map
        if job.mode == "mapping":
            self._tasks.add(asked, Store(target=None), lambda answer: _written(asked, answer))
        elif active is None or active.path is None:
            asked.not_done("there is no map yet")
        else:
            asked.done(MapFile(path=active.path, map_id=active.map_id))

    def _drawn(self, asked: Asked, answer: TaskAnswer) -> None:
        assert isinstance(answer, Drawn)
        active = self._worker.active_map
        assert active is not None
        georeference = MapImage(
            map=active.map_id,
            width_px=answer.columns,
            height_px=answer.rows,
            metres_per_px=answer.resolution_m,
            column_of_x0_px=-answer.x_min_m / answer.resolution_m,
            row_of_y0_px=answer.rows + answer.y_min_m / answer.resolution_m,
        )
        asked.done(Picture(png=answer.png, georeference=georeference))

    def _compared(self, asked: Asked, answer: TaskAnswer) -> None:
        assert isinstance(answer, Compared)
        active = self._worker.active_map
        assert active is not None
        asked.done(map_changes(answer.diff, active.map_id))

    # -- recordings

    def _save_recording(self, asked: Asked, reason: str) -> None:
        path = self._recorder.save(reason)
        if path is None:
            asked.not_done("nothing is kept, or the last saving still goes on: see the robot's log")
        else:
            asked.done(CommandReply(ok=True, file=path.name))


def _at(pose: Pose2) -> CommandReply:
    return CommandReply(ok=True, pose=FoundPose(x=pose.x_m, y=pose.y_m, theta=pose.theta_rad))


def _stored(asked: Asked, name: str, answer: TaskAnswer) -> None:
    assert isinstance(answer, Stored)
    saved = MapPart(id=answer.map_id, name=name, version=answer.map_scans)
    asked.done(CommandReply(ok=True, map=saved, file=answer.path.name))


def _written(asked: Asked, answer: TaskAnswer) -> None:
    assert isinstance(answer, Stored)
    asked.done(MapFile(path=answer.path, map_id=answer.map_id))
