"""The localizer's whole state as plain JSON values, and back, to the last bit.

A recording that begins in the middle of a run begins with it. Objects of our own packages are
taken apart by their attributes and put together again without calling anything of theirs, so a
file can make no more than values: no code, no module that is not loaded already.
"""

from __future__ import annotations

import base64
import enum
import math
import sys
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Final

import numpy as np

Plain = Any
"""What :mod:`json` can write."""

_OURS: Final = "amr_slam."
_MAX_ARRAY_BYTES: Final = 1 << 24


class StateError(ValueError):
    """A state that cannot be taken apart, or a file's that cannot be put together."""


def taken_apart(value: object, known: Mapping[type, str]) -> Plain:
    """``value`` as plain values. ``known``: kinds of objects that the other end has, and names.

    Raises StateError for what is of no known kind.
    """
    return _Apart(known).of(value)


def put_together(plain: Plain, known: Mapping[str, object]) -> Any:
    """The contrary of :func:`taken_apart`. ``known``: those objects. Raises StateError."""
    try:
        return _Together(known).of(plain)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise StateError(f"the recorded state makes no sense: {error!r:.100}") from error


class _Apart:
    def __init__(self, known: Mapping[type, str]) -> None:
        self._known = known
        self._seen: dict[int, int] = {}
        self._kept: list[object] = []  # an id is an object's own only while that lives

    def of(self, value: Any) -> Plain:  # noqa: PLR0911  # one return a kind
        if value is None or type(value) in {bool, int, str}:
            return value
        if type(value) in self._known:
            return {"known": self._known[type(value)]}
        if isinstance(value, enum.Enum):
            return {"enum": _name_of(type(value)), "value": value.value}
        if isinstance(value, np.generic):  # float64 is a float, too, and not the same
            return {"scalar": value.dtype.str, "value": self.of(value.item())}
        if isinstance(value, float):
            return value if math.isfinite(value) else {"float": str(value)}
        if isinstance(value, np.ndarray):
            return _array_apart(value)
        if type(value) in {tuple, set, frozenset}:
            return {type(value).__name__: [self.of(item) for item in value]}
        return self._shared(value)

    def _shared(self, value: Any) -> Plain:
        """What more than one may hold, and change."""
        if id(value) in self._seen:
            return {"same": self._seen[id(value)]}
        number = self._seen[id(value)] = len(self._seen)
        self._kept.append(value)
        if type(value) is list:
            return {"list": [self.of(item) for item in value], "id": number}
        if type(value) is deque:
            items = [self.of(item) for item in value]
            return {"deque": items, "id": number, "maxlen": value.maxlen}
        if type(value) in {dict, Counter}:
            items = [[self.of(key), self.of(item)] for key, item in value.items()]
            return {type(value).__name__.lower(): items, "id": number}
        if not type(value).__module__.startswith(_OURS):
            raise StateError(f"{type(value)} is of no kind that a recording holds")
        parts = {name: self.of(part) for name, part in _parts(value)}
        return {"object": _name_of(type(value)), "id": number, "parts": parts}


class _Together:
    def __init__(self, known: Mapping[str, object]) -> None:
        self._known = known
        self._made: dict[int, Any] = {}

    def of(self, plain: Plain) -> Any:  # noqa: PLR0911  # one return a kind
        if not isinstance(plain, dict):
            if isinstance(plain, list):
                raise StateError("a bare list")
            return plain
        kind = next(iter(plain))
        content = plain[kind]
        match kind:
            case "known":
                return self._known[content]
            case "same":
                return self._made[content]
            case "enum":
                return _class_of(content, enum.Enum)(plain["value"])
            case "float":
                return float(content)
            case "scalar":
                return np.dtype(content).type(self.of(plain["value"]))
            case "array":
                return _array_together(plain)
            case "tuple" | "set" | "frozenset":
                make = {"tuple": tuple, "set": set, "frozenset": frozenset}[kind]
                return make(self.of(item) for item in content)
        return self._shared(kind, content, plain)

    def _shared(self, kind: str, content: Any, plain: Plain) -> Any:
        """Made first and filled then: what is in it may point back to it."""
        made: Any
        match kind:
            case "list":
                made = self._made[plain["id"]] = []
                made.extend(self.of(item) for item in content)
            case "deque":
                made = self._made[plain["id"]] = deque(maxlen=plain["maxlen"])
                made.extend(self.of(item) for item in content)
            case "dict" | "counter":
                made = self._made[plain["id"]] = {} if kind == "dict" else Counter()
                for key, item in content:
                    made[self.of(key)] = self.of(item)
            case "object":
                made = self._made[plain["id"]] = object.__new__(_class_of(content, object))
                for name, part in plain["parts"].items():
                    if name.startswith("__"):
                        raise StateError(f"an attribute {name!r:.40}")
                    object.__setattr__(made, name, self.of(part))
            case _:
                raise StateError(f"an unknown kind {kind!r:.40}")
        return made


def _parts(value: Any) -> list[tuple[str, Any]]:
    """Attributes; of a dataclass its fields alone, not what it has computed of them."""
    if is_dataclass(value):
        return [(field.name, getattr(value, field.name)) for field in fields(value)]
    return list(vars(value).items())


def _name_of(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _class_of(name: str, base: type) -> type:
    module, _, qualname = name.partition(":")
    if not module.startswith(_OURS) or module not in sys.modules:
        raise StateError(f"a class of {module!r:.60}")
    found = getattr(sys.modules[module], qualname)
    if not isinstance(found, type) or not issubclass(found, base) or found.__module__ != module:
        raise StateError(f"{name!r:.80} is no such class")
    return found


def _array_apart(array: np.ndarray[Any, Any]) -> Plain:
    if array.dtype.hasobject:
        raise StateError("an array of objects")
    data = np.ascontiguousarray(array).tobytes()
    return {
        "array": array.dtype.str,
        "shape": list(array.shape),
        "data": base64.b64encode(data).decode("ascii"),
        "readonly": not array.flags.writeable,
    }


def _array_together(plain: Plain) -> np.ndarray[Any, Any]:
    data = base64.b64decode(plain["data"], validate=True)
    dtype = np.dtype(plain["array"])
    if dtype.hasobject or len(data) > _MAX_ARRAY_BYTES:
        raise StateError("no possible array")
    made = np.frombuffer(data, dtype).reshape(plain["shape"]).copy()
    made.setflags(write=not plain["readonly"])
    return made
