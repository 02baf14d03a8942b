"""``NAME.amrmap``: one file, checked, written atomically. Format: docs/map-format.md.

Layout: a magic line, the header's length, a JSON header, the arrays one after another (zlib over
all of them), and a SHA-256 over everything before it. Never pickle; nothing in the file decides
how much memory is taken beyond the bounds below.
"""

from __future__ import annotations

import hashlib
import json
import stat
import struct
import uuid
import zlib
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amr_slam.durable import write_durably
from amr_slam.geometry import Pose2
from amr_slam.map import layers
from amr_slam.map.params import MapParams
from amr_slam.map.pointmap import PointMap
from amr_slam.map.provenance import (
    from_header,
    imported_from_header,
    merged_from_header,
    merged_to_header,
    to_header,
)
from amr_slam.map.rays import Rays, nothing
from amr_slam.map.ties import MapTies

MAGIC = b"AMRMAP\r\n"
VERSION = 3
MAX_FILE_BYTES = 512 * 2**20
MAX_CONTENT_BYTES = 2 * 2**30
_MAX_HEADER_BYTES = 2**20
# Maps shrink to a third or a twelfth when they are packed. What shrinks by more than this is no
# map, and would fill a robot's memory before it is found out.
_BY_HOW_MUCH, _SMALL = 64, 2**20
_LENGTH = struct.Struct("<I")
_DIGEST_BYTES = 32
_NAMESPACE = uuid.UUID("6f1c1f5e-5d0b-4c3b-9c0e-2a4f6a3b7d10")

# Arrays of version 1, in the file's order: name -> (dtype, columns; 0 = one-dimensional).
_ARRAYS_1 = {
    "wall_keys": ("<i8", 0),
    "wall_sums": ("<f8", 7),
    "space_keys": ("<i8", 0),
    "space_sums": ("<f8", 2),
    "path_stamps_ns": ("<i8", 0),
    "path_poses": ("<f8", 3),
    "path_noises_m": ("<f8", 0),
}
_ARRAYS_2 = _ARRAYS_1 | {
    "wall_sums": ("<f8", 8),
    "ray_counts": ("<i8", 0),
    "ray_quanta_m": ("<f8", 0),
    "ray_across_m": ("<f8", 0),
    "ray_ends": ("<i2", 2),
    "ray_origins": ("<i2", 2),
    "ray_normals": ("<i2", 0),
    "ray_weights": ("<u1", 0),
}
_TIES = {
    "tie_starts": ("<i8", 0),
    "tie_ends": ("<i8", 0),
    "tie_deltas": ("<f8", 3),
    "tie_informations": ("<f8", 9),
    "tie_loops": ("<u1", 0),
}
_ARRAYS = _ARRAYS_2 | _TIES
# Walls are met at about 45 degrees: noise across them over noise along the beam.
_TYPICAL_ACROSS = 0.7
_LAYOUTS = {1: _ARRAYS_1, 2: _ARRAYS_2, VERSION: _ARRAYS}


class MapError(Exception):
    """A map file that cannot be used; the message names the file and what to do."""


def save_map(grown: PointMap, path: Path, *, keep: int = 2) -> uuid.UUID:
    """Write the map and return its UUID, a function of its content (same map, same bytes).

    Written beside the target, synced, then renamed: a crash at any moment leaves the old file or
    the new one, whole. The ``keep`` newest old versions stay as NAME.amrmap.1, .2, ...
    Raises MapError where the folder cannot be written.
    """
    data, map_id = encode(grown)
    try:
        write_durably(path, data, keep=keep)
    except OSError as error:
        raise MapError(f"{path}: cannot write the map: {error.strerror or error}") from error
    return map_id


