"""One map of two, once it is known how they lie on each other.

The first map's scans stay where they are: its frame, and all that is drawn in it, go on to hold.
The second one's move to where both agree best, bent by what its pose graph lets it bend. The second
is taken for the later one: what it contradicts in the first gives way.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy

from amr_slam.geometry import Array, Pose2, inverse_matrix, turned
from amr_slam.graph.posegraph import Edge, optimize
from amr_slam.living import MapChange, Watcher, WatchParams
from amr_slam.living.accepting import clear, make_room
from amr_slam.map import LayerError, Layers, Merged, PointMap
from amr_slam.map.moving import carry_forgotten
from amr_slam.map.ties import MapTies, no_ties
from amr_slam.merging.finding import Found
from amr_slam.merging.overlay import Laid, registered
from amr_slam.merging.scans import cloud_of, path_poses
from amr_slam.params import SlamParams

_MOST_CROSSES: Final = 2000
"""Scans of the second map that are tied to the first."""
_LEAST_KNOWN: Final = 0.5
_LEAST_INLIERS: Final = 0.6
"""A scan that fits worse is no tie."""
_LEAST_CELLS: Final = 6
"""A change of fewer cells is a table's leg that one session saw and the other did not."""
_MAX_NAME: Final = 60


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Merger:
    """A map of two."""

    map: PointMap
    bent_m: float
    """How far the second map's scans were moved by more than the rigid motion, at most."""
    changes: tuple[MapChange, ...]
    """What the second map has contradicted in the first, in the first's frame."""


def join(
    known: PointMap, other: PointMap, other_id: uuid.UUID, found: Found, params: SlamParams
) -> Merger:
    """A new map with all that is in both. Raises LayerError where it cannot have all layers."""
    layers = _layers(known, other, found.known_from_other)
    crosses = [
        one
        for one in registered(known, other, found.known_from_other, _MOST_CROSSES, params)
        if one.found.known >= _LEAST_KNOWN and one.found.inliers >= _LEAST_INLIERS
    ]
    rigid = [found.known_from_other @ pose for _, pose in other.path]
    poses = _bent(other, crosses, rigid)
    changes = _contradicted(known, other, crosses)
    fresh = known.copied()
    for change in changes:
        (clear if change.kind == "gone" else make_room)(fresh, change)
    fresh.append_all(other, poses)
    carry_forgotten(other, fresh, found.known_from_other)
    fresh.ties = _ties(known, other, crosses)
    fresh.merged = (*known.merged, *other.merged, _record(other, other_id, found))
    fresh.edit(layers)
    return Merger(
        map=fresh,
        bent_m=max(a.distance_to(b) for a, b in zip(poses, rigid, strict=True)),
        changes=changes,
    )


def _contradicted(
    known: PointMap, other: PointMap, crosses: Sequence[Laid]
) -> tuple[MapChange, ...]:
    """What the second map's scans show to be new or gone in the first, by the same votes as those
    of a robot that watches; but one pass has to do, so small things are left as they are."""
    watcher = Watcher(known, WatchParams(passes=1))
    for one in crosses:
        stamp_ns = other.path[one.row][0]
        watcher.see(cloud_of(other, one.row), one.found.pose, one.covariance, stamp_ns)
    return tuple(one for one in watcher.diff().changes if len(one.cells_m) >= _LEAST_CELLS)


def _record(other: PointMap, other_id: uuid.UUID, found: Found) -> Merged:
    pose = found.known_from_other
    return Merged(
        map_id=str(other_id),
        name=other.name[:_MAX_NAME],
        x_m=pose.x_m,
        y_m=pose.y_m,
        theta_rad=pose.theta_rad,
        rms_m=found.overlay.rms_m,
        scans=len(other.path),
        common_m2=found.overlay.common_m2,
    )


# -- poses and graph


