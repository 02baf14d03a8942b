"""``amr-slam run``: start up, turn until a signal comes, shut down.

Device threads and the SLAM process put what they have into one inbox; the loop takes it out, owns
all state, and waits for nobody else: poses go on whatever a scanner, a search or a subscriber does.
"""

from __future__ import annotations

import gc
import logging
import queue
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Final

from amr_slam.config import Config, ConfigError
from amr_slam.localizer import Sample
from amr_slam.publishing import RobotPublisher
from amr_slam.rerun import WitnessedLocalizer
from amr_slam.samples import DriveSample, Outcome, Scan
from amr_slam.service.clocks import PoseSchedule
from amr_slam.service.commands import Commands
from amr_slam.service.devices import DeviceEnded, ScannerThread, WheelsThread
from amr_slam.service.encoders import encoders
from amr_slam.service.metrics import Metrics, MetricsServer
from amr_slam.service.pipe import FromWorker
from amr_slam.service.recorder import Recorder
from amr_slam.service.remembering import Recollection, Remembering
from amr_slam.service.reporting import Reporter
from amr_slam.service.resuming import Resuming, localizing_first
from amr_slam.service.systemd import Notifier
from amr_slam.service.tasks import Tasks
from amr_slam.service.upkeep import Upkeep
from amr_slam.service.worker import SlamWorker
from amr_slam.serving import Asked
from amr_slam.shadow import Shadow
from amr_slam.slam_messages import Renewed, SlamJob
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.starting import Started

_log = logging.getLogger(__name__)

# Together below the 5 s in which a stop has to be done.
_SAVE_LIMIT_S: Final = 3.5
_CLOSE_LIMIT_S: Final = 1.0
_SWITCH_S: Final = 0.0005
"""After so long a thread that decodes or records hands the interpreter to who waits; Python's own
5 ms are a quarter of the time between two poses."""
_RING_SHARE: Final = 0.1
"""Of a ring, that may lie before its first snapshot ..."""
_RING_S: Final = 600.0
"""... and of a recording without one."""

_Item = Scan | DriveSample | DeviceEnded | FromWorker | Asked
_FITTING: Final = frozenset({Outcome.ACCEPTED, Outcome.INFLATED, Outcome.RESET})


def run(
    config: Config,
    config_path: Path,
    record: Path | None = None,
    started: Started | None = None,
) -> int:
    """Localize until SIGTERM (0) or SIGINT (130); SIGUSR1 saves what was recorded last.

    ``record``: a file for all that is recorded, from the start. ``started``: a SLAM process from
    before this module was imported. Raises ConfigError, SessionError, OSError when ``record``
    cannot be written, and RuntimeError where a driver failed in a way that no driver may: systemd
    starts anew. A device that is missing is waited for.
    """
    sys.setswitchinterval(_SWITCH_S)
    with ExitStack() as opened:  # whatever happens, what was opened is closed in reverse order
        daemon = startup(config, config_path, opened, record, started)
        exit_status = main_loop(daemon)
        shutdown(daemon, opened)
    return exit_status


def startup(
    config: Config,
    config_path: Path,
    opened: ExitStack,
    record: Path | None = None,
    started: Started | None = None,
) -> Daemon:
    """Everything is running, nothing is waited for: the first turns do that."""
    signals = _Signals()
    opened.callback(signals.restore)
    recorder = Recorder(config, config_path, record)
    opened.callback(recorder.close)
    memory = config.map.directory / f"{config.robot.name}.lastpose"
    recollection = Recollection(memory)
    job, wanted = first_jobs(config, recollection.cut_off)
    inbox: queue.SimpleQueue[_Item] = queue.SimpleQueue()
    worker = SlamWorker(job, inbox.put, config.service.answer_limit_s, started)
    opened.callback(_stop_worker, worker, inbox)
    publisher = opened.enter_context(
        RobotPublisher(config.zenoh, config.robot.name, encoders(config))
    )
    reconnect_max_s = config.service.reconnect_max_s
    tap, wheels_late_s = recorder.tap, config.localizer.wheels_late_s
    scanners = [ScannerThread(s, inbox.put, reconnect_max_s, tap) for s in config.scanners]
    wheels = WheelsThread(config.odometry, inbox.put, reconnect_max_s, wheels_late_s, tap)
    devices: list[ScannerThread | WheelsThread] = [wheels, *scanners]
    opened.callback(_stop_devices, devices)
    for device in devices:
        device.start()
    shadow = _shadow(config, publisher, opened)
    metrics = Metrics()
    if config.metrics.port:
        opened.callback(MetricsServer(config.metrics, metrics).close)
    reporter = Reporter(
        config, publisher, worker, wheels, scanners, recorder, metrics=metrics, shadow=shadow
    )
    remembering = Remembering(memory)
    opened.callback(remembering.close)
    upkeep = Upkeep(
        recollection=recollection,
        remembering=remembering,
        resuming=Resuming(worker, wanted),
    )
    daemon = Daemon(
        config, config_path, inbox, worker, reporter, recorder, upkeep=upkeep, signals=signals
    )
    publisher.serve(inbox.put)
    recorder.shows_maps(inbox.put)
    return daemon


