"""JSON Schema of everything that goes over the network, for readers in other languages."""

from __future__ import annotations

from typing import Any, Final

from amr_slam.wire.commands import COMMANDS, CommandReply
from amr_slam.wire.map_changes import MapChanges
from amr_slam.wire.messages import MapImage, PoseMessage, ScanMessage, StatusMessage
from amr_slam.wire.values import Payload

_PAYLOADS: Final[dict[str, type[Payload]]] = {
    **{said.kind: said for said in (PoseMessage, StatusMessage, ScanMessage)},
    **{said.kind: said for said in (MapImage, MapChanges)},
    **COMMANDS,
    CommandReply.kind: CommandReply,
}


def json_schemas() -> dict[str, dict[str, Any]]:
    """JSON Schema (2020-12) of each payload by its kind: commands as a robot takes them, where
    what has a default may be left out; all else as robots send it, where nothing is."""
    return {
        kind: {"$schema": "https://json-schema.org/draft/2020-12/schema"}
        | payload.model_json_schema(mode="validation" if kind in COMMANDS else "serialization")
        for kind, payload in _PAYLOADS.items()
    }
