"""``amr-slam watch``: the robots on Zenoh as a live table, or as lines where nobody looks."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, Literal

from rich.console import Console
from rich.live import Live

from amr_slam.client import FleetListener
from amr_slam.watching.rows import Rates, Row, Sort, row_of
from amr_slam.watching.shown import json_line, line, table

__all__ = ["Form", "Row", "Sort", "json_line", "line", "row_of", "table", "watch"]

Form = Literal["text", "json"]

_CONNECT_TIMEOUT_S: Final = 5.0  # longer, and a mistyped address looks like a hang
_REFRESH_S: Final = 0.25
_LINE_PERIOD_S: Final = 1.0
_ONCE_S: Final = 1.25
"""Robots are heard within a tenth of a second; their rate takes a whole one."""
_WIDE: Final = 200
"""Columns of a table that no terminal bounds."""


def watch(
    endpoint: str,
    robots: Sequence[str] = (),
    *,
    prefix: str = "amr",
    keys: Path | None = None,
    sort: Sort = "name",
    form: Form = "text",
    once: bool = False,
    console: Console | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Show the robots until Ctrl-C (or ``stop``): a table on a terminal, else a line a second for
    each robot. ``once``: show what there is, and end. ``form``: "json" for lines of JSON anywhere.
    Raises SessionError when nobody answers at ``endpoint``."""
    console = console or Console()
    stop = stop or threading.Event()
    rates = Rates()
    with FleetListener(
        endpoint, robots, prefix=prefix, keys=keys, connect_timeout_s=_CONNECT_TIMEOUT_S
    ) as fleet:

        def rows() -> list[Row]:
            return rates.rows(fleet.views(), sort, time.monotonic())

        if once:
            rows()
            stop.wait(_ONCE_S)
            _show_once(console, rows(), endpoint, form)
        elif form == "json" or not console.is_terminal:
            written = json_line if form == "json" else line
            while not stop.wait(_LINE_PERIOD_S):
                _write(console, rows(), written)
        else:
            with Live(console=console, auto_refresh=False) as live:
                while not stop.wait(_REFRESH_S):
                    ascii_only = console.options.ascii_only
                    live.update(table(rows(), endpoint, ascii_only=ascii_only), refresh=True)


def _show_once(console: Console, rows: Sequence[Row], endpoint: str, form: Form) -> None:
    if form == "json":
        _write(console, rows, json_line)
    else:
        if not console.is_terminal:
            console.width = _WIDE
        console.print(table(rows, endpoint, ascii_only=console.options.ascii_only))


def _write(console: Console, rows: Sequence[Row], written: Callable[[Row], str]) -> None:
    for row in rows:
        console.file.write(written(row) + "\n")
    console.file.flush()
