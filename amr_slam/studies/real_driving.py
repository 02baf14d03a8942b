"""Driving on until the answer is unique: the localizer on a recording, started anywhere."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from amr_slam.engine import SlamEngine
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.localizer import Localizer, LocalizerParams, Mounting
from amr_slam.map import PointMap
from amr_slam.odometry import PoseOdometry
from amr_slam.params import SlamParams
from amr_slam.recording import Sample
from amr_slam.replay import thin_scans
from amr_slam.samples import Scan, State
from amr_slam.studies.real_passes import Recording
from amr_slam.studies.scenes import RIGHT_M, RIGHT_RAD, pose_error

SCAN_PERIOD_S: Final = 2.0
"""The scanner's, at least."""
MOST_SCANS: Final = 12
"""After so many scans without a place the drive is given up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim:
    """From a start that nobody told the localizer to its first claim to know where it is."""

    log: str
    start_ns: int
    scans: int
    """Registered until the claim, or until the drive was given up."""
    located: bool
    pose: Pose2 | None
    """What was claimed: map_from_base at the last scan."""
    error_m: float
    """Of it; 0 where nothing was claimed."""
    error_rad: float

    @property
    def wrong(self) -> bool:
        """The claim is not within 0.25 m and 5 degrees."""
        return self.located and not (self.error_m <= RIGHT_M and self.error_rad <= RIGHT_RAD)

    @property
    def cut_short(self) -> bool:
        """The recording's part ended before the question was decided."""
        return not self.located and self.scans < MOST_SCANS


def first_claim(
    recording: Recording, known: PointMap, params: SlamParams, start_ns: int, end_ns: int
) -> Claim:
    """Feed the samples from ``start_ns`` to ``end_ns`` until the localizer claims a place."""
    engine = SlamEngine(params, known, "localization")
    names = {sample.scanner for sample in recording.samples if isinstance(sample, Scan)}
    localizer = Localizer(
        LocalizerParams(),
        FilterParams(),
        params.clouds,
        PoseOdometry(),
        dict.fromkeys(names, Mounting(base_from_lidar=Pose2.identity())),
        "localization",
    )
    scans = 0
    for sample in thin_scans(_between(recording, start_ns, end_ns), SCAN_PERIOD_S):
        localizer.handle(sample)
        request = localizer.take_request()
        if request is None:
            continue
        result = engine.update(request)
        localizer.handle(result)
        scans += 1
        estimate = localizer.estimate(sample.stamp_ns)
        if estimate is not None and estimate.state is State.LOCALIZED:
            return _claimed(recording, localizer, start_ns, result.stamp_ns, scans)
        if scans == MOST_SCANS:
            break
    return Claim(
        log=recording.name, start_ns=start_ns, scans=scans, located=False, pose=None,
        error_m=0.0, error_rad=0.0,
    )  # fmt: skip


def _between(recording: Recording, start_ns: int, end_ns: int) -> Iterator[Sample]:
    """The samples, and the last one of the wheels before them: without it the filter is not yet
    there when the first scan comes."""
    before: Sample | None = None
    for sample in recording.samples:
        if sample.stamp_ns > end_ns:
            return
        if sample.stamp_ns < start_ns:
            before = before if isinstance(sample, Scan) else sample
            continue
        if before is not None:
            yield before
            before = None
        yield sample


def _claimed(
    recording: Recording, localizer: Localizer, start_ns: int, stamp_ns: int, scans: int
) -> Claim:
    assert localizer.filter is not None
    there = localizer.filter.pose_at(stamp_ns)
    assert there is not None
    row = int(recording.reference.stamps_ns.searchsorted(stamp_ns))
    error_m, error_rad = pose_error(there[0], recording.reference.pose(row))
    return Claim(
        log=recording.name, start_ns=start_ns, scans=scans, located=True, pose=there[0],
        error_m=error_m, error_rad=error_rad,
    )  # fmt: skip