def main_loop(daemon: Daemon) -> int:
    """Turn until a signal asks to stop; returns the exit status for it."""
    while daemon.signals.number is None:
        daemon.turn()
    return 0 if daemon.signals.number == signal.SIGTERM else 128 + signal.SIGINT


def shutdown(daemon: Daemon, opened: ExitStack) -> None:
    """Devices, publisher and worker, in this order; the worker saves its map."""
    _log.info("stopping")
    daemon.notifier.stopping()
    opened.close()


class Daemon:
    """The one owner of state; :meth:`turn` is all that it does."""

    def __init__(
        self,
        config: Config,
        config_path: Path,
        inbox: queue.SimpleQueue[_Item],
        worker: SlamWorker,
        reporter: Reporter,
        recorder: Recorder,
        *,
        upkeep: Upkeep,
        signals: _Signals,
    ) -> None:
        self.notifier = Notifier()
        self.signals = signals
        self._config = config
        self._config_path = config_path
        self._inbox = inbox
        self._worker = worker
        self._reporter = reporter
        self._recorder = recorder
        self._upkeep = upkeep
        self._is_ready = False
        self._localizer = WitnessedLocalizer(
            config.localizer,
            config.fusion,
            config.slam.clouds,
            config.drive,
            {scanner.name: scanner.mounting.mounting for scanner in config.scanners},
            worker.mode,
        )
        if recorder.records:
            period_s = _RING_SHARE * (config.recording.ring_s or _RING_S)
            self._localizer.witness(recorder.decided, config.drive, period_s)
        self._tasks = Tasks(worker)
        self._commands = Commands(config, self._localizer, worker, self._tasks, recorder)
        self._handed_out: SlamRequest | None = None
        self._schedule = PoseSchedule(config.service.publish_hz, time.monotonic_ns())

    def turn(self) -> None:
        """Wait for what comes next, at most until a pose is due; take it in; tell the world."""
        samples = self._sorted(self._take_out())
        for sample in samples:
            outcome = self._localizer.handle(sample)
            if isinstance(sample, Scan | DriveSample):
                self._recorder.take(sample)
            if isinstance(sample, SlamResult) and outcome in _FITTING:
                self._show_scan(sample)
        self._hand_out_request()
        self._tasks.submit()
        now_ns = time.monotonic_ns()
        self._commands.turn(now_ns)
        self._worker.supervise(now_ns)
        wheels_came = any(isinstance(s, DriveSample) for s in samples)
        if self._schedule.takes(now_ns, wheels_came=wheels_came):
            estimate = self._localizer.estimate(now_ns)
            self._reporter.publish_pose(estimate)
            self._upkeep.turn(now_ns, estimate, self._localizer, self._worker)
        self._reporter.note_troubles(self._upkeep.troubles())
        self._reporter.note_wheels(self._localizer.calibration, self._localizer.wheel_events)
        summary = self._reporter.report(now_ns, self._localizer.outcomes)
        self._notify(now_ns, summary)
        if self.signals.wants_saving():
            self._recorder.save("sigusr1")

    def _take_out(self) -> list[_Item]:
        items: list[_Item] = []
        try:
            items.append(self._inbox.get(timeout=self._schedule.wait_s(time.monotonic_ns())))
            while True:
                items.append(self._inbox.get_nowait())
        except queue.Empty:
            return items

    def _sorted(self, items: Sequence[_Item]) -> list[Sample]:
        samples: list[Sample] = []
        for item in items:
            if isinstance(item, DeviceEnded):
                self._give_up(item)
            elif isinstance(item, Asked):
                self._commands.take(item, time.monotonic_ns())
            elif not isinstance(item, FromWorker):
                samples.append(item)
            elif isinstance(answer := self._worker.hear(item), SlamResult):
                samples.append(answer)
            elif isinstance(answer, Renewed):
                self._localizer.restart(self._worker.mode, True)
            elif answer is not None:
                if not self._upkeep.resuming.heard(answer, self._localizer):
                    self._tasks.heard(answer)
            elif item.message is None:
                self._localizer.drop_request()
                self._tasks.lost()
                self._upkeep.resuming.lost()
        return sorted(samples, key=lambda sample: sample.stamp_ns)

    def _give_up(self, ended: DeviceEnded) -> None:
        if ended.unusable is None:
            raise RuntimeError(f"{ended.name}: the driver has failed; its traceback stands above")
        names = [scanner.name for scanner in self._config.scanners]
        where = ("scanners", names.index(ended.name)) if ended.name in names else ("odometry",)
        raise ConfigError(ended.unusable, (*where, "options"), self._config_path)

    def _hand_out_request(self) -> None:
        request = self._localizer.take_request()
        if request is None:
            return
        if self._worker.idle and not self._tasks.first:
            self._worker.submit(request)
            self._tasks.yield_turn()
            self._handed_out = request
        else:
            self._localizer.drop_request()

    def _show_scan(self, result: SlamResult) -> None:
        """Where the estimate has it: what people see beside the pose must agree with it."""
        request, known = self._handed_out, self._localizer.filter
        if request is None or known is None or request.cloud.stamp_ns != result.stamp_ns:
            return
        at = known.pose_at(result.stamp_ns)
        if at is not None:
            self._reporter.publish_scan(request.cloud, at[0])

    def _notify(self, now_ns: int, summary: str | None) -> None:
        if not self._is_ready and (self._worker.ready or self._worker.refusal is not None):
            self._is_ready = True
            # What start-up built stays: a full collection over it would hold the poses for 60 ms.
            gc.collect()
            gc.freeze()
            self.notifier.ready("running")
        if summary is not None:
            self.notifier.status(summary)
        if self._worker.has_pulse(now_ns):
            self.notifier.feed()


