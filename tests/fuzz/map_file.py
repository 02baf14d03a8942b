"""The map file: its frame, its header, its arrays."""

from __future__ import annotations

import contextlib
import hashlib
import zlib

import numpy as np

from amr_slam.clouds import Cloud
from amr_slam.geometry import Pose2
from amr_slam.map.file import MAGIC, MapError, decode, encode
from amr_slam.map.params import MapParams
from amr_slam.map.pointmap import PointMap


def target(data: bytes) -> None:
    """First byte: whether what follows is a file, one without its checksum, or header and rest."""
    if not data:
        return
    kind, body = data[0] % 3, data[1:]
    if kind == 1:
        body += hashlib.sha256(body).digest()
    elif kind == 2:
        head, _, content = body.partition(b"\0")
        body = MAGIC + len(head).to_bytes(4, "little") + head + zlib.compress(content, 1)
        body += hashlib.sha256(body).digest()
    with contextlib.suppress(MapError):
        grown, _ = decode(body)
        written = encode(grown)
        assert encode(decode(written[0])[0]) == written


def seeds() -> list[bytes]:
    """An empty map and one of two walls, as files and as header and content."""
    inputs = []
    for count in (0, 2):
        grown = PointMap(MapParams())
        if count:
            grown.insert(_cloud(), Pose2.identity())
        file, _ = encode(grown)
        start = len(MAGIC) + 4
        end = start + int.from_bytes(file[len(MAGIC) : start], "little")
        content = zlib.decompress(file[end:-32])
        inputs += [b"\x00" + file, b"\x01" + file[:-32]]
        inputs.append(b"\x02" + file[start:end] + b"\0" + content)
    return inputs


def _cloud() -> Cloud:
    points_m = np.array([(1.0, 0.0), (0.0, 2.0)])
    return Cloud(
        stamp_ns=1,
        points_m=points_m,
        normals=-points_m / np.linalg.norm(points_m, axis=1, keepdims=True),
        origins_m=np.zeros((2, 2)),
        weights=np.ones(2),
        scanners=np.zeros(2, dtype=np.int8),
        sigma_m=0.01,
        across_m=0.01,
    )
