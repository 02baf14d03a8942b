"""What a camera system says, checked: nothing of it is trusted."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final, NoReturn

from amr_slam.geometry import Pose2, wrap_angle
from amr_slam.shadow.settings import ShadowSettings

MAX_PAYLOAD_BYTES: Final = 64 * 1024
_MAX_ENTRIES: Final = 1000
_FARTHEST_M: Final = 1e6
_LATEST_S: Final = 1e11
_PER_SECOND: Final = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}


class CameraPoseError(ValueError):
    """A payload that is no pose: one line with the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPose:
    """One pose of the marker in the cameras' frame."""

    stamp_s: float
    """On the camera system's clock."""
    x_m: float
    y_m: float
    theta_rad: float | None
    """None where the system gives none."""

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.theta_rad or 0.0)


def parse(
    payload: bytes, settings: ShadowSettings, robot: str, received_s: float
) -> CameraPose | None:
    """The robot's pose in a payload; None where it speaks of other robots only.

    ``received_s``: UTC, the stamp where the payload has none. Raises CameraPoseError.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise CameraPoseError(f"{len(payload)} bytes, at most {MAX_PAYLOAD_BYTES}")
    try:
        content = json.loads(payload, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise CameraPoseError(f"not JSON: {str(error)[:100]}") from error
    entry = _own(content, settings, settings.robot_id or robot)
    if entry is None:
        return None
    scale = 1e-3 if settings.length_unit == "mm" else 1.0
    x_m, y_m = (scale * _number(entry, field) for field in (settings.x, settings.y))
    if not (abs(x_m) <= _FARTHEST_M and abs(y_m) <= _FARTHEST_M):
        raise CameraPoseError("a position farther off than 1000 km")
    theta_rad = None
    if settings.theta:
        theta = _number(entry, settings.theta)
        theta_rad = wrap_angle(math.radians(theta) if settings.angle_unit == "deg" else theta)
    stamp_s = received_s
    if settings.stamp:
        # A list of robots has one stamp for all, as a rule.
        holder = entry if _has(entry, settings.stamp) else content
        stamp_s = _stamp_s(_found(holder, settings.stamp), settings)
    return CameraPose(stamp_s=stamp_s, x_m=x_m, y_m=y_m, theta_rad=theta_rad)


def _own(content: Any, settings: ShadowSettings, robot_id: str) -> Any:
    """The part that is about this robot, or None."""
    entries = [content]
    if settings.entries:
        entries = _found(content, settings.entries)
        if not isinstance(entries, list) or len(entries) > _MAX_ENTRIES:
            raise CameraPoseError(f"{settings.entries}: no list of at most {_MAX_ENTRIES}")
    if not settings.robot:
        return entries[0] if entries else None
    for entry in entries:
        named = _found(entry, settings.robot)
        if isinstance(named, str | int) and str(named) == robot_id:
            return entry
    return None


def _found(content: Any, path: str) -> Any:
    for part in path.split("."):
        if isinstance(content, dict) and part in content:
            content = content[part]
        elif isinstance(content, list) and part.isdecimal() and int(part[:9]) < len(content):
            content = content[int(part[:9])]
        else:
            raise CameraPoseError(f"{path}: is missing")
    return content


def _has(content: Any, path: str) -> bool:
    try:
        _found(content, path)
    except CameraPoseError:
        return False
    return True


def _number(content: Any, path: str) -> float:
    return _finite(_found(content, path), path)


def _finite(value: Any, path: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CameraPoseError(f"{path}: not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number) or abs(number) > 1e300:
        raise CameraPoseError(f"{path}: not a finite number")
    return number


def _stamp_s(value: Any, settings: ShadowSettings) -> float:
    if settings.time_unit != "iso":
        stamp_s = _finite(value, settings.stamp) / _PER_SECOND[settings.time_unit]
    else:
        if not isinstance(value, str):
            raise CameraPoseError(f"{settings.stamp}: not a text")
        try:
            told = datetime.fromisoformat(value[:64])
            stamp_s = (told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp()
        except (ValueError, OverflowError) as error:
            raise CameraPoseError(f"{settings.stamp}: not a time as ISO 8601 has it") from error
    if not 0.0 <= stamp_s <= _LATEST_S:
        raise CameraPoseError(f"{settings.stamp}: not a time since 1970; time_unit may be wrong")
    return stamp_s


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no number of JSON")
