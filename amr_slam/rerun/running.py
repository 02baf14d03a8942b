"""A recorded run once more: from its first snapshot on, each decision and sample in its order."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mcap.records import Channel, Message, Metadata, Schema

from amr_slam.config import Config, ConfigError, parse
from amr_slam.fusion.ekf import Ekf
from amr_slam.localizer import Localizer
from amr_slam.recording import RecordingError, mcap_file, messages, raw
from amr_slam.reporting import pose_message
from amr_slam.rerun.decisions import DRIVE, EKF, SNAPSHOT
from amr_slam.rerun.state import put_together
from amr_slam.samples import PoseEstimate
from amr_slam.wire import PoseMessage, WireError

_MAX_DECISION_BYTES: Final = 1 << 25
_DOINGS: Final = frozenset(
    {"abandon", "drop_request", "forget", "go_on_mapping", "place", "restart", "seek"}
)
_SAMPLES: Final = {messages.SCAN_SCHEMA, messages.WHEELS_SCHEMA, messages.JOINTS_SCHEMA}
_NOT_COMPARED: Final = {"stamp", "fault"}
"""The wall clock is no part of a pose, and of faults devices have a say, too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rerun:
    """How a run came out the second time."""

    poses: int
    """That were published and made again."""
    same: int
    """Of them, those that are the same to the last bit."""
    first_difference: str | None
    answers: int
    """Of the registration, as recorded."""


def rerun(path: Path, config: Config | None = None) -> Rerun:
    """Do again what the daemon did. ``config``: None: that in the recording.

    Raises RecordingError when the file cannot be read, holds no snapshot, or is damaged.
    """
    try:
        with path.open("rb") as stream:
            return _Run(config).through(mcap_file.records(stream))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (*mcap_file.DAMAGE, ConfigError, WireError) as error:
        raise RecordingError(f"{path}: {str(error) or type(error).__name__}") from None


class _Run:
    def __init__(self, config: Config | None) -> None:
        self._config = config
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Channel] = {}
        self._localizer: Localizer | None = None
        self._estimate: PoseEstimate | None = None
        self._poses = self._same = self._answers = 0
        self._difference: str | None = None

    def through(self, records: Iterator[Any]) -> Rerun:
        try:
            for record in records:
                self._take(record)
        except mcap_file.CutOffError:
            pass  # what came before it is worth as much
        if self._localizer is None:
            raise ValueError("holds no snapshot to begin at")
        return Rerun(
            poses=self._poses,
            same=self._same,
            first_difference=self._difference,
            answers=self._answers,
        )

    def _take(self, record: Any) -> None:
        match record:
            case Schema():
                self._schemas[record.id] = record.name
            case Channel():
                self._channels[record.id] = record
            case Metadata() if record.name == raw.ABOUT and self._config is None:
                self._config = _recorded(raw.read_about(record.metadata).config)
            case Message():
                channel = self._channels[record.channel_id]
                self._message(channel.topic, self._schemas[channel.schema_id], record.data)

    def _message(self, topic: str, schema: str, data: bytes) -> None:
        if schema == messages.DECISION_SCHEMA:
            if len(data) > _MAX_DECISION_BYTES:
                raise ValueError(f"a decision of {len(data)} bytes")
            decision = json.loads(data)
            self._decide(decision["do"], decision["arguments"])
        elif self._localizer is None:
            return
        elif schema in _SAMPLES or topic == "/odometry":
            sample = messages.decode(schema, data)
            if not isinstance(sample, tuple):
                self._localizer.handle(sample)
                self._localizer.take_request()
        elif schema == messages.PUBLISHED_SCHEMAS["pose"] and self._estimate is not None:
            self._compare(self._estimate, PoseMessage.decode(data))

    def _decide(self, do: str, arguments: list[Any]) -> None:
        if do == SNAPSHOT:
            if self._localizer is None:
                self._localizer = self._begun(arguments[0])
            return
        if self._localizer is None:
            return
        given = [put_together(argument, {}) for argument in arguments]
        if do == "answer":
            self._answers += 1
            self._localizer.handle(given[0])
            self._localizer.take_request()
        elif do == "estimate":
            self._estimate = self._localizer.estimate(given[0])
        elif do in _DOINGS:
            getattr(self._localizer, do)(*given)
        else:
            raise ValueError(f"an unknown decision {do!r:.40}")

    def _begun(self, state: Any) -> Localizer:
        config = self._config
        if config is None:
            raise ValueError("holds no configuration")
        localizer = Localizer(
            config.localizer, config.fusion, config.slam.clouds, config.drive, {}, "mapping"
        )
        known = {DRIVE: config.drive, EKF: Ekf(config.fusion)}
        vars(localizer).update(put_together(state, known))
        return localizer

    def _compare(self, estimate: PoseEstimate, told: PoseMessage) -> None:
        again = pose_message(
            estimate, robot=told.robot, seq=told.seq, utc_from_monotonic_ns=0, map_id=told.map
        )
        was, now = (one.model_dump(exclude=_NOT_COMPARED) for one in (told, again))
        self._poses += 1
        self._same += was == now
        if was != now and self._difference is None:
            name = next(name for name in was if was[name] != now[name])
            self._difference = f"pose {told.seq}: {name} was {was[name]!r}, is {now[name]!r}"


def _recorded(text: str) -> Config:
    """The robot of the recording, wherever its maps may be. Raises ConfigError, ValueError."""
    return parse(tomllib.loads(text) | {"map": {"mode": "mapping"}})
