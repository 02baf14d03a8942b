"""Where the robot may be: several places, carried along by the wheels, weighed scan by scan.

One scan is not enough where a building repeats itself, and two that agree under the wheels are no
proof either: look-alike places agree as well. So all places that were found stay in the race until
one of them has all the odds but a thousandth. What is weighed against each other are the
places *and* the possibility that it is none of them (another building, an unmapped part).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from amr_slam.agreement import AGREE_D2, agreement_d2, covariance_of, fused, moved
from amr_slam.evidence import Answer, Hypothesis, Verdict, apart
from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Candidate, Motion

Wheels = Callable[[int, int], Motion | None]
"""What the wheels say between two instants; None when they no longer know."""

# Added to what agrees: maps bend, and the clocks of wheels and scanner differ.
_SLACK: Final = np.diag([0.1**2, 0.1**2, 0.05**2])
# Fixes of one map share its errors, as in the fusion.
_INFLATION: Final = 2.0
# No look at a scan is worth more than 10,000 : 1, whatever the odds say.
_MOST_LOG: Final = math.log(1e4)
# The best place has at most this log-odds: "none of them" keeps a share however long all goes well.
_GREATEST_LOG: Final = math.log(1e5)
# Who enters late is held to have been missed until now, but not worse than this.
_LATE_LOG: Final = math.log(1e-2)
# Views that are remembered one by one; older ones are summed up.
_VIEWS: Final = 8

Open = Annotated[float, Gt(0.0), Lt(1.0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingParams:
    """When one of several places is the one where the robot is."""

    sure: Open = 0.999
    """Odds that a place must have before the robot is said to be there: all others and "none of
    them" together share the rest."""
    views: Annotated[int, Ge(1)] = 2
    """Poses from which scans must speak for the place."""
    view_m: Annotated[float, Gt(0.0)] = 0.3
    """A scan taken this far from all earlier ones is another view ..."""
    view_rad: Annotated[float, Gt(0.0)] = 0.3
    """... as is one turned by this much. Nearer ones see the same and count as one witness."""
    standing_scans: Annotated[int, Ge(1)] = 3
    """A robot that does not move is located when so many scans in a row were each accepted alone
    with odds of ``sure`` for the same place: who may not drive unlocated cannot fetch a second
    view. They guard against passers-by, not against a building that looks alike."""
    overlap: Annotated[float, Gt(0.0), Le(1.0)] = 0.4
    """Exponent on what each view after the first says: neighbouring views share most of their
    walls, and with them their errors."""
    alike: Annotated[float, Ge(1.0)] = 2.0
    """Two places whose odds in one scan differ by up to this factor are alike to it. A map is a
    little truer here than there; counted as evidence, that would decide after enough scans."""
    again: Annotated[float, Ge(1.0)] = 4.0
    """Factor on the odds of a place that a further view finds where the wheels say. On recordings
    of offices and halls, right places were found again by 0.8 of the next scans, wrong ones of the
    same building by 0.2, of another building by 0.1."""
    missed: Open = 0.25
    """Odds against "none of them" that a place is given by a scan that did not find it: 0.2 of the
    right ones are missed, and 0.8 of the wrong ones."""
    most: Annotated[int, Ge(2), Le(100)] = 12
    """Places that are tracked."""


@dataclass(slots=True, kw_only=True, eq=False)
class _Tracked:
    """One place, at the tracker's present instant."""

    pose: Pose2
    covariance: Array
    before: float = 0.0
    """Log-odds against "none of them" that it came with."""
    told: list[float] = field(default_factory=list)
    """Sum of what the scans of each view said: logarithms of odds against "none of them"."""
    sure_scans: int = 0
    """Scans in a row that were accepted here, alone."""
    matched: bool = True
    """Found by the newest scan."""
    home: bool = False
    """The pose that the fusion holds."""


