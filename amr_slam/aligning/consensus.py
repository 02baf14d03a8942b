"""The rigid motion that most pairs agree with, whatever the others say: the start of a fit.

Positions are complex numbers. A marker at m on the robot, seen in a frame that is turned by u and
shifted by t, is at c = t + u p + u m exp(i phi): linear in t, u and u m, so that two pairs (three
with the marker's offset) give one proposal. Proposals are judged by the median of all residuals,
which up to half of wrong pairs cannot spoil (P. Rousseeuw, "Least median of squares regression",
J. Am. Stat. Assoc. 79, 1984).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.aligning.pairs import AlignError
from amr_slam.geometry import Array

Complex = NDArray[np.complex128]

_PROPOSALS: Final = 600
_MOST_PAIRS: Final = 1500
"""So many pairs judge a proposal."""
_FACTOR: Final = 1.25
"""Proposals that stretch by more come from pairs too near to each other, or from other units."""

_ONE_SPOT_M: Final = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Where the fit begins."""

    shift: complex
    turn: complex
    """Of length 1."""
    offset: complex
    """The marker's on the robot; 0 where it was not asked for."""
    median_m: float
    """Half of the pairs are nearer than this to where it puts them."""


def start(
    site: Array, known: Array, headings_rad: Array | None, *, mirrored: bool = False
) -> Start:
    """The best proposal for positions (n, 2) in both frames.

    ``headings_rad`` (n,): of the base in the map; then the marker's offset is proposed too.
    ``mirrored``: as if one frame counted y the other way. Raises AlignError where there is none.
    """
    c, p = _complex(site), _complex(known)
    _check_spread(p)
    if mirrored:
        c = np.conj(c)
    columns = [np.ones(len(p), dtype=np.complex128), p]
    if headings_rad is not None:
        columns.append(np.exp(1j * headings_rad))
    table = np.stack(columns, axis=1)
    rows = np.linspace(0, len(p) - 1, min(len(p), _MOST_PAIRS)).astype(np.intp)
    samples = _samples(len(rows), len(columns))
    unknowns = _solved(table[rows[samples]], c[rows[samples]])
    turn = unknowns[:, 1]
    fair = np.isfinite(unknowns).all(axis=1)
    fair &= (np.abs(turn) > 1.0 / _FACTOR) & (np.abs(turn) < _FACTOR)
    if not fair.any():
        raise AlignError(_why_none(c[rows], p[rows]))
    unknowns = unknowns[fair]
    turn = unknowns[:, 1] / np.abs(unknowns[:, 1])
    # With the turn made one of length 1, the shift is the samples' own again.
    middle = p[rows[samples[fair]]].mean(axis=1)
    shift = unknowns[:, 0] + (unknowns[:, 1] - turn) * middle
    rest = c[rows] - shift[:, None] - turn[:, None] * p[rows]
    if headings_rad is not None:
        rest = rest - unknowns[:, 2:3] * table[rows, 2]
    medians = np.median(np.abs(rest), axis=1)
    best = int(np.argmin(medians))
    offset = unknowns[best, 2] / turn[best] if headings_rad is not None else 0.0
    return Start(
        shift=complex(shift[best]),
        turn=complex(turn[best]),
        offset=complex(offset),
        median_m=float(medians[best]),
    )


def _complex(points: Array) -> Complex:
    return np.asarray(points[:, 0] + 1j * points[:, 1])


def _samples(count: int, size: int) -> NDArray[np.intp]:
    """(k, size) rows: all combinations where they are few, else as many at random (seeded)."""
    if count < size:
        raise AlignError(f"{count} pairs are too few: {size} at least")
    if count <= 12:
        return np.array(list(itertools.combinations(range(count), size)), dtype=np.intp)
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, count, (2 * _PROPOSALS, size))
    ordered = np.sort(drawn, axis=1)
    distinct = (np.diff(ordered, axis=1) > 0).all(axis=1)
    return np.asarray(drawn[distinct][:_PROPOSALS])


def _solved(tables: Complex, values: Complex) -> Complex:
    """(k, size) solutions of k small systems; NaN where there is none."""
    near = np.abs(np.linalg.det(tables)) < 1e-9
    tables = np.where(near[:, None, None], np.eye(tables.shape[1]), tables)
    solved = np.linalg.solve(tables, values[..., None])[..., 0]
    return np.where(near[:, None], np.nan, solved)


def _check_spread(p: Complex) -> None:
    middle = np.median(p.real) + 1j * np.median(p.imag)
    spread_m = float(np.percentile(np.abs(p - middle), 90.0))
    if spread_m < _ONE_SPOT_M:
        raise AlignError(
            f"all pairs lie in one spot (9 of 10 within {spread_m:.2f} m of its middle): they tell "
            "nothing of a turn; take them all over the map"
        )


def _why_none(c: Complex, p: Complex) -> str:
    ours, theirs = np.abs(np.diff(p)), np.abs(np.diff(c))
    moved = ours > 0.0
    factor = float(np.median(theirs[moved] / ours[moved])) if moved.any() else 0.0
    return (
        f"distances in the site's frame are {factor:.3g} times those in the map: "
        "other units, or not the same robot"
    )
