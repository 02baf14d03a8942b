"""Tables of pairs, landmarks and camera poses: CSV as instruments, scripts and spreadsheets write
it, commas with points or semicolons with decimal commas."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from amr_slam.aligning.fit import Fit
from amr_slam.aligning.pairs import AlignError, PosePairs, Track
from amr_slam.geometry import Array
from amr_slam.recording import read_tum
from amr_slam.recording.values import parse_stamp

_MAX_BYTES: Final = 512 * 2**20
_MAX_ROWS: Final = 2_000_000
_MAX_LABEL: Final = 60
_USABLE: Final = frozenset({"", "localized", "mapping", "odometry_only"})
"""States of the robot, where a table tells them, in which its pose was worth something."""

Row = dict[str, str]


def read_pairs(path: Path, map_id: str | None = None) -> PosePairs:
    """Columns ``camera_x, camera_y, slam_x, slam_y`` in m; optional: ``camera_theta, slam_theta``
    in rad (or ``..._theta_deg``), ``stamp``, ``slam_vx`` (m/s), ``slam_omega`` (rad/s), ``state``
    and ``map``: only rows of the map ``map_id`` (a UUID) are taken then.

    Raises AlignError, one line, with the line of the file.
    """
    labels, site, known, twists = [], [], [], []
    rates, others = False, 0
    for number, row in _rows(path, ("camera_x", "camera_y", "slam_x", "slam_y")):
        with _at(path, number):
            if row.get("state", "") not in _USABLE:
                continue
            if map_id is not None and row.get("map", map_id) != map_id:
                others += 1
                continue
            labels.append(_label(row, ("stamp", "name"), f"line {number}"))
            site.append(_pose(row, "camera_"))
            known.append(_pose(row, "slam_"))
            rates = "slam_vx" in row and "slam_omega" in row
            if rates:
                twists.append((_number(row, "slam_vx"), 0.0, _number(row, "slam_omega")))
    if others and not labels:
        raise AlignError(
            f"{path}: all {others} rows are of other maps than {map_id}: drive in this one "
            '(mode = "localization") with shadow mode on'
        )
    return PosePairs(
        labels=tuple(labels),
        site=_table(site),
        map=_table(known),
        twists=_table(twists) if rates else None,
    )


def read_landmarks(path: Path) -> PosePairs:
    """Columns ``name, x_map, y_map, x_site, y_site`` in m. Raises AlignError."""
    labels, site, known = [], [], []
    for number, row in _rows(path, ("name", "x_map", "y_map", "x_site", "y_site")):
        with _at(path, number):
            labels.append(_label(row, ("name",), f"line {number}"))
            site.append((_number(row, "x_site"), _number(row, "y_site"), math.nan))
            known.append((_number(row, "x_map"), _number(row, "y_map"), math.nan))
    return PosePairs(labels=tuple(labels), site=_table(site), map=_table(known))


def read_camera(path: Path) -> Track:
    """A TUM file, or a CSV file with ``stamp`` (s, or ISO 8601), ``x``, ``y`` (m) and perhaps
    ``theta`` (rad) or ``theta_deg``. Raises AlignError and RecordingError."""
    if path.suffix not in {".csv", ".CSV"}:
        trajectory = read_tum(path)
        return Track(stamps_ns=trajectory.stamps_ns, poses=trajectory.poses)
    stamps, poses = [], []
    for number, row in _rows(path, ("stamp", "x", "y")):
        with _at(path, number):
            stamps.append(_stamp_ns(row["stamp"]))
            poses.append(_pose(row, ""))
    return Track(stamps_ns=np.array(stamps, dtype=np.int64), poses=_table(poses))


def write_residuals(path: Path, pairs: PosePairs, fit: Fit) -> None:
    """One line a pair: what the site says less what the map says, in the site's frame."""
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("pair", "agrees", "dx_m", "dy_m", "distance_m", "dtheta_deg"))
        for row in range(len(pairs)):
            dx, dy = fit.offsets_m[row].tolist()
            turn = float(fit.offsets_rad[row])
            writer.writerow(
                (
                    pairs.labels[row],
                    "yes" if fit.agrees[row] else "no",
                    f"{dx:.4f}",
                    f"{dy:.4f}",
                    f"{math.hypot(dx, dy):.4f}",
                    f"{math.degrees(turn):.3f}" if math.isfinite(turn) else "",
                )
            )


class _at:  # noqa: N801  # reads as a statement
    """Any ValueError within names the line."""

    def __init__(self, path: Path, number: int) -> None:
        self._where = f"{path}:{number}"

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ValueError):
            raise AlignError(f"{self._where}: {error}") from error


def _rows(path: Path, needed: tuple[str, ...]) -> Iterator[tuple[int, Row]]:
    """(line, its cells by the header's names), bounded. Raises AlignError and OSError."""
    if path.stat().st_size > _MAX_BYTES:
        raise AlignError(f"{path}: more than {_MAX_BYTES >> 20} MiB")
    try:
        with path.open(encoding="utf-8-sig", newline="") as stream:
            yield from _parsed(path, stream, needed)
    except UnicodeDecodeError as error:
        raise AlignError(f"{path}: not a text in UTF-8") from error
    except csv.Error as error:
        raise AlignError(f"{path}: not CSV: {error}") from error


def _parsed(path: Path, stream: TextIO, needed: tuple[str, ...]) -> Iterator[tuple[int, Row]]:
    header = stream.readline(10_000)
    separator = ";" if ";" in header else ","
    names = [name.strip().strip('"').lower() for name in header.strip().split(separator)]
    missing = [name for name in needed if name not in names]
    if missing:
        raise AlignError(
            f"{path}:1: the first line must name the columns {', '.join(needed)}; "
            f"missing: {', '.join(missing)}"
        )
    for number, cells in enumerate(csv.reader(stream, delimiter=separator), start=2):
        if number > _MAX_ROWS:
            raise AlignError(f"{path}: more than {_MAX_ROWS} lines")
        if not any(cell.strip() for cell in cells):
            continue
        if len(cells) != len(names):
            raise AlignError(f"{path}:{number}: {len(cells)} cells, the header has {len(names)}")
        values = (cell.strip() for cell in cells)
        if separator == ";":
            values = (value.replace(",", ".") for value in values)
        yield number, dict(zip(names, values, strict=True))


def _number(row: Row, name: str) -> float:
    try:
        number = float(row[name])
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e9:
        raise ValueError(f"{name}: {row[name][:40]!r} is not a number")
    return number


def _pose(row: Row, prefix: str) -> tuple[float, float, float]:
    theta = math.nan
    if row.get(f"{prefix}theta"):
        theta = _number(row, f"{prefix}theta")
    elif row.get(f"{prefix}theta_deg"):
        theta = math.radians(_number(row, f"{prefix}theta_deg"))
    return _number(row, f"{prefix}x"), _number(row, f"{prefix}y"), theta


def _label(row: Row, names: tuple[str, ...], otherwise: str) -> str:
    text = next((row[name] for name in names if row.get(name)), otherwise)
    return "".join(c if c.isprintable() else "?" for c in text)[:_MAX_LABEL]


def _stamp_ns(text: str) -> int:
    if "-" in text[1:] and ":" in text:
        told = datetime.fromisoformat(text)
        return round(1e9 * (told if told.tzinfo else told.replace(tzinfo=UTC)).timestamp())
    return parse_stamp(text)


def _table(rows: list[tuple[float, float, float]]) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
