from __future__ import annotations

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest
from labs import cloud_at, heading_error_rad, lab, plain_cloud, tour_poses

from amr_slam.geometry import Array, Pose2
from amr_slam.registration import cpd
from amr_slam.registration.alignment import Target
from amr_slam.registration.cpd import CpdParams

with warnings.catch_warnings():
    warnings.simplefilter("ignore", SyntaxWarning)  # pycpd compares with "is"
    from pycpd import RigidRegistration

LONG = CpdParams(max_iterations=1000, tolerance=1e-9, max_points=1000)


class FixedScale(RigidRegistration):  # type: ignore[misc]  # pycpd has no types
    """pycpd's expectation and rotation, with the scale of figure 2 held at 1."""

    sigma2: float

    def update_transform(self) -> None:
        super().update_transform()
        self.s = 1.0
        mean_x = self.P.sum(axis=0) @ self.X / self.Np
        mean_y = self.P.sum(axis=1) @ self.Y / self.Np
        self.t = mean_x - mean_y @ self.R

    def update_variance(self) -> None:
        before = float(self.sigma2)
        spread_x = self.Pt1 @ np.sum(self.X_hat**2, axis=1)
        self.sigma2 = (spread_x - 2.0 * np.trace(self.A @ self.R) + self.YPY) / (2.0 * self.Np)
        self.diff = abs(self.sigma2 - before) / before


def by_pycpd(data: Array, points: Array, outliers: float) -> Pose2:
    """``data_from_points``."""
    other = FixedScale(X=data, Y=points, w=outliers, max_iterations=1000, tolerance=1e-9)
    _, (_, rotation, translation) = other.register()
    x, y = np.ravel(translation)
    # pycpd multiplies rows from the left: its R is the transpose.
    return Pose2(x, y, math.atan2(rotation[0, 1], rotation[0, 0]))


def shape(count: int, rng: np.random.Generator) -> Array:
    """Points on an L and a box: no symmetry."""
    t = rng.uniform(0.0, 1.0, count)
    kind = rng.integers(0, 3, count)
    return np.where(
        kind[:, None] == 0,
        np.column_stack([6.0 * t, 0.0 * t]),
        np.where(
            kind[:, None] == 1,
            np.column_stack([0.0 * t, 3.0 * t]),
            np.column_stack([4.0 + 0.0 * t, 1.0 + t]),
        ),
    )


@pytest.mark.parametrize("outliers", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("case", ["whole", "subset", "outliers"])
def test_cpd_agrees_with_pycpd(outliers: float, case: str) -> None:
    rng = np.random.default_rng(0)
    truth = Pose2(0.4, -0.2, 0.15)
    source = shape(120, rng) + rng.normal(0.0, 0.03, (120, 2))
    data = truth @ shape(150, rng) + rng.normal(0.0, 0.03, (150, 2))
    if case == "subset":
        source = source[source[:, 0] < 4.0]
    if case == "outliers":
        data = np.concatenate([data, rng.uniform(-2.0, 8.0, (50, 2))])
    initial = Pose2(0.1, 0.1, -0.05)
    expected = by_pycpd(data, initial @ source, outliers) @ initial
    found = cpd.align(
        plain_cloud(source),
        Target(points_m=data, normals=np.zeros_like(data)),
        initial,
        replace(LONG, outliers=outliers),
    )
    assert found.converged
    assert found.target_from_source.distance_to(expected) < 1e-3
    assert heading_error_rad(found.target_from_source, expected) < 1e-3
    if case == "whole":
        assert expected.distance_to(truth) < 0.05  # the oracle itself is right


def test_one_round_of_expectation_and_maximization_is_pycpds() -> None:
    rng = np.random.default_rng(1)
    data, points = rng.normal(0.0, 2.0, (40, 2)), rng.normal(0.0, 2.0, (30, 2))
    other = FixedScale(X=data, Y=points, w=0.2, sigma2=0.7)
    other.iterate()
    probability = cpd.expectation(data, points, 0.7, 0.2)
    np.testing.assert_allclose(probability, other.P, rtol=1e-9)
    rotation, translation, variance, weight = cpd.maximization(data, points, probability)
    np.testing.assert_allclose(rotation, other.R.T, rtol=1e-9)
    np.testing.assert_allclose(translation, other.t, rtol=1e-9)
    assert variance == pytest.approx(other.sigma2)
    assert weight == pytest.approx(other.Np)


@pytest.mark.parametrize("place", [0, 30])
def test_a_scan_drifts_onto_another_of_the_same_place(place: int) -> None:
    """Roughly: ICP has the last word. What CPD cannot do, a small part of a large map, is the
    paper's own finding (section 2.1)."""
    truth, rng = tour_poses(0)[place], np.random.default_rng(0)
    there = truth @ Pose2(0.2, 0.1, 0.3)
    seen = cloud_at(lab(0), there, rng, sigma_m=0.01)
    target = Target(points_m=there @ seen.points_m, normals=np.zeros_like(seen.points_m))
    cloud = cloud_at(lab(0), truth, rng, sigma_m=0.01)
    found = cpd.align(cloud, target, truth @ Pose2(0.4, -0.3, 0.25), CpdParams(max_points=250))
    assert found.target_from_source.distance_to(truth) < 0.15
    assert heading_error_rad(found.target_from_source, truth) < 0.03


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_stay_where_they_are(count: int) -> None:
    initial = Pose2(1.0, 2.0, 0.3)
    some = np.random.default_rng(0).normal(size=(20, 2))
    full = Target(points_m=some, normals=np.zeros_like(some))
    few = Target(points_m=some[:count], normals=np.zeros((count, 2)))
    for source, target in ((some[:count], full), (some, few)):
        found = cpd.align(plain_cloud(source), target, initial, CpdParams())
        assert not found.converged
        assert found.target_from_source == initial
        assert found.inliers == 0.0
        assert not found.information.any()


@pytest.mark.parametrize("spread_m", [0.0, 1e-9])
def test_points_all_in_one_place_are_survived(spread_m: float) -> None:
    points = np.full((20, 2), 3.0) + spread_m * np.arange(20)[:, None]
    target = Target(points_m=points, normals=np.zeros_like(points))
    found = cpd.align(plain_cloud(points), target, Pose2.identity(), CpdParams())
    assert found.target_from_source.is_finite()
    assert np.all(np.isfinite(found.information))


def test_thinning_keeps_both_ends_and_never_more_than_asked() -> None:
    points = np.arange(200.0).reshape(-1, 2)
    for most in (10, 50, 99):
        thinned = cpd.thin(points, most)
        assert len(np.unique(thinned, axis=0)) == most
        np.testing.assert_array_equal(thinned[[0, -1]], points[[0, -1]])
    assert cpd.thin(points, 100) is points
