"""The JSON messages of native recordings: samples to bytes and back, exactly.

Scans and poses carry the fields of Foxglove's well-known schemas, so that its tools draw them,
and beside these our own, so that nothing is lost. Numbers survive to the last bit.
"""

from __future__ import annotations

import json
import math
from typing import Any, NamedTuple

import numpy as np

from amr_slam.foxglove import (
    POSE_IN_FRAME,
    Fields,
    as_bytes,
    pose_fields,
    pose_in_frame,
    time_fields,
)
from amr_slam.geometry import Pose2
from amr_slam.recording.raw import RAW_PREFIX, RAW_SCHEMA, encode_raw
from amr_slam.recording.values import Sample
from amr_slam.samples import JointSample, OdometrySample, Raw, RawBytes, RawFrame, Scan, WheelSample

MESSAGE_BOUND_BYTES = 1 << 20
_BEAMS_BOUND = 20_000
_JOINTS_BOUND = 64
_COUNT_BOUND = (1 << 63) - 1
_SECOND_NS = 1_000_000_000


def _schema(title: str, required: Fields, optional: Fields | None = None) -> bytes:
    schema = {
        "title": title,
        "type": "object",
        "properties": required | (optional or {}),
        "required": list(required),
    }
    return json.dumps(schema, separators=(",", ":")).encode("ascii")


_NUMBER = {"type": "number"}
_INTEGER = {"type": "integer"}
_STRING = {"type": "string"}
_TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": _INTEGER, "nsec": _INTEGER},
}
_POSE = {
    "type": "object",
    "title": "foxglove.Pose",
    "properties": {
        "position": {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)},
        "orientation": {"type": "object", "properties": dict.fromkeys("xyzw", _NUMBER)},
    },
}
_NUMBERS = {"type": "array", "items": _NUMBER}
_INTEGERS = {"type": "array", "items": _INTEGER}
_STRINGS = {"type": "array", "items": _STRING}

_ODOM = {"type": "object", "properties": dict.fromkeys(("x", "y", "theta"), _NUMBER)}
_HEALTH = {
    "type": "object",
    "properties": {"link": _STRING, "rate_hz": _NUMBER, "samples": _INTEGER, "errors": _INTEGER},
}

SCAN_SCHEMA = "foxglove.LaserScan"
POSE_SCHEMA = POSE_IN_FRAME
WHEELS_SCHEMA = "amr_slam.WheelSample"
PUBLISHED_SCHEMAS = {"pose": "amr_slam.PoseMessage", "status": "amr_slam.StatusMessage"}
"""Of what was published, by the last part of its key. The messages are :mod:`amr_slam.wire`'s; the
schemas name what a chart can show of them."""
JOINTS_SCHEMA = "amr_slam.JointSample"
DECISION_SCHEMA = "amr_slam.Decision"
"""What the daemon's loop did with the localizer beside the samples (:mod:`amr_slam.rerun`)."""
SCHEMAS = {
    SCAN_SCHEMA: _schema(
        SCAN_SCHEMA,
        {
            "timestamp": _TIME,
            "frame_id": _STRING,
            "pose": _POSE,
            "start_angle": _NUMBER,
            "end_angle": _NUMBER,
            "ranges": _NUMBERS,
            "intensities": _NUMBERS,
            "angle_step": _NUMBER,
            "sweep": _NUMBER,
            "no_return": _INTEGERS,
        },
        {"range_max": _NUMBER, "seq": _INTEGER},
    ),
    POSE_SCHEMA: _schema(
        POSE_SCHEMA,
        {"timestamp": _TIME, "frame_id": _STRING, "pose": _POSE, "theta": _NUMBER},
        {"segment": _INTEGER},
    ),
    WHEELS_SCHEMA: _schema(
        WHEELS_SCHEMA,
        {"timestamp": _TIME, "left_rad": _NUMBER, "right_rad": _NUMBER, "segment": _INTEGER},
    ),
    PUBLISHED_SCHEMAS["pose"]: _schema(
        PUBLISHED_SCHEMAS["pose"],
        {
            **dict.fromkeys(("stamp", "age_s", "x", "y", "theta", "vx", "omega"), _NUMBER),
            **dict.fromkeys(("error95_m", "since_fix_s", "since_fix_m"), _NUMBER),
            **dict.fromkeys(("v", "seq", "epoch"), _INTEGER),
            **dict.fromkeys(("robot", "state"), _STRING),
            "covariance": _NUMBERS,
            "odom": _ODOM,
        },
    ),
    PUBLISHED_SCHEMAS["status"]: _schema(
        PUBLISHED_SCHEMAS["status"],
        {
            **dict.fromkeys(("v", "seq"), _INTEGER),
            **dict.fromkeys(("robot", "state"), _STRING),
            **dict.fromkeys(("stamp", "uptime_s", "cpu_percent", "memory_mb"), _NUMBER),
            **dict.fromkeys(("wheels", "slam"), _HEALTH),
        },
    ),
    DECISION_SCHEMA: _schema(DECISION_SCHEMA, {"do": _STRING, "arguments": {"type": "array"}}),
    JOINTS_SCHEMA: _schema(
        JOINTS_SCHEMA,
        {"timestamp": _TIME, "names": _STRINGS, "angles_rad": _NUMBERS, "segment": _INTEGER},
    ),
}


