"""The records of an MCAP file (https://mcap.dev/spec), every length and checksum checked."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator, Mapping
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

_MAGIC = b"\x89MCAP0\r\n"
# Ours have 1 MiB; a chunk that claims more than this is damage or meant to do harm.
_RECORD_BOUND_BYTES = 64 << 20
TOTAL_BOUND_BYTES = 2 << 30
"""Of all messages of a file together: they are read into memory."""
# Whatever a damaged file makes the libraries below stumble over.
DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    TypeError,
    OverflowError,
    RecursionError,
)


_KINDS: Mapping[int, type[Schema | Channel | Attachment | Metadata]] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


class CutOffError(ValueError):
    """The file ends before it is complete: its writer was stopped in the middle."""


def records(stream: BinaryIO) -> Iterator[McapRecord]:
    """Every record of the data section; its checksum and the file's end are checked.

    Raises CutOffError after the last whole record of a file that ends early, and what is in
    DAMAGE for everything else that is wrong.
    """
    if stream.read(len(_MAGIC)) != _MAGIC:
        raise ValueError("not an MCAP file")
    checksum, total = zlib.crc32(_MAGIC), 0
    while True:
        head = stream.read(9)
        if len(head) < 9:
            raise _cut_off(stream)
        opcode, length = struct.unpack("<BQ", head)
        if length > _RECORD_BOUND_BYTES:
            raise ValueError(f"record of {length} bytes")
        body = stream.read(length)
        if len(body) < length:
            raise _cut_off(stream)
        if opcode == Opcode.DATA_END:
            break
        checksum = zlib.crc32(body, zlib.crc32(head, checksum))
        found = _parse(opcode, body)
        total += sum(len(record.data) for record in found if isinstance(record, Message))
        if total > TOTAL_BOUND_BYTES:
            raise ValueError(f"messages of more than {TOTAL_BOUND_BYTES} bytes")
        yield from found
    expected = DataEnd.read(ReadDataStream(io.BytesIO(body))).data_section_crc
    if expected not in (0, checksum):
        raise ValueError("checksum of the data is wrong")
    if not _is_complete(stream):
        raise CutOffError("cut off")


def _cut_off(stream: BinaryIO) -> ValueError:
    """Why a record ends after the file: a wrong length in a file that has its end."""
    if _is_complete(stream):
        return ValueError("record longer than the file")
    return CutOffError("cut off")


def _is_complete(stream: BinaryIO) -> bool:
    stream.seek(-len(_MAGIC), io.SEEK_END)
    return stream.read() == _MAGIC


def _parse(opcode: int, body: bytes) -> list[McapRecord]:
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.CHUNK:
        return breakup_chunk(_unpacked(Chunk.read(stream)), validate_crc=True)
    if opcode == Opcode.MESSAGE:
        return [Message.read(stream, len(body))]
    kind = _KINDS.get(opcode)
    return [] if kind is None else [kind.read(stream)]


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
