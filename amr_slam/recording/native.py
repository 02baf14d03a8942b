"""Native recordings: MCAP files (https://mcap.dev/spec) that Foxglove opens.

Topics: ``/scan/<name>``, ``/wheels``, ``/odometry`` and ``/truth``. Each message's log time is
the sample's stamp. Other topics in a file are left alone.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, McapRecord, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import Writer

from amr_slam.geometry import Pose2
from amr_slam.recording import messages
from amr_slam.recording.values import Log, RecordingError, Sample, Trajectory

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK_BYTES = 1 << 20
# Ours have 1 MiB; a chunk that claims more than this is damage or meant to do harm.
_RECORD_BOUND_BYTES = 64 << 20
_TOTAL_BOUND_BYTES = 2 << 30
# Whatever a damaged file makes the libraries below stumble over.
_DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    TypeError,
    OverflowError,
    RecursionError,
)


class RecordingWriter:
    """Writes one recording; a context manager. The same calls give the same bytes."""

    def __init__(self, path: Path) -> None:
        """Raises OSError when ``path`` cannot be written."""
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
        self._writer.start(library="amr-slam")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, sample: Sample) -> None:
        self._add(sample.stamp_ns, *messages.encode(sample))

    def write_truth(self, stamp_ns: int, map_from_base: Pose2) -> None:
        """Where the robot really was, in the frame of a map that begins at the start pose."""
        self._add(stamp_ns, *messages.encode_truth(stamp_ns, map_from_base))

    def close(self) -> None:
        """Completes the file. Idempotent."""
        if not self._stream.closed:
            self._writer.finish()  # type: ignore[no-untyped-call]  # mcap has no types here
            self._stream.close()

    def _add(self, stamp_ns: int, topic: str, schema: str, data: bytes) -> None:
        if topic not in self._channels:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(
                    schema, "jsonschema", messages.SCHEMAS[schema]
                )
            self._channels[topic] = self._writer.register_channel(
                topic, "json", self._schemas[schema]
            )
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns)


def read_native(path: Path) -> Log:
    """All samples and the truth of a recording.

    Raises RecordingError when it cannot be read, is damaged, cut off or beyond all bounds.
    """
    samples: list[Sample] = []
    truth: list[tuple[int, Pose2]] = []
    try:
        with path.open("rb") as stream:
            for topic, schema, data in _messages(stream):
                if not (
                    topic in {"/wheels", "/joints", "/odometry", "/truth"}
                    or topic.startswith("/scan/")
                ):
                    continue
                match messages.decode(schema, data):
                    case (stamp_ns, pose):
                        truth.append((stamp_ns, pose))
                    case sample:
                        samples.append(sample)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror or error}") from None
    except _DAMAGE as error:
        reason = str(error) or type(error).__name__
        raise RecordingError(f"{path}: damaged recording: {reason}") from None
    truth.sort(key=lambda entry: entry[0])
    return Log(samples=tuple(samples), truth=_trajectory(truth) if truth else None)


def _trajectory(poses: list[tuple[int, Pose2]]) -> Trajectory:
    return Trajectory(
        stamps_ns=np.array([stamp for stamp, _ in poses], dtype=np.int64),
        poses=np.array([pose.as_array() for _, pose in poses]),
    )


def _messages(stream: BinaryIO) -> Iterator[tuple[str, str, bytes]]:
    """(topic, name of the schema, data) of every message, in the order of the file."""
    schemas: dict[int, str] = {0: ""}
    channels: dict[int, tuple[str, str]] = {}
    for record in _records(stream):
        if isinstance(record, Schema):
            schemas[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = (record.topic, schemas[record.schema_id])
        elif isinstance(record, Message):
            yield *channels[record.channel_id], record.data


def _records(stream: BinaryIO) -> Iterator[McapRecord]:
    """Every record of the data section; its checksum and the file's end are checked."""
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("not an MCAP file")
    checksum, total = zlib.crc32(_MAGIC), 0
    while True:
        head = stream.read(9)
        if len(head) < 9:
            raise ValueError("cut off")
        opcode, length = struct.unpack("<BQ", head)
        if length > _RECORD_BOUND_BYTES:
            raise ValueError(f"record of {length} bytes")
        body = stream.read(length)
        if len(body) < length:
            raise ValueError("cut off")
        if opcode == Opcode.DATA_END:
            break
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        records = _parse(opcode, body)
        total += sum(len(record.data) for record in records if isinstance(record, Message))
        if total > _TOTAL_BOUND_BYTES:
            raise ValueError(f"messages of more than {_TOTAL_BOUND_BYTES} bytes")
        yield from records
    expected = DataEnd.read(ReadDataStream(io.BytesIO(body))).data_section_crc
    if expected not in (0, checksum):
        raise ValueError("checksum of the data is wrong")
    stream.seek(-len(_MAGIC), io.SEEK_END)
    if stream.read() != _MAGIC:
        raise ValueError("cut off")


def _parse(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(io.BytesIO(body))
    match opcode:
        case Opcode.SCHEMA:
            return [Schema.read(stream)]
        case Opcode.CHANNEL:
            return [Channel.read(stream)]
        case Opcode.MESSAGE:
            return [Message.read(stream, len(body))]
        case Opcode.CHUNK:
            return breakup_chunk(_unpacked(Chunk.read(stream)), validate_crc=True)
    return []


def _unpacked(chunk: Chunk) -> Chunk:
    """The chunk without compression. Never more is unpacked than the bound allows."""
    size = chunk.uncompressed_size
    if size > _RECORD_BOUND_BYTES:
        raise ValueError(f"chunk of {size} bytes")
    if chunk.compression == "zstd":
        unpacker = zstandard.ZstdDecompressor(max_window_size=_RECORD_BOUND_BYTES)
        with unpacker.stream_reader(io.BytesIO(chunk.data)) as reader:
            data = reader.read(size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise ValueError(f"compression {chunk.compression[:20]!r} is not known")
    if len(data) != size:
        raise ValueError("chunk of another size than it says")
    return Chunk(
        compression="",
        data=data,
        message_end_time=chunk.message_end_time,
        message_start_time=chunk.message_start_time,
        uncompressed_crc=chunk.uncompressed_crc,
        uncompressed_size=size,
    )
