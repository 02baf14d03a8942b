"""Instant actions and states of VDA 5050: JSON from the network, some of which moves the robot."""

from __future__ import annotations

import contextlib
import json
from typing import Any

from messages import MAP_ID, pose_of

from amr_slam.encodings.vda5050 import Vda5050Settings, encoders
from amr_slam.wire import SetPose, WireError

_SETTINGS = Vda5050Settings(
    versions=("2.1", "3.0"), manufacturer="acme", take_position=True, take_radius_m=2.0
)


def target(data: bytes) -> None:
    """What is not refused is a command that passes its own checks again; what is told is JSON."""
    for encoder in encoders(_SETTINGS, prefix="amr", robot="amr7", pose_hz=50.0):
        list(encoder.pose(pose_of()))
        for inlet in encoder.inlets:
            with contextlib.suppress(WireError):
                request = inlet.decode(data)
                if request is not None:
                    assert isinstance(request.command, SetPose)
                    assert SetPose.decode(request.command.encode()) == request.command
        for encoded in encoder.pose(pose_of()):
            json.loads(encoded.payload)


def seeds() -> list[bytes]:
    """A position for each version, with others beside it, and a state."""
    position = {"x": 1.5, "y": -2.0, "theta": 0.5, "mapId": MAP_ID, "lastNodeId": "n7"}
    parameters = [{"key": key, "value": value} for key, value in position.items()]
    pause: dict[str, Any] = {"actionType": "startPause", "actionId": "p", "blockingType": "HARD"}
    messages = []
    for kind in ("initPosition", "initializePosition"):
        action = {"actionType": kind, "actionId": "a", "actionParameters": parameters}
        whole = {"headerId": 1, "manufacturer": "acme", "serialNumber": "amr7"}
        messages += [{**whole, "actions": [action]}, {"actions": [pause, action, action]}]
    messages.append({"headerId": 4711, "orderId": "", "errors": [{"errorType": "x"}]})
    return [json.dumps(message).encode() for message in messages]