class Hypotheses:
    """The tracker. No clock, no randomness: the same answers give the same places."""

    def __init__(self, params: TrackingParams) -> None:
        self._params = params
        self.clear()

    def clear(self) -> None:
        """Forget everything: the pose is known, or nothing that was known holds any more."""
        self._tracked: list[_Tracked] = []
        self._stamp_ns: int | None = None
        self._now = Pose2.identity()
        """The wheels' way since the first view."""
        self._views: list[Pose2] = []
        """Where, along it, the scans were taken."""
        self._heard: list[int] = []
        """Scans of each view."""
        self._forgotten = False
        """The first view is no longer among them."""

    def __len__(self) -> int:
        return len(self._tracked)

    def expect(self, stamp_ns: int, pose: Pose2, covariance: Array) -> None:
        """Begin with a pose that is ``sure``: the fusion's own, which scans contradict."""
        self.clear()
        self._stamp_ns = stamp_ns
        prior = math.log(self._params.sure / (1.0 - self._params.sure))
        self._tracked = [_Tracked(pose=pose, covariance=covariance, before=prior, home=True)]

    def weigh(self, stamp_ns: int, answer: Answer, wheels: Wheels) -> None:
        """Take in what a search of the whole map made of the scan of ``stamp_ns``.

        An answer without places says nothing: too little was seen to compare.
        """
        self.carry(stamp_ns, wheels)
        if not answer.places or len(answer.odds) != len(answer.places):
            return
        view = self._view()
        said = self._said(answer)
        matches = self._matches(answer.places)
        for tracked in self._tracked:
            tracked.matched = False
            tracked.told[view] += math.log(self._params.missed)
        for place, tracked in matches.items():
            found = answer.places[place]
            tracked.pose, tracked.covariance = fused(
                tracked.pose, tracked.covariance, found.pose, _INFLATION * covariance_of(found)
            )
            tracked.matched = True
            tracked.told[view] += said[place] - math.log(self._params.missed)
            if self._found_elsewhere(tracked, view):
                tracked.told[view] += math.log(self._params.again)
        alone = answer.verdict is Verdict.ACCEPTED and answer.odds[0] >= self._params.sure
        known = set(matches)
        for place, hypothesis in enumerate(answer.places):
            if place not in known:
                matches[place] = self._enter(hypothesis, view, said[place])
        for tracked in self._tracked:
            sure = alone and tracked is matches[0]
            tracked.sure_scans = tracked.sure_scans + 1 if sure else 0
        self._prune()

    def carry(self, stamp_ns: int, wheels: Wheels) -> None:
        """Move all places along to another instant; wheels that do not know end the tracking."""
        if self._stamp_ns is None:
            self._stamp_ns = stamp_ns
        if stamp_ns == self._stamp_ns:
            return
        motion = wheels(self._stamp_ns, stamp_ns)
        if motion is None or motion.gap:
            self.clear()
            self._stamp_ns = stamp_ns
            return
        self._stamp_ns = stamp_ns
        self._now = self._now @ motion.delta
        for tracked in self._tracked:
            tracked.pose, tracked.covariance = moved(tracked.pose, tracked.covariance, motion)

    def poses(self) -> Array | None:
        """(k, 3) of all places at the instant of the last :meth:`carry`; None: there is none."""
        if not self._tracked:
            return None
        return np.array([tracked.pose.as_array() for tracked in self._tracked])

    def candidates(self) -> tuple[Candidate, ...]:
        """The places with their odds, best first; what is missing to 1 is "none of them"."""
        ranked = zip(self._tracked, self._odds(), strict=True)
        return tuple(
            Candidate(map_from_base=tracked.pose, odds=odds)
            for tracked, odds in sorted(ranked, key=lambda pair: -pair[1])
        )

    @property
    def stamp_ns(self) -> int | None:
        """The instant for which the places are given; None before the first."""
        return self._stamp_ns

    @property
    def home_odds(self) -> float | None:
        """Odds of the pose that was expected; None where there was none."""
        for tracked, odds in zip(self._tracked, self._odds(), strict=True):
            if tracked.home:
                return odds
        return None

    def unique(self) -> tuple[Pose2, Array] | None:
        """Pose and covariance (3, 3) of the one place where the robot is, found by the newest
        scan; None while that is not sure, or where it is the expected pose."""
        for tracked, odds in zip(self._tracked, self._odds(), strict=True):
            if odds < self._params.sure or not tracked.matched or tracked.home:
                continue
            views = sum(told > 0.0 for told in tracked.told)
            if views >= self._params.views or tracked.sure_scans >= self._params.standing_scans:
                return tracked.pose, tracked.covariance
        return None

    # -- how

    def _said(self, answer: Answer) -> list[float]:
        """The odds of its places against "none of them", as logarithms."""
        none = max(1.0 - sum(answer.odds), math.exp(-_MOST_LOG))
        logs = [math.log(max(odds, 1e-300) / none) for odds in answer.odds]
        best = max(logs)
        behind = [max(0.0, best - log - math.log(self._params.alike)) for log in logs]
        return [max(-_MOST_LOG, min(best - gap, _MOST_LOG)) for gap in behind]

    def _view(self) -> int:
        """Which view the newest scan belongs to; a new one where it was taken elsewhere."""
        params, now = self._params, self._now
        off = [view.inverse() @ now for view in self._views]
        near = [
            (math.hypot(one.x_m, one.y_m), row)
            for row, one in enumerate(off)
            if math.hypot(one.x_m, one.y_m) < params.view_m and abs(one.theta_rad) < params.view_rad
        ]
        if near:
            row = min(near)[1]
            self._heard[row] += 1
            return row
        if len(self._views) == _VIEWS:
            self._forget_first()
        self._views.append(now)
        self._heard.append(1)
        for tracked in self._tracked:
            tracked.told.append(0.0)
        return len(self._views) - 1

    def _found_elsewhere(self, tracked: _Tracked, view: int) -> bool:
        """Whether an earlier view found it, so that this one finds it again."""
        missed = math.log(self._params.missed)
        return any(
            row < view and told > missed * heard + 1e-9
            for row, (told, heard) in enumerate(zip(tracked.told, self._heard, strict=True))
        )

    def _forget_first(self) -> None:
        weight = self._view_weights()[0] / self._heard[0]
        for tracked in self._tracked:
            tracked.before += weight * tracked.told.pop(0)
        del self._views[0], self._heard[0]
        self._forgotten = True

    def _view_weights(self) -> list[float]:
        first = 1.0 if not self._forgotten else self._params.overlap
        return [first if row == 0 else self._params.overlap for row in range(len(self._views))]

    def _log(self, tracked: _Tracked) -> float:
        """Log-odds against "none of them". The scans of one view are averaged, not added up: the
        second look of a standing robot is no second witness."""
        total = tracked.before
        for weight, told, heard in zip(
            self._view_weights(), tracked.told, self._heard, strict=False
        ):
            total += weight * told / heard
        return total

    def _odds(self) -> list[float]:
        if not self._tracked:
            return []
        weights = np.exp([self._log(tracked) for tracked in self._tracked])
        return [float(odds) for odds in weights / (1.0 + weights.sum())]

    def _matches(self, places: tuple[Hypothesis, ...]) -> dict[int, _Tracked]:
        """Which tracked place each of the found ones is, the closest pairs first."""
        pairs = []
        for row, tracked in enumerate(self._tracked):
            for place, found in enumerate(places):
                spread = tracked.covariance + covariance_of(found) + _SLACK
                d2 = agreement_d2(tracked.pose, found.pose, spread)
                if d2 <= AGREE_D2:
                    pairs.append((d2, row, place))
        matches: dict[int, _Tracked] = {}
        rows: set[int] = set()
        for _, row, place in sorted(pairs):
            if place not in matches and row not in rows:
                matches[place] = self._tracked[row]
                rows.add(row)
        return matches

    def _enter(self, found: Hypothesis, view: int, said: float) -> _Tracked:
        """A place that nothing tracked explains: missed by all scans before."""
        missed = math.log(self._params.missed)
        told = [missed * heard for heard in self._heard]
        told[view] += said - missed
        tracked = _Tracked(pose=found.pose, covariance=_INFLATION * covariance_of(found), told=told)
        before = [heard - (row == view) for row, heard in enumerate(self._heard)]
        weights = self._view_weights()
        late = sum(
            weight * missed * scans / heard
            for weight, scans, heard in zip(weights, before, self._heard, strict=True)
        )
        tracked.before = max(_LATE_LOG - late, 0.0)
        self._tracked.append(tracked)
        return tracked

    def _keep_none(self) -> None:
        """Lower all places alike, so that their odds among each other stay."""
        excess = max(self._log(tracked) for tracked in self._tracked) - _GREATEST_LOG
        if excess > 0.0:
            for tracked in self._tracked:
                tracked.before -= excess

    def _prune(self) -> None:
        """One of those that have become one place, and only so many of them."""
        kept: list[_Tracked] = []
        for tracked in sorted(self._tracked, key=self._log, reverse=True):
            same = [other for other in kept if not apart(tracked.pose, other.pose)]
            if not same:
                kept.append(tracked)
            elif tracked.home:
                same[0].home = True
        self._tracked = kept[: self._params.most]
        self._keep_none()
