"""Native recordings: MCAP files (https://mcap.dev/spec) that Foxglove opens.

Topics: ``/raw/<device>`` what passed on a device's line; ``/scan/<name>``, ``/wheels``,
``/odometry`` what was decoded; ``/pose``, ``/status`` what was published; ``/truth``. The log time
of a sample is its stamp. What Foxglove draws beside (:mod:`drawn`) and other topics in a file are
left alone by the reader. See docs/recording-format.md.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import Writer
from numpy.typing import NDArray

from amr_slam import foxglove
from amr_slam.geometry import Pose2
from amr_slam.recording import mcap_file, messages, raw
from amr_slam.recording.drawn import Drawing
from amr_slam.recording.messages import Entry
from amr_slam.recording.values import (
    About,
    Log,
    RecordedDevice,
    RecordingError,
    Sample,
    Trajectory,
)
from amr_slam.samples import Raw

_log = logging.getLogger(__name__)

# A power cut costs what the newest chunk holds: two seconds of a robot with two scanners.
_CHUNK_BYTES = 256 << 10
# Ours have more fields than Foxglove's of the same name.
_SCHEMAS = foxglove.SCHEMAS | messages.SCHEMAS
_DECODED = {"/wheels", "/joints", "/odometry", "/truth"}


class RecordingWriter:
    """Writes one recording; a context manager. The same calls give the same bytes."""

    def __init__(self, path: Path, mountings: Mapping[str, Pose2] | None = None) -> None:
        """``mountings``: base_from_lidar by the scanner's name, for who looks at the recording.

        Raises OSError when ``path`` cannot be written.
        """
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
        self._writer.start(library="amr-slam")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._message_bytes = 0
        self._drawing = Drawing(mountings or {})

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def is_full(self) -> bool:
        """Whether the file holds nearly as much as can be read again."""
        return self._message_bytes > mcap_file.TOTAL_BOUND_BYTES - (64 << 20)

    def describe(self, about: About, devices: Iterable[RecordedDevice]) -> None:
        """Who records which devices: before their first raw message."""
        self._writer.add_metadata(raw.ABOUT, raw.about_metadata(about))
        for device in devices:
            for name, data in device.files.items():
                self._writer.add_attachment(
                    0, 0, f"{device.name}/{name}", "application/octet-stream", data
                )
            topic, metadata = f"{raw.RAW_PREFIX}{device.name}", raw.device_metadata(device)
            self._open_channel(topic, raw.RAW_SCHEMA, metadata)

    def write(self, sample: Sample) -> None:
        self.add(messages.encode(sample))

    def write_raw(self, passed: Raw) -> None:
        """Of a device that was described. Raises KeyError for another."""
        self.add(messages.encode(passed))

    def write_truth(self, stamp_ns: int, map_from_base: Pose2) -> None:
        """Where the robot really was, in the frame of a map that begins at the start pose."""
        self.add(messages.encode_truth(stamp_ns, map_from_base))

    def write_map(
        self,
        stamp_ns: int,
        pixels: NDArray[np.uint8],
        metres_per_px: float,
        column_of_x0_px: float,
        row_of_y0_px: float,
    ) -> None:
        """The map as it is from ``stamp_ns`` on, for who looks at the recording: see
        :func:`amr_slam.foxglove.grid`."""
        drawn = foxglove.grid(stamp_ns, "map", pixels, metres_per_px, column_of_x0_px, row_of_y0_px)
        self._add(Entry("/map", foxglove.GRID, stamp_ns, foxglove.as_bytes(drawn)))

    def add(self, entry: Entry) -> None:
        """Write a message that was encoded before, and what is drawn of it."""
        self._add(entry)
        for one in self._drawing.of(entry.topic, entry.stamp_ns, entry.data):
            self._add(Entry(one.topic, one.schema, one.stamp_ns, foxglove.as_bytes(one.fields)))

    def _add(self, entry: Entry) -> None:
        if entry.topic not in self._channels:
            if entry.schema == raw.RAW_SCHEMA:
                raise KeyError(f"{entry.topic}: no such device was described")
            self._open_channel(entry.topic, entry.schema, {})
        self._message_bytes += len(entry.data)
        channel, stamp_ns = self._channels[entry.topic], entry.stamp_ns
        self._writer.add_message(channel, stamp_ns, entry.data, stamp_ns)

    def flush(self) -> None:
        """Hand all whole chunks to the operating system."""
        self._stream.flush()

    def sync(self) -> None:
        """Wait until the disk has all whole chunks."""
        self._stream.flush()
        os.fsync(self._stream.fileno())

    def close(self) -> None:
        """Completes the file. Idempotent."""
        if not self._stream.closed:
            with self._stream:
                self._writer.finish()  # type: ignore[no-untyped-call]  # mcap has no types here

    def _open_channel(self, topic: str, schema: str, metadata: Mapping[str, str]) -> None:
        is_raw = schema == raw.RAW_SCHEMA
        if schema not in self._schemas:
            kind = "ros1msg" if is_raw else "jsonschema"
            definition = raw.RAW_DEFINITION if is_raw else _SCHEMAS[schema]
            self._schemas[schema] = self._writer.register_schema(schema, kind, definition)
        self._channels[topic] = self._writer.register_channel(
            topic, "ros1" if is_raw else "json", self._schemas[schema], dict(metadata)
        )


def read_native(path: Path) -> Log:
    """All that a recording holds; of one that was cut off, what came before, with a warning.

    Raises RecordingError when it cannot be read, is damaged, cut off before its first samples or
    beyond all bounds.
    """
    reader = _Reader()
    try:
        with path.open("rb") as stream:
            try:
                for record in mcap_file.records(stream):
                    reader.take(record)
            except mcap_file.CutOffError:
                if reader.is_empty:
                    raise
                _log.warning("%s: cut off: what came after it is lost", path)
        return reader.log()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except mcap_file.DAMAGE as error:
        reason = str(error) or type(error).__name__
        raise RecordingError(f"{path}: damaged recording: {reason}") from None


class _Reader:
    """Gathers a file's records; raises what is in DAMAGE."""

    def __init__(self) -> None:
        self._schemas: dict[int, str] = {0: ""}
        self._channels: dict[int, Channel] = {}
        self._attachments: dict[str, bytes] = {}
        self._about: About | None = None
        self._samples: list[Sample] = []
        self._truth: list[tuple[int, Pose2]] = []
        self._raw: list[Raw] = []

    @property
    def is_empty(self) -> bool:
        return not (self._samples or self._truth or self._raw)

    def take(self, record: McapRecord) -> None:
        match record:
            case Schema():
                self._schemas[record.id] = record.name
            case Channel():
                self._channels[record.id] = record
            case Message():
                self._message(self._channels[record.channel_id], record)
            case Attachment():
                self._attachments[record.name] = record.data
            case Metadata() if record.name == raw.ABOUT:
                self._about = raw.read_about(record.metadata)

    def _message(self, channel: Channel, message: Message) -> None:
        topic, schema = channel.topic, self._schemas[channel.schema_id]
        if topic.startswith(raw.RAW_PREFIX):
            if schema != raw.RAW_SCHEMA:
                raise ValueError(f"{topic}: unknown schema {schema!r:.80}")
            device = topic.removeprefix(raw.RAW_PREFIX)
            self._raw.append(raw.decode_raw(device, message.log_time, message.data))
        elif topic in _DECODED or topic.startswith("/scan/"):
            match messages.decode(schema, message.data):
                case (stamp_ns, pose):
                    self._truth.append((stamp_ns, pose))
                case sample:
                    self._samples.append(sample)

    def log(self) -> Log:
        heard = {one.device for one in self._raw}
        devices = {
            name: raw.read_device(channel.topic, channel.metadata, self._attachments)
            for channel in self._channels.values()
            if (name := channel.topic.removeprefix(raw.RAW_PREFIX)) in heard
            and channel.topic.startswith(raw.RAW_PREFIX)
        }
        self._truth.sort(key=lambda entry: entry[0])
        return Log(
            samples=tuple(self._samples),
            truth=_trajectory(self._truth) if self._truth else None,
            raw=tuple(self._raw),
            devices=tuple(devices.values()),
            about=self._about,
        )


def _trajectory(poses: list[tuple[int, Pose2]]) -> Trajectory:
    return Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in poses], dtype=np.int64),
        poses=np.array([pose.as_array() for _, pose in poses]),
    )
