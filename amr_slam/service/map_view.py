"""The active map's picture, for who looks at a recording later: drawn in the SLAM process."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from typing import Any, Final

from amr_slam.samples import State
from amr_slam.serving import Asked, ImageWanted, Picture
from amr_slam.serving.asked import Put
from amr_slam.wire import StatusMessage

_GOOD: Final = frozenset({State.LOCALIZED, State.MAPPING})
"""Only then is it asked for: a robot that seeks its place has no time for pictures."""

_GROWS_S: Final = 60.0
"""So often is a map drawn that grows: as often as it is saved."""


class MapView:
    """Asks for a picture of each map that becomes active, and again of one that grows.

    Only :meth:`follow` is for one thread.
    """

    def __init__(self) -> None:
        self.put: Put | None = None
        """Has it drawn; None: there is nobody yet."""
        self._lock = threading.Lock()
        self._asked: str | None = None
        self._asked_s = 0.0
        self._picture: Picture | None = None

    @property
    def newest(self) -> Picture | None:
        """None before there is one."""
        with self._lock:
            return self._picture

    def follow(self, status: StatusMessage, now_s: float) -> None:
        """``now_s``: of the monotonic clock. Returns at once."""
        if self.put is None or status.map is None or status.state not in _GOOD:
            return
        with self._lock:
            aged = status.mode == "mapping" and now_s >= self._asked_s + _GROWS_S
            if self._asked == status.map.id and not aged:
                return
            self._asked, self._asked_s = status.map.id, now_s
        asked = Asked(request=ImageWanted(resolution_m=None), by="recorder")
        asked.answer.add_done_callback(self._answered)
        self.put(asked)

    def _answered(self, answer: Future[Any]) -> None:
        """On the loop's thread."""
        with self._lock:
            if answer.cancelled() or answer.exception() is not None:
                self._asked = None  # with the next status it is asked for again
            else:
                self._picture = answer.result()
