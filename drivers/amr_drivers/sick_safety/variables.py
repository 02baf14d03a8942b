"""Variables and methods of the scanners: bytes to values and back, no I/O.

Source: protocol fact sheet, sections C.2 and C.3. Indices of the identity and their strings with
a length of 2 bytes: SICK's own driver sick_safetyscanners_base. All little-endian.
"""

from __future__ import annotations

import ipaddress
import struct
from dataclasses import dataclass
from typing import Final

from amr_drivers.errors import BadTelegram

SERIAL_NUMBER: Final = 3
FIRMWARE: Final = 4
TYPE_CODE: Final = 13
DEVICE_STATUS: Final = 15
REQUIRED_ACTION: Final = 16
DEVICE_NAME: Final = 17
STATUS_OVERVIEW: Final = 23
CONFIGURATION: Final = 28
LATEST_TELEGRAM: Final = 179
"""Of channel 0; those of the others follow."""
CHANNELS: Final = 4
CHANGE_STREAM: Final = 176
"""Method: where a channel's data are sent."""

STATUS: Final = 1
DERIVED: Final = 2
BEAMS: Final = 4
FIELDS: Final = 8
APPLICATION: Final = 16
"""Blocks that a channel may send."""

SCALE_DEG: Final = 4_194_304
"""Angles are whole numbers of 1/4194304 degree."""
AHEAD_DEG: Final = 90.0
"""What the device calls the direction straight ahead."""

_MAX_TEXT: Final = 256
_ACTIONS: Final = (
    "confirm or change the configuration",
    "check and test the configuration",
    "check the surroundings and the partner device",
    "check the inputs and interfaces",
    "check the device and its error messages",
    "run the set-up, network included",
    "check the firmware",
    "wait",
)
_OVERVIEW: Final = struct.Struct("<cBBB3B5xIIH2xI24xIH")
_CONFIGURATION: Final = struct.Struct("<36xI12xI12x16s")
_STREAM: Final = struct.Struct("<B3xBB2x4sHHiiH2x")
_INTERFACES: Final = {"IZ": 1, "PZ": 3, "LZ": 3, "AN": 4, "EN": 4}
"""Letters 13 and 14 of the type code to the interface's number; EFI-pro has several pairs."""
_EFI_PRO: Final = 0


def encode_text(text: str) -> bytes:
    """A string behind its length."""
    raw = text.encode("latin-1")
    return len(raw).to_bytes(2, "little") + raw


def decode_text(data: bytes) -> str:
    """A string behind its length; what no display shows is left out. Raises BadTelegram."""
    length = int.from_bytes(data[:2], "little")
    if len(data) < 2 or length > min(len(data) - 2, _MAX_TEXT):
        raise BadTelegram(f"a text of {length} bytes in {len(data)}")
    text = data[2 : 2 + length].decode("latin-1")
    return "".join(letter for letter in text if letter.isprintable()).strip()


def model_of(type_code: str) -> str:
    """The product's name. Example: ``NANS3-CAAZ30AN1`` is a nanoScan3."""
    names = {"NANS3": "nanoScan3", "MICS3": "microScan3/outdoorScan3"}
    return names.get(type_code[:5], type_code or "microScan3 family")


def interface_of(type_code: str) -> int:
    """Number of the interface in :class:`Stream`, by the type code's letters 13 and 14."""
    return _INTERFACES.get(type_code[12:14], _EFI_PRO)


def actions(data: bytes) -> tuple[str, ...]:
    """What somebody has to do at the scanner. Raises BadTelegram."""
    if len(data) < 2:
        raise BadTelegram(f"required actions in {len(data)} bytes")
    bits = int.from_bytes(data[:2], "little")
    return tuple(text for bit, text in enumerate(_ACTIONS) if bits >> bit & 1)


def encode_actions(bits: int) -> bytes:
    """The value of REQUIRED_ACTION."""
    return bits.to_bytes(2, "little")


@dataclass(frozen=True, slots=True, kw_only=True)
class Configuration:
    """Checks of what is configured in the device: the same for the same configuration."""

    checksum: int
    network_checksum: int
    digest: bytes
    """16 bytes."""


