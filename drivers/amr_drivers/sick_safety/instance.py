"""An instance: all that a scanner tells of one scan. Bytes to values and back, no I/O.

Source: protocol fact sheet, section C.5. The same bytes come reassembled from UDP and as the value
of a variable over TCP. All little-endian. Blocks lie where the header's offsets say, with gaps
between them; each may be absent.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.blocks import Beams, Block, DerivedValues, Header, Instance, Status
from amr_drivers.sick_safety.variables import SCALE_DEG

_HEAD: Final = struct.Struct("<c3BIIB3xIIH2xI")
_BLOCKS: Final = struct.Struct("<10H")
HEADER: Final = _HEAD.size + _BLOCKS.size
_LOCAL_IO: Final = struct.Struct("<HH")
_DERIVED: Final = struct.Struct("<HHH2xiiI")
_DERIVED_BYTES: Final = 24
"""As real devices send them; the last four say nothing."""
_STATUS_BYTES: Final = 16
_COUNT: Final = 4
_BEAM: Final = np.dtype([("distance", "<u2"), ("rssi", "u1"), ("status", "u1")])
MAX_BEAMS: Final = 2751


@dataclass(frozen=True, slots=True, kw_only=True)
class Parts:
    """What can be read of an instance that may be cut short or broken."""

    instance: Instance
    """With the blocks that are sound. Beams: those that are there, from the first on."""
    complaint: str | None
    """What is wrong with the whole; None: nothing."""


def decode_instance(data: bytes) -> Instance:
    """All of it, every offset and length checked. Raises BadTelegram.

    A channel that is not switched on gives a header that is not ``enabled``, and no blocks.
    """
    parts = decode_parts(data)
    if parts.complaint is not None:
        raise BadTelegram(parts.complaint)
    return parts.instance


def decode_parts(data: bytes) -> Parts:
    """All that is there, for who looks at a damaged recording: no scan is made of it.

    Raises BadTelegram when not even the header is there.
    """
    header = decode_header(data)
    if not header.enabled:
        return Parts(instance=Instance(header=header), complaint=None)
    complaints = [text for text in (_layout_complaint(header, len(data)),) if text is not None]
    status = _attempt(_decode_status, data, header.status, complaints)
    derived = _attempt(_decode_derived, data, header.derived, complaints)
    beams = _attempt(_decode_beams, data, header.beams, complaints)
    if derived is not None and beams is not None and not complaints and derived.beams != len(beams):
        complaints.append(f"{len(beams)} beams measured instead of {derived.beams}")
    instance = Instance(header=header, status=status, derived=derived, beams=beams)
    return Parts(instance=instance, complaint=complaints[0] if complaints else None)


def decode_header(data: bytes) -> Header:
    """Raises BadTelegram where it is not all there or its version is no letter."""
    if len(data) < HEADER:
        raise BadTelegram(f"an instance of {len(data)} bytes has no header")
    letter, *version, serial, plug, channel, sequence, number, date, time_ms = _HEAD.unpack_from(
        data
    )
    if letter != b"\0" and not b"A" <= letter <= b"Z":
        raise BadTelegram(f"version {letter!r} is no letter")
    offsets = _BLOCKS.unpack_from(data, _HEAD.size)
    blocks = [
        Block(offset=offset, size=size)
        for offset, size in zip(offsets[::2], offsets[1::2], strict=True)
    ]
    # The header does not tell its length; where the first block lies does.
    first = min((block.offset for block in blocks if block.present), default=0)
    local_io = None
    if first >= HEADER + _LOCAL_IO.size and len(data) >= HEADER + _LOCAL_IO.size:
        offset, size = _LOCAL_IO.unpack_from(data, HEADER)
        local_io = Block(offset=offset, size=size)
    major, minor, release = version
    return Header(
        version=(letter.decode("ascii"), major, minor, release),
        serial_number=serial,
        plug_number=plug,
        channel=channel,
        sequence=sequence,
        scan_number=number,
        date=date,
        time_ms=time_ms,
        status=blocks[0],
        derived=blocks[1],
        beams=blocks[2],
        fields=blocks[3],
        application=blocks[4],
        local_io=local_io,
    )


def encode_instance(instance: Instance, *, header_bytes: int = 76) -> bytes:
    """An instance with these blocks one behind the other. ``header_bytes``: where the first block
    lies, at least 52; from 56 on the header has a (here empty) block for local inputs."""
    blocks: list[bytes] = []
    offsets: list[int] = []
    at = header_bytes
    for part in (
        _status_bytes(instance),
        _derived_bytes(instance),
        _beam_bytes(instance),
        b"",
        b"",
    ):
        offsets += (at, len(part)) if part else (0, 0)
        # Real devices leave 4 bytes between the blocks.
        block = part + bytes(4) if part else b""
        blocks.append(block)
        at += len(block)
    header = instance.header
    letter, *version = header.version
    head = _HEAD.pack(
        letter.encode("ascii"),
        *version,
        header.serial_number,
        header.plug_number,
        header.channel,
        header.sequence,
        header.scan_number,
        header.date,
        header.time_ms,
    ) + _BLOCKS.pack(*offsets)
    return head.ljust(header_bytes, b"\0") + b"".join(blocks)


_T = TypeVar("_T")


def _attempt(
    decode: Callable[[bytes, Block, list[str]], _T],
    data: bytes,
    block: Block,
    complaints: list[str],
) -> _T | None:
    if not block.present:
        return None
    try:
        return decode(data, block, complaints)
    except BadTelegram as reason:
        complaints.append(str(reason))
        return None


def _layout_complaint(header: Header, length: int) -> str | None:
    """What is wrong with the places of the blocks, those that are not looked into as well."""
    blocks = [header.status, header.derived, header.beams, header.fields, header.application]
    # Not that of local inputs: one source alone says that these bytes of the header mean it.
    end = HEADER
    for block in sorted((b for b in blocks if b.present), key=lambda block: block.offset):
        if block.offset < end:
            return f"a block at {block.offset} lies within what comes before it"
        end = block.offset + block.size
    return f"{length} bytes of an instance of {end}" if end > length else None


def _slice(data: bytes, block: Block, least: int, name: str) -> bytes:
    if block.size < least or block.offset < HEADER:
        raise BadTelegram(f"{name}: {block.size} bytes at {block.offset}")
    part = data[block.offset : block.offset + block.size]
    if len(part) < least:
        raise BadTelegram(f"{name}: {len(part)} bytes of {block.size} are there")
    return part


def _decode_status(data: bytes, block: Block, _complaints: list[str]) -> Status:
    raw = _slice(data, block, _STATUS_BYTES, "status")
    flags, errors = raw[0], raw[15]
    return Status(
        run_mode=bool(flags & 1),
        standby=bool(flags & 2),
        contamination_warning=bool(flags & 4),
        contamination_error=bool(flags & 8),
        reference_contour=bool(flags & 16),
        manipulation=bool(flags & 32),
        application_error=bool(errors & 1),
        device_error=bool(errors & 2),
        safe_off=int.from_bytes(raw[1:4], "little"),
        other_off=int.from_bytes(raw[4:7], "little"),
        reset_required=int.from_bytes(raw[7:10], "little"),
        monitoring_cases=tuple(raw[10:14]),
    )


def _decode_derived(data: bytes, block: Block, _complaints: list[str]) -> DerivedValues:
    raw = _slice(data, block, _DERIVED.size, "derived values")
    factor, beams, scan_time_ms, start, step, interbeam_us = _DERIVED.unpack_from(raw)
    derived = DerivedValues(
        factor=factor,
        beams=beams,
        scan_time_ms=scan_time_ms,
        start_deg=start / SCALE_DEG,
        step_deg=step / SCALE_DEG,
        interbeam_us=interbeam_us,
    )
    if not 2 <= beams <= MAX_BEAMS or factor == 0 or scan_time_ms == 0:
        raise BadTelegram(f"{beams} beams, factor {factor}, scan time {scan_time_ms} ms")
    if step <= 0 or derived.step_deg * (beams - 1) > 360.0 or abs(derived.start_deg) > 360.0:
        raise BadTelegram(f"{beams} beams of {derived.step_deg:g} deg from {derived.start_deg:g}")
    if 1e3 * derived.sweep_s > scan_time_ms + 1:
        raise BadTelegram(f"a sweep of {1e3 * derived.sweep_s:g} ms in scans of {scan_time_ms}")
    return derived


def _decode_beams(data: bytes, block: Block, complaints: list[str]) -> Beams:
    raw = _slice(data, block, _COUNT, "measured values")
    count = int.from_bytes(raw[:_COUNT], "little")
    if count > MAX_BEAMS or _COUNT + _BEAM.itemsize * count > block.size:
        raise BadTelegram(f"{count} beams in a block of {block.size} bytes")
    there = min(count, (len(raw) - _COUNT) // _BEAM.itemsize)
    if there < count:
        complaints.append(f"{there} of {count} beams are there")
    values = np.frombuffer(raw, dtype=_BEAM, count=there, offset=_COUNT)
    return Beams(distance=values["distance"], rssi=values["rssi"], status=values["status"])


def _status_bytes(instance: Instance) -> bytes:
    status = instance.status
    if status is None:
        return b""
    flags = (
        status.run_mode,
        status.standby,
        status.contamination_warning,
        status.contamination_error,
        status.reference_contour,
        status.manipulation,
    )
    errors = (status.application_error, status.device_error)
    return b"".join(
        (
            bytes((_bits(flags),)),
            status.safe_off.to_bytes(3, "little"),
            status.other_off.to_bytes(3, "little"),
            status.reset_required.to_bytes(3, "little"),
            bytes(status.monitoring_cases),
            bytes((0, _bits(errors))),
        )
    )


def _bits(flags: tuple[bool, ...]) -> int:
    return sum(flag << bit for bit, flag in enumerate(flags))


def _derived_bytes(instance: Instance) -> bytes:
    derived = instance.derived
    if derived is None:
        return b""
    return _DERIVED.pack(
        derived.factor,
        derived.beams,
        derived.scan_time_ms,
        round(derived.start_deg * SCALE_DEG),
        round(derived.step_deg * SCALE_DEG),
        derived.interbeam_us,
    ).ljust(_DERIVED_BYTES, b"\0")


def _beam_bytes(instance: Instance) -> bytes:
    beams = instance.beams
    if beams is None:
        return b""
    values = np.zeros(len(beams), dtype=_BEAM)
    values["distance"], values["rssi"], values["status"] = beams.distance, beams.rssi, beams.status
    return len(beams).to_bytes(_COUNT, "little") + values.tobytes()
