"""How a map is made of what was seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le


@dataclass(frozen=True, slots=True, kw_only=True)
class MapParams:
    """Cells, and what counts as wall or as free."""

    cell_m: Annotated[float, Gt(0.0), Le(1.0)] = 0.05
    """One map point at most per cell of this size: the mean of what fell into it."""
    free_cell_m: Annotated[float, Gt(0.0), Le(1.0)] = 0.1
    """Cells in which rays that passed and rays that ended are counted."""
    ray_margin_m: Annotated[float, Ge(0.0)] = 0.15
    """A ray is evidence of free space only up to this much before its end."""
    vanish_ratio: Annotated[float, Gt(0.0)] = 4.0
    """A point whose cell was passed this many times as often as hit is taken for gone."""
    noisy_m: Annotated[float, Gt(0.0)] = 0.02
    """Scans noisier than this leave bands, not lines: walls are thinned."""
    thin: bool = True
    """False keeps the band (the paper's union of scans)."""
