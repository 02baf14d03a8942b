"""The last ten minutes of each robot, so that a page that is opened after the event shows it."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from typing import Final

import numpy as np

from amr_slam.geometry import Array
from amr_slam.watching.rows import ABSENT, SILENT, STALE, Row

SPAN_S: Final = 600.0
PERIOD_S: Final = 0.5
_ROWS: Final = 1500
"""Two a second for ten minutes, and room for changes of state between them."""
COLUMNS: Final = (
    "t_s", "x_m", "y_m", "theta_rad", "xx_m2", "xy_m2", "yy_m2", "error95_m", "epoch", "map",
    "state",
)  # fmt: skip
STATES: Final = (
    "localized", "mapping", "starting", "odometry_only", "ambiguous", "lost", SILENT, STALE, ABSENT,
)  # fmt: skip
"""As their numbers in the column."""
_MAX_MAPS: Final = 256


class _Ring:
    """The newest rows of one robot."""

    def __init__(self) -> None:
        self._rows = np.empty((_ROWS, len(COLUMNS)))
        self._count = 0
        self.state = ""
        self.stamp_s = -np.inf

    def append(self, row: tuple[float, ...]) -> None:
        self._rows[self._count % _ROWS] = row
        self._count += 1

    def since(self, begin_s: float) -> Array:
        """Rows (n, columns), oldest first."""
        start = self._count % _ROWS
        rows = self._rows[: self._count]
        if self._count >= _ROWS:
            rows = np.concatenate([self._rows[start:], self._rows[:start]])
        newer: Array = rows[rows[:, 0] >= begin_s]
        return newer


class History:
    """All robots' rings."""

    def __init__(self) -> None:
        self._rings: dict[str, _Ring] = {}
        self._maps: list[str] = []

    def record(self, rows: Iterable[Row], now_s: float) -> None:
        """Note where the robots are: each twice a second, and when its state changes."""
        for row in rows:
            pose = row.view.pose
            ring = self._rings.get(row.view.robot)
            if pose is None or (
                ring is not None and row.state == ring.state and now_s - ring.stamp_s < PERIOD_S
            ):
                continue
            if ring is None:
                ring = self._rings[row.view.robot] = _Ring()
            ring.state, ring.stamp_s = row.state, now_s
            covariance = pose.covariance
            ring.append(
                (
                    now_s, pose.x, pose.y, pose.theta, covariance[0], covariance[1], covariance[4],
                    pose.error95_m, pose.epoch, self._number_of(pose.map), STATES.index(row.state),
                )
            )  # fmt: skip

    def _number_of(self, map_id: str | None) -> int:
        """-1: none, or one of too many."""
        if map_id in self._maps:
            return self._maps.index(map_id)
        if map_id is None or len(self._maps) >= _MAX_MAPS:
            return -1
        self._maps.append(map_id)
        return len(self._maps) - 1

    def packed(self, now_s: float) -> bytes:
        """For the page: the length of a JSON header (u32, little endian), the header, and the
        robots' rows one after another as float32, their times relative to ``begin_s``."""
        begin_s = now_s - SPAN_S
        robots, blocks = [], []
        for name, ring in self._rings.items():
            rows = ring.since(begin_s)
            rows[:, 0] -= begin_s
            robots.append({"robot": name, "rows": len(rows)})
            blocks.append(np.clip(rows, -3e38, 3e38).astype("<f4").tobytes())
        header = json.dumps(
            {
                "begin_s": begin_s,
                "columns": COLUMNS,
                "states": STATES,
                "maps": self._maps,
                "robots": robots,
            }
        ).encode()
        header += b" " * (-len(header) % 4)  # the numbers begin where they may be looked at
        return struct.pack("<I", len(header)) + header + b"".join(blocks)