def encode(grown: PointMap) -> tuple[bytes, uuid.UUID]:
    """The file's bytes and the map's UUID."""
    none = nothing(0.0)
    arrays: dict[str, NDArray[Any]] = {
        "wall_keys": grown.walls.keys,
        "wall_sums": grown.walls.sums,
        "space_keys": grown.space.keys,
        "space_sums": grown.space.sums,
        "path_stamps_ns": np.array([stamp for stamp, _ in grown.path], dtype=np.int64),
        "path_poses": np.array([pose.as_array() for _, pose in grown.path]).reshape(-1, 3),
        "path_noises_m": np.array(grown.noises_m, dtype=np.float64),
        "ray_counts": np.array([len(rays) for rays in grown.rays], dtype=np.int64),
        "ray_quanta_m": np.array([rays.quantum_m for rays in grown.rays], dtype=np.float64),
        "ray_across_m": np.array([rays.across_m for rays in grown.rays], dtype=np.float64),
        "ray_ends": np.concatenate([none.ends, *(rays.ends for rays in grown.rays)]),
        "ray_origins": np.concatenate([none.origins, *(rays.origins for rays in grown.rays)]),
        "ray_normals": np.concatenate([none.normals, *(rays.normals for rays in grown.rays)]),
        "ray_weights": np.concatenate([none.weights, *(rays.weights for rays in grown.rays)]),
        "tie_starts": grown.ties.starts,
        "tie_ends": grown.ties.ends,
        "tie_deltas": grown.ties.deltas,
        "tie_informations": grown.ties.informations.reshape(-1, 9),
        "tie_loops": grown.ties.loops,
    }
    content = b"".join(
        np.ascontiguousarray(array, dtype=_ARRAYS[name][0]).tobytes()
        for name, array in arrays.items()
    )
    drawn = layers.to_header(grown.layers) if grown.layers.everything else []
    map_id = _identity(content, drawn)
    header: dict[str, Any] = {
        "version": VERSION,
        "uuid": str(map_id),
        "name": grown.name,
        "params": asdict(grown.params),
        "rows": {name: len(array) for name, array in arrays.items()},
    }
    if grown.reframings:
        header["reframings"] = to_header(grown.reframings)
    if grown.merged:
        header["merged"] = merged_to_header(grown.merged)
    if grown.imported is not None:
        header["imported"] = asdict(grown.imported)
    if drawn:
        header["layers"] = drawn
    text = json.dumps(header, sort_keys=True).encode()
    if len(text) > _MAX_HEADER_BYTES:
        raise MapError(f"{grown.name}: its header would be {len(text)} bytes: remove layers")
    body = MAGIC + _LENGTH.pack(len(text)) + text + zlib.compress(content, 6)
    return body + hashlib.sha256(body).digest(), map_id


def _identity(content: bytes, drawn: list[dict[str, Any]]) -> uuid.UUID:
    """Of what counts: a map without layers is the one that it was before there were any."""
    told = hashlib.sha256(content)
    told.update(json.dumps(drawn, sort_keys=True).encode() if drawn else b"")
    return uuid.uuid5(_NAMESPACE, told.hexdigest())


def load_map(path: Path) -> tuple[PointMap, uuid.UUID]:
    """The map in a file and its UUID. Raises MapError: missing, damaged, too new, too large."""
    try:
        about = path.stat()
        size = about.st_size
        if not stat.S_ISREG(about.st_mode):
            raise MapError(f"{path}: is no file")
        if size > MAX_FILE_BYTES:
            raise MapError(f"{path}: {size} bytes, more than a map may have ({MAX_FILE_BYTES})")
        data = path.read_bytes()
    except OSError as error:
        raise MapError(f"{path}: cannot read the map: {error.strerror or error}") from error
    try:
        return decode(data)
    except MapError as error:
        raise MapError(f"{path}: {error}") from error


def decode(data: bytes) -> tuple[PointMap, uuid.UUID]:
    """The map in a file's bytes. Raises MapError; see :func:`load_map`."""
    start = len(MAGIC) + _LENGTH.size
    if not data.startswith(MAGIC):
        raise MapError("not a map file (it does not begin as one)")
    if len(data) < start + _DIGEST_BYTES:
        raise MapError("the file is cut short; use an older version (NAME.amrmap.1)")
    body, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    header = _header(body, start)
    version = header.get("version")
    if not isinstance(version, int) or version not in _LAYOUTS:
        raise MapError(
            f"map format version {version!r}, this program reads 1 to {VERSION}: "
            "use the amr-slam that wrote it, or a newer one"
        )
    if hashlib.sha256(body).digest() != digest:
        raise MapError("the file is damaged (checksum); use an older version (NAME.amrmap.1)")
    try:
        return _build(header, body, start)
    except (KeyError, TypeError, ValueError) as error:
        raise MapError(f"the file's content makes no sense: {error}") from error


