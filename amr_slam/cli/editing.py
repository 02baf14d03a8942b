"""``amr-slam map edit``: layers over a map."""

from __future__ import annotations

import argparse
import getpass
import json
import sys
import time
from pathlib import Path
from typing import Any, Final

import numpy as np

from amr_slam import areas
from amr_slam.cli.outputs import UsageError, check_outputs
from amr_slam.geometry import Array
from amr_slam.map import LayerError, LayerKind, Layers, load_map, save_map
from amr_slam.map.layers import corners_from, to_header

_MAX_JSON_BYTES: Final = 4 * 2**20


def edit(arguments: argparse.Namespace) -> int:
    """One step, saved; or the list of the layers."""
    path: Path = arguments.map
    known, _ = load_map(path)
    if arguments.step == "list":
        _list(known.layers, as_json=arguments.json)
        return 0
    out: Path = arguments.out or path
    if arguments.out is not None:
        check_outputs(out, source=path)
    layers, said = _changed(arguments, known.layers)
    known.edit(layers)
    # In place, the map of before stays as NAME.amrmap.1.
    map_id = save_map(known, out, keep=arguments.keep if out == path else 0)
    sys.stdout.write(f"{out}: {said}; {len(layers)} layers, map {map_id}\n")
    return 0


def _changed(arguments: argparse.Namespace, layers: Layers) -> tuple[Layers, str]:
    """The layers after the step, and what it did, in words. Raises LayerError, UsageError."""
    if arguments.step == "undo":
        return layers.undone()
    by, at_s = arguments.by or _who(), int(time.time())
    if arguments.step == "remove":
        return layers.without(arguments.names, by, at_s), f"removed {', '.join(arguments.names)}"
    if arguments.step == "draw":
        drawn = _from_file(arguments.file)
    else:
        kind = LayerKind(arguments.step)
        name = arguments.name or _free_name(kind, layers)
        drawn = [(kind, name, np.array(arguments.points, dtype=np.float64))]
    told = ", ".join(f'{kind} "{name}"' for kind, name, _ in drawn)
    return layers.with_drawn(drawn, by, at_s), f"drew {told}"


def _who() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # nobody has a name here
        return "unknown"


def _free_name(kind: LayerKind, layers: Layers) -> str:
    taken = {one.name for one in layers.active}
    return next(name for i in range(1, len(taken) + 2) if (name := f"{kind}-{i}") not in taken)


def _from_file(path: Path) -> list[tuple[LayerKind, str, Array]]:
    """Layers as ``list --json`` tells them; only kind, name and points count."""
    if path.stat().st_size > _MAX_JSON_BYTES:
        raise UsageError(f"{path}: more than {_MAX_JSON_BYTES} bytes")
    try:
        raw: Any = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: not JSON: {error}") from error
    entries = raw.get("layers") if isinstance(raw, dict) else None
    if not isinstance(entries, list):
        raise UsageError(f'{path}: needs {{"layers": [...]}}, as map edit MAP list --json writes')
    drawn = [
        _from_entry(f"{path}: layer {i}", entry)
        for i, entry in enumerate(entries, 1)
        if not (isinstance(entry, dict) and entry.get("removed"))
    ]
    if not drawn:
        raise UsageError(f"{path}: there is no layer in it")
    return drawn


def _from_entry(told: str, entry: Any) -> tuple[LayerKind, str, Array]:
    if not isinstance(entry, dict):
        raise UsageError(f"{told}: must be an object with kind, name and points_m")
    kinds = [str(kind) for kind in LayerKind]
    if entry.get("kind") not in kinds:
        raise UsageError(f"{told}: kind must be one of {', '.join(kinds)}")
    try:
        return LayerKind(entry["kind"]), entry.get("name", ""), corners_from(entry.get("points_m"))
    except ValueError as error:
        raise UsageError(f"{told}: {error}") from error


def _list(layers: Layers, *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps({"layers": to_header(layers)}) + "\n")
        return
    for one in layers.active:
        size = (
            f"{areas.length_m(one.corners_m):.2f} m"
            if one.kind is LayerKind.WALL
            else f"{areas.area_m2(one.corners_m):.2f} m2"
        )
        low, high = one.corners_m.min(axis=0), one.corners_m.max(axis=0)
        at = time.strftime("%Y-%m-%d %H:%M", time.gmtime(one.added.at_s))
        sys.stdout.write(
            f"{one.kind:6}{one.name:20} {size:>11}, {len(one.corners_m)} points, "
            f"x {low[0]:.2f} to {high[0]:.2f}, y {low[1]:.2f} to {high[1]:.2f}; "
            f"{at} UTC by {one.added.by}; {one.layer_id}\n"
        )


__all__ = ["LayerError", "edit"]
