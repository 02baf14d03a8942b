"""One robot as it is drawn: where it is, what that is worth, where else it may be, how it is.

What it is given are the robot's own messages (``pose``, ``status``) as parsed JSON objects, from
the network or from a recording; see docs/fleet.md for their fields.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from amr_slam.foxglove.messages import (
    ERROR,
    INFO,
    WARNING,
    Fields,
    log,
    pose_fields,
    time_fields,
    transforms,
)
from amr_slam.geometry import Pose2
from amr_slam.states import State

# Of Okabe and Ito, told apart with any colour vision; the state is written beside, too.
_COLOURS: Final = {
    State.LOCALIZED: (0.0, 0.62, 0.45),
    State.MAPPING: (0.0, 0.45, 0.70),
    State.STARTING: (0.6, 0.6, 0.6),
    State.ODOMETRY_ONLY: (0.90, 0.62, 0.0),
    State.LOST: (0.84, 0.37, 0.0),
    State.AMBIGUOUS: (0.80, 0.47, 0.65),
}
_CHI2_95: Final = 5.991
"""Squared radius of the ellipse that holds 95 % of a Gaussian of two dimensions."""
_FARTHEST_M: Final = 1000.0
"""A larger ellipse says nothing: none is drawn."""
_LEVELS: Final = {
    "OK": INFO,
    "STALE": WARNING,
    "LOST": ERROR,
    State.LOST: ERROR,
    State.AMBIGUOUS: ERROR,
    State.ODOMETRY_ONLY: WARNING,
}
_LASTS_S: Final = 2
"""Without news a robot fades from the scene: it may be elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Robot:
    """Names of one robot's frames and things in the scene."""

    name: str
    base_frame: str
    map_frame: str = "map"

    def transforms(self, stamp_ns: int, pose: Mapping[str, float]) -> Fields:
        """Where the robot is: raises KeyError or TypeError where ``pose`` is no pose message."""
        return transforms(stamp_ns, self.map_frame, {self.base_frame: _pose(pose)})

    def scene(self, stamp_ns: int, pose: Fields, stale_s: float | None = None) -> Fields:
        """An arrow ahead, the 95 % ellipse of the position and a line of text, in the state's
        colour. ``stale_s``: so long there was no other pose, and this one is not to be trusted.

        Raises KeyError, TypeError or ValueError where ``pose`` is no pose message.
        """
        state = State(pose["state"])
        here, colour = _pose(pose), _COLOURS[state if stale_s is None else State.LOST]
        ellipse = _ellipse(pose["covariance"], here, colour)
        error_m = float(pose["error95_m"])
        known = f"± {error_m:.2f} m" if error_m < _FARTHEST_M else "± ?"
        says = f"{state} {known}" if stale_s is None else f"no pose for {stale_s:.0f} s"
        caption = {
            "pose": pose_fields(here, 0.6),
            "billboard": True,
            "font_size": 14.0,
            "scale_invariant": True,
            "color": _colour(colour, 1.0),
            "text": f"{self.name}: {says}",
        }
        drawn = [self._entity(stamp_ns, "robot", [_arrow(here, colour)], ellipse, [caption])]
        return {"deletions": [], "entities": drawn}

    def candidates(self, stamp_ns: int, status: Fields) -> Fields:
        """The places where an ambiguous robot may be, with their odds; none: nothing is drawn."""
        colour = _COLOURS[State.AMBIGUOUS]
        places = status.get("candidates") or []
        arrows = [_arrow(_pose(place), colour) for place in places]
        captions = [
            {
                "pose": pose_fields(_pose(place), 0.6),
                "billboard": True,
                "font_size": 12.0,
                "scale_invariant": True,
                "color": _colour(colour, 1.0),
                "text": f"{self.name}? {place['odds']:.0%}",
            }
            for place in places
        ]
        drawn = [self._entity(stamp_ns, "candidates", arrows, [], captions)]
        return {"deletions": [], "entities": drawn}

    def _entity(
        self,
        stamp_ns: int,
        what: str,
        arrows: list[Fields],
        cylinders: list[Fields],
        texts: list[Fields],
    ) -> Fields:
        return {
            "timestamp": time_fields(stamp_ns),
            "frame_id": self.map_frame,
            "id": f"{self.name}/{what}",
            "lifetime": {"sec": _LASTS_S, "nsec": 0},
            "frame_locked": True,
            "metadata": [],
            "arrows": arrows,
            "cubes": [],
            "spheres": [],
            "cylinders": cylinders,
            "lines": [],
            "triangles": [],
            "texts": texts,
            "models": [],
        }


class Health:
    """What a robot's status messages say of it, as log lines: what is amiss at first, then each
    change."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._said: dict[str, tuple[str, str | None]] = {}

    def lines(self, stamp_ns: int, status: Fields) -> Iterator[Fields]:
        """Raises KeyError, TypeError or AttributeError where it is no status message."""
        for part, (word, detail) in _parts(status).items():
            before = self._said.get(part)
            if before is not None and before[0] == word and (word == "OK" or detail == before[1]):
                continue
            self._said[part] = word, detail
            if before is None and word in {"OK", ""}:
                continue
            text = f"{part}: {word}" if word else f"{part} is over"
            level = _LEVELS.get(word, WARNING if part in {"fault", "advice"} and word else INFO)
            yield log(stamp_ns, level, self._name, text if detail is None else f"{text}: {detail}")


def _parts(status: Fields) -> dict[str, tuple[str, str | None]]:
    """What there is to say of each part: a word for what it is, and more where there is more."""
    health = {**status["scanners"], "wheels": status["wheels"], "slam": status["slam"]}
    return {
        "state": (status["state"], None),
        **{part: (one["link"], one.get("detail")) for part, one in health.items()},
        "fault": (status.get("fault") or "", None),
        "advice": (status.get("advice") or "", None),
    }


def _pose(fields: Mapping[str, float]) -> Pose2:
    return Pose2(float(fields["x"]), float(fields["y"]), float(fields["theta"]))


def _colour(rgb: tuple[float, float, float], alpha: float) -> Fields:
    return {"r": rgb[0], "g": rgb[1], "b": rgb[2], "a": alpha}


def _arrow(pose: Pose2, colour: tuple[float, float, float]) -> Fields:
    return {
        "pose": pose_fields(pose, 0.1),
        "shaft_length": 0.5,
        "shaft_diameter": 0.08,
        "head_length": 0.25,
        "head_diameter": 0.25,
        "color": _colour(colour, 1.0),
    }


def _ellipse(
    covariance: Sequence[float], centre: Pose2, colour: tuple[float, float, float]
) -> list[Fields]:
    """A flat cylinder over the 95 % ellipse of x and y; none where it were too large to tell."""
    xx, xy, _, _, yy, *_ = (float(value) for value in covariance)
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    radii = [math.sqrt(_CHI2_95 * max(v, 0.0)) for v in (middle + half, middle - half)]
    if not radii[0] < _FARTHEST_M:
        return []
    theta_rad = 0.5 * math.atan2(2.0 * xy, xx - yy)
    return [
        {
            "pose": pose_fields(Pose2(centre.x_m, centre.y_m, theta_rad), 0.01),
            "size": {"x": 2.0 * radii[0], "y": 2.0 * radii[1], "z": 0.01},
            "bottom_scale": 1.0,
            "top_scale": 1.0,
            "color": _colour(colour, 0.35),
        }
    ]
