"""What passes on a device's line, as messages of a native recording.

``/raw/<device>`` carries messages of the schema ``amr_slam/Raw`` in the serialization of ROS 1
(http://wiki.ros.org/msg): little-endian, packed, an array after its length. It needs no library,
and Foxglove and the tools of ROS read it by the definition that the file holds. The log time of a
message is the stamp.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping

from amr_slam.recording.values import About, RecordedDevice
from amr_slam.samples import Raw, RawBytes, RawFrame, Way

RAW_SCHEMA = "amr_slam/Raw"
RAW_DEFINITION = b"""\
# One thing that passed on a device's line. The log time is when, by the robot's monotonic clock.
uint8 RECEIVED=0  # data came in: one read of a stream, or one datagram
uint8 SENT=1      # data went out
uint8 GAP=2       # what came before and what comes after do not belong together
uint8 OPENED=3    # the driver was opened (anew): decoding begins here without memory
uint8 FRAME=4     # a CAN frame came in
uint8 kind
uint8 EXTENDED=1  # the identifier has 29 bits
uint8 REMOTE=2
uint8 ERROR=4     # a report of the adapter, can_id is its class
uint8 can_flags
uint32 can_id
uint8[] data
"""
RAW_PREFIX = "/raw/"
ABOUT = "amr_slam"
"""Name of the metadata record that says who made the file."""

_HEAD = struct.Struct("<BBII")
_WAYS = (Way.RECEIVED, Way.SENT, Way.GAP, Way.OPENED)
_KINDS = {way: kind for kind, way in enumerate(_WAYS)}
_FRAME = len(_WAYS)
_EXTENDED, _REMOTE, _ERROR = 1, 2, 4
_MAX_CAN_ID = (1 << 29) - 1
_MAX_CAN_BYTES = 64
_MAX_TEXT = 1 << 20
_NAME_BOUND = 64
_UTC_BOUND_NS = 9_000_000_000 * 10**9  # in 2255


def encode_raw(raw: Raw) -> bytes:
    """The message; device and stamp are the channel's and the log time."""
    if isinstance(raw, RawBytes):
        return _HEAD.pack(_KINDS[raw.way], 0, 0, len(raw.data)) + raw.data
    flags = _EXTENDED * raw.is_extended | _REMOTE * raw.is_remote | _ERROR * raw.is_error
    return _HEAD.pack(_FRAME, flags, raw.identifier, len(raw.data)) + raw.data


def decode_raw(device: str, stamp_ns: int, message: bytes) -> Raw:
    """The contrary of :func:`encode_raw`. Raises ValueError for what it never gives."""
    if len(message) < _HEAD.size:
        raise ValueError(f"raw message of {len(message)} bytes")
    kind, flags, can_id, length = _HEAD.unpack_from(message)
    data = message[_HEAD.size :]
    if len(data) != length:
        raise ValueError(f"raw message with {len(data)} bytes of {length}")
    if kind == _FRAME:
        if can_id > _MAX_CAN_ID or flags > 7 or length > _MAX_CAN_BYTES:
            raise ValueError(f"CAN frame {can_id:#x} with flags {flags} and {length} bytes")
        return RawFrame(
            device=device,
            stamp_ns=stamp_ns,
            identifier=can_id,
            is_extended=bool(flags & _EXTENDED),
            is_remote=bool(flags & _REMOTE),
            is_error=bool(flags & _ERROR),
            data=data,
        )
    if kind > _FRAME or flags or can_id:
        raise ValueError(f"raw message of kind {kind} with flags {flags} and identifier {can_id}")
    way = _WAYS[kind]
    if way in {Way.GAP, Way.OPENED} and data:
        raise ValueError(f"{way} with {length} bytes")
    return RawBytes(device=device, stamp_ns=stamp_ns, way=way, data=data)


def device_metadata(device: RecordedDevice) -> dict[str, str]:
    """Of the device's channel."""
    return {"kind": device.kind, "driver": device.driver, "settings": device.settings}


def read_device(
    topic: str, metadata: Mapping[str, str], attachments: Mapping[str, bytes]
) -> RecordedDevice:
    """From its channel and the file's attachments. Raises ValueError: not of this form."""
    name = topic.removeprefix(RAW_PREFIX)
    kind, driver, settings = (metadata.get(key) for key in ("kind", "driver", "settings"))
    if kind not in {"scanner", "odometry"} or driver is None or settings is None:
        raise ValueError(f"{topic}: its metadata must be kind, driver and settings")
    if not 0 < len(name) <= _NAME_BOUND or len(driver) > _NAME_BOUND or len(settings) > _MAX_TEXT:
        raise ValueError(f"{topic}: name or metadata are too long")
    return RecordedDevice(
        name=name,
        kind="scanner" if kind == "scanner" else "odometry",
        driver=driver,
        settings=settings,
        files={
            attached.removeprefix(f"{name}/"): data
            for attached, data in attachments.items()
            if attached.startswith(f"{name}/")
        },
    )


def settings_table(device: RecordedDevice) -> dict[str, object]:
    """The settings as a configuration would have them. Raises ValueError: no JSON object."""
    try:
        table = json.loads(device.settings)
    except RecursionError:
        raise ValueError("settings are nested too deeply") from None
    if not isinstance(table, dict):
        raise ValueError("settings are no JSON object")  # noqa: TRY004 - one kind for bad content
    return table


def about_metadata(about: About) -> dict[str, str]:
    """Of the file."""
    return {
        "robot": about.robot,
        "version": about.version,
        "monotonic_ns": str(about.monotonic_ns),
        "utc_ns": str(about.utc_ns),
        "config": about.config,
        "reason": about.reason,
    }


def read_about(metadata: Mapping[str, str]) -> About:
    """Raises ValueError or KeyError: not of this form."""
    stamps = [metadata[key] for key in ("monotonic_ns", "utc_ns")]
    if not all(text.isdecimal() and len(text) < 20 for text in stamps):
        raise ValueError(f"{stamps!r:.80} are no instants")
    if int(stamps[1]) >= _UTC_BOUND_NS:
        raise ValueError("wall clock of a distant future")
    if any(len(text) > _MAX_TEXT for text in metadata.values()):
        raise ValueError("metadata are too long")
    return About(
        robot=metadata["robot"],
        version=metadata["version"],
        monotonic_ns=int(stamps[0]),
        utc_ns=int(stamps[1]),
        config=metadata["config"],
        reason=metadata.get("reason", ""),
    )
