"""The scan telegram LMDscandata, every block of it, both ways and in both dialects. No I/O.

Source: fact sheet, B.4 and B.5. The layout is the same in CoLa A and CoLa B; it is read to the
last byte, and what leaves a byte over is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.fields import Fields, FieldWriter, Words, fields, writer
from amr_drivers.sick_cola.framing import Dialect
from amr_slam.geometry import readonly

_LENGTH_BITS: tuple[Literal[16, 8], ...] = (16, 8)
"""Of the names' length fields in CoLa B: not documented; the one that leaves nothing over is it."""
_MAX_ENCODERS = 16


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One list of values over the sweep: distances, intensities or angles."""

    name: str
    """Five characters: DIST1 .. DIST5, RSSI1 .. RSSI5, ANGL1, VANG1."""
    bits: Literal[8, 16]
    scale: float
    offset: float
    start_angle: int
    """1/10000 degree, counter-clockwise."""
    angle_step: int
    """1/10000 degree, rounded; see :func:`amr_drivers.sick_cola.meaning.exact_step_deg`."""
    values: Words
    """(n,) read-only, raw."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", readonly(self.values, np.uint16))


@dataclass(frozen=True, slots=True)
class Encoder:
    """A wheel encoder wired to the scanner."""

    position: int
    speed: int


@dataclass(frozen=True, slots=True)
class Position:
    """Where the scanner was told that it is."""

    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    rotation: int


@dataclass(frozen=True, slots=True)
class DeviceTime:
    """The device's date; since 1970 unless it has a time server."""

    year: int
    month: int
    day: int
    hour: int
    minute: int
    second: int
    microsecond: int


@dataclass(frozen=True, slots=True)
class Event:
    """A digital input that changed."""

    name: str
    encoder: int
    time_us: int
    angle: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanData:
    """One LMDscandata telegram as sent."""

    version: int
    device_number: int
    serial_number: int
    status: tuple[int, int]
    telegram_counter: int
    scan_counter: int
    start_up_us: int
    """Time since start-up at the scan: of its start or of its end, that depends on the device."""
    transmission_us: int
    """Time of transmission, same clock; both wrap at 2**32."""
    inputs: tuple[int, int]
    outputs: tuple[int, int]
    layer_angle: int
    """1/100 degree; 0 on scanners with one layer."""
    scan_frequency: int
    """1/100 Hz."""
    measurement_frequency: int
    """100 Hz."""
    channels: tuple[Channel, ...]
    encoders: tuple[Encoder, ...] = ()
    position: Position | None = None
    device_name: str | None = None
    comment: str | None = None
    time: DeviceTime | None = None
    event: Event | None = None

    def channel(self, kind: Literal["DIST", "RSSI"]) -> Channel | None:
        """The first echo's, None where no channel is of this kind."""
        of_kind = [channel for channel in self.channels if channel.name.startswith(kind)]
        return min(of_kind, key=lambda channel: channel.name, default=None)


def decode_scan(body: bytes, dialect: Dialect) -> ScanData:
    """The telegram behind ``sRA LMDscandata`` or ``sSN LMDscandata``. Raises BadTelegram."""
    read = fields(body, dialect)
    head = [read.unsigned(bits) for bits in (16, 16, 32, 8, 8, 16, 16, 32, 32, 8, 8, 8, 8)]
    layer_angle = read.signed(16)
    scan_frequency, measurement_frequency = read.unsigned(32), read.unsigned(32)
    encoder_count = read.unsigned(16)
    if encoder_count > _MAX_ENCODERS:
        raise BadTelegram(f"{encoder_count} encoders")
    encoders = tuple(Encoder(read.unsigned(32), read.unsigned(16)) for _ in range(encoder_count))
    channels = (*_channels(read, 16), *_channels(read, 8))
    position, name, comment, time, event = _tail(read)
    return ScanData(
        version=head[0],
        device_number=head[1],
        serial_number=head[2],
        status=(head[3], head[4]),
        telegram_counter=head[5],
        scan_counter=head[6],
        start_up_us=head[7],
        transmission_us=head[8],
        inputs=(head[9], head[10]),
        outputs=(head[11], head[12]),
        layer_angle=layer_angle,
        scan_frequency=scan_frequency,
        measurement_frequency=measurement_frequency,
        encoders=encoders,
        channels=channels,
        position=position,
        device_name=name,
        comment=comment,
        time=time,
        event=event,
    )


_Tail = tuple[Position | None, str | None, str | None, DeviceTime | None, Event | None]


def _channels(read: Fields, bits: Literal[8, 16]) -> list[Channel]:
    return [_channel(read, bits) for _ in range(read.unsigned(16))]


