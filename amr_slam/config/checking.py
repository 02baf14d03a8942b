"""From a TOML file to frozen dataclasses, strictly: one line names file, key and reason.

An algorithm or a driver writes its parameters once, as a plain frozen dataclass with bounds by
``annotated_types``. For each such class a pydantic model is made here that forbids unknown keys,
infinities and conversions between types; what it lets pass becomes an instance of the dataclass.
"""

from __future__ import annotations

import difflib
import functools
import json
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, TypeVar, Union, get_args, get_origin
from typing import get_type_hints as type_hints

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

_T = TypeVar("_T")

_MAX_FILE_BYTES: Final = 256 * 1024  # the longest sensible file is a tenth of it
_MAX_SHOWN: Final = 60  # characters of a refused value


class ConfigError(Exception):
    """A configuration that must not be started with. ``str()`` is ``FILE: key.path: reason``."""

    def __init__(self, reason: str, path: tuple[str | int, ...] = (), file: Path | None = None):
        super().__init__(reason, path, file)
        self.reason = " ".join(reason.split())
        self.path = path
        """From the top of the file down to the key; numbers count tables of a list from 0."""
        self.file = file

    def __str__(self) -> str:
        key = "".join(f"[{p}]" if isinstance(p, int) else f".{_shown_key(p)}" for p in self.path)
        parts = (str(self.file or ""), key.lstrip("."), self.reason)
        line = ": ".join(part for part in parts if part)
        return "".join(c if c.isprintable() else "?" for c in line)


@contextmanager
def located(*path: str | int, file: Path | None = None) -> Iterator[None]:
    """Say of every ConfigError from within that it happened in ``file`` under ``path``."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(error.reason, path + error.path, file or error.file) from error


def read_toml(file: Path) -> dict[str, Any]:
    """The file's tables. Raises ConfigError: unreadable, too large, not TOML."""
    with located(file=file):
        try:
            with file.open("rb") as stream:
                content = stream.read(_MAX_FILE_BYTES + 1)
            if len(content) > _MAX_FILE_BYTES:
                raise ConfigError(f"larger than {_MAX_FILE_BYTES} bytes")
            return tomllib.loads(content.decode())
        except OSError as error:
            raise ConfigError(error.strerror or str(error)) from error
        except RecursionError as error:
            raise ConfigError("nested too deeply") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"not UTF-8: {error.reason} at byte {error.start}") from error
        except ValueError as error:  # TOMLDecodeError, numbers of 5000 digits
            raise ConfigError(f"not TOML: {error}") from error


def checked(cls: type[_T], table: Mapping[str, Any], base: _T | None = None) -> _T:
    """An instance of the dataclass ``cls`` from a table of the file.

    With ``base`` the table holds only what differs from it, else all that has no default.
    Raises ConfigError with the path from the table down.
    """
    source: type = cls
    twin = _twin(source, partial=base is not None)
    try:
        # By way of JSON: strict, and yet lists become tuples and strings paths or enums.
        model = twin.model_validate_json(json.dumps(table, default=_date))
    except ValidationError as error:
        raise _first(error, twin) from error
    except RecursionError as error:
        raise ConfigError("nested too deeply") from error
    except ValueError as error:  # TOML's hexadecimal numbers have no limit, JSON's decimal ones do
        raise ConfigError("a number in it has thousands of digits") from error
    instance: _T = _built(model, base)
    return instance


class _Twin(BaseModel):
    """Base of the models made of dataclasses."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        strict=True,
        allow_inf_nan=False,
        protected_namespaces=(),
        defer_build=True,  # most are only parts of others, and then need no validator of their own
    )
    source: ClassVar[type]


@functools.cache
def _twin(cls: type, *, partial: bool) -> type[_Twin]:
    hints = type_hints(cls, include_extras=True)
    entries: dict[str, Any] = {}
    for field in fields(cls):
        required = not partial and field.default is MISSING and field.default_factory is MISSING
        # The dataclass's own default is used: this one only marks that there is one.
        entries[field.name] = (_twinned(hints[field.name], partial), ... if required else None)
    twin = create_model(cls.__name__, __base__=_Twin, **entries)
    twin.source = cls
    return twin


def _twinned(hint: Any, partial: bool) -> Any:  # noqa: FBT001  # recursion over one annotation
    """The annotation with each dataclass in it replaced by its model."""
    if isinstance(hint, type) and is_dataclass(hint):
        return _twin(hint, partial=partial)
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return Annotated[_twinned(arguments[0], partial), *arguments[1:]]
    if not any(is_dataclass(argument) for argument in arguments):
        return hint
    replaced = tuple(_twinned(argument, partial) for argument in arguments)
    return origin[replaced] if origin in {tuple, list, dict} else Union[replaced]  # noqa: UP007


def _built(value: Any, base: Any = None) -> Any:
    """Models back to their dataclasses, in tuples too."""
    if isinstance(value, tuple):
        return tuple(_built(item) for item in value)
    if not isinstance(value, _Twin):
        return value
    changes = {}
    for name in sorted(value.model_fields_set):
        with located(name):
            changes[name] = _built(getattr(value, name), getattr(base, name, None))
    try:
        return replace(base, **changes) if base is not None else value.source(**changes)
    except ValueError as error:  # a check of the dataclass over several of its fields
        raise ConfigError(str(error)) from error


def _first(failed: ValidationError, twin: type[_Twin]) -> ConfigError:
    """The error to show: an unknown key first, as it is often why another one is missing."""
    errors = failed.errors(include_url=False, include_context=False)
    error = min(errors, key=lambda e: e["type"] != "extra_forbidden")
    path = error["loc"]
    if error["type"] == "json_invalid":  # our own JSON: only its depth can be wrong
        return ConfigError("nested too deeply")
    if error["type"] == "extra_forbidden":
        reason = _unknown_key(str(path[-1]), _keys_at(twin, path[:-1]))
    elif error["type"] == "missing":
        reason = "is missing"
    elif error["type"] in {"model_type", "dict_type"}:
        reason = f"should be a table, not {shown(error['input'])}"
    else:
        reason = error["msg"].removeprefix("Input ").removeprefix("Value error, ")
        if not isinstance(error["input"], dict | list):
            reason += f", not {shown(error['input'])}"
    if len(errors) > 1:
        reason += f" (and {len(errors) - 1} more)"
    return ConfigError(reason, path)


def _unknown_key(key: str, known: list[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    if close:
        return f"unknown key; did you mean {close[0]}?"
    return f"unknown key; known here: {', '.join(known)}"


def _keys_at(twin: type[_Twin], path: tuple[str | int, ...]) -> list[str]:
    for part in path:
        if part in twin.model_fields:
            twin = _twin_in(twin.model_fields[str(part)].annotation) or twin
    return list(twin.model_fields)


def _twin_in(annotation: Any) -> type[_Twin] | None:
    if isinstance(annotation, type) and get_origin(annotation) is None:
        return annotation if issubclass(annotation, _Twin) else None
    return next(filter(None, map(_twin_in, get_args(annotation))), None)


def shown(value: Any) -> str:
    """As it stands in the file, on one line, of bounded length."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."


def _shown_key(key: str) -> str:
    return key if key.replace("_", "").replace("-", "").isalnum() else shown(key)


def _date(value: object) -> dict[str, str]:
    """TOML's dates and times mean nothing to us: a table is refused where a value stands."""
    return {"date or time": str(value)}
