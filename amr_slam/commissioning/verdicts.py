"""The report in the technician's words: a light for each question, and one for all."""

from __future__ import annotations

import enum
from dataclasses import dataclass

from amr_slam.commissioning.cold_starts import Outcome
from amr_slam.commissioning.making import Report


class Light(enum.StrEnum):
    """As on a traffic light, each with its word."""

    GREEN = "good"
    AMBER = "look at it"
    RED = "act first"


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """One question and its answer."""

    question: str
    light: Light
    answer: str
    anchor: str
    """Part of the page that tells more."""


def judged(report: Report) -> tuple[Judged, ...]:
    """All questions, in the order in which they matter."""
    return (_cold_start(report), _alike(report), _exact(report), _covered(report))


def overall(answers: tuple[Judged, ...]) -> Light:
    """The worst of all."""
    order = (Light.GREEN, Light.AMBER, Light.RED)
    return max((answer.light for answer in answers), key=order.index)


def percent(share: float) -> str:
    """Whole percents, that say neither 100 nor 0 where it is not so."""
    whole = round(100.0 * share)
    if whole == 100 and share < 1.0:
        return "over 99 %"
    if whole == 0 and share > 0.0:
        return "under 1 %"
    return f"{whole} %"


def _cold_start(report: Report) -> Judged:
    starts = report.starts
    wrong = sum(one.outcome is Outcome.WRONG for one in starts.tried)
    found = starts.share(Outcome.LOCATED)
    soon = starts.share(Outcome.LOCATED, Outcome.UNSURE)
    light = Light.GREEN if soon >= 0.95 else Light.AMBER if soon >= 0.8 else Light.RED
    answer = (
        f"Switched on anywhere, it knows its place at once at {percent(found)} of the floor"
        f" and has no doubt which place it is at {percent(soon)}."
    )
    if wrong:
        light = Light.RED
        answer += f" At {wrong} of {len(starts.tried)} poses it took a wrong place for right."
    else:
        answer += " It never took a wrong place for right."
    return Judged(
        question="Does the robot find itself when it is switched on?",
        light=light, answer=answer, anchor="cold-starts",
    )  # fmt: skip


def _alike(report: Report) -> Judged:
    question, part = "Do places look alike?", "look-alikes"
    confused = report.starts.share(Outcome.ALIKE, Outcome.WRONG)
    if not report.pairs:
        answer = (
            "No pair of places was found that is taken for one another"
            f" ({len(report.starts.tried)} poses tried)."
        )
        light = Light.GREEN if confused < 0.05 else Light.AMBER
        return Judged(question=question, light=light, answer=answer, anchor=part)
    wrong = sum(pair.wrong for pair in report.pairs)
    light = Light.RED if wrong or confused > 0.2 else Light.AMBER
    count = len(report.pairs)
    answer = (
        f"{count} {'pair' if count == 1 else 'pairs'} of places look alike; the robot hesitates at"
        f" {percent(confused)} of the floor."
    )
    together = report.together
    if together is not None:
        boxes = "One box" if together.boxes == 1 else f"{together.boxes} boxes"
        answer += (
            f" {boxes} would settle {together.located + together.unsure} of the"
            f" {together.poses} poses."
        )
    return Judged(question=question, light=light, answer=answer, anchor=part)


def _exact(report: Report) -> Judged:
    params, found = report.params, report.precision
    good, poor = found.share(params.good_m), 1.0 - found.share(params.poor_m)
    light = Light.GREEN if good >= 0.95 and poor < 0.01 else Light.AMBER
    if poor > 0.1:
        light = Light.RED
    answer = (
        f"One scan tells the position to {100.0 * params.good_m:.0f} cm or better at"
        f" {percent(good)} of the floor; at {percent(poor)} it is worse than"
        f" {100.0 * params.poor_m:.0f} cm."
    )
    return Judged(
        question="How exactly does it know where it is?",
        light=light, answer=answer, anchor="precision",
    )  # fmt: skip


def _covered(report: Report) -> Judged:
    found = report.coverage
    count = len(found.borders)
    light = Light.GREEN if found.borders_m < 2.0 and found.seldom <= 0.2 else Light.AMBER
    if found.borders_m > 0.1 * max(found.walls_m, 1.0):
        light = Light.RED
    answer = f"{found.floor_m2:.0f} m² of floor were seen free."
    if count:
        answer += (
            f" At {count} {'place' if count == 1 else 'places'} within reach"
            f" ({found.borders_m:.0f} m in all) the floor goes on and nobody looked."
        )
    else:
        answer += " Nothing within reach was left out."
    if found.counted:
        often = report.params.seen_often
        answer += f" {percent(found.seldom)} of it was seen by fewer than {often} scans."
    return Judged(question="Is the map complete?", light=light, answer=answer, anchor="coverage")
