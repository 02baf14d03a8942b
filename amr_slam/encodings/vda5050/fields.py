"""A pose message in the fields of VDA 5050. Pure."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

from amr_slam.encodings.vda5050.editions import Edition
from amr_slam.encodings.vda5050.trust import Worth
from amr_slam.wire import PoseMessage

Fields = dict[str, Any]


def to_json(fields: Fields) -> bytes:
    """JSON in UTF-8. Raises ValueError where a number is not finite."""
    return json.dumps(fields, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()


def timestamp(stamp_s: float) -> str:
    """UTC to the nearest ms: ``2026-03-18T09:30:00.125Z``."""
    seconds, milliseconds = divmod(round(1000 * stamp_s), 1000)
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%dT%H:%M:%S}.{milliseconds:03d}Z"


def position(
    edition: Edition, message: PoseMessage, known: Worth, map_id: str, map_name: str
) -> Fields:
    """``agvPosition`` or ``mobileRobotPosition``. ``map_id``: empty before there is a map."""
    fields: Fields = {
        "x": message.x,
        "y": message.y,
        "theta": message.theta,
        "mapId": map_id,
        edition.localized: known.localized,
        "localizationScore": known.score,
    }
    if known.deviation_m is not None:
        fields["deviationRange"] = known.deviation_m
    if edition.described_in_position and map_name:
        fields[edition.map_text] = map_name
    return fields


def velocity(message: PoseMessage) -> Fields:
    """In the vehicle's frame. Without ``vy``: nothing measures it."""
    return {"vx": message.vx, "omega": message.omega}


def maps(edition: Edition, message: PoseMessage, map_id: str, map_name: str) -> list[Fields]:
    """The map in use. Its version is the UUID of its content: maps may share a name."""
    if message.map is None:
        return []
    active = {"mapId": map_id, "mapVersion": message.map, "mapStatus": "ENABLED"}
    return [{**active, edition.map_text: map_name} if map_name else active]


def errors(edition: Edition, known: Worth) -> list[Fields]:
    """One while the vehicle is not localized, none otherwise."""
    if known.objection is None:
        return []
    return [
        {
            "errorType": edition.not_localized,
            "errorLevel": "FATAL",
            "errorDescription": known.objection,
            "errorHint": f"Look where the vehicle stands; set its position ({edition.set_pose}).",
        }
    ]