def decode_configuration(data: bytes) -> Configuration:
    """The value of CONFIGURATION. Raises BadTelegram where bytes are missing or none is valid."""
    if len(data) < _CONFIGURATION.size or data[0] == 0:
        raise BadTelegram(f"metadata of a configuration in {len(data)} bytes")
    checksum, network, digest = _CONFIGURATION.unpack_from(data)
    return Configuration(checksum=checksum, network_checksum=network, digest=digest)


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusOverview:
    """How the device is. The numbers of states are not documented publicly."""

    version: str
    device_state: int
    configuration_state: int
    application_state: int
    power_on_count: int
    time_ms: int
    date: int
    error_code: int
    error_time_ms: int = 0
    error_date: int = 0


def encode_overview(overview: StatusOverview) -> bytes:
    """The value of STATUS_OVERVIEW."""
    letter, major, minor, release = overview.version.split(".")
    return _OVERVIEW.pack(
        letter.encode("latin-1"),
        int(major),
        int(minor),
        int(release),
        overview.device_state,
        overview.configuration_state,
        overview.application_state,
        overview.power_on_count,
        overview.time_ms,
        overview.date,
        overview.error_code,
        overview.error_time_ms,
        overview.error_date,
    )


def decode_overview(data: bytes) -> StatusOverview:
    """Raises BadTelegram where bytes are missing or the version says that nothing is valid."""
    if len(data) < _OVERVIEW.size or data[0] == 0:
        raise BadTelegram(f"a status overview of {len(data)} bytes")
    letter, major, minor, release, *states = _OVERVIEW.unpack_from(data)
    device, configuration, application, count, time_ms, date, code, at_ms, on = states
    return StatusOverview(
        version=f"{letter.decode('latin-1')}.{major}.{minor}.{release}",
        device_state=device,
        configuration_state=configuration,
        application_state=application,
        power_on_count=count,
        time_ms=time_ms,
        date=date,
        error_code=code,
        error_time_ms=at_ms,
        error_date=on,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stream:
    """Where a channel's data are to be sent: the argument of CHANGE_STREAM."""

    channel: int
    enabled: bool
    interface: int
    """0 EFI-pro, 1 EtherNet/IP, 3 PROFINET, 4 not safety-related Ethernet."""
    receiver: str
    """IPv4 address."""
    port: int
    """UDP port; 0 is none."""
    every_nth: int = 1
    start_deg: float = 0.0
    """First beam as the robot has it: 0 straight ahead, counter-clockwise."""
    stop_deg: float = 0.0
    """Last beam; the same as ``start_deg``: all beams."""
    features: int = STATUS | DERIVED | BEAMS


def encode_stream(stream: Stream) -> bytes:
    """28 bytes. Raises ValueError for a receiver that is no IPv4 address."""
    # All beams are asked for by 0 and 0 as sent, not by angles that are the same.
    whole = stream.start_deg == stream.stop_deg
    start, stop = (0, 0) if whole else (_sent(stream.start_deg), _sent(stream.stop_deg))
    return _STREAM.pack(
        stream.channel,
        stream.enabled,
        stream.interface,
        ipaddress.IPv4Address(stream.receiver).packed[::-1],
        stream.port,
        stream.every_nth,
        start,
        stop,
        stream.features,
    )


def decode_stream(data: bytes) -> Stream:
    """Raises BadTelegram unless it is 28 bytes that name a channel, a port and a rate."""
    if len(data) != _STREAM.size:
        raise BadTelegram(f"settings of a channel in {len(data)} bytes")
    channel, enabled, interface, receiver, port, nth, start, stop, features = _STREAM.unpack(data)
    if channel >= CHANNELS or enabled > 1 or nth == 0 or (enabled and port == 0):
        raise BadTelegram(f"channel {channel}, every {nth} scans to port {port}")
    whole = start == stop == 0
    return Stream(
        channel=channel,
        enabled=bool(enabled),
        interface=interface,
        receiver=str(ipaddress.IPv4Address(receiver[::-1])),
        port=port,
        every_nth=nth,
        start_deg=0.0 if whole else start / SCALE_DEG - AHEAD_DEG,
        stop_deg=0.0 if whole else stop / SCALE_DEG - AHEAD_DEG,
        features=features,
    )


def _sent(angle_deg: float) -> int:
    return round((angle_deg + AHEAD_DEG) * SCALE_DEG)