class Entry(NamedTuple):
    """One message of a recording."""

    topic: str
    schema: str
    stamp_ns: int
    data: bytes


def encode(sample: Sample | Raw) -> Entry:
    """The message of a sample, or of what passed on a line."""
    if isinstance(sample, RawBytes | RawFrame):
        topic = f"{RAW_PREFIX}{sample.device}"
        return Entry(topic, RAW_SCHEMA, sample.stamp_ns, encode_raw(sample))
    return Entry(*_encode_sample(sample))


def encode_published(leaf: str, stamp_ns: int, payload: bytes) -> Entry:
    """What was published at ``stamp_ns`` (monotonic) under the key that ends in ``leaf``."""
    return Entry(f"/{leaf}", PUBLISHED_SCHEMAS[leaf], stamp_ns, payload)


def encode_decision(stamp_ns: int, do: str, arguments: Any) -> Entry:
    """``arguments``: plain JSON values."""
    data = as_bytes({"do": do, "arguments": arguments})
    return Entry("/decisions", DECISION_SCHEMA, stamp_ns, data)


def _encode_sample(sample: Sample) -> tuple[str, str, int, bytes]:
    stamp_ns = sample.stamp_ns
    if isinstance(sample, Scan):
        return f"/scan/{sample.scanner}", SCAN_SCHEMA, stamp_ns, as_bytes(_scan_fields(sample))
    if isinstance(sample, OdometrySample):
        fields = _pose_fields(stamp_ns, "odom", sample.odom_from_base)
        return "/odometry", POSE_SCHEMA, stamp_ns, as_bytes(fields | {"segment": sample.segment})
    if isinstance(sample, JointSample):
        fields = {
            "timestamp": time_fields(stamp_ns),
            "names": list(sample.names),
            "angles_rad": list(sample.angles_rad),
            "segment": sample.segment,
        }
        return "/joints", JOINTS_SCHEMA, stamp_ns, as_bytes(fields)
    fields = {
        "timestamp": time_fields(stamp_ns),
        "left_rad": sample.left_rad,
        "right_rad": sample.right_rad,
        "segment": sample.segment,
    }
    return "/wheels", WHEELS_SCHEMA, stamp_ns, as_bytes(fields)


def encode_truth(stamp_ns: int, map_from_base: Pose2) -> Entry:
    """The message of where the robot really was."""
    data = as_bytes(_pose_fields(stamp_ns, "map", map_from_base))
    return Entry("/truth", POSE_SCHEMA, stamp_ns, data)


def _scan_fields(scan: Scan) -> Fields:
    """No measurement and no return are both 0 in ``ranges``; ``no_return`` lists the latter."""
    ranges = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, 0.0)
    last_rad = scan.angle_min_rad + scan.angle_step_rad * (len(ranges) - 1)
    fields: Fields = {
        "timestamp": time_fields(scan.stamp_ns),
        "frame_id": scan.scanner,
        "pose": pose_fields(Pose2.identity()),
        "start_angle": scan.angle_min_rad,
        "end_angle": last_rad,
        "ranges": ranges.tolist(),
        "intensities": [],
        "angle_step": scan.angle_step_rad,
        "sweep": scan.sweep_s,
        "no_return": np.flatnonzero(np.isposinf(scan.ranges_m)).tolist(),
    }
    if math.isfinite(scan.range_max_m):
        fields["range_max"] = scan.range_max_m
    if scan.seq is not None:
        fields["seq"] = scan.seq
    return fields


