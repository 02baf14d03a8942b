"""From what single scans say of the scanners' configuration to a fault that is told, and back."""

from __future__ import annotations

from collections import Counter, deque
from typing import Final

from amr_slam.inspection import Inspection, Looks

_LAST: Final = 5
"""A fault is told within five scans."""
_SAME: Final = 3
"""So many of them must name it;"""
_SAME_BY_MOTION: Final = 2
"""fewer where the way of the scans contradicts the wheels: each of them is two scans."""
_RIGHT: Final = 2
"""So many right ones in a row end it."""


class Suspicions:
    """What the last scans said; no clock."""

    def __init__(self) -> None:
        self._heard: deque[Inspection] = deque(maxlen=_LAST)
        self._right = 0
        self.fault: str | None = None
        """Told: no pose is worth anything until it is over."""
        self._by_motion = False

    @property
    def doubtful(self) -> bool:
        """Whether the newest scan alone says that the pose cannot be right."""
        return bool(self._heard) and _wrong(self._heard[-1]) and self._heard[-1].by_motion

    @property
    def by_motion(self) -> bool:
        """The fault that is told looked like another pose: all poses since were wrong."""
        return self.fault is not None and self._by_motion

    def hear(self, inspection: Inspection) -> bool:
        """Take in one scan's word; True when it made the fault known that is now told."""
        self._heard.append(inspection)
        told = inspection.looks is Looks.RIGHT and (inspection.by_motion or not self._by_motion)
        if told:
            self._right += 1
        elif inspection.looks is Looks.WRONG:
            self._right = 0
        if self.fault is not None:
            if self._right >= _RIGHT:
                self.fault, self._by_motion = None, False
                self._heard.clear()
            return False
        names = Counter(one.fault for one in self._heard if _wrong(one))
        for name, count in names.most_common(1):
            by_motion = any(one.by_motion for one in self._heard if one.fault == name)
            if count >= (_SAME_BY_MOTION if by_motion else _SAME):
                self.fault, self._by_motion, self._right = name, by_motion, 0
                return True
        return False

    def withholds(self, inspection: Inspection) -> bool:
        """Whether a fix of this scan must not be used."""
        return self.fault is not None or _wrong(inspection)


def _wrong(inspection: Inspection) -> bool:
    return inspection.looks is Looks.WRONG
