"""What people say of the pose: it is here, it is somewhere there, forget it, take another map."""

from __future__ import annotations

from amr_slam.geometry import Array, Pose2
from amr_slam.localizer.fused import ANYWHERE, NEW_MAP, FusedPose
from amr_slam.localizer.placing import Placing
from amr_slam.region import Region
from amr_slam.samples import SlamPose
from amr_slam.seeking import Seek
from amr_slam.slam_request import SlamResult
from amr_slam.states import Mode
from amr_slam.suspicions import Suspicions


class Commands:
    """Carries out what :class:`Localizer` is told; one search in a named region at a time."""

    def __init__(self, fused: FusedPose, placing: Placing, suspicions: Suspicions) -> None:
        self._fused = fused
        self._placing = placing
        self._suspicions = suspicions
        self._seek: Seek | None = None

    def objection(self) -> str | None:
        """See :meth:`Localizer.objection`."""
        if self._placing.mode == "mapping":
            return "not while mapping: the new map grows around the pose"
        if self._fused.filter is None:
            return "no wheel sample has come yet"
        return self._suspicions.fault and f"scanner configuration: {self._suspicions.fault}"

    def seek(self, region: Region) -> Seek:
        """See :meth:`Localizer.seek`."""
        self._end_seek("another pose has been named meanwhile")
        self._seek = Seek(self._fused.running.stamp_ns, region)
        return self._seek

    def abandon(self, seek: Seek, reason: str) -> None:
        """See :meth:`Localizer.abandon`."""
        if seek is self._seek and not seek.ended:
            seek.give_up(reason)

    def place(self, map_from_base: Pose2, covariance: Array) -> None:
        """See :meth:`Localizer.place`."""
        self._end_seek("another command has set the pose")
        self._placing.begin(None, map_from_base, covariance, located=True)
        self._placing.unconfirmed = True

    def forget(self) -> None:
        """See :meth:`Localizer.forget`."""
        pose = self._fused.running.map_from_base
        self._end_seek("another command has made the robot forget its pose")
        self._placing.begin(None, pose, ANYWHERE, located=False)

    def go_on_mapping(self) -> None:
        """See :meth:`Localizer.go_on_mapping`."""
        self._placing.mode = "mapping"

    def restart(self, mode: Mode, *, keeps_pose: bool = False) -> None:
        """See :meth:`Localizer.restart`."""
        self._end_seek("the map has been changed")
        self._placing.mode = mode
        fusion = self._fused.filter
        if keeps_pose and self._placing.located and fusion is not None:
            self._placing.begin(None, fusion.map_from_base, fusion.covariance, located=True)
            self._placing.unconfirmed = True
            return
        self._placing.last_result = None
        start = NEW_MAP if mode == "mapping" else (Pose2.identity(), ANYWHERE)
        self._fused.start = start
        self._placing.begin(None, *start, located=mode == "mapping")

    def region_at(self, stamp_ns: int) -> Region | None:
        """Where to look in the scan of this instant; None: nobody has named a region."""
        if self._seek is None:
            return None
        return self._seek.region_at(stamp_ns, self._fused.motion_between)

    def hear(self, result: SlamResult) -> SlamPose | None:
        """What a scan says of the named region; the pose to jump to once enough say the same."""
        if self._fused.filter is None or self._seek is None or self._seek.ended:
            return None
        return self._seek.hear(result, self._fused.motion_between)

    def miss(self) -> None:
        """The pose that the search has found cannot be taken any more."""
        if self._seek is not None:
            self._seek.give_up("the pose that was found cannot be taken")

    def _end_seek(self, reason: str) -> None:
        if self._seek is not None and not self._seek.ended:
            self._seek.give_up(reason)
        self._seek = None