class _Signals:
    """Remembers that SIGTERM, SIGINT or SIGUSR1 came, instead of what they would do."""

    def __init__(self) -> None:
        self.number: int | None = None
        """Of the first that asks to stop."""
        self._saving_wanted = False
        noted = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
        self._before = {number: signal.signal(number, self._note) for number in noted}

    def wants_saving(self) -> bool:
        """Whether SIGUSR1 came since the last call."""
        wanted, self._saving_wanted = self._saving_wanted, False
        return wanted

    def restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if number == signal.SIGUSR1:
            self._saving_wanted = True
        else:
            self.number = self.number or number


def first_jobs(config: Config, cut_off: str | None) -> tuple[SlamJob, SlamJob | None]:
    """What to begin with, and the mapping that follows once the robot is found in its map.

    ``cut_off``: name of the map whose mapping the last run did not end by itself."""
    job = _job(config)
    again = cut_off == job.name
    if job.target is None or not (again or config.map.extend) or not job.target.exists():
        return job, None
    return localizing_first(job), replace(job, source=job.target, saved_before=again)


def _job(config: Config) -> SlamJob:
    mapping = config.map.mode == "mapping"
    return SlamJob(
        mode=config.map.mode,
        params=config.slam,
        source=None if mapping else config.map.path,
        target=config.map.directory / f"{config.map.name}.amrmap" if mapping else None,
        name=config.map.name,
        save_period_s=config.service.save_period_s,
        hold=mapping and config.map.extend and config.map.hold,
        policy=config.map.accept,
    )


def _shadow(config: Config, publisher: RobotPublisher, opened: ExitStack) -> Shadow | None:
    """What it hears it tells the reporter, and nobody else."""
    if config.shadow.key is None:
        return None
    shadow = Shadow(config.shadow, config.robot.name)
    opened.callback(shadow.close)
    publisher.hear(config.shadow.key, shadow.heard)
    return shadow


def _stop_devices(devices: Sequence[ScannerThread | WheelsThread]) -> None:
    for device in devices:
        device.ask_to_stop()
    deadline_s = time.monotonic() + _CLOSE_LIMIT_S
    for device in devices:
        device.join(max(0.0, deadline_s - time.monotonic()))


def _stop_worker(worker: SlamWorker, inbox: queue.SimpleQueue[_Item]) -> None:
    """Its last words are whether the map was saved."""
    worker.stop(_SAVE_LIMIT_S)
    for item in iter(partial(_next, inbox), None):
        if isinstance(item, FromWorker):
            worker.hear(item)


def _next(inbox: queue.SimpleQueue[_Item]) -> _Item | None:
    try:
        return inbox.get_nowait()
    except queue.Empty:
        return None