def _bent(other: PointMap, crosses: Sequence[Laid], rigid: Sequence[Pose2]) -> list[Pose2]:
    """The second map's poses in the first, by its own graph and by where its scans are found there;
    where it has no graph, or that falls into pieces, the rigid motion's."""
    if not crosses or not _hangs_together(other):
        return list(rigid)
    edges = [replace(edge, start=edge.start + 1, end=edge.end + 1) for edge in _edges(other.ties)]
    for one in crosses:  # the first map is one node: its frame
        information = inverse_matrix(one.covariance)
        delta = one.found.pose
        edges.append(
            Edge(start=0, end=one.row + 1, delta=delta, information=information, loop=True)
        )
    begun = np.array([[0.0, 0.0, 0.0], *(pose.as_array() for pose in rigid)])
    return [Pose2.from_array(pose) for pose in optimize(begun, edges)[1:]]


def _hangs_together(one: PointMap) -> bool:
    count, ties = len(one.path), one.ties
    if not len(ties):
        return False
    links = scipy.sparse.coo_array(
        (np.ones(len(ties)), (ties.starts, ties.ends)), shape=(count, count)
    )
    return int(scipy.sparse.csgraph.connected_components(links, directed=False)[0]) == 1


def _edges(ties: MapTies) -> list[Edge]:
    return [
        Edge(
            start=int(ties.starts[row]),
            end=int(ties.ends[row]),
            delta=Pose2.from_array(ties.deltas[row]),
            information=ties.informations[row],
            loop=bool(ties.loops[row]),
        )
        for row in range(len(ties))
    ]


def _ties(known: PointMap, other: PointMap, crosses: Sequence[Laid]) -> MapTies:
    """Both graphs, and what ties them: each scan to the first map's nearest one. None where one of
    them has none: half a graph would fall apart."""
    if not len(known.ties) or not len(other.ties) or not crosses:
        return no_ties()
    first = len(known.path)
    anchors = scipy.spatial.cKDTree(path_poses(known)[:, :2])
    places = np.array([one.found.pose.translation for one in crosses])
    starts = np.asarray(anchors.query(places)[1], dtype=np.int64)
    deltas: list[Array] = []
    informations: list[Array] = []
    for one, start in zip(crosses, starts.tolist(), strict=True):
        anchor = known.path[start][1]
        deltas.append((anchor.inverse() @ one.found.pose).as_array())
        informations.append(inverse_matrix(turned(one.covariance, anchor.rotation.T)))
    return MapTies(
        starts=np.concatenate([known.ties.starts, other.ties.starts + first, starts]),
        ends=np.concatenate(
            [known.ties.ends, other.ties.ends + first, [first + one.row for one in crosses]]
        ),
        deltas=np.concatenate([known.ties.deltas, other.ties.deltas, deltas]),
        informations=np.concatenate(
            [known.ties.informations, other.ties.informations, informations]
        ),
        loops=np.concatenate(
            [known.ties.loops, other.ties.loops, np.ones(len(crosses), dtype=np.bool_)]
        ),
    )


# -- layers


def _layers(known: PointMap, other: PointMap, way: Pose2) -> Layers:
    """Those of both, but for what was removed in the second map. Raises LayerError."""
    ids = {one.layer_id for one in known.layers.everything}
    names = {one.name for one in known.layers.active}
    steps = max(
        (
            e.step
            for one in known.layers.everything
            for e in (one.added, one.removed)
            if e is not None
        ),
        default=0,
    )
    brought = []
    for one in other.layers.moved(way).active:
        if one.layer_id in ids:  # both were edited copies of one map once
            continue
        name = one.name
        number = 2
        while name in names:
            suffix = f" {number}"
            name, number = f"{one.name[: _MAX_NAME - len(suffix)]}{suffix}", number + 1
        names.add(name)
        added = replace(one.added, step=one.added.step + steps)
        brought.append(replace(one, name=name, added=added))
    try:
        return Layers([*known.layers.everything, *brought])
    except LayerError:
        return Layers([*known.layers.active, *brought])