def identity(data: bytes) -> uuid.UUID:
    """The UUID in a file's bytes, whose content is not looked at. Raises MapError."""
    start = len(MAGIC) + _LENGTH.size
    if not data.startswith(MAGIC) or len(data) < start + _DIGEST_BYTES:
        raise MapError("not a map file")
    try:
        return uuid.UUID(str(_header(data[:-_DIGEST_BYTES], start).get("uuid")))
    except ValueError as error:
        raise MapError("the file is damaged (header)") from error


def _header(body: bytes, start: int) -> dict[str, Any]:
    (length,) = _LENGTH.unpack_from(body, len(MAGIC))
    if length > min(_MAX_HEADER_BYTES, len(body) - start):
        raise MapError("the file is damaged (header length); use an older version (NAME.amrmap.1)")
    try:
        header = json.loads(body[start : start + length])
    except (ValueError, RecursionError) as error:
        raise MapError("the file is damaged (header); use an older version") from error
    if not isinstance(header, dict):
        raise MapError("the file is damaged (header); use an older version (NAME.amrmap.1)")
    return header


def _build(header: dict[str, Any], body: bytes, start: int) -> tuple[PointMap, uuid.UUID]:
    (length,) = _LENGTH.unpack_from(body, len(MAGIC))
    layout = _LAYOUTS[header["version"]]
    rows = {name: int(header["rows"][name]) for name in layout}
    sizes = {
        name: rows[name] * np.dtype(dtype).itemsize * max(columns, 1)
        for name, (dtype, columns) in layout.items()
    }
    total = sum(sizes.values())
    packed = len(body) - start - length
    if min(rows.values()) < 0 or total > min(MAX_CONTENT_BYTES, _BY_HOW_MUCH * packed + _SMALL):
        raise MapError(f"the header claims {total} bytes of map, which {packed} bytes cannot hold")
    unpacker = zlib.decompressobj()
    try:
        content = unpacker.decompress(body[start + length :], total + 1)
    except zlib.error as error:
        raise MapError(f"the file is damaged ({error}); use an older version") from error
    if len(content) != total:
        raise MapError("the file is damaged (content length); use an older version")
    arrays: dict[str, NDArray[Any]] = {}
    offset = 0
    for name, (dtype, columns) in layout.items():
        flat = np.frombuffer(content, dtype, sizes[name] // np.dtype(dtype).itemsize, offset)
        arrays[name] = flat.reshape(-1, columns).copy() if columns else flat.copy()
        offset += sizes[name]
    if header["version"] == 1:
        _upgrade(arrays)
    if header["version"] < VERSION:
        arrays |= {name: np.empty((0, columns)) for name, (_, columns) in _TIES.items()}
    grown = PointMap(_params(header["params"]), str(header["name"]))
    _fill(grown, arrays)
    grown.reframings = from_header(header.get("reframings", []))
    grown.merged = merged_from_header(header.get("merged", []))
    grown.imported = imported_from_header(header.get("imported"))
    grown.layers = layers.from_header(header.get("layers", []))
    return grown, uuid.UUID(str(header["uuid"]))


def _upgrade(arrays: dict[str, NDArray[Any]]) -> None:
    """Version 1 kept neither the number of points in a cell nor rays: their weight stands for
    the number, and there is nothing to rebuild the map from."""
    walls, scans = arrays["wall_sums"], len(arrays["path_poses"])
    arrays["wall_sums"] = np.hstack([walls, walls[:, :1]])
    none = nothing(0.0)
    arrays["ray_counts"] = np.zeros(scans, dtype=np.int64)
    arrays["ray_quanta_m"] = np.full(scans, none.quantum_m)
    arrays["ray_across_m"] = _TYPICAL_ACROSS * arrays["path_noises_m"]
    arrays["ray_ends"], arrays["ray_origins"] = none.ends, none.origins
    arrays["ray_normals"], arrays["ray_weights"] = none.normals, none.weights


def _params(raw: dict[str, Any]) -> MapParams:
    params = MapParams(**raw)
    numbers = [value for value in asdict(params).values() if not isinstance(value, bool)]
    if not all(isinstance(value, int | float) and value >= 0.0 for value in numbers):
        raise ValueError("map parameters must be numbers")
    if not all(1e-3 <= cell_m <= 1.0 for cell_m in (params.cell_m, params.free_cell_m)):
        raise ValueError("cells must measure a millimetre to a metre")
    return params


def _fill(grown: PointMap, arrays: dict[str, NDArray[Any]]) -> None:
    for name in (name for name, (dtype, _) in _ARRAYS.items() if dtype == "<f8"):
        if not np.all(np.isfinite(arrays[name])):
            raise ValueError(f"{name} holds numbers that are not finite")
    walls = arrays["wall_sums"]
    if np.any(walls[:, (0, 7)] <= 0.0):
        raise ValueError("wall cells without a point")
    # Raises ValueError itself: such points would stop the first search instead of the loading.
    grown.space.keys_of(walls[:, 1:3] / walls[:, :1])
    for grid, keys, sums in (
        (grown.walls, "wall_keys", "wall_sums"),
        (grown.space, "space_keys", "space_sums"),
    ):
        if len(arrays[keys]) != len(arrays[sums]) or np.any(np.diff(arrays[keys]) <= 0):
            raise ValueError(f"{keys} must be sorted and match {sums}")
        grid.keys = arrays[keys]
        grid.sums = np.asarray(arrays[sums], dtype=grid.sums.dtype)
    lengths = {len(arrays[name]) for name in ("path_poses", "path_stamps_ns", "path_noises_m")}
    if len(lengths) != 1:
        raise ValueError("the path's stamps, poses and noises differ in number")
    grown.path = [
        (int(stamp), Pose2.from_array(pose))
        for stamp, pose in zip(arrays["path_stamps_ns"], arrays["path_poses"], strict=True)
    ]
    grown.noises_m = [float(noise) for noise in arrays["path_noises_m"]]
    grown.rays = _rays(arrays)
    grown.ties = MapTies(
        starts=arrays["tie_starts"].ravel(),
        ends=arrays["tie_ends"].ravel(),
        deltas=arrays["tie_deltas"],
        informations=arrays["tie_informations"],
        loops=arrays["tie_loops"].ravel() != 0,
    )
    grown.ties.check(len(grown.path))
    grown.revision = 1


def _rays(arrays: dict[str, NDArray[Any]]) -> list[Rays]:
    counts, quanta_m = arrays["ray_counts"], arrays["ray_quanta_m"]
    names = ("ray_ends", "ray_origins", "ray_normals", "ray_weights")
    total = int(counts.sum())
    across_m = arrays["ray_across_m"]
    if not len(counts) == len(quanta_m) == len(across_m) == len(arrays["path_poses"]):
        raise ValueError("the path and its scans' rays differ in number")
    if np.any(counts < 0) or any(len(arrays[name]) != total for name in names):
        raise ValueError("the rays do not add up")
    if not np.all((quanta_m > 0.0) & (quanta_m < 1e3)):
        raise ValueError("rays are measured in parts of nothing")
    ends = np.cumsum(counts)
    return [
        Rays(
            quantum_m=float(quantum_m),
            across_m=float(noise),
            ends=arrays["ray_ends"][end - count : end],
            origins=arrays["ray_origins"][end - count : end],
            normals=arrays["ray_normals"][end - count : end],
            weights=arrays["ray_weights"][end - count : end],
        )
        for quantum_m, noise, count, end in zip(quanta_m, across_m, counts, ends, strict=True)
    ]
