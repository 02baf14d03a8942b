"""Writes the last pose now and then, off the loop's thread, and looks there first after a start."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Final

from amr_slam.durable import remove_durably, write_durably
from amr_slam.geometry import wrap_angle
from amr_slam.localizer import Localizer
from amr_slam.region import Region
from amr_slam.samples import PoseEstimate, State
from amr_slam.seeking import Seek
from amr_slam.service.last_pose import (
    LastPose,
    UnusableHint,
    clocks_ns,
    encode,
    must_be_fresh,
    read,
)
from amr_slam.service.worker import ActiveMap

_log = logging.getLogger(__name__)

_LEAST_PERIOD_NS: Final = 2_000_000_000
"""Between two writings of a robot that drives: 43,000 pages of flash a day at most."""
_STANDING_PERIOD_NS: Final = 30_000_000_000
"""A robot that stands renews the file's age alone."""
_MOVED_M: Final = 1.0
_MOVED_RAD: Final = 0.3
_SURE_M: Final = 0.5
"""``error95_m`` of a pose that is worth remembering."""
_CLOSE_LIMIT_S: Final = 0.3
_RADIUS_M: Final = 5.0
"""What a robot may drive between two writings, and until it stops without poses."""
_MOST_RADIUS_M: Final = 10.0
_HEADING_RAD: Final = 1.5
_SEEK_LIMIT_NS: Final = 30_000_000_000


class Remembering:
    """The writing side. :meth:`note` is for the loop's thread and returns at once."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._wanted: LastPose | None = None
        self._is_wanted = False
        self._written: LastPose | None = None
        self._due_ns = self._standing_ns = 0
        self._condition = threading.Condition()
        self._ended = False
        self.trouble: str | None = None
        """Why the last writing failed; None when it did not."""
        # A daemon: a disk that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name="last-pose", daemon=True)
        self._thread.start()

    def note(
        self, now_ns: int, estimate: PoseEstimate, active: ActiveMap | None, *, mapping: bool
    ) -> None:
        """Remember a pose that is known, and forget it as soon as it is not.

        Of a map that grows the file stays: it says that mapping has not ended.
        """
        if estimate.state in {State.LOST, State.AMBIGUOUS}:
            if self._written is not None and not self._written.mapping:
                self._written = None
                self._want(None)
            return
        known = estimate.state in {State.LOCALIZED, State.MAPPING}
        if not known or active is None or estimate.error95_m > _SURE_M or now_ns < self._due_ns:
            return
        if now_ns < self._standing_ns and not self._has_moved(estimate, active):
            return
        self._due_ns, self._standing_ns = now_ns + _LEAST_PERIOD_NS, now_ns + _STANDING_PERIOD_NS
        uptime_ns, utc_ns = clocks_ns()
        self._written = LastPose(
            map_id=active.map_id,
            map_name=active.name,
            mapping=mapping,
            map_from_base=estimate.map_from_base,
            covariance=estimate.covariance,
            uptime_ns=uptime_ns,
            utc_ns=utc_ns,
        )
        self._want(self._written)

    def close(self) -> None:
        """The run ends by itself: nothing is to be gone on with, but the place is known.
        Idempotent."""
        if not self._ended and self._written is not None and self._written.mapping:
            self._want(None)
        with self._condition:
            self._ended = True
            self._condition.notify()
        self._thread.join(_CLOSE_LIMIT_S)
        if self._thread.is_alive():
            _log.warning("%s: the disk does not answer; left behind", self._path)

    def _has_moved(self, estimate: PoseEstimate, active: ActiveMap) -> bool:
        last = self._written
        if last is None or last.map_id != active.map_id:
            return True
        before, now = last.map_from_base, estimate.map_from_base
        turn_rad = wrap_angle(now.theta_rad - before.theta_rad)
        return now.distance_to(before) > _MOVED_M or abs(turn_rad) > _MOVED_RAD

    def _want(self, wanted: LastPose | None) -> None:
        with self._condition:
            self._wanted, self._is_wanted = wanted, True
            self._condition.notify()

    # -- the thread

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._is_wanted or self._ended)
                if not self._is_wanted:
                    return
                wanted, self._is_wanted = self._wanted, False
            self._store(wanted)

    def _store(self, wanted: LastPose | None) -> None:
        try:
            if wanted is None:
                remove_durably(self._path)
            else:
                write_durably(self._path, encode(wanted))
        except OSError as error:
            trouble = f"{self._path}: the last pose is not kept: {error.strerror or error}"
            if self.trouble is None:
                _log.warning("%s", trouble)
            self.trouble = trouble
        else:
            self.trouble = None


class Recollection:
    """The reading side: what the last run left, until it is confirmed or refuted."""

    def __init__(self, path: Path) -> None:
        self.hint: LastPose | None = None
        """What there is to go by."""
        self._seek: Seek | None = None
        self._deadline_ns = 0
        self.cut_off: str | None = None
        """Name of the map that a run was growing when it was cut off."""
        try:
            last = read(path)
            self.cut_off = last.map_name if last.mapping else None
            must_be_fresh(last, *clocks_ns())
            self.hint = last
        except UnusableHint as reason:
            _log.info("%s: no last pose to begin at: %s", path, reason)

    def drop(self, reason: str) -> None:
        """It says nothing of this run."""
        if self.hint is not None:
            _log.info("the last pose is of no use: %s", reason)
        self.hint = None

    def turn(self, now_ns: int, localizer: Localizer, active: ActiveMap | None) -> None:
        """Look there as soon as there are a map and wheels; tell what came of it."""
        if self.hint is None:
            return
        if self._seek is None:
            if active is not None and localizer.filter is not None:
                self._begin(now_ns, localizer, active, self.hint)
            return
        if not self._seek.ended and now_ns > self._deadline_ns:
            localizer.abandon(self._seek, "no two scans came in time")
        if self._seek.ended:
            self.hint = None
            if self._seek.pose is not None:
                _log.info("localized where the last run left off")
            else:
                _log.info("not where the last run left off: %s", self._seek.reason)

    def _begin(self, now_ns: int, localizer: Localizer, active: ActiveMap, hint: LastPose) -> None:
        # A map that goes on growing has become a file with a UUID of its own.
        same = active.name == hint.map_name if hint.mapping else active.map_id == hint.map_id
        objection = localizer.objection() if same else f"it is of another map, {hint.map_name}"
        if objection is not None:
            self.drop(objection)
            return
        radius_m = min(_RADIUS_M + hint.spread_m, _MOST_RADIUS_M)
        self._seek = localizer.seek(
            Region(map_from_base=hint.map_from_base, radius_m=radius_m, heading_rad=_HEADING_RAD)
        )
        self._deadline_ns = now_ns + _SEEK_LIMIT_NS
