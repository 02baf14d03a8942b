"""The report's pictures: layers and marks, for the page to put into one drawing each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amr_slam.commissioning.boxes import Box
from amr_slam.commissioning.cold_starts import Outcome
from amr_slam.commissioning.making import Report
from amr_slam.geometry import Array
from amr_slam.pictures import Layer, Sheet

ERROR_STEPS_M: Final = (0.01, 0.02, 0.05, 0.1, 0.2)
ERROR_COLOURS: Final = ("#2166AC", "#67A9CF", "#B8D8E8", "#FDD9A0", "#EF8A62", "#B2182B")
SEEN_STEPS: Final = (1, 2, 5, 10, 30)
SEEN_COLOURS: Final = ("#D9822B", "#F5C98A", "#BFE3D0", "#7CC8AE", "#3A9C86", "#0B6B62")

# Strokes for weak directions: this far apart on the sheet, this long, for ratios from here on.
_STROKE_APART, _STROKE, _RATIO = 34.0, 22.0, 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Mark:
    """Something drawn by the page: ``kind`` is its class in the style sheet."""

    kind: str
    x: float
    y: float
    x2: float = 0.0
    y2: float = 0.0
    text: str = ""
    trail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """An entry of a legend."""

    text: str
    colour: str = ""
    kind: str = ""
    share: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Figure:
    """One drawing."""

    title: str
    """For who cannot see it."""
    sheet: Sheet
    floor: Layer
    walls: Layer
    heat: Layer | None = None
    lines: tuple[Mark, ...] = ()
    dots: tuple[Mark, ...] = ()
    boxes: tuple[Mark, ...] = ()
    letters: tuple[Mark, ...] = ()
    keys: tuple[Key, ...] = field(default=())


class Drawing:
    """Makes the figures of one report, all on one sheet."""

    def __init__(self, report: Report) -> None:
        self._report = report
        cells = report.coverage.cells_m
        self._sheet = Sheet(report.known, cells if len(cells) else np.empty((0, 2)))
        self._floor, self._walls = self._sheet.known()

    def coverage(self) -> Figure:
        """How often the floor was seen, and where it goes on."""
        found = self._report.coverage
        classes = np.asarray(np.searchsorted(SEEN_STEPS, found.seen, side="left"))
        heat = self._sheet.heat(found.cells_m, found.cell_m, classes, SEEN_COLOURS)
        lines, letters = [], []
        for number, border in enumerate(found.borders, 1):
            lines += [self._mark("border", cell) for cell in border.cells_m]
            letters.append(self._mark("number", border.middle_m, text=str(number)))
        names = ("1 scan", "2", "3 to 5", "6 to 10", "11 to 30", "more than 30")
        keys = _keys(names, SEEN_COLOURS, classes) if found.counted else ()
        return self._figure(
            "How often each part of the floor was seen, and where the map ends without a wall",
            heat=heat if found.counted else None,
            dots=lines,
            letters=letters,
            keys=(*keys, Key(text="the floor goes on, nobody looked", kind="border")),
        )

    def precision(self) -> Figure:
        """Expected error over the floor, with its weakest direction."""
        found = self._report.precision
        cells = self._report.coverage.cells_m
        classes = np.asarray(np.searchsorted(ERROR_STEPS_M, found.error95_m, side="left"))
        reach_m = max(1.1 * found.spacing_m, 0.8)
        off, nearest = cKDTree(found.places_m).query(cells, distance_upper_bound=reach_m)
        near = np.isfinite(off)
        heat = self._sheet.heat(
            cells[near],
            self._report.coverage.cell_m,
            classes[np.asarray(nearest)[near]],
            ERROR_COLOURS,
        )
        names = ("up to 1 cm", "2 cm", "5 cm", "10 cm", "20 cm", "more")
        letters = [
            self._mark("number", weak.middle_m, text=str(number))
            for number, weak in enumerate(found.weak[:9], 1)
        ]
        return self._figure(
            "Expected error of the position over the floor, and its largest direction",
            heat=heat,
            lines=self._strokes(),
            letters=letters,
            keys=(
                *_keys(names, ERROR_COLOURS, classes),
                Key(text="weakest direction, where it is twice as bad as the other", kind="stroke"),
            ),
        )

    def _strokes(self) -> list[Mark]:
        found, marks = self._report.precision, []
        taken: list[tuple[float, float]] = []
        for place, axis, ratio in zip(found.places_m, found.axes_rad, found.ratios, strict=True):
            x, y = self._sheet.at(place)
            if ratio < _RATIO or any(math.hypot(x - a, y - b) < _STROKE_APART for a, b in taken):
                continue
            taken.append((x, y))
            dx, dy = 0.5 * _STROKE * math.cos(axis), -0.5 * _STROKE * math.sin(axis)
            marks.append(
                Mark(kind="stroke", x=round(x - dx, 1), y=round(y - dy, 1),
                     x2=round(x + dx, 1), y2=round(y + dy, 1))
            )  # fmt: skip
        return marks

    def cold_starts(self) -> Figure:
        """Where cold starts were tried, and what came of them."""
        starts = self._report.starts
        dots = [
            self._mark(one.outcome.value, one.truth.translation)
            for one in sorted(starts.tried, key=lambda one: list(Outcome).index(one.outcome))
        ]
        names = {
            Outcome.LOCATED: "located at once",
            Outcome.UNSURE: "right, but not yet sure",
            Outcome.ALIKE: "several places fit",
            Outcome.BLIND: "sees too little",
            Outcome.WRONG: "wrong place taken for right",
        }
        keys = [
            Key(text=text, kind=outcome.value, share=starts.share(outcome))
            for outcome, text in names.items()
        ]
        return self._figure("What came of each cold start", dots=dots, keys=keys)

    def look_alikes(self) -> Figure:
        """The pairs, with letters, and the boxes that help."""
        lines, dots, letters = [], [], []
        for number, pair in enumerate(self._report.pairs[:12]):
            kind = f"pair{number % 6}"
            dots += [self._mark(kind, at) for at in np.vstack([pair.here_m, pair.there_m])]
            one, other = pair.middles_m
            (x, y), (x2, y2) = self._sheet.at(one), self._sheet.at(other)
            if not pair.same_place:
                lines.append(Mark(kind=f"link {kind}", x=x, y=y, x2=x2, y2=y2))
                letters.append(Mark(kind=f"letter {kind}", x=x2, y=y2, text=f"{pair.letter}*"))
            letters.append(Mark(kind=f"letter {kind}", x=x, y=y, text=pair.letter))
        suggested = [one.box for one in self._report.resolutions]
        suggested += [one.box for one in self._report.anchors]
        boxes = [self._box(box) for box in suggested if box is not None]
        return self._figure(
            "Pairs of places that are taken for one another, and boxes that resolve them",
            lines=lines, dots=dots, boxes=boxes, letters=letters,
            keys=(
                Key(text="A and A*: the robot takes one for the other", kind="pair0"),
                Key(text="suggested box", kind="box"),
            ),
        )  # fmt: skip

    def _box(self, box: Box) -> Mark:
        x, y = self._sheet.at(box.pose.translation)
        return Mark(kind="box", x=x, y=y, trail=self._sheet.trail(box.corners_m))

    def _mark(self, kind: str, at: Array, text: str = "") -> Mark:
        x, y = self._sheet.at(at)
        return Mark(kind=kind, x=x, y=y, text=text)

    def _figure(
        self,
        title: str,
        *,
        heat: Layer | None = None,
        lines: Sequence[Mark] = (),
        dots: Sequence[Mark] = (),
        boxes: Sequence[Mark] = (),
        letters: Sequence[Mark] = (),
        keys: Sequence[Key] = (),
    ) -> Figure:
        return Figure(
            title=title, sheet=self._sheet, floor=self._floor, walls=self._walls, heat=heat,
            lines=tuple(lines), dots=tuple(dots), boxes=tuple(boxes), letters=tuple(letters),
            keys=tuple(keys),
        )  # fmt: skip


def _keys(
    names: Sequence[str], colours: Sequence[str], classes: NDArray[np.intp]
) -> tuple[Key, ...]:
    shares = np.bincount(classes, minlength=len(names)) / max(len(classes), 1)
    return tuple(
        Key(text=name, colour=colour, share=float(share))
        for name, colour, share in zip(names, colours, shares, strict=True)
    )
