"""``amr-slam map diff|accept|rollback``."""

from __future__ import annotations

import argparse
import datetime as dt
import json
import sys
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from amr_slam.cli.outputs import UsageError, check_outputs, writing
from amr_slam.config import ConfigError, load
from amr_slam.living import (
    ChangesError,
    MapChange,
    MapDiff,
    OtherFrameError,
    Watcher,
    WatchParams,
    accept,
    changes_path,
    compare_maps,
    eligible,
    load_changes,
    save_changes,
)
from amr_slam.map import MapError, PointMap, load_map, roll_back, save_map
from amr_slam.map.file import MAGIC
from amr_slam.map.versions import MOST_VERSIONS

ACTIONS: Final = frozenset({"diff", "accept", "rollback"})
FAILURES: Final[dict[type[Exception], int]] = {
    ConfigError: 2,
    ChangesError: 1,
    OtherFrameError: 1,
}


def run(arguments: argparse.Namespace) -> int:
    """One of :data:`ACTIONS`."""
    if arguments.action == "diff":
        return _diff(arguments)
    return _accept(arguments) if arguments.action == "accept" else _roll_back(arguments)


def _diff(arguments: argparse.Namespace) -> int:
    check_outputs(arguments.out, source=arguments.map)
    known, map_id = load_map(arguments.map)
    against: Path | None = arguments.against
    if against is not None and _is_map(against):
        older, _ = load_map(against)
        diff = compare_maps(known, older, against.name)
        if not arguments.json:
            grown_m2 = known.area_m2() - older.area_m2()
            sys.stdout.write(f"floor seen free: {grown_m2:+.1f} m2 against {against.name}\n")
    else:
        path = against or changes_path(arguments.map)
        diff = _watched(known, map_id, path)[1]
    if arguments.json:
        told = {"map": str(map_id), "against": diff.against}
        changes = [change.as_json() for change in diff.changes]
        sys.stdout.write(json.dumps({**told, "changes": changes}) + "\n")
    else:
        _list(diff)
    if arguments.out is not None:
        from amr_slam.pictures import draw_changes  # noqa: PLC0415 - half a second, for this alone

        with writing(arguments.out) as out:
            draw_changes(known, diff, out, f"{known.name}: changes against {diff.against}")
    return 0


def _watched(known: PointMap, map_id: uuid.UUID, path: Path) -> tuple[Watcher, MapDiff]:
    """Raises ChangesError, where nobody has watched yet, too."""
    try:
        watcher = load_changes(path, known, map_id, WatchParams())
    except FileNotFoundError as error:
        raise ChangesError(
            f"{path}: nothing has been watched yet: a robot that is localized in the map writes it"
        ) from error
    return watcher, watcher.diff()


def _is_map(path: Path) -> bool:
    """By its first bytes. What cannot be read is for the reader to complain of."""
    try:
        with path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC
    except OSError as error:
        raise ChangesError(f"{path}: cannot be read: {error.strerror or error}") from error


def _list(diff: MapDiff) -> None:
    if not diff.changes:
        sys.stdout.write(f"no changes against {diff.against}\n")
        return
    sys.stdout.write(f"{len(diff.changes)} changes against {diff.against}\n")
    sys.stdout.write(
        "  no  kind        x       y    size in m  passes  since (UTC)       seen last\n"
    )
    for change in diff.changes:
        x_m, y_m = change.centre_m
        x_min, y_min, x_max, y_max = change.box_m
        passes = "-" if change.passes is None else str(change.passes)
        sys.stdout.write(
            f"{change.number:4}  {change.kind:5} {x_m:8.2f}{y_m:8.2f}  "
            f"{x_max - x_min:4.1f} x {y_max - y_min:4.1f}  {passes:>6}  "
            f"{_told(change.since_s)}  {_told(change.seen_s)}\n"
        )


def _told(utc_s: float | None) -> str:
    if utc_s is None:
        return "-" + 15 * " "
    return dt.datetime.fromtimestamp(utc_s, dt.UTC).strftime("%Y-%m-%d %H:%M")


def _accept(arguments: argparse.Namespace) -> int:
    if not 1 <= arguments.keep <= MOST_VERSIONS:
        raise UsageError(f"--keep {arguments.keep}: 1 to {MOST_VERSIONS} older versions are kept")
    known, map_id = load_map(arguments.map)
    path = changes_path(arguments.map)
    watcher, diff = _watched(known, map_id, path)
    chosen = _chosen(arguments, diff)
    if not chosen:
        sys.stdout.write("nothing to accept\n")
        return 0
    done = accept(known, watcher, chosen)
    for change in done.left:
        sys.stdout.write(f"{_named(change)}: not accepted: too few rays of it are kept; pass by\n")
    if not done.taken:
        raise MapError(f"{arguments.map}: nothing was accepted")
    new_id = save_map(done.map, arguments.map, keep=arguments.keep)
    watcher.rebase(done.map)
    save_changes(watcher, done.map, new_id, path)
    for change in done.taken:
        sys.stdout.write(f"{_named(change)}: accepted\n")
    sys.stdout.write(f"{arguments.map}: {new_id}; the version before is {arguments.map.name}.1\n")
    return 0


def _chosen(arguments: argparse.Namespace, diff: MapDiff) -> Sequence[MapChange]:
    if arguments.all:
        return diff.changes
    if arguments.policy is not None:
        policy = load(arguments.policy).map.accept
        if not policy.passes:
            raise UsageError(f"{arguments.policy}: map.accept.passes is 0: it accepts nothing")
        return eligible(diff, policy)
    by_number = {change.number: change for change in diff.changes}
    unknown = [number for number in arguments.only if number not in by_number]
    if unknown:
        raise UsageError(f"--only {unknown[0]}: there are {len(by_number)} changes")
    return [by_number[number] for number in dict.fromkeys(arguments.only)]


def _named(change: MapChange) -> str:
    x_m, y_m = change.centre_m
    return f"{change.number} {change.kind} at x {x_m:.2f}, y {y_m:.2f}"


def _roll_back(arguments: argparse.Namespace) -> int:
    if not 1 <= arguments.to <= MOST_VERSIONS:
        raise UsageError(f"--to {arguments.to}: there are versions 1 to {MOST_VERSIONS} at most")
    map_id = roll_back(arguments.map, arguments.to)
    sys.stdout.write(
        f"{arguments.map}: {map_id}, which was version {arguments.to}; "
        f"what it replaces is {arguments.map.name}.1\n"
    )
    return 0
