"""What a robot hears on topics of VDA 5050, as far as it looks at it. Fields that are not needed
here are somebody else's: these are the standard's messages, not ours."""

from __future__ import annotations

from typing import Annotated, Final, Self

from annotated_types import Ge, Interval, Len, Lt
from pydantic import ConfigDict, JsonValue, ValidationError
from pydantic.alias_generators import to_camel

from amr_slam.wire.commands import Metres
from amr_slam.wire.values import Part, WireError, complaint

HEADER_IDS: Final = 1 << 32
"""They are 32 bits wide, and begin anew then."""


class _Heard(Part):
    model_config = ConfigDict(alias_generator=to_camel)

    @classmethod
    def decode(cls, payload: bytes) -> Self:
        """Raises WireError, one line, for anything that is not such a message."""
        try:
            return cls.model_validate_json(payload)
        except ValidationError as error:
            raise WireError(complaint(error)) from error


class StateHeader(_Heard):
    """Of a vehicle controller's ``state``."""

    header_id: Annotated[int, Ge(0), Lt(HEADER_IDS)]


class Position(_Heard):
    """Parameters of ``initPosition`` and ``initializePosition``; ``lastNodeId`` is the vehicle
    controller's."""

    x: Metres
    y: Metres
    theta: Annotated[float, Interval(ge=-3.14159265359, le=3.14159265359)]
    """The standard's own bounds, a little beyond pi."""
    map_id: Annotated[str, Len(1, 128)]


class _Parameter(_Heard):
    key: Annotated[str, Len(0, 128)]
    value: JsonValue


class InstantAction(_Heard):
    """One action of any type."""

    action_type: Annotated[str, Len(1, 128)]
    action_id: Annotated[str, Len(1, 128)]
    action_parameters: Annotated[tuple[_Parameter, ...], Len(0, 64)] = ()

    def position(self) -> Position:
        """Its parameters as a position. Raises WireError, one line, where they are none."""
        given = {one.key: one.value for one in self.action_parameters}
        if len(given) < len(self.action_parameters):
            raise WireError("a parameter is given twice")
        try:
            return Position.model_validate(given)
        except ValidationError as error:
            raise WireError(complaint(error)) from error


class InstantActions(_Heard):
    """Topic ``instantActions``."""

    manufacturer: str | None = None
    serial_number: str | None = None
    actions: Annotated[tuple[InstantAction, ...], Len(0, 64)]
