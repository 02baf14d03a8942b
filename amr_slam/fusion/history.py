"""The fixes of the last seconds in the order of their stamps, each with the state after it."""

from __future__ import annotations

import bisect

from amr_slam.fusion.chain import Chain, State
from amr_slam.fusion.values import Innovation
from amr_slam.samples import SlamPose


class History:
    """What the state at any instant follows from: a beginning, and the fixes since.

    A fix that comes late is put in its place, and those after it are weighed anew, so that the
    order of arrival does not matter.
    """

    def __init__(self, chain: Chain, begun: State) -> None:
        """``begun``: the oldest state that is known; no fix is older."""
        self._chain = chain
        self._begun = begun
        self._fixes: list[SlamPose] = []
        self._stamps_ns: list[int] = []
        self._posteriors: list[State] = []
        self._innovations: list[Innovation] = []

    @property
    def start_ns(self) -> int:
        """The oldest instant of which the state is known."""
        return self._begun.stamp_ns

    @property
    def last(self) -> State:
        """The state after the newest fix."""
        return self._posteriors[-1] if self._posteriors else self._begun

    def holds(self, stamp_ns: int) -> bool:
        """Whether there is a fix of this stamp; the beginning counts as one."""
        return stamp_ns == self._begun.stamp_ns or stamp_ns in self._stamps_ns

    def state_at(self, stamp_ns: int) -> State:
        """State at an instant, :attr:`start_ns` at the earliest, with the fixes up to it."""
        return self._chain.advanced(self._before(self._count(stamp_ns)), stamp_ns)

    def insert(self, fix: SlamPose) -> Innovation:
        """Put a fix of a stamp that no other has in its place; how it agreed with those before."""
        place = bisect.bisect_left(self._stamps_ns, fix.stamp_ns)
        self._fixes.insert(place, fix)
        self._stamps_ns.insert(place, fix.stamp_ns)
        self._absorb_from(place)
        return self._innovations[place]

    def weigh_after(self, stamp_ns: int) -> None:
        """Weigh the fixes after an instant anew: of the wheels of then more is known now."""
        self._absorb_from(self._count(stamp_ns))

    def forget_before(self, stamp_ns: int) -> None:
        """The beginning is an instant later than it was, with the fixes up to it in its state."""
        self._begun = self.state_at(stamp_ns)
        gone = self._count(stamp_ns)
        for column in (self._fixes, self._stamps_ns, self._posteriors, self._innovations):
            del column[:gone]

    def _count(self, stamp_ns: int) -> int:
        """How many fixes there are up to an instant."""
        return bisect.bisect_right(self._stamps_ns, stamp_ns)

    def _before(self, place: int) -> State:
        """The state after the fix before a place."""
        return self._posteriors[place - 1] if place else self._begun

    def _absorb_from(self, first: int) -> None:
        """Weigh and absorb the fixes from the given one on, in the order of their stamps."""
        del self._posteriors[first:], self._innovations[first:]
        for fix in self._fixes[first:]:
            posterior, innovation = self._chain.absorbed(self.last, fix)
            self._posteriors.append(posterior)
            self._innovations.append(innovation)
