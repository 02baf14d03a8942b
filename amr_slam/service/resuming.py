"""A map on disk that is to grow on: once scans have found the robot in it.

A map never forgets a wrong pose, so nothing joins it before that. It is one whose mapping was cut
off, or one that is to be extended. A run that ended by itself is not gone on with unless the
configuration says so: the next one begins a new map.
"""

from __future__ import annotations

import logging
from dataclasses import replace

from amr_slam.localizer import Localizer
from amr_slam.samples import State
from amr_slam.service.worker import SlamWorker
from amr_slam.slam_messages import Declined, Grow, SlamJob, Switched, TaskAnswer

_log = logging.getLogger(__name__)


def localizing_first(job: SlamJob) -> SlamJob:
    """The job with which a mapping job begins that goes on with its file."""
    return replace(job, mode="localization", source=job.target, target=None)


class Resuming:
    """All methods are for the loop's thread."""

    def __init__(self, worker: SlamWorker, wanted: SlamJob | None) -> None:
        """``wanted``: the mapping to go on with; the worker runs its :func:`localizing_first`.
        None: there is none."""
        self._worker = worker
        self._begun = worker.job
        self._wanted = wanted
        self._asked = False
        if wanted is not None:
            _log.warning("%s: %s goes on when the robot is found", self._why(), wanted.target)

    @property
    def waits(self) -> bool:
        """Whether the map does not grow yet."""
        return self._wanted is not None

    @property
    def trouble(self) -> str | None:
        """For people, while it waits."""
        if self._wanted is None:
            return None
        return (
            f"{self._why()}; {self._wanted.name} grows on as soon as the robot is found "
            "in it: stop it where the map is known"
        )

    def _why(self) -> str:
        cut_off = self._wanted is not None and self._wanted.saved_before
        return "mapping was cut off" if cut_off else "the map is to be extended"

    def turn(self, state: State | None) -> None:
        """Ask for it when the robot is found; give it up when somebody has chosen another map."""
        if self._wanted is None or self._asked:
            return
        if self._worker.job is not self._begun:
            self._wanted = None
        elif state is State.LOCALIZED and self._worker.idle:
            self._asked = True
            self._worker.submit(Grow(job=self._wanted))

    def heard(self, answer: TaskAnswer, localizer: Localizer) -> bool:
        """Whether the process's answer is for this."""
        if not self._asked:
            return False
        self._asked, self._wanted = False, None
        if isinstance(answer, Switched):
            localizer.go_on_mapping()
            _log.info("mapping goes on in %s", answer.job.target)
        elif isinstance(answer, Declined):
            _log.error("mapping does not go on: %s", answer.reason)
        return True

    def lost(self) -> None:
        """The process has ended: what was asked of it is asked of the next one."""
        self._asked = False
