"""Where scans tell the pose well and where they do not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from labs import cloud_at, corridor, covered_poses, lab, mapped_lab
from locating import PARAMS, map_of

from amr_slam.commissioning import ReportParams, usual_eyes
from amr_slam.commissioning.boxes import POST, Box, with_box
from amr_slam.commissioning.precision import expected_covariance, precision
from amr_slam.engine import SlamEngine
from amr_slam.fusion import error95_m
from amr_slam.geometry import Pose2
from amr_slam.slam_request import SlamRequest


def test_in_a_long_corridor_the_weak_direction_is_along_it() -> None:
    known = map_of(corridor(), [(x, 0.0) for x in range(-24, 25, 4)])
    places = np.array([[0.5 * x, 0.0] for x in range(-12, 13)], dtype=float)
    params = ReportParams(poor_m=0.1)
    found = precision(known.target(), usual_eyes(), places, PARAMS, params)
    assert np.median(np.abs(np.sin(found.axes_rad))) < 0.05
    assert np.median(found.ratios) > 5.0
    assert np.median(found.error95_m) > params.poor_m
    # Across the corridor, all is well.
    assert (found.error95_m / found.ratios).max() < 0.05
    assert sum(len(weak.rows) for weak in found.weak) >= 0.5 * len(places)
    for weak in found.weak:
        assert abs(math.sin(weak.axis_rad)) < 0.05


@pytest.mark.parametrize("seed", [3, 11])
def test_measured_errors_keep_what_is_expected(seed: int) -> None:
    """Scans of the world in the map: 95 % of the errors are within 1.5 of the expected radius,
    and the radius is no more than ten times what they are."""
    known, rng = mapped_lab(seed), np.random.default_rng(seed)
    engine = SlamEngine(PARAMS, known, "localization")
    covariance = np.diag([0.05**2, 0.05**2, 0.03**2])
    ratios = []
    for truth in covered_poses(seed, 40):
        expected = error95_m(expected_covariance(known.target(), usual_eyes(), truth, PARAMS, rng))
        request = SlamRequest(
            cloud=cloud_at(lab(seed), truth, rng, sigma_m=0.01),
            map_from_base=truth
            @ Pose2.from_array(rng.multivariate_normal(np.zeros(3), covariance)),
            covariance=covariance,
        )
        fix = engine.update(request).fix
        assert fix is not None
        ratios.append(fix.map_from_base.distance_to(truth) / expected)
    assert 0.1 < np.quantile(ratios, 0.95) < 1.5


def test_a_box_stands_in_the_copy_and_not_in_the_map() -> None:
    known = mapped_lab(3)
    place = next(iter(covered_poses(3, 1)))
    one = Box(shape=POST, pose=place, corner=False)
    before = len(known.target())
    after = with_box(known, one)
    assert len(known.target()) == before
    distance = np.asarray(after.target().tree.query(one.corners_m)[0])
    assert distance.max() < 0.05
    assert not after.target().lookup.seen_free(place.translation[None])[0]
    assert known.target().lookup.seen_free(place.translation[None])[0]
