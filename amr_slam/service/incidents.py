"""When the last minutes are saved by themselves: the robot got worse, and nobody was there."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from amr_slam.samples import Link, State

_log = logging.getLogger(__name__)

_GOOD: Final = frozenset({State.LOCALIZED, State.MAPPING})
_STATE_LASTS_NS: Final = 2_000_000_000
"""A state that is over sooner is no incident."""
_LINK_LASTS_NS: Final = 1_000_000_000
_AFTER_NS: Final = 5_000_000_000
"""What came of it is worth seeing, too."""
_PERIOD_NS: Final = 300_000_000_000
"""Between two savings: half of the ring, so that what happens meanwhile is in the next one."""


class Incidents:
    """Watches state, links and the SLAM process; no clock, for one thread.

    What happens while a saving is not due yet is put off, not left out.
    """

    def __init__(self, save: Callable[[str], Path | None]) -> None:
        """``save``: has the ring saved for a reason; None where it cannot be just now."""
        self._save = save
        self._was_good = False
        self._bad_since_ns: int | None = None
        self._connected: set[str] = set()
        self._lost_since_ns: dict[str, int] = {}
        self._crashes = 0
        self._reasons: list[str] = []
        self._due_ns = 0
        self._next_ns = 0

    def look(self, now_ns: int, state: State, links: Mapping[str, Link], crashes: int) -> None:
        """``links``: of devices by name. ``crashes``: of the SLAM process so far."""
        self._look_at_state(now_ns, state)
        for name, link in links.items():
            self._look_at_link(now_ns, name, link)
        if crashes > self._crashes:
            self._note(now_ns, "slam-restarted")
        self._crashes = crashes
        if self._reasons and now_ns >= self._due_ns:
            self._tell(now_ns)

    def _look_at_state(self, now_ns: int, state: State) -> None:
        if state in _GOOD:
            self._was_good, self._bad_since_ns = True, None
        elif self._was_good:
            if self._bad_since_ns is None:
                self._bad_since_ns = now_ns
            if now_ns - self._bad_since_ns >= _STATE_LASTS_NS:
                self._was_good = False
                self._note(now_ns, str(state).replace("_", "-"))

    def _look_at_link(self, now_ns: int, name: str, link: Link) -> None:
        if link is Link.OK:
            self._connected.add(name)
            self._lost_since_ns.pop(name, None)
        elif link is Link.LOST and name in self._connected:
            since_ns = self._lost_since_ns.setdefault(name, now_ns)
            if now_ns - since_ns >= _LINK_LASTS_NS:
                self._connected.discard(name)
                self._note(now_ns, f"{re.sub('[^A-Za-z0-9_-]', '-', name)[:30]}-lost")

    def _note(self, now_ns: int, reason: str) -> None:
        if not self._reasons:
            self._due_ns = max(now_ns + _AFTER_NS, self._next_ns)
        if reason not in self._reasons:
            self._reasons.append(reason)

    def _tell(self, now_ns: int) -> None:
        path = self._save(self._reasons[0])
        if path is None:
            self._due_ns = now_ns + _AFTER_NS
            return
        _log.warning("incident (%s): the last minutes go to %s", ", ".join(self._reasons), path)
        self._reasons.clear()
        self._next_ns = now_ns + _PERIOD_NS
