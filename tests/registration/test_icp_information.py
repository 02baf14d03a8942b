"""What ICP claims to know, against what it does know."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from labs import cloud_at, corridor, exact_target, room

from amr_slam.geometry import Array, Pose2, inverse_matrix, wrap_angle
from amr_slam.map import MapParams, PointMap
from amr_slam.registration import icp
from amr_slam.registration.alignment import Alignment
from amr_slam.registration.icp import IcpParams, Prior, points_alone

fixed = settings(derandomize=True, deadline=None, max_examples=100)


def difference(a: Pose2, b: Pose2) -> Array:
    off = a.as_array() - b.as_array()
    off[2] = wrap_angle(float(off[2]))
    return off


@pytest.mark.parametrize(("floor", "correlation", "over"), [(1e-3, 4.0, 1.0), (0.03, 4.0, 4.0)])
def test_information_is_what_repeated_scans_show(
    floor: float, correlation: float, over: float
) -> None:
    """Monte Carlo under known noise: claimed over shown variance is one, or the correlation where
    a map's error as large as the noise is assumed (here is none); in no direction surer than
    that, in none 2.5 times less sure."""
    truth, rng = Pose2(3.0, 2.2, 0.3), np.random.default_rng(0)
    params = IcpParams(correlation=correlation, sigma_floor_m=floor)
    target = exact_target(room())
    errors, claims = [], []
    for _ in range(150):
        cloud = cloud_at(room(), truth, rng, sigma_m=0.03)
        found = icp.align(cloud, target, truth, params)
        errors.append(difference(found.target_from_source, truth))
        claims.append(np.linalg.inv(found.information))
    shown = np.cov(np.array(errors).T)
    claimed = np.mean(claims, axis=0)
    root = np.linalg.inv(np.linalg.cholesky(shown))
    ratios = np.linalg.eigvalsh(root @ claimed @ root.T) / over
    assert ratios.min() > 0.9
    assert ratios.max() < 2.5
    # No bias beyond what the noise explains.
    mean = np.mean(errors, axis=0)
    assert mean @ np.linalg.inv(shown) @ mean < 16.0 / len(errors)


def mapped_corridor() -> PointMap:
    grown, rng = PointMap(MapParams()), np.random.default_rng(1)
    for x in np.arange(-6.0, 6.1, 0.6):
        pose = Pose2(x, 0.1, 0.0)
        grown.insert(cloud_at(corridor(), pose, rng, sigma_m=0.01), pose)
    return grown


def test_along_a_corridor_the_wheels_decide() -> None:
    """The walls know nothing along it: the information says so, and the prior is kept there."""
    truth, rng = Pose2(0.5, -0.1, 0.2), np.random.default_rng(2)
    believed = Pose2(0.9, 0.05, 0.25)
    prior = Prior(
        target_from_source=believed, information=np.diag([0.1**-2, 0.1**-2, math.radians(3) ** -2])
    )
    cloud = cloud_at(corridor(), truth, rng, sigma_m=0.01)
    found = icp.align(cloud, mapped_corridor().target(), believed, IcpParams(), prior)
    pose, information = found.target_from_source, found.information
    assert pose.x_m == pytest.approx(believed.x_m, abs=0.1)
    assert pose.y_m == pytest.approx(truth.y_m, abs=0.01)
    assert pose.theta_rad == pytest.approx(truth.theta_rad, abs=0.005)
    along = 1.0 / np.linalg.inv(information)[0, 0]
    assert along < 0.02 * information[1, 1]
    # A filter that hears it must not come to know the place along the corridor.
    alone, covariance = points_alone(found, prior)
    assert covariance[0, 0] > 0.5 * 0.1**2
    assert covariance[1, 1] < 0.01**2
    assert alone.y_m == pytest.approx(truth.y_m, abs=0.01)


entries = st.lists(st.floats(-1.0, 1.0), min_size=9, max_size=9)


def positive(values: list[float], smallest: float) -> Array:
    """A well-conditioned symmetric matrix with eigenvalues of ``smallest`` to about ten."""
    root = np.array(values).reshape(3, 3)
    return np.asarray(root @ root.T + smallest * np.eye(3))


def joint_of(points: Array, H: Array, prior: Array, L: Array) -> Array:
    return np.asarray(prior + np.linalg.solve(H + L, H @ (points - prior)))


@fixed
@given(
    h=entries,
    l=entries,
    off=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    theta=st.floats(-math.pi, math.pi),
)
def test_a_filter_that_adds_the_prior_again_gets_the_joint_optimum(
    h: list[float],
    l: list[float],  # noqa: E741  # the textbooks' letter
    off: tuple[float, float, float],
    theta: float,
) -> None:
    """Where the points know enough in all directions, their own optimum comes out exactly."""
    H, L = positive(h, 1.0), positive(l, 0.5)
    L /= 5.0 * np.linalg.eigvalsh(L).max()  # the points know five times more, everywhere
    prior = Pose2(2.0, -1.0, theta)
    points = prior.as_array() + np.array(off)
    joint = joint_of(points, H, prior.as_array(), L)
    alignment = Alignment(
        target_from_source=Pose2.from_array(joint),
        information=H,
        converged=True,
        iterations=1,
        inliers=1.0,
        rmse_m=0.0,
    )
    alone, covariance = points_alone(alignment, Prior(target_from_source=prior, information=L))
    np.testing.assert_allclose(difference(alone, Pose2.from_array(points)), 0.0, atol=1e-9)
    np.testing.assert_allclose(covariance, np.linalg.inv(H), rtol=1e-6, atol=1e-9)
    again = joint_of(
        prior.as_array() + difference(alone, prior),
        inverse_matrix(covariance),
        prior.as_array(),
        L,
    )
    np.testing.assert_allclose(again, joint, atol=1e-9)


@fixed
@given(
    h=entries,
    l=entries,
    off=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    weak=st.floats(0.0, 0.15),
)
def test_what_the_points_do_not_know_is_not_made_up(
    h: list[float],
    l: list[float],  # noqa: E741  # the textbooks' letter
    off: tuple[float, float, float],
    weak: float,
) -> None:
    """One direction in which the points know less than the prior: the fused pose stays between
    the prior and the joint optimum there, and the covariance is no better than the points'."""
    L = positive(l, 0.5)
    root = np.linalg.cholesky(L)
    axes, _ = np.linalg.qr(np.array(h).reshape(3, 3) + 2.0 * np.eye(3))
    ratios = np.array([weak, 3.0, 8.0])
    H = root @ (axes * ratios) @ axes.T @ root.T
    prior = Pose2(2.0, -1.0, 0.3)
    joint = joint_of(prior.as_array() + np.array(off), H, prior.as_array(), L)
    alignment = Alignment(
        target_from_source=Pose2.from_array(joint),
        information=H,
        converged=True,
        iterations=1,
        inliers=1.0,
        rmse_m=0.0,
    )
    alone, covariance = points_alone(alignment, Prior(target_from_source=prior, information=L))
    assert np.linalg.eigvalsh(covariance).min() > 0.0
    whitened = np.sort(np.linalg.eigvalsh(root.T @ covariance @ root))
    np.testing.assert_allclose(whitened[:2], [1 / 8, 1 / 3], rtol=1e-6)
    assert whitened[2] >= 1.0 / max(weak, 1e-6) * (1.0 - 1e-6)
    pulled = axes[:, 0] @ root.T @ (joint - prior.as_array())
    heard = axes[:, 0] @ root.T @ difference(alone, prior)
    assert heard == pytest.approx(pulled, abs=1e-9)
