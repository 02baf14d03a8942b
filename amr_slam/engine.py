"""The SLAM side of the program: owns the map, answers one scan at a time.

Runs in a process of its own in the daemon and in line in a replay; it knows neither.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from amr_slam.areas import within
from amr_slam.changes import Change, compare
from amr_slam.clouds import Cloud
from amr_slam.evidence import (
    MOST_HIDDEN,
    Answer,
    Hypothesis,
    Rung,
    Verdict,
    apart,
    hidden,
    objection,
    unknown,
)
from amr_slam.fixing import among_others, compatible, fix_of, placed, prior_of
from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.graph.chart import Chart
from amr_slam.inspection import Inspection, Inspector, Looks
from amr_slam.living import Watcher
from amr_slam.map import LayerKind, PointMap
from amr_slam.map.held import Held
from amr_slam.params import SlamParams
from amr_slam.region import Region, slam_region
from amr_slam.registration.icp import Prior
from amr_slam.samples import SlamPose
from amr_slam.slam import slam_absolute_rungs, slam_relative
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.states import Mode

# Chance that the wheels mislead even about how much they may: they never say more than that.
_WHEELS_LIE = 1e-3


class SlamEngine:
    """Scan in, pose out; in mapping mode the map grows by each accepted scan."""

    def __init__(
        self, params: SlamParams, grown: PointMap, mode: Mode, *, resumed: bool = False
    ) -> None:
        """``resumed``: mapping goes on where another engine left off, which has grown the map
        and whose last scan was the newest in it."""
        self.params = params
        self.map = grown
        self.mode: Mode = mode
        self._last_inserted: Pose2 | None = None
        self._joined: tuple[Pose2, Array] | None = None
        self.chart: Chart | None = None
        if mode == "mapping" and not len(grown):
            self.chart = Chart(params)
        elif mode == "mapping" and resumed:
            self.chart = Chart.restored(params, grown)
        # Any other map that was loaded is held for true: its loops are closed.
        self._inspector = Inspector(params)
        self.watcher: Watcher | None = None
        """Localization: hears of each scan that is accepted where it was expected. Set by who
        keeps what it has seen."""
        self.utc_from_stamp_ns = 0
        """For the watcher: a cloud's stamp and this are UTC."""
        self._held: Held | None = None
        self._resuming: Chart | None = None

    def go_on(self, *, hold: bool = False) -> None:
        """From now on the map that is loaded grows on, by its own graph if the next scan is taken
        near the newest ones in it; anywhere else it is held for true as it is, its loops closed.
        ``hold``: as :meth:`hold` says."""
        self.mode = "mapping"
        if hold:
            self.hold()
        else:
            self._resuming = Chart.restored(self.params, self.map)

    def hold(self) -> None:
        """From now on what is in the map stays as it is, loops too; what is new joins it."""
        self._held, self.chart = Held(self.map), None

    def update(self, request: SlamRequest) -> SlamResult:
        """Register one cloud. Never raises for what a scan contains."""
        cloud = request.cloud
        empty = not self.map.path and not len(self.map)
        if self.mode == "mapping" and empty and request.map_from_base is not None:
            return self._found(request)
        if self._resuming is not None and request.map_from_base is not None:
            self._take_up(self._resuming, request.map_from_base)
        if request.region is not None and self.mode == "localization":
            return self._seek(request, request.region)
        prior = prior_of(request)
        vague = prior is not None and self._vague(prior)
        if prior is not None and vague and self.mode == "localization":
            # What fits near a guess proves nothing: it is one place among all others.
            request, prior, vague = among_others(request, prior), None, False
        zone = None if prior is None else self._zone_around(cloud, prior.target_from_source)
        if zone is not None:
            return self._blind(cloud.stamp_ns, zone)
        climbed = tuple(self._climb(request, prior, vague=vague))
        answer = self._choose(climbed, prior, vague=vague)
        inspection = self._inspect(request, answer)
        wrong = inspection.looks is Looks.WRONG
        fix = None
        believed = False
        if answer.verdict is Verdict.ACCEPTED and answer.best is not None and not wrong:
            fix = fix_of(cloud.stamp_ns, answer.best, answer.rung, prior, self.map.error_m)
            believed = prior is not None and compatible(fix, prior)
        new = fix is None and not wrong and self._new_territory(climbed[0])
        scans, moved = len(self.map.path), None
        if self.mode == "mapping":
            moved = self._grow(request, answer, fix, believed=believed, new=new)
        inserted = len(self.map.path) > scans
        result = self._result(cloud.stamp_ns, climbed, answer, fix, inserted=inserted)
        change = self._compare(cloud, climbed[0] if fix is None else answer)
        if believed and prior is not None and fix is not None and answer.best is not None:
            pose = placed(request, answer.rung, answer.best, fix)
            self._watch(cloud, pose, inverse_matrix(prior.information), fix)
        counts = None if self.watcher is None else self.watcher.counts()
        return replace(result, change=change, inspection=inspection, moved=moved, changes=counts)

    def _watch(self, cloud: Cloud, pose: Pose2, prior: Array, fix: SlamPose) -> None:
        if self.watcher is None or self.mode == "mapping":
            return
        known = inverse_matrix(inverse_matrix(prior) + inverse_matrix(fix.covariance))
        self.watcher.see(cloud, pose, known, cloud.stamp_ns + self.utc_from_stamp_ns)

    @property
    def local(self) -> PointMap:
        """What scans are registered in."""
        return self.map if self.chart is None else self.chart.local

    def anchored(self, pose: Pose2) -> tuple[int, Pose2]:
        """A pose (map_from_base) as (number of the newest scan in the map, its own pose in that
        scan's base frame): loops that are closed later move it along. See :meth:`unanchored`."""
        if self.chart is None or not len(self.chart.poses):
            return -1, pose
        return len(self.chart.poses) - 1, self.chart.newest.inverse() @ pose

    def unanchored(self, row: int, pose: Pose2) -> Pose2:
        """The map_from_base, as of now, of what :meth:`anchored` gave."""
        return pose if self.chart is None or row < 0 else self.chart.pose(row) @ pose

    def _take_up(self, chart: Chart, pose: Pose2) -> None:
        """Go on with a restored chart, if the piece of the way that it ended with knows ``pose``:
        elsewhere the next scan could neither be registered in that nor tied to its newest node."""
        self._resuming = None
        away_m = [pose.distance_to(known) for _, known in chart.local.path]
        if min(away_m, default=math.inf) <= self.params.closing.beyond_m:
            self.chart = chart

    def settle(self) -> None:
        """Bring ``map`` up to date, each scan to where loops have moved it: due before anybody
        else uses the map. Whoever asks it next pays about 1 ms for each scan that joined since
        the last time, or for every scan where a loop has been closed."""
        if self.chart is not None and self.chart.moved:
            self.map.move([Pose2.from_array(pose) for pose in self.chart.poses])
            self.chart.moved = False
        if self.chart is not None:
            self.map.ties = self.chart.ties()

    def _zone_around(self, cloud: Cloud, expected: Pose2) -> str | None:
        """The zone without landmarks that hides the scan, taken at the expected pose, or None."""
        zones = self.local.layers.areas(LayerKind.ZONE)
        if not zones or not len(cloud):
            return None
        moved = expected @ cloud.points_m
        if hidden(cloud, ~within(moved, zones)) <= MOST_HIDDEN:
            return None
        return max(zones, key=lambda zone: float(cloud.weights @ within(moved, [zone]))).name

    def _blind(self, stamp_ns: int, zone: str) -> SlamResult:
        """What fits elsewhere proves nothing of a robot that is where nothing may be proven."""
        answer = unknown(f'no-localize zone "{zone}": by the wheels alone')
        result = self._result(stamp_ns, (answer,), answer, None, inserted=False)
        return replace(result, zone=zone)

    def _seek(self, request: SlamRequest, region: Region) -> SlamResult:
        """Sought where somebody says; that pose says nothing of the scanners' mounting."""
        climbed = tuple(slam_region(request.cloud, self.map, region, self.params))
        answer, fix = climbed[-1], None
        if answer.verdict is Verdict.ACCEPTED and answer.best is not None:
            error_m = self.map.error_m
            fix = fix_of(request.cloud.stamp_ns, answer.best, answer.rung, None, error_m)
        result = self._result(request.cloud.stamp_ns, climbed, answer, fix, inserted=False)
        return replace(result, change=self._compare(request.cloud, answer), sought=True)

    def _inspect(self, request: SlamRequest, answer: Answer) -> Inspection:
        if answer.best is not None and answer.best.hidden > 0.0:
            return Inspection()  # what is left out may be just what would tell
        return self._inspector.inspect(
            request.cloud,
            request.views,
            request.map_from_base,
            request.motion,
            answer,
            self.local,
            mapping=self.mode == "mapping",
        )

    def _compare(self, cloud: Cloud, answer: Answer) -> Change | None:
        """Of a growing map nothing can be said to have changed; nor of a place merely guessed."""
        guessed = answer.verdict is not Verdict.ACCEPTED and answer.rung is not Rung.RELATIVE
        if self.mode == "mapping" or answer.best is None or guessed:
            return None
        return compare(cloud, self.map.target(), answer.best.pose)

    def _vague(self, prior: Prior) -> bool:
        """The robot may be outside the window in which the first rung looks."""
        deviations = np.sqrt(np.diag(inverse_matrix(prior.information)))
        return bool(np.any(3.0 * deviations > self.params.window_max))

    def _climb(self, request: SlamRequest, prior: Prior | None, *, vague: bool) -> Iterator[Answer]:
        """One answer a rung, up to the first that ends the search."""
        cloud = request.cloud
        if prior is None:
            rungs = slam_absolute_rungs(cloud, self.local, self.params, request.also)
        else:
            # A growing map lacks the very places where the robot is: there, a search of the whole
            # map finds look-alikes, so the last rung stays around the expected pose.
            rungs = slam_relative(
                cloud, self.local, prior, self.params, everywhere=self.mode == "localization"
            )
        begun_s = time.perf_counter()
        for answer in rungs:
            ended_s = time.perf_counter()
            yield replace(answer, elapsed_s=ended_s - begun_s)
            if not vague and self._ends(answer):
                return
            begun_s = ended_s

    def _choose(self, climbed: Sequence[Answer], prior: Prior | None, *, vague: bool) -> Answer:
        last = climbed[-1]
        if not vague and self._ends(last):
            return last
        # A poor fit near the expected pose counts once the search around found nothing better.
        accepted = [answer for answer in climbed if answer.verdict is Verdict.ACCEPTED]
        answer = max(accepted, key=lambda one: self._worth(one.best, prior), default=last)
        best = answer.best
        if best is None or not accepted or self.mode == "localization":
            return answer
        # ... "Nothing" includes what no rung would accept: a map never forgets a wrong pose.
        places = [place for one in climbed for place in one.places]
        others = [self._worth(place, prior) for place in places if apart(place.pose, best.pose)]
        margin = self._worth(best, prior) - max(others, default=-math.inf)
        if margin >= self._lead(answer, vague=vague):
            return answer
        return replace(
            answer,
            verdict=Verdict.AMBIGUOUS,
            margin=margin,
            reason=f"another rung's place fits about as well (margin {margin:.2f})",
        )

    def _worth(self, place: Hypothesis | None, prior: Prior | None) -> float:
        """What speaks for a place: its score and, while mapping, what the wheels say of it. Where
        the robot leaves what the map knows, the way back fits better than the way ahead."""
        if place is None:
            return -math.inf
        if prior is None or self.mode == "localization":
            return place.score
        off = place.pose.as_array() - prior.target_from_source.as_array()
        off[2] = wrap_angle(float(off[2]))
        against = min(0.5 * float(off @ prior.information @ off), -math.log(_WHEELS_LIE))
        return place.score - against / self.params.plausibility.margin

    def _lead(self, answer: Answer, *, vague: bool) -> float:
        """Least lead in worth that the chosen place needs over all that any rung found."""
        if vague or answer.rung is not Rung.RELATIVE:
            return self.params.rescue.margin
        return -self.params.rescue.margin

    def _ends(self, answer: Answer) -> bool:
        """Whether no further rung is needed. In new territory the little that is known must fit:
        otherwise the wheels may have slipped, and it is no new territory."""
        if self._settles(answer):
            return True
        best = answer.best
        fits = best is not None and objection(best, self.params.settled) is None
        return fits and self._new_territory(answer)

    def _settles(self, answer: Answer) -> bool:
        if answer.verdict is not Verdict.ACCEPTED or answer.best is None:
            return False
        everywhere = answer.rung in {Rung.ABSOLUTE, Rung.EXHAUSTIVE}
        return everywhere or objection(answer.best, self.params.settled) is None

    def _found(self, request: SlamRequest) -> SlamResult:
        """The first scan founds the map: its frame is where the robot stands."""
        pose = request.map_from_base or Pose2.identity()
        inspection = self._inspector.founding(request.cloud, request.views, pose)
        wrong = inspection.looks is Looks.WRONG
        inserted = len(request.cloud) > 0 and not wrong
        if inserted:
            self.join(request.cloud, pose, np.eye(3))
        answer = unknown("the first scan founds the map" if inserted else "the scan is empty")
        if wrong:
            answer = unknown("the scanners contradict each other")
        result = self._result(request.cloud.stamp_ns, (answer,), answer, None, inserted=inserted)
        return replace(result, inspection=inspection)

    def _new_territory(self, answer: Answer) -> bool:
        """Mapping: the scan overlaps too little with the map to say anything. That is no
        failure: it joins the map where the wheels say, unless the search finds it elsewhere."""
        best = answer.best
        return (
            self.mode == "mapping"
            and answer.rung is Rung.RELATIVE
            and best is not None
            and best.known < self.params.relative.known
        )

    def _grow(
        self,
        request: SlamRequest,
        answer: Answer,
        fix: SlamPose | None,
        *,
        believed: bool,
        new: bool,
    ) -> Pose2 | None:
        """What closing a loop has moved the newest pose by, if it has."""
        pose, covariance = None, request.covariance
        if believed and answer.best is not None and fix is not None and covariance is not None:
            pose = placed(request, answer.rung, answer.best, fix)
            covariance = inverse_matrix(inverse_matrix(covariance) + inverse_matrix(fix.covariance))
        elif new:
            pose = request.map_from_base
        if pose is None or covariance is None or not self._moved(pose):
            return None
        return self.join(request.cloud, pose, covariance)

    def join(self, cloud: Cloud, pose: Pose2, covariance: Array) -> Pose2 | None:
        """Let a scan become part of the map, as :attr:`SlamResult.joined_at` told of it. The same
        scans make the same map. What closing a loop has moved the newest pose by, if it has."""
        self._last_inserted, self._joined = pose, (pose, covariance)
        if self.chart is None:
            (self.map if self._held is None else self._held).insert(cloud, pose)
            return None
        # Nobody registers in the whole map meanwhile: it is drawn when somebody wants it.
        self.map.append(cloud, pose)
        moved = self.chart.insert(cloud, pose, covariance)
        self._last_inserted = self.chart.newest
        return moved

    def _moved(self, pose: Pose2) -> bool:
        """A standing robot adds nothing but noise."""
        if self._last_inserted is None:
            return True
        delta = self._last_inserted.inverse() @ pose
        return (
            delta.distance_to(Pose2.identity()) > self.params.insert_m
            or abs(delta.theta_rad) > self.params.insert_rad
        )

    def _result(
        self,
        stamp_ns: int,
        climbed: tuple[Answer, ...],
        answer: Answer,
        fix: SlamPose | None,
        *,
        inserted: bool,
    ) -> SlamResult:
        return SlamResult(
            stamp_ns=stamp_ns,
            answer=answer,
            climbed=climbed,
            fix=fix,
            inserted=inserted,
            joined_at=self._joined if inserted else None,
            map_error_m=self.map.error_m,
            map_scans=len(self.map.path),
        )
