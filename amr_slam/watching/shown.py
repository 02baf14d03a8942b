"""Robots as a table for people, as lines of text, and as lines of JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Final

from rich.table import Table
from rich.text import Text

from amr_slam.samples import State
from amr_slam.watching.rows import ABSENT, COLUMNS, SILENT, STALE, Row

_STYLES: Final = {
    State.LOCALIZED: ("green", "●", "*"),
    State.MAPPING: ("green", "■", "#"),
    State.STARTING: ("yellow", "○", "o"),
    State.ODOMETRY_ONLY: ("yellow", "▲", "^"),
    State.LOST: ("bold red", "✖", "X"),
    State.AMBIGUOUS: ("bold red", "◆", "?"),
    STALE: ("bold red", "✖", "X"),
    SILENT: ("red", "✖", "X"),
    ABSENT: ("red", "·", "-"),
}
"""Colour, and a shape for who does not see colours; in ASCII for terminals that have no more."""


def line(row: Row) -> str:
    """One robot as a line of ``name=value``, first the UTC time at which it was written."""
    name, *cells = row.cells()
    pairs = zip(COLUMNS, cells, strict=True)
    return " ".join([_now("seconds"), name, *(f"{n.replace(' ', '_')}={v}" for n, v in pairs)])


def json_line(row: Row) -> str:
    """One robot as a JSON object, with the UTC time at which it was written."""
    return json.dumps({"time": _now("milliseconds"), **row.values()}, separators=(",", ":"))


def table(rows: Iterable[Row], endpoint: str, *, ascii_only: bool = False) -> Table:
    """All robots as a table."""
    shown = Table(title=f"Robots at {endpoint}", title_justify="left")
    shown.add_column("robot", no_wrap=True)
    for column in COLUMNS:
        numeric = column.endswith((" m", " deg", " s", " Hz")) or column == "epoch"
        shown.add_column(
            column,
            justify="right" if numeric else "left",
            no_wrap=column != "health",
            overflow="fold",
        )
    for row in rows:
        style, *shapes = _STYLES[row.state]
        name, state, *cells = row.cells()
        # Text, not str: what the network says is not read as markup.
        texts = (name, f"{shapes[ascii_only]} {state}", *cells)
        shown.add_row(*(Text(text) for text in texts), style=style)
    return shown


def _now(to: str) -> str:
    return datetime.now(UTC).isoformat(timespec=to)
