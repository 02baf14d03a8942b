"""What a registered scan makes of the pose: a correction, a jump, or nothing."""

from __future__ import annotations

from amr_slam.agreement import AGREE_D2, agreement_d2, moved
from amr_slam.evidence import Answer, Rung, apart
from amr_slam.geometry import Array, Pose2, turned, wrap_angle
from amr_slam.hypotheses import Hypotheses
from amr_slam.localizer.fused import FusedPose
from amr_slam.samples import Outcome, SlamPose
from amr_slam.slam_request import SlamResult
from amr_slam.states import Mode
from amr_slam.trust import LocalizerParams, too_wide, whole_map


class Placing:
    """Where the robot is believed to be, and what speaks for another place."""

    def __init__(
        self, params: LocalizerParams, fused: FusedPose, mode: Mode, *, located: bool
    ) -> None:
        self._params = params
        self._fused = fused
        self.mode: Mode = mode
        self.located = located
        """Whether the fused pose is of a place that somebody or a scan has named."""
        self.unconfirmed = False
        """The pose is what somebody said; no scan has agreed with it yet."""
        self.refusals = 0
        """Scans in a row that were of no use."""
        self.elsewhere: Array | None = None
        """(3,) The newest scan fits, but not where the robot is thought to be: from there to where
        it fits, in the map frame."""
        self.last_result: SlamResult | None = None
        """The newest answer of the registration about the pose."""
        self.answered_ns: int | None = None
        """Instant of the newest scan that was registered, since the last jump."""
        self.hypotheses = Hypotheses(params.tracking)
        self._agreeing: list[SlamPose] = []
        self._left: SlamPose | None = None

    def begin(
        self, stamp_ns: int | None, map_from_base: Pose2, covariance: Array, *, located: bool
    ) -> Outcome:
        """Jump to a pose of ``stamp_ns`` (None: of now) and forget what spoke for the last one."""
        outcome = self._fused.reset(stamp_ns, map_from_base, covariance)
        if outcome is not Outcome.RESET:
            return outcome
        self.located, self.unconfirmed, self.refusals = located, False, 0
        self.elsewhere = self._left = None
        self._agreeing.clear()
        self.hypotheses.clear()
        # The way from an older scan to the next one says nothing of the scanners' mounting.
        self.answered_ns = None
        return Outcome.RESET

    def take_in(self, result: SlamResult, fix: SlamPose | None) -> Outcome:
        """Weigh an answer; ``fix``: its pose, as far as it is believed."""
        with self._fused.eased():
            outcome = self._weigh_answer(result, whole_map(result), fix)
        self._fused.note_slip(result.stamp_ns)
        self.elsewhere = self._beside(fix) if outcome is Outcome.GATED else None
        if outcome in {Outcome.ACCEPTED, Outcome.INFLATED, Outcome.RESET}:
            if outcome is not Outcome.RESET:
                self._left = None
            self.refusals, self.unconfirmed = 0, False
            self._agreeing.clear()
            self.hypotheses.clear()
        elif result.zone is None and (
            outcome is not Outcome.UNKNOWN or not self._fits_where_expected(result)
        ):
            self.refusals += 1
        return outcome

    def follow_map(self, stamp_ns: int, moved: Pose2) -> None:
        """A loop has moved the map under the robot: the pose goes with it, as a new epoch."""
        there = self._fused.running.pose_at(stamp_ns)
        if there is None:
            return
        self._fused.reset(stamp_ns, moved @ there[0], turned(there[1], moved.rotation))
        self.elsewhere = self._left = None
        self._agreeing.clear()
        self.hypotheses.clear()

    def _beside(self, fix: SlamPose | None) -> Array | None:
        """(3,) from the expected pose to that of a fix which was refused, in the map frame."""
        expected = None if fix is None else self._fused.running.pose_at(fix.stamp_ns)
        if fix is None or expected is None:
            return None
        off = fix.map_from_base.as_array() - expected[0].as_array()
        off[2] = wrap_angle(float(off[2]))
        return off

    @property
    def zone(self) -> str | None:
        """The zone without landmarks that the newest scan lies in."""
        return None if self.last_result is None else self.last_result.zone

    def seek_anew(self) -> None:
        """What the pose was built on was wrong."""
        self.located = False
        self.hypotheses.clear()

    @property
    def is_doubtful(self) -> bool:
        """Whether more than one scan says that the robot is elsewhere."""
        home_odds = self.hypotheses.home_odds
        return self.refusals > 1 and home_odds is not None and home_odds < 0.5

    def _weigh_answer(
        self, result: SlamResult, whole_map: Answer | None, fix: SlamPose | None
    ) -> Outcome:
        """A fix near the expected pose is the fusion's; what a search of the whole map found must
        first be the only place left, unless the fusion's own pose agrees with it."""
        from_whole_map = whole_map is not None and result.answer is whole_map
        outcome = Outcome.UNKNOWN if fix is None else Outcome.GATED
        if fix is not None and self.located and not (from_whole_map and self._adrift(fix)):
            outcome = self._fused.running.correct(fix)
        if outcome not in {Outcome.UNKNOWN, Outcome.GATED}:
            return outcome
        if whole_map is not None:
            jumped = self._weigh_places(result.stamp_ns, whole_map)
            outcome = jumped or outcome
        if fix is not None and not from_whole_map and outcome is Outcome.GATED:
            outcome = self._consider_jump(fix)
        return outcome

    def _adrift(self, fix: SlamPose) -> bool:
        """Whether the fusion knows so little that agreeing with it proves nothing."""
        expected = self._fused.running.pose_at(fix.stamp_ns)
        return expected is not None and too_wide(expected[1], self._params)

    def _weigh_places(self, stamp_ns: int, answer: Answer) -> Outcome | None:
        """Weigh the places found in the whole map; jump to one when no other is left."""
        fusion = self._fused.running
        expected = fusion.pose_at(stamp_ns)
        if expected is None:
            return None
        if self.located and not len(self.hypotheses) and not too_wide(expected[1], self._params):
            self.hypotheses.expect(stamp_ns, *expected)
        self.hypotheses.weigh(stamp_ns, answer, fusion.motion_between)
        unique = self.hypotheses.unique()
        if unique is None or too_wide(unique[1], self._params):
            return None
        outcome = fusion.reset(stamp_ns, *unique)
        self.located = self.located or outcome is Outcome.RESET
        return outcome

    def _fits_where_expected(self, result: SlamResult) -> bool:
        """Whether a scan that was not accepted still lies for the most part on the walls around
        the expected pose: then the place has changed, and the robot is not lost."""
        near, change = result.climbed[0], result.change
        if not self.located or near.best is None or change is None:
            return False
        expected = self._fused.running.pose_at(result.stamp_ns)
        return (
            near.rung is Rung.RELATIVE
            and expected is not None
            and change.explained >= self._params.explained_share
            and not apart(expected[0], near.best.pose)
        )

    def _consider_jump(self, fix: SlamPose) -> Outcome:
        """A fix that contradicts the estimate: jump once enough of them agree."""
        fusion = self._fused.running
        if self._left is not None and self._agrees(self._left, fix):
            # The jump after the outage was to a wrong place.
            return self._jump(fix)
        since_fix_s = fusion.since_fix_s - 1e-9 * (fusion.stamp_ns - fix.stamp_ns)
        expected = fusion.pose_at(fix.stamp_ns)
        # A growing map has no place to be found in: what it does not forget must agree first.
        is_outage = self.mode == "localization" and since_fix_s > self._params.outage_s
        if is_outage and expected is not None:
            outcome = self._jump(fix)
            self._left = SlamPose(
                stamp_ns=fix.stamp_ns, map_from_base=expected[0], covariance=expected[1]
            )
            return outcome
        if self._agreeing and not self._agrees(self._agreeing[-1], fix):
            self._agreeing.clear()
        self._agreeing.append(fix)
        independent = all(refused.relocalized for refused in self._agreeing)
        needed = (
            self._params.agreeing_relocalizations if independent else self._params.agreeing_refusals
        )
        if len(self._agreeing) < needed:
            return Outcome.GATED
        self._fused.note_lies(fix)
        return self._jump(fix)

    def _jump(self, fix: SlamPose) -> Outcome:
        self._left = None
        return self._fused.running.reset(fix.stamp_ns, fix.map_from_base, fix.covariance)

    def _agrees(self, earlier: SlamPose, later: SlamPose) -> bool:
        """Whether the wheels' motion carries one fix onto the other."""
        motion = self._fused.motion_between(earlier.stamp_ns, later.stamp_ns)
        if motion is None:
            return False
        expected, covariance = moved(earlier.map_from_base, earlier.covariance, motion)
        spread = covariance + later.covariance
        return agreement_d2(expected, later.map_from_base, spread) <= AGREE_D2
