"""The whole pipeline on a recording: the daemon's localizer and engine, fed from a list."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from amr_slam.engine import SlamEngine
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import Localizer
from amr_slam.recording import Trajectory
from amr_slam.samples import DriveSample, Outcome, Scan
from amr_slam.slam_request import SlamResult


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayResult:
    """What came out of a recording."""

    online: Trajectory
    """The fused pose at every wheel sample, from nothing but what was known then."""
    final: Trajectory
    """The same stamps, each correction spread over the wheels' path between two fixes."""
    error95_m: Array
    """(n,) the online poses' own claim of their error."""
    results: tuple[SlamResult, ...]
    """Every answer of the registration."""
    refused: int
    """Answers with a pose that the fusion did not take."""


def thin_scans(
    samples: Iterable[Scan | DriveSample], scan_period_s: float
) -> Iterator[Scan | DriveSample]:
    """At most one scan in ``scan_period_s`` of each scanner; wheels untouched."""
    newest_ns: dict[str, int] = {}
    for sample in samples:
        if isinstance(sample, Scan):
            last = newest_ns.get(sample.scanner)
            if last is not None and sample.stamp_ns - last < round(1e9 * scan_period_s):
                continue
            newest_ns[sample.scanner] = sample.stamp_ns
        yield sample


def replay(
    samples: Iterable[Scan | DriveSample],
    localizer: Localizer,
    engine: SlamEngine,
    on_progress: Callable[[int], None] | None = None,
) -> ReplayResult:
    """Feed every sample in order; each scan is registered before the next sample comes.

    ``on_progress`` is called with each sample's stamp (ns).
    """
    stamps: list[int] = []
    poses: list[Array] = []
    odometry: list[Pose2] = []
    claims: list[float] = []
    fixes: list[tuple[int, Pose2]] = []
    anchors: list[tuple[int, Pose2]] = []
    results: list[SlamResult] = []
    refused = 0
    for sample in samples:
        outcome = localizer.handle(sample)
        if not isinstance(sample, Scan) and outcome is Outcome.ACCEPTED:
            # The pose that left the robot at this sample: registration answers after it.
            estimate = localizer.estimate(sample.stamp_ns)
            if estimate is not None:
                stamps.append(sample.stamp_ns)
                poses.append(estimate.map_from_base.as_array())
                odometry.append(estimate.odom_from_base)
                claims.append(estimate.error95_m)
        request = localizer.take_request()
        if request is not None:
            result = engine.update(request)
            taken = localizer.handle(result)
            results.append(result)
            refused += result.fix is not None and taken is Outcome.GATED
            corrected = localizer.filter.pose_at(result.stamp_ns) if localizer.filter else None
            if result.fix is not None and taken is not Outcome.GATED and corrected is not None:
                fixes.append((result.stamp_ns, corrected[0]))
                anchors.append(engine.anchored(corrected[0]))
        if on_progress is not None:
            on_progress(sample.stamp_ns)
    fixes = [
        (stamp_ns, engine.unanchored(*anchor))
        for (stamp_ns, _), anchor in zip(fixes, anchors, strict=True)
    ]
    online = Trajectory(
        stamps_ns=np.array(stamps, dtype=np.int64), poses=np.array(poses).reshape(-1, 3)
    )
    return ReplayResult(
        online=online,
        final=spread(online, odometry, fixes),
        error95_m=np.array(claims),
        results=tuple(results),
        refused=refused,
    )


def spread(online: Trajectory, odometry: list[Pose2], fixes: list[tuple[int, Pose2]]) -> Trajectory:
    """The trajectory with each correction spread evenly over the time between its two fixes.

    ``odometry`` (n poses): wheels alone at the trajectory's stamps; ``fixes``: (stamp ns, pose)
    in order. Before the first fix and after the last one the wheels are hung onto it.
    """
    if not fixes or not len(online.stamps_ns):
        return online
    stamps = online.stamps_ns
    fix_ns = np.array([stamp for stamp, _ in fixes], dtype=np.int64)
    anchors = [odometry[min(int(i), len(odometry) - 1)] for i in np.searchsorted(stamps, fix_ns)]
    poses = np.empty((len(stamps), 3))
    for row, (stamp, wheels) in enumerate(zip(stamps, odometry, strict=True)):
        after = int(np.searchsorted(fix_ns, stamp, side="right"))
        before = max(after - 1, 0)
        pose = fixes[before][1] @ (anchors[before].inverse() @ wheels)
        if 0 < after < len(fixes):
            arrival = fixes[before][1] @ (anchors[before].inverse() @ anchors[after])
            error = (arrival.inverse() @ fixes[after][1]).log()
            share = (stamp - fix_ns[before]) / (fix_ns[after] - fix_ns[before])
            pose = pose @ Pose2.exp(float(share) * error)
        poses[row] = pose.as_array()
    return Trajectory(stamps_ns=stamps, poses=poses)
