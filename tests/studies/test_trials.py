"""Trials: what counts as right, accepted and wrongly accepted, and how it is written."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from amr_slam.params import preset
from amr_slam.slam import Verdict
from amr_slam.studies.scenes import laboratory_scene, with_noise
from amr_slam.studies.trials import (
    Circumstances,
    Trial,
    localize,
    mean_and_std,
    percent,
    success,
    verdicts,
)
from amr_slam.studies.witnesses import Hunt, Witnesses

UNDER = Circumstances(kind="laboratory", seed=11, sigma_m=0.0)
RIGHT = Trial(
    under=UNDER,
    verdict=Verdict.ACCEPTED,
    pose=None,
    error_m=0.01,
    error_rad=0.001,
    score=0.9,
    inliers=0.95,
    known=1.0,
    conflict=0.0,
    passes=0.0,
    agreeing=0.9,
    e_psr_m=0.02,
    margin=0.4,
    odds=0.99,
    ms=1.0,
)
WRONG = replace(RIGHT, error_m=3.0)
SILENT = replace(WRONG, verdict=Verdict.UNKNOWN)


def test_success_counts_the_best_place_whatever_the_verdict() -> None:
    assert success([RIGHT, replace(RIGHT, verdict=Verdict.AMBIGUOUS), WRONG, SILENT]) == "50.0 %"
    assert success([replace(RIGHT, error_rad=0.2)]) == "0.0 %"
    assert verdicts([RIGHT, WRONG, SILENT, SILENT]) == ("50.0 %", "0.0 %", "50.0 %", "1")


def test_only_an_accepted_wrong_place_is_wrongly_accepted() -> None:
    assert WRONG.wrongly_accepted
    assert not RIGHT.wrongly_accepted
    assert not SILENT.wrongly_accepted


def test_confirmation_takes_two_accepted_answers_that_agree() -> None:
    twice = Witnesses(first=WRONG, second=WRONG, agree=True)
    assert twice.wrongly_confirmed
    assert not replace(twice, agree=False).confirmed
    assert not replace(twice, second=SILENT).confirmed
    assert not Witnesses(first=RIGHT, second=RIGHT, agree=True).wrongly_confirmed


def test_numbers_as_they_are_printed() -> None:
    assert percent(0, 0) == "-"
    assert percent(1, 6000) == "0.02 %"
    assert mean_and_std([0.1, 0.3, math.inf, math.nan]) == ("0.200", "0.100")
    assert mean_and_std([]) == ("-", "-")


@pytest.mark.parametrize("seed", [11])
def test_scans_of_the_mapped_world_are_found_and_agree(seed: int) -> None:
    scene, params, model = laboratory_scene(seed), preset("default"), with_noise(0.0)
    known = scene.map_at_truth(model, params)
    hunt = Hunt(known=known, model=model, params=params, scene=scene, in_map=True)
    rng = np.random.default_rng(1)
    for pose in scene.poses(2, rng):
        pair = hunt.witnesses(pose, UNDER, rng)
        assert pair.first.right
        assert pair.second.right
        assert pair.agree
        # The same answer is worth nothing where the robot is not in the map at all.
        cloud = scene.cloud(model, pose, rng)
        assert not localize(cloud, known, params, None, UNDER).right
