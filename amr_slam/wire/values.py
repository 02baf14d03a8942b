"""Bounds and kinds of values, and how a payload becomes a model and the other way."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Final, Literal, Self

from annotated_types import Ge, Gt, Interval, Le, Len
from pydantic import BaseModel, ConfigDict, ValidationError

SCHEMA_VERSION: Final = 1
MAX_MESSAGE_BYTES: Final = 64 * 1024
"""Larger payloads are refused unread (reliability row 29)."""
MAX_COMMAND_BYTES: Final = 4 * 1024
"""The same for the arguments of commands."""
MAX_MAP_BYTES: Final = 64 * 1024 * 1024
"""Larger maps and pictures of maps do not go over the network; routers refuse them, too."""

Text = Annotated[str, Len(0, 500)]
Name = Annotated[str, Len(1, 128)]
Uuid = Annotated[str, Len(36, 36)]
Seconds = Annotated[float, Ge(0)]
Count = Annotated[int, Ge(0)]
Share = Annotated[float, Interval(ge=0.0, le=1.0)]
Angle = Annotated[float, Gt(-math.pi), Le(math.pi)]


class WireError(ValueError):
    """A payload that is no message of ours: too large, no JSON, wrong fields. One line."""


class Part(BaseModel):
    """Frozen, finite, of exactly the declared types; unknown fields are a newer sender's."""

    model_config = ConfigDict(
        frozen=True,
        allow_inf_nan=False,
        strict=True,
        extra="ignore",
        json_schema_serialization_defaults_required=True,
    )


class Payload(Part):
    """What is sent as a whole."""

    kind: ClassVar[str]
    """What complaints call it."""
    max_bytes: ClassVar[int] = MAX_MESSAGE_BYTES
    v: Literal[1] = SCHEMA_VERSION

    def encode(self) -> bytes:
        """JSON in UTF-8. Raises WireError when it would be refused by :meth:`decode`."""
        payload = self.model_dump_json().encode()
        self._check_size(payload)
        return payload

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Raises WireError, one line, for anything that is not such a payload."""
        cls._check_size(payload)
        try:
            return cls.model_validate_json(payload)
        except ValidationError as error:
            raise WireError(f"{cls.kind}: {complaint(error)}") from error

    @classmethod
    def _check_size(cls, payload: bytes) -> None:
        if len(payload) > cls.max_bytes:
            raise WireError(f"{cls.kind}: {len(payload)} bytes, at most {cls.max_bytes}")


def complaint(error: ValidationError) -> str:
    """The first thing that is wrong, and where."""
    first = error.errors(include_url=False, include_input=False)[0]
    where = " ".join(".".join(str(part) for part in first["loc"]).split())[:60]
    return f"{where or 'payload'}: {first['msg'].removeprefix('Value error, ')}"
