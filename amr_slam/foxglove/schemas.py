"""JSON schemas by which Foxglove knows a channel's messages: those of its own that we write.

Fields and types are Foxglove's; of a scene only the primitives that we use are named.
"""

from __future__ import annotations

import json
from typing import Any, Final

_Schema = dict[str, Any]

TRANSFORMS: Final = "foxglove.FrameTransforms"
SCENE_UPDATE: Final = "foxglove.SceneUpdate"
LOG: Final = "foxglove.Log"
GRID: Final = "foxglove.Grid"
POINT_CLOUD: Final = "foxglove.PointCloud"
POSE_IN_FRAME: Final = "foxglove.PoseInFrame"

_NUMBER: Final[_Schema] = {"type": "number"}
_WHOLE: Final[_Schema] = {"type": "integer", "minimum": 0}
_TEXT: Final[_Schema] = {"type": "string"}
_FLAG: Final[_Schema] = {"type": "boolean"}
# Foxglove unpacks what is marked so, and only that.
_BINARY: Final[_Schema] = {"type": "string", "contentEncoding": "base64"}


def _object(title: str, **properties: _Schema) -> _Schema:
    return {
        "title": title,
        "type": "object",
        "properties": properties,
        "required": list(properties),
    }


def _list(items: _Schema) -> _Schema:
    return {"type": "array", "items": items}


_TIME: Final = _object("time", sec=_WHOLE, nsec=_WHOLE)
_DURATION: Final = _object("duration", sec={"type": "integer"}, nsec=_WHOLE)
_VECTOR2: Final = _object("foxglove.Vector2", x=_NUMBER, y=_NUMBER)
_VECTOR3: Final = _object("foxglove.Vector3", x=_NUMBER, y=_NUMBER, z=_NUMBER)
_QUATERNION: Final = _object("foxglove.Quaternion", **dict.fromkeys("xyzw", _NUMBER))
_POSE: Final = _object("foxglove.Pose", position=_VECTOR3, orientation=_QUATERNION)
_COLOUR: Final = _object("foxglove.Color", **dict.fromkeys("rgba", _NUMBER))
_FIELDS: Final = _list(
    _object("foxglove.PackedElementField", name=_TEXT, offset=_WHOLE, type=_WHOLE)
)
_ARROW: Final = _object(
    "foxglove.ArrowPrimitive",
    pose=_POSE,
    shaft_length=_NUMBER,
    shaft_diameter=_NUMBER,
    head_length=_NUMBER,
    head_diameter=_NUMBER,
    color=_COLOUR,
)
_CYLINDER: Final = _object(
    "foxglove.CylinderPrimitive",
    pose=_POSE,
    size=_VECTOR3,
    bottom_scale=_NUMBER,
    top_scale=_NUMBER,
    color=_COLOUR,
)
_CAPTION: Final = _object(
    "foxglove.TextPrimitive",
    pose=_POSE,
    billboard=_FLAG,
    font_size=_NUMBER,
    scale_invariant=_FLAG,
    color=_COLOUR,
    text=_TEXT,
)
_ENTITY: Final = _object(
    "foxglove.SceneEntity",
    timestamp=_TIME,
    frame_id=_TEXT,
    id=_TEXT,
    lifetime=_DURATION,
    frame_locked=_FLAG,
    metadata=_list(_object("foxglove.KeyValuePair", key=_TEXT, value=_TEXT)),
    arrows=_list(_ARROW),
    cubes=_list({"type": "object"}),
    spheres=_list({"type": "object"}),
    cylinders=_list(_CYLINDER),
    lines=_list({"type": "object"}),
    triangles=_list({"type": "object"}),
    texts=_list(_CAPTION),
    models=_list({"type": "object"}),
)
_SCHEMAS: Final = (
    _object(
        TRANSFORMS,
        transforms=_list(
            _object(
                "foxglove.FrameTransform",
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_VECTOR3,
                rotation=_QUATERNION,
            )
        ),
    ),
    _object(
        SCENE_UPDATE,
        deletions=_list(
            _object("foxglove.SceneEntityDeletion", timestamp=_TIME, type=_WHOLE, id=_TEXT)
        ),
        entities=_list(_ENTITY),
    ),
    _object(LOG, timestamp=_TIME, level=_WHOLE, message=_TEXT, name=_TEXT, file=_TEXT, line=_WHOLE),
    _object(
        GRID,
        timestamp=_TIME,
        frame_id=_TEXT,
        pose=_POSE,
        column_count=_WHOLE,
        cell_size=_VECTOR2,
        row_stride=_WHOLE,
        cell_stride=_WHOLE,
        fields=_FIELDS,
        data=_BINARY,
    ),
    _object(
        POINT_CLOUD,
        timestamp=_TIME,
        frame_id=_TEXT,
        pose=_POSE,
        point_stride=_WHOLE,
        fields=_FIELDS,
        data=_BINARY,
    ),
    _object(POSE_IN_FRAME, timestamp=_TIME, frame_id=_TEXT, pose=_POSE),
)
SCHEMAS: Final = {
    schema["title"]: json.dumps(schema, separators=(",", ":")).encode("ascii")
    for schema in _SCHEMAS
}
"""By name, as bytes for a channel."""
