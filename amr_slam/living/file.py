"""``NAME.amrmap.changes``: what was watched, beside the map's file. Format: docs/living-maps.md.

Made as the map's file is: a magic line, a bounded JSON header, arrays as one zlib stream, a
SHA-256 over everything before it; written atomically.
"""

from __future__ import annotations

import hashlib
import json
import logging
import struct
import uuid
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from amr_slam.durable import write_durably
from amr_slam.geometry import Pose2
from amr_slam.living.evidence import COLUMNS, checked
from amr_slam.living.params import WatchParams
from amr_slam.living.watcher import Sighting, Watcher
from amr_slam.map import PointMap
from amr_slam.map.lineage import frame_of
from amr_slam.map.rays import Rays, nothing

_log = logging.getLogger(__name__)

MAGIC: Final = b"AMRCHG\r\n"
VERSION: Final = 1
MAX_FILE_BYTES: Final = 64 * 2**20
MAX_CONTENT_BYTES: Final = 256 * 2**20
_MAX_HEADER_BYTES: Final = 2**16
_LENGTH: Final = struct.Struct("<I")
_DIGEST_BYTES: Final = 32
_FARTHEST_M: Final = 1e6

# In the file's order: name -> (dtype, columns; 0 = one-dimensional).
_ARRAYS: Final = {
    **{f"{kind}_{name}": (dtype, 0) for kind in ("new", "gone") for name, dtype in COLUMNS.items()},
    "scan_stamps_ns": ("<i8", 0),
    "scan_poses": ("<f8", 3),
    "scan_sigmas_m": ("<f8", 0),
    "scan_across_m": ("<f8", 0),
    "scan_quanta_m": ("<f8", 0),
    "scan_rays": ("<i8", 0),
    "ray_ends": ("<i2", 2),
    "ray_origins": ("<i2", 2),
    "ray_normals": ("<i2", 0),
    "ray_weights": ("<u1", 0),
}


class ChangesError(Exception):
    """A file of changes that cannot be used, or not with this map; one line."""


def changes_path(map_path: Path) -> Path:
    """Where the changes of the map in this file are kept."""
    return map_path.with_name(f"{map_path.name}.changes")


def save_changes(watcher: Watcher, known: PointMap, map_id: uuid.UUID, path: Path) -> None:
    """Write what was watched of ``known``. Raises OSError; then the old content is still there."""
    write_durably(path, encode(watcher, known, map_id))


def load_changes(path: Path, known: PointMap, map_id: uuid.UUID, params: WatchParams) -> Watcher:
    """What was watched of this map, or of another version of it. Raises ChangesError, and
    FileNotFoundError where nothing was."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ChangesError(f"{path}: larger than changes may be ({MAX_FILE_BYTES} bytes)")
        data = path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ChangesError(f"{path}: cannot be read: {error.strerror or error}") from error
    try:
        return decode(data, known, map_id, params)
    except ChangesError as error:
        raise ChangesError(f"{path}: {error}") from error


def resume_watching(path: Path, known: PointMap, map_id: uuid.UUID, params: WatchParams) -> Watcher:
    """What was watched so far; from nothing where there is no file, or none of this map's."""
    try:
        return load_changes(path, known, map_id, params)
    except FileNotFoundError:
        pass
    except ChangesError as error:
        _log.warning("changes: %s; watching begins anew", error)
    return Watcher(known, params)


def encode(watcher: Watcher, known: PointMap, map_id: uuid.UUID) -> bytes:
    """The file's bytes."""
    scans, none = watcher.sightings, nothing(0.0)
    rays = [scan.rays for scan in scans]
    arrays: dict[str, NDArray[Any]] = {
        **{f"new_{name}": watcher.new.rows[name] for name in COLUMNS},
        **{f"gone_{name}": watcher.gone.rows[name] for name in COLUMNS},
        "scan_stamps_ns": np.array([scan.stamp_ns for scan in scans], dtype=np.int64),
        "scan_poses": np.array([scan.map_from_base.as_array() for scan in scans]).reshape(-1, 3),
        "scan_sigmas_m": np.array([scan.sigma_m for scan in scans]),
        "scan_across_m": np.array([one.across_m for one in rays]),
        "scan_quanta_m": np.array([one.quantum_m for one in rays]),
        "scan_rays": np.array([len(one) for one in rays], dtype=np.int64),
        "ray_ends": np.concatenate([none.ends, *(one.ends for one in rays)]),
        "ray_origins": np.concatenate([none.origins, *(one.origins for one in rays)]),
        "ray_normals": np.concatenate([none.normals, *(one.normals for one in rays)]),
        "ray_weights": np.concatenate([none.weights, *(one.weights for one in rays)]),
    }
    content = b"".join(
        np.ascontiguousarray(arrays[name], dtype=dtype).tobytes()
        for name, (dtype, _) in _ARRAYS.items()
    )
    header = {
        "version": VERSION,
        "map": str(map_id),
        "frame": frame_of(known),
        "cell_m": known.space.cell_m,
        "rows": {name: len(array) for name, array in arrays.items()},
    }
    text = json.dumps(header, sort_keys=True).encode()
    body = MAGIC + _LENGTH.pack(len(text)) + text + zlib.compress(content, 6)
    return body + hashlib.sha256(body).digest()


