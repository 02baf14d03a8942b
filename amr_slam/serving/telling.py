"""The active map's picture, for those who are told it and do not ask."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from amr_slam.serving.asked import Asked, ImageWanted, NotDone, Picture, Put
from amr_slam.serving.desk import Answering, Desk
from amr_slam.wire import MapPart, StatusMessage

_log = logging.getLogger(__name__)

_PERIOD_S: Final = 30.0
"""A map that grows is not drawn more often, and nothing that failed is tried sooner again."""


class MapTeller:
    """Has the map drawn when it is another one, on a thread of its own, and hands it on."""

    def __init__(self, put: Put, tell: Callable[[Picture], None]) -> None:
        """``tell``: on that thread; may wait for a slow network."""
        self._desk = Desk("map teller", put, places=1)
        self._tell = tell
        self._asked_for: MapPart | None = None
        self._asked_s = 0.0
        self._failed = False

    def follow(self, message: StatusMessage) -> None:
        """With each status; returns at once."""
        known, now_s = message.map, time.monotonic()
        if known is None or (known == self._asked_for and not self._failed):
            return
        is_another = self._asked_for is None or known.id != self._asked_for.id
        if not is_another and now_s - self._asked_s < _PERIOD_S:
            return
        failed, self._failed = self._failed, False
        if self._desk.enter(self._draw):
            self._asked_for, self._asked_s = known, now_s
        else:
            self._failed = failed

    def close(self) -> None:
        self._desk.close()

    def _draw(self) -> Answering:
        """On the desk's thread."""
        try:
            picture: Picture = self._desk.ask(Asked(request=ImageWanted(resolution_m=None), by=""))
        except NotDone as error:
            self._failed = True
            _log.warning("the map was not drawn: %s", error)
            return _nothing
        return partial(self._tell, picture)


def _nothing() -> None:
    """There is no picture to tell of."""