def _pose_fields(stamp_ns: int, frame: str, frame_from_base: Pose2) -> Fields:
    return pose_in_frame(stamp_ns, frame, frame_from_base) | {"theta": frame_from_base.theta_rad}


def decode(schema: str, data: bytes) -> Sample | tuple[int, Pose2]:
    """Any sample, or (stamp in ns, pose) of a pose without a segment.

    Raises ValueError, KeyError, TypeError, OverflowError or RecursionError on anything else.
    """
    if len(data) > MESSAGE_BOUND_BYTES:
        raise ValueError(f"message of {len(data)} bytes")
    fields = json.loads(data)
    if not isinstance(fields, dict):
        raise TypeError("message is not a JSON object")
    stamp_ns = _stamp(fields["timestamp"])
    if schema == SCAN_SCHEMA:
        return _scan(fields, stamp_ns)
    if schema == WHEELS_SCHEMA:
        return WheelSample(
            stamp_ns=stamp_ns,
            left_rad=_number(fields["left_rad"]),
            right_rad=_number(fields["right_rad"]),
            segment=_integer(fields["segment"]),
        )
    if schema == JOINTS_SCHEMA:
        return _joints(fields, stamp_ns)
    if schema != POSE_SCHEMA:
        raise ValueError(f"unknown schema {schema!r}")
    position = fields["pose"]["position"]
    pose = Pose2(_number(position["x"]), _number(position["y"]), _number(fields["theta"]))
    if "segment" not in fields:
        return stamp_ns, pose
    return OdometrySample(
        stamp_ns=stamp_ns, odom_from_base=pose, segment=_integer(fields["segment"])
    )


def _joints(fields: Fields, stamp_ns: int) -> JointSample:
    names, angles_rad = fields["names"], fields["angles_rad"]
    if (
        not isinstance(names, list)
        or not isinstance(angles_rad, list)
        or len(names) > _JOINTS_BOUND
    ):
        raise ValueError("names and angles are no lists of a possible length")
    if not all(isinstance(name, str) for name in names):
        raise TypeError("a joint's name is no text")
    return JointSample(
        stamp_ns=stamp_ns,
        names=tuple(names),
        angles_rad=tuple(_number(angle) for angle in angles_rad),
        segment=_integer(fields["segment"]),
    )


def _scan(fields: Fields, stamp_ns: int) -> Scan:
    raw, no_return = fields["ranges"], fields["no_return"]
    if not isinstance(raw, list) or not isinstance(no_return, list) or len(raw) > _BEAMS_BOUND:
        raise ValueError("ranges are no list of a possible length")
    ranges = np.array([_number(value) for value in raw], dtype=np.float64)
    ranges[~(ranges > 0.0)] = np.nan
    for index in no_return:
        ranges[_integer(index, len(raw) - 1)] = np.inf
    angle_step_rad, sweep_s = _number(fields["angle_step"]), _number(fields["sweep"])
    if angle_step_rad <= 0.0 or sweep_s < 0.0:
        raise ValueError(f"angle step of {angle_step_rad} rad, sweep of {sweep_s} s")
    scanner = fields["frame_id"]
    if not isinstance(scanner, str):
        raise TypeError("frame_id is no text")
    return Scan(
        scanner=scanner,
        stamp_ns=stamp_ns,
        ranges_m=ranges,
        angle_min_rad=_number(fields["start_angle"]),
        angle_step_rad=angle_step_rad,
        sweep_s=sweep_s,
        range_max_m=_number(fields["range_max"]) if "range_max" in fields else math.inf,
        seq=_integer(fields["seq"]) if "seq" in fields else None,
    )


def _stamp(time: Fields) -> int:
    seconds, rest_ns = _integer(time["sec"]), _integer(time["nsec"], _SECOND_NS - 1)
    return _integer(seconds * _SECOND_NS + rest_ns)


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r:.40} is not a finite number")
    return float(value)


def _integer(value: object, bound: int = _COUNT_BOUND) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= bound:
        raise ValueError(f"{value!r:.40} is not a whole number from 0 to {bound}")
    return value
