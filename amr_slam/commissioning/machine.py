"""The report for programs: one JSON object with what the page tells."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from amr_slam.commissioning.about import About
from amr_slam.commissioning.boxes import Box
from amr_slam.commissioning.cold_starts import Outcome
from amr_slam.commissioning.making import Report
from amr_slam.commissioning.verdicts import judged, overall
from amr_slam.geometry import Array, Pose2


def facts(report: Report, about: About) -> dict[str, Any]:
    """Lengths in m, angles in rad, in the map frame; finite numbers only."""
    answers = judged(report)
    found, exact, starts = report.coverage, report.precision, report.starts
    return {
        "about": asdict(about) | {"map_name": report.known.name},
        "params": asdict(report.params),
        "overall": overall(answers).value,
        "answers": [
            {"question": one.question, "light": one.light.value, "answer": one.answer}
            for one in answers
        ],
        "coverage": {
            "floor_m2": _round(found.floor_m2),
            "drivable_m2": _round(found.drivable_m2),
            "walls_m": _round(found.walls_m),
            "counted": found.counted,
            "seldom": _round(found.seldom),
            "borders": [
                {"middle_m": _list(one.middle_m), "length_m": _round(one.length_m)}
                for one in found.borders
            ],
        },
        "precision": {
            "spacing_m": _round(exact.spacing_m),
            "quantiles_m": {
                str(share): _round(float(np.quantile(exact.error95_m, share)))
                for share in (0.5, 0.9, 0.95, 0.99)
            },
            "places": [
                {"x": _round(x), "y": _round(y), "error95_m": _round(error), "axis": _round(axis),
                 "ratio": _round(ratio)}
                for (x, y), error, axis, ratio in zip(
                    exact.places_m, exact.error95_m, exact.axes_rad, exact.ratios, strict=True
                )
            ],
            "weak": [
                {"middle_m": _list(one.middle_m), "places": len(one.rows),
                 "axis": _round(one.axis_rad), "median_m": _round(one.median_m)}
                for one in exact.weak
            ],
        },
        "cold_starts": {
            "shares": {outcome.value: _round(starts.share(outcome)) for outcome in Outcome},
            "tried": [
                {"pose": _pose(one.truth), "outcome": one.outcome.value, "even": one.even,
                 "rivals": [_pose(rival) for rival in one.rivals]}
                for one in starts.tried
            ],
        },
        "look_alikes": [
            {"letter": one.letter, "here_m": _list(one.middles_m[0]),
             "there_m": _list(one.middles_m[1]), "poses": len(one.confused), "wrong": one.wrong}
            for one in report.pairs
        ],
        "boxes_together": None if report.together is None else asdict(report.together),
        "suggestions": [
            {"pair": one.pair.letter, "box": _box(one.box), "tried": one.tried,
             "poses": one.poses, "resolved_before": one.before, "resolved": one.resolved,
             "located": one.located}
            for one in report.resolutions
        ] + [
            {"weak": number, "box": _box(one.box), "tried": one.tried, "places": one.places,
             "before_m": _round(one.before_m), "after_m": _round(one.after_m),
             "good_after": one.good_after}
            for number, one in enumerate(report.anchors, 1)
        ],
    }  # fmt: skip


def _box(one: Box | None) -> dict[str, Any] | None:
    if one is None:
        return None
    size = {"width_m": one.shape.width_m, "depth_m": one.shape.depth_m}
    return {"shape": one.shape.name, "pose": _pose(one.pose), "corner": one.corner} | size


def _pose(pose: Pose2) -> list[float]:
    return _list(pose.as_array())


def _list(values: Array) -> list[float]:
    return [_round(float(value)) for value in values]


def _round(value: float) -> float:
    return round(float(value), 4)