def _channel(read: Fields, bits: Literal[8, 16]) -> Channel:
    name = read.letters(5)
    scale, offset = read.real(), read.real()
    start_angle, angle_step = read.signed(32), read.unsigned(16)
    return Channel(
        name=name,
        bits=bits,
        scale=scale,
        offset=offset,
        start_angle=start_angle,
        angle_step=angle_step,
        values=read.values(read.unsigned(16), bits),
    )


def _tail(read: Fields) -> _Tail:
    """The blocks after the channels, whatever the width of their texts' length fields."""
    mark, reason = read.mark(), BadTelegram("cut short")
    for length_bits in _LENGTH_BITS:
        read.back_to(mark)
        try:
            return _blocks(read, length_bits)
        except BadTelegram as error:
            reason = error
    raise reason


def _blocks(read: Fields, length_bits: Literal[8, 16]) -> _Tail:
    position = name = comment = time = event = None
    if _flag(read):
        x, y, z, roll, pitch, yaw = (read.real() for _ in range(6))
        position = Position(x, y, z, roll, pitch, yaw, read.unsigned(8))
    if _flag(read):
        name = read.text(length_bits)
    if _flag(read):
        comment = read.text(length_bits)
    if _flag(read):
        year = read.unsigned(16)
        month, day, hour, minute, second = (read.unsigned(8) for _ in range(5))
        time = DeviceTime(year, month, day, hour, minute, second, read.unsigned(32))
    if _flag(read):
        event = Event(read.letters(4), read.unsigned(32), read.unsigned(32), read.signed(32))
    read.end()
    return position, name, comment, time, event


def _flag(read: Fields) -> bool:
    flag = read.unsigned(16)
    if flag > 1:
        raise BadTelegram(f"a block's flag is {flag}")
    return flag == 1


def encode_scan(scan: ScanData, dialect: Dialect, length_bits: Literal[8, 16] = 16) -> bytes:
    """What :func:`decode_scan` reads; ``length_bits`` of the texts' length fields in CoLa B."""
    out = writer(dialect)
    status, inputs, outputs = scan.status, scan.inputs, scan.outputs
    out.unsigned(scan.version, 16)
    out.unsigned(scan.device_number, 16)
    out.unsigned(scan.serial_number, 32)
    for byte in status:
        out.unsigned(byte, 8)
    out.unsigned(scan.telegram_counter, 16)
    out.unsigned(scan.scan_counter, 16)
    out.unsigned(scan.start_up_us, 32)
    out.unsigned(scan.transmission_us, 32)
    for byte in (*inputs, *outputs):
        out.unsigned(byte, 8)
    out.signed(scan.layer_angle, 16)
    out.unsigned(scan.scan_frequency, 32)
    out.unsigned(scan.measurement_frequency, 32)
    out.unsigned(len(scan.encoders), 16)
    for encoder in scan.encoders:
        out.unsigned(encoder.position, 32)
        out.unsigned(encoder.speed, 16)
    _write_channels(out, scan.channels)
    _write_blocks(out, scan, length_bits)
    return out.data()


def _write_channels(out: FieldWriter, channels: tuple[Channel, ...]) -> None:
    for bits in (16, 8):
        of_width = [channel for channel in channels if channel.bits == bits]
        out.unsigned(len(of_width), 16)
        for channel in of_width:
            out.letters(channel.name)
            out.real(channel.scale)
            out.real(channel.offset)
            out.signed(channel.start_angle, 32)
            out.unsigned(channel.angle_step, 16)
            out.unsigned(len(channel.values), 16)
            out.values(channel.values, channel.bits)


def _write_blocks(out: FieldWriter, scan: ScanData, length_bits: Literal[8, 16]) -> None:
    out.unsigned(int(scan.position is not None), 16)
    if (position := scan.position) is not None:
        for value in (position.x, position.y, position.z):
            out.real(value)
        for value in (position.roll, position.pitch, position.yaw):
            out.real(value)
        out.unsigned(position.rotation, 8)
    for text in (scan.device_name, scan.comment):
        out.unsigned(int(text is not None), 16)
        if text is not None:
            out.text(text, length_bits)
    out.unsigned(int(scan.time is not None), 16)
    if (time := scan.time) is not None:
        out.unsigned(time.year, 16)
        for value in (time.month, time.day, time.hour, time.minute, time.second):
            out.unsigned(value, 8)
        out.unsigned(time.microsecond, 32)
    out.unsigned(int(scan.event is not None), 16)
    if (event := scan.event) is not None:
        out.letters(event.name)
        out.unsigned(event.encoder, 32)
        out.unsigned(event.time_us, 32)
        out.signed(event.angle, 32)
