"""What keeps a run going over its own end: the last pose, and a map that was growing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from amr_slam.localizer import Localizer
from amr_slam.samples import PoseEstimate
from amr_slam.service.remembering import Recollection, Remembering
from amr_slam.service.resuming import Resuming
from amr_slam.service.worker import SlamWorker


@dataclass(frozen=True, slots=True, kw_only=True)
class Upkeep:
    """All methods are for the loop's thread and return at once."""

    recollection: Recollection
    remembering: Remembering
    resuming: Resuming

    def turn(
        self, now_ns: int, estimate: PoseEstimate | None, localizer: Localizer, worker: SlamWorker
    ) -> None:
        """With each pose that leaves."""
        self.recollection.turn(now_ns, localizer, worker.active_map)
        self.resuming.turn(None if estimate is None else estimate.state)
        if estimate is not None and not self.resuming.waits:
            self.remembering.note(
                now_ns, estimate, worker.active_map, mapping=worker.mode == "mapping"
            )

    def troubles(self) -> Iterator[str]:
        """For people, one line each, while they last."""
        for trouble in (self.resuming.trouble, self.remembering.trouble):
            if trouble is not None:
                yield trouble