def decode(data: bytes, known: PointMap, map_id: uuid.UUID, params: WatchParams) -> Watcher:
    """From a file's bytes. Raises ChangesError."""
    start = len(MAGIC) + _LENGTH.size
    if not data.startswith(MAGIC):
        raise ChangesError("not a file of changes (it does not begin as one)")
    body, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    if len(body) < start or hashlib.sha256(body).digest() != digest:
        raise ChangesError("the file is damaged (checksum): remove it, changes are watched anew")
    (length,) = _LENGTH.unpack_from(body, len(MAGIC))
    try:
        header = json.loads(body[start : start + min(length, _MAX_HEADER_BYTES)])
        _check_header(header, known, map_id)
        arrays = _unpacked(header["rows"], body[start + length :])
        watcher = _watcher(arrays, known, params)
        if header["map"] != str(map_id):
            watcher.rebase(known)
    except (KeyError, TypeError, ValueError, RecursionError, zlib.error) as error:
        raise ChangesError(f"the file's content makes no sense: {error}") from error
    return watcher


def _check_header(header: dict[str, Any], known: PointMap, map_id: uuid.UUID) -> None:
    if header["version"] != VERSION:
        raise ChangesError(
            f"version {header['version']!r}, this program reads {VERSION}: "
            "use the amr-slam that wrote it"
        )
    ours = header["map"] == str(map_id) or (header["frame"] and header["frame"] == frame_of(known))
    if not ours or header["cell_m"] != known.space.cell_m:
        raise ChangesError("the changes are those of another map")


def _unpacked(rows: dict[str, Any], packed: bytes) -> dict[str, NDArray[Any]]:
    counts = {name: int(rows[name]) for name in _ARRAYS}
    sizes = {
        name: counts[name] * np.dtype(dtype).itemsize * max(columns, 1)
        for name, (dtype, columns) in _ARRAYS.items()
    }
    total = sum(sizes.values())
    if min(counts.values()) < 0 or total > MAX_CONTENT_BYTES:
        raise ValueError(f"the header claims {total} bytes")
    content = zlib.decompressobj().decompress(packed, total + 1)
    if len(content) != total:
        raise ValueError("content length")
    arrays: dict[str, NDArray[Any]] = {}
    offset = 0
    for name, (dtype, columns) in _ARRAYS.items():
        flat = np.frombuffer(content, dtype, sizes[name] // np.dtype(dtype).itemsize, offset)
        arrays[name] = flat.reshape(-1, columns).copy() if columns else flat.copy()
        offset += sizes[name]
        if dtype == "<f8" and not np.all(np.isfinite(arrays[name])):
            raise ValueError(f"{name} holds numbers that are not finite")
    return arrays


def _watcher(arrays: dict[str, NDArray[Any]], known: PointMap, params: WatchParams) -> Watcher:
    watcher = Watcher(known, params)
    for kind in ("new", "gone"):
        columns = {name: arrays[f"{kind}_{name}"] for name in COLUMNS}
        if len({len(column) for column in columns.values()}) != 1:
            raise ValueError("the cells' columns differ in length")
        evidence = checked(columns, params)
        setattr(watcher, kind, evidence)
    counts = arrays["scan_rays"]
    scans = [name for name in _ARRAYS if name.startswith("scan_")]
    rays = [name for name in _ARRAYS if name.startswith("ray_")]
    if any(len(arrays[name]) != len(counts) for name in scans) or np.any(counts < 0):
        raise ValueError("the scans' columns differ in length")
    if any(len(arrays[name]) != int(counts.sum()) for name in rays):
        raise ValueError("the rays do not add up")
    if not np.all((arrays["scan_quanta_m"] > 0.0) & (arrays["scan_quanta_m"] < 1e3)):
        raise ValueError("rays are measured in parts of nothing")
    if np.any(np.abs(arrays["scan_poses"]) > _FARTHEST_M):
        raise ValueError("scans lie beyond all maps")
    ends = np.cumsum(counts)
    for row, (count, end) in enumerate(zip(counts, ends, strict=True)):
        part = slice(int(end - count), int(end))
        watcher.sightings.append(
            Sighting(
                stamp_ns=int(arrays["scan_stamps_ns"][row]),
                map_from_base=Pose2.from_array(arrays["scan_poses"][row]),
                sigma_m=float(arrays["scan_sigmas_m"][row]),
                rays=Rays(
                    quantum_m=float(arrays["scan_quanta_m"][row]),
                    across_m=float(arrays["scan_across_m"][row]),
                    ends=arrays["ray_ends"][part],
                    origins=arrays["ray_origins"][part],
                    normals=arrays["ray_normals"][part],
                    weights=arrays["ray_weights"][part],
                ),
            )
        )
    return watcher
