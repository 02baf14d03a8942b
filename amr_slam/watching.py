"""``amr-slam watch``: the robots on Zenoh as a live table, or as lines where nobody looks."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from amr_slam.client import FleetListener, RobotView
from amr_slam.samples import State
from amr_slam.wire import UNKNOWN

_CONNECT_TIMEOUT_S: Final = 5.0  # longer, and a mistyped address looks like a hang
_REFRESH_S: Final = 0.25
_LINE_PERIOD_S: Final = 1.0
_STALE_S: Final = 0.5  # 25 poses at 50 Hz: older is not a pose to drive by
_COLUMNS: Final = ("robot", "state", "x m", "y m", "theta deg", "error95 m", "age s", "health")
_STYLES: Final = {
    State.LOCALIZED: "green",
    State.MAPPING: "green",
    State.STARTING: "yellow",
    State.ODOMETRY_ONLY: "yellow",
    State.LOST: "bold red",
    State.AMBIGUOUS: "bold red",
}


def watch(
    endpoint: str,
    robots: Sequence[str] = (),
    *,
    prefix: str = "amr",
    keys: Path | None = None,
    console: Console | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Show the robots until Ctrl-C (or ``stop``): a table on a terminal, else a line a second for
    each robot. Raises SessionError when nobody answers at ``endpoint``."""
    console = console or Console()
    stop = stop or threading.Event()
    with FleetListener(
        endpoint, robots, prefix=prefix, keys=keys, connect_timeout_s=_CONNECT_TIMEOUT_S
    ) as fleet:
        if not console.is_terminal:
            while not stop.wait(_LINE_PERIOD_S):
                for view in _sorted(fleet.views()):
                    console.out(line(view), highlight=False)
            return
        with Live(console=console, auto_refresh=False) as live:
            while not stop.wait(_REFRESH_S):
                live.update(table(_sorted(fleet.views()), endpoint), refresh=True)


def line(view: RobotView) -> str:
    """One robot as a line of ``name=value``, first the UTC time at which it was written."""
    cells = _cells(view)
    pairs = zip(_COLUMNS[1:], cells[1:], strict=True)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return " ".join([now, cells[0], *(f"{n.replace(' ', '_')}={v}" for n, v in pairs)])


def table(views: Iterable[RobotView], endpoint: str) -> Table:
    """All robots as a table."""
    shown = Table(title=f"Robots at {endpoint}")
    for column in _COLUMNS:
        numeric = column.endswith((" m", " deg", " s"))
        shown.add_column(column, justify="right" if numeric else "left")
    for view in views:
        # Text, not str: what the network says is not read as markup.
        shown.add_row(*(Text(cell) for cell in _cells(view)), style=_style(view))
    return shown


def _sorted(views: dict[str, RobotView]) -> list[RobotView]:
    return [views[robot] for robot in sorted(views)]


def _cells(view: RobotView) -> tuple[str, ...]:
    name, pose = _printable(view.robot), view.pose
    state = "absent" if not view.alive else str(pose.state) if pose else "silent"
    if pose is None:
        return (name, state, "-", "-", "-", "-", "-", _health(view))
    error95 = "unknown" if pose.error95_m >= UNKNOWN else f"{pose.error95_m:.3f}"
    return (
        name,
        state,
        f"{pose.x:.3f}",
        f"{pose.y:.3f}",
        f"{math.degrees(pose.theta):.2f}",
        error95,
        f"{pose.age_s + view.pose_age_s():.2f}",
        _health(view),
    )


def _health(view: RobotView) -> str:
    """What is wrong, or OK."""
    said = [view.pose.fault] if view.pose and view.pose.fault else []
    if view.status is not None:
        said += [
            f"{one.odds:.0%} at ({one.x:.2f}, {one.y:.2f}, {math.degrees(one.theta):.0f} deg)"
            for one in view.status.candidates
        ]
        said += [
            f"{name} {part.link}" + (f" ({part.detail})" if part.detail else "")
            for name, part in view.status.health().items()
            if part.link != "OK" or part.detail
        ]
        said += [view.status.advice] if view.status.advice else []
    if view.refused:
        said.append(f"{view.refused} bad messages")
    healthy = "OK" if view.status is not None else "-"
    return _printable("; ".join(said)) or healthy


def _style(view: RobotView) -> str:
    if not view.alive or view.pose is None or view.pose_age_s() > _STALE_S:
        return "red"
    return _STYLES[view.pose.state]


def _printable(text: str) -> str:
    """Without the control characters by which a name could steer the terminal."""
    return "".join(c if c.isprintable() else "?" for c in text)
