"""Foxglove's own message definitions, from its SDK, as JSON schemas that leave nothing open."""

from __future__ import annotations

import functools
from typing import Any

import jsonschema
from foxglove import messages
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorSet,
)

Schema = dict[str, Any]

_KIND = FieldDescriptorProto
_SIMPLE: dict[int, Schema] = {
    _KIND.TYPE_DOUBLE: {"type": "number"},
    _KIND.TYPE_FLOAT: {"type": "number"},
    _KIND.TYPE_UINT32: {"type": "integer"},
    _KIND.TYPE_FIXED32: {"type": "integer"},
    _KIND.TYPE_STRING: {"type": "string"},
    _KIND.TYPE_BYTES: {"type": "string", "contentEncoding": "base64"},
    _KIND.TYPE_BOOL: {"type": "boolean"},
}
_NSEC = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
# In JSON these are what the documentation says, not what protobuf has.
_IN_JSON: dict[str, Schema] = {
    ".google.protobuf.Timestamp": {"sec": {"type": "integer", "minimum": 0}, "nsec": _NSEC},
    ".google.protobuf.Duration": {"sec": {"type": "integer"}, "nsec": _NSEC},
}


@functools.cache
def official(name: str) -> Schema:
    """The schema of ``foxglove.<Name>``; every field is required, no other one is allowed."""
    found = getattr(messages, name.removeprefix("foxglove.")).get_schema()
    assert (found.name, found.encoding) == (name, "protobuf")
    files = FileDescriptorSet()
    files.ParseFromString(found.data)
    kinds: dict[str, DescriptorProto] = {}
    enums: dict[str, EnumDescriptorProto] = {}
    for file in files.file:
        for kind in file.message_type:
            kinds[f".{file.package}.{kind.name}"] = kind
            for enum in kind.enum_type:
                enums[f".{file.package}.{kind.name}.{enum.name}"] = enum
        for enum in file.enum_type:
            enums[f".{file.package}.{enum.name}"] = enum

    def message(full_name: str) -> Schema:
        if full_name in _IN_JSON:
            return _closed(_IN_JSON[full_name])
        return _closed({field.name: one(field) for field in kinds[full_name].field})

    def one(field: FieldDescriptorProto) -> Schema:
        value = single(field)
        if field.label == _KIND.LABEL_REPEATED:
            return {"type": "array", "items": value}
        return value

    def single(field: FieldDescriptorProto) -> Schema:
        if field.type == _KIND.TYPE_MESSAGE:
            return message(field.type_name)
        if field.type == _KIND.TYPE_ENUM:
            return {"enum": [value.number for value in enums[field.type_name].value]}
        return _SIMPLE[field.type]

    return message(f".{name}")


@functools.cache
def _validator(name: str) -> Any:
    return jsonschema.Draft202012Validator(official(name))


def check(name: str, fields: Schema) -> None:
    """Raises ValidationError where ``fields`` are no message ``foxglove.<Name>``."""
    _validator(name).validate(fields)


def _closed(properties: Schema) -> Schema:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }
