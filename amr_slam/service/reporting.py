"""What leaves the robot: poses, and the status that says what stands behind them."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from os import getpid
from typing import Final

from amr_slam.clouds import Cloud
from amr_slam.config import Config
from amr_slam.fusion import Calibration
from amr_slam.geometry import Pose2
from amr_slam.publishing import RobotPublisher
from amr_slam.reporting import (
    calibration_part,
    candidate_part,
    changes_part,
    health_part,
    pose_message,
    scan_message,
    slip_part,
)
from amr_slam.samples import Candidate, Health, Link, PoseEstimate, State
from amr_slam.service.clocks import WallClock
from amr_slam.service.devices import ScannerThread, WheelsThread
from amr_slam.service.incidents import Incidents
from amr_slam.service.metrics import Metrics
from amr_slam.service.recorder import Recorder
from amr_slam.service.usage import Usage
from amr_slam.service.worker import SlamWorker
from amr_slam.shadow import Shadow
from amr_slam.trust import drift_of
from amr_slam.wheel_events import WheelEvent
from amr_slam.wire import HealthPart, MapPart, StatusMessage

_log = logging.getLogger(__name__)

_PERIOD_NS: Final = 1_000_000_000
_LEAST_PERIOD_NS: Final = 100_000_000
"""A link that flaps must not flood the network."""
_MAX_FAULT: Final = 500
_MAX_DETAIL: Final = 200


class Reporter:
    """Publishes each pose it is given, and the status once a second and when it changes."""

    def __init__(
        self,
        config: Config,
        publisher: RobotPublisher,
        worker: SlamWorker,
        wheels: WheelsThread,
        scanners: Sequence[ScannerThread],
        recorder: Recorder,
        *,
        metrics: Metrics,
        shadow: Shadow | None = None,
    ) -> None:
        self._metrics = metrics
        self._config = config
        self._shadow = shadow
        self._publisher = publisher
        self._recorder = recorder
        self._worker = worker
        self._wheels = wheels
        self._scanners = {scanner.name: scanner for scanner in scanners}
        self._clock = WallClock()
        self._usage = Usage()
        self._used = (0.0, 0.0)
        self._version = version("amr-slam")
        self._started_ns = self._told_ns = self._looked_ns = time.monotonic_ns()
        self._told: tuple[object, ...] = ()
        self._poses = self._statuses = self._scans = 0
        self._epoch = 0
        self._state = State.STARTING
        self._pose_fault: str | None = None
        self._candidates: tuple[Candidate, ...] = ()
        self._explained: float | None = None
        self._fault: str | None = None
        self._calibration: Calibration | None = None
        self._slips: tuple[WheelEvent, ...] = ()
        self._troubles: tuple[str, ...] = ()
        save = partial(recorder.save, automatic=True)
        self._incidents = Incidents(save) if recorder.saves_by_itself else None

    def note_wheels(self, known: Calibration | None, slips: tuple[WheelEvent, ...]) -> None:
        """What the fusion has to say of the wheels, for the next status."""
        self._calibration, self._slips = known, slips

    def note_troubles(self, troubles: Iterable[str]) -> None:
        """What the service itself has to say, one line each."""
        self._troubles = tuple(troubles)

    def publish_pose(self, estimate: PoseEstimate | None) -> None:
        """``None``: no wheel sample came yet, so that there is no pose of any worth."""
        if estimate is None:
            return
        if estimate.state is not self._state:
            fields = {"amr_robot": self._config.robot.name, "amr_state": str(estimate.state)}
            _log.info("state: %s, was %s", estimate.state, self._state, extra=fields)
        self._epoch = estimate.epoch
        self._state, self._pose_fault = estimate.state, estimate.fault
        self._candidates, self._explained = estimate.candidates, estimate.explained
        active = self._worker.active_map
        message = pose_message(
            replace(estimate, fault=_joined(estimate.fault, self._fault)),
            robot=self._config.robot.name,
            seq=self._poses,
            utc_from_monotonic_ns=self._clock.utc_from_monotonic_ns,
            map_id=active.map_id if active is not None else None,
        )
        self._poses += 1
        self._publisher.publish_pose(message)
        self._recorder.published(message)
        if self._shadow is not None:
            self._shadow.said(message)
        self._metrics.note_pose(message, time.monotonic_ns())

    def publish_scan(self, cloud: Cloud, map_from_base: Pose2) -> None:
        """The points of a scan that was registered, unless nobody wants any."""
        most = self._config.zenoh.scan_points
        if not most:
            return
        points = map_from_base @ cloud.take(cloud.even(most)).points_m
        active = self._worker.active_map
        self._publisher.publish_scan(
            scan_message(
                points,
                robot=self._config.robot.name,
                seq=self._scans,
                stamp_ns=cloud.stamp_ns,
                utc_from_monotonic_ns=self._clock.utc_from_monotonic_ns,
                map_id=active.map_id if active is not None else None,
                epoch=self._epoch,
            )
        )
        self._scans += 1

    def report(self, now_ns: int, outcomes: Mapping[str, int]) -> str | None:
        """Publish the status if it is time to; then one line of it, for systemd."""
        self._clock.follow(now_ns)
        health = {name: scanner.health(now_ns) for name, scanner in self._scanners.items()}
        wheels, slam = self._wheels.health(now_ns), self._worker.health(now_ns)
        self._fault = _joined(
            self._worker.fault,
            self._worker.warning,
            *_complaints(health | {"wheels": wheels}),
            *self._troubles,
            self._recorder.trouble,
        )
        parts = {**health, "wheels": wheels, "slam": slam}
        if self._incidents is not None:
            connected = {name: part.link for name, part in parts.items() if name != "slam"}
            self._incidents.look(now_ns, self._state, connected, self._worker.crashes)
        active = self._worker.active_map
        what = (
            self._state,
            tuple(part.link for part in parts.values()),
            active.map_id if active is not None else None,
            self._worker.mode,
            self._epoch,
            self._clock.steps,
            len(self._candidates),
            self._slips[-1:],
        )
        since_ns = now_ns - self._told_ns
        if since_ns < (_PERIOD_NS if what == self._told else _LEAST_PERIOD_NS):
            return None
        self._told, self._told_ns = what, now_ns
        message = self._message(now_ns, health, wheels, slam, outcomes)
        self._publisher.publish_status(message)
        self._recorder.published(message)
        self._metrics.note_status(message)
        self._statuses += 1
        links = ", ".join(f"{name} {part.link}" for name, part in parts.items())
        return f"{self._state}: {links}"

    def _message(
        self,
        now_ns: int,
        scanners: Mapping[str, Health],
        wheels: Health,
        slam: Health,
        outcomes: Mapping[str, int],
    ) -> StatusMessage:
        cpu_percent, memory_mb = self._usage_at(now_ns)
        active = self._worker.active_map
        return StatusMessage(
            robot=self._config.robot.name,
            seq=self._statuses,
            stamp=(now_ns + self._clock.utc_from_monotonic_ns) / 1e9,
            state=self._state,
            mode=self._worker.mode,
            map=None
            if active is None
            else MapPart(id=active.map_id, name=active.name, version=active.scans),
            scanners={name: _part(health) for name, health in scanners.items()},
            wheels=_part(wheels),
            slam=_part(slam),
            outcomes=dict(outcomes),
            commands=dict(self._publisher.command_counts()),
            clock_steps=self._clock.steps,
            version=self._version,
            uptime_s=1e-9 * (now_ns - self._started_ns),
            cpu_percent=cpu_percent,
            memory_mb=memory_mb,
            fault=_joined(self._pose_fault, self._fault),
            candidates=tuple(candidate_part(one) for one in self._candidates),
            explained=self._explained,
            calibration=None if self._calibration is None else calibration_part(self._calibration),
            advice=None if self._calibration is None else drift_of(self._calibration),
            slips=tuple(
                slip_part(event, self._clock.utc_from_monotonic_ns) for event in self._slips
            ),
            changes=None if self._worker.changes is None else changes_part(self._worker.changes),
            refused_requests=self._publisher.refused,
            shadow=None if self._shadow is None else self._shadow.part(),
        )

    def _usage_at(self, now_ns: int) -> tuple[float, float]:
        """Not measured over less than half a second: the kernel counts in 10 ms."""
        if now_ns - self._looked_ns >= _PERIOD_NS // 2:
            self._looked_ns = now_ns
            pids = [getpid(), *([] if self._worker.pid is None else [self._worker.pid])]
            self._used = self._usage.look(pids)
        return self._used


def _complaints(parts: Mapping[str, Health]) -> list[str]:
    """One for each device that is not well."""
    return [
        f"{name} {part.link}: {part.detail or 'nothing received'}"
        for name, part in parts.items()
        if part.link is not Link.OK
    ]


def _joined(*faults: str | None) -> str | None:
    text = "; ".join(fault for fault in faults if fault)
    return text[:_MAX_FAULT] or None


def _part(health: Health) -> HealthPart:
    detail = health.detail
    return health_part(replace(health, detail=detail and detail[:_MAX_DETAIL]))
