"""Corrections enter the published pose without a jerk, or as a new epoch."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.fusion import Easing, EasingParams, error95_m
from amr_slam.geometry import Pose2

MS = 1_000_000
P = np.diag([1e-4, 1e-4, 1e-5])
PARAMS = EasingParams()
small = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.15, 0.15))


@settings(derandomize=True, deadline=None, max_examples=60)
@given(errors=st.lists(small, min_size=1, max_size=4))
def test_small_corrections_enter_at_a_bounded_speed(
    errors: list[tuple[float, float, float]],
) -> None:
    """A standing robot; corrections every 0.3 s, also while the last one still enters."""
    easing, pose = Easing(PARAMS), Pose2(3.0, -2.0, 3.1)
    shown_before = pose
    for step in range(20 * (len(errors) + 8)):
        now_ns = 15 * MS * step
        if step % 20 == 0 and step // 20 < len(errors):
            shown, _ = easing.applied(now_ns, pose, P)
            pose = pose @ Pose2(*errors[step // 20])
            easing.corrected(now_ns, shown, pose)
        shown, covariance = easing.applied(now_ns, pose, P)
        if easing.epoch == 0:
            turn = shown.theta_rad - shown_before.theta_rad
            # 15 ms at 0.3 m/s and 0.5 rad/s, and less than 0.25 s for a correction at most.
            assert shown.distance_to(shown_before) <= max(0.3, 0.3 / 0.25) * 0.0151
            assert abs(math.remainder(turn, math.tau)) <= max(0.5, 0.2 / 0.25) * 0.0151
        assert shown.distance_to(pose) <= error95_m(covariance)
        assert np.linalg.eigvalsh(covariance - P)[0] >= -1e-12
        shown_before = shown
    assert shown == pose


def test_a_large_correction_is_a_new_epoch_with_its_delta() -> None:
    easing, before = Easing(PARAMS), Pose2(1.0, 2.0, 3.0)
    after = Pose2(1.5, 1.9, -3.1)
    easing.corrected(5 * MS, before, after)
    assert easing.epoch == 1
    assert easing.delta is not None
    np.testing.assert_allclose(easing.delta.as_array(), [0.5, -0.1, math.tau - 6.1], atol=1e-12)
    assert easing.applied(5 * MS, after, P) == (after, P)


@pytest.mark.parametrize("size_m", [0.001, 0.1])
def test_a_jump_is_a_jump_however_small(size_m: float) -> None:
    easing = Easing(PARAMS)
    easing.corrected(0, Pose2.identity(), Pose2(size_m, 0.0, 0.0), is_jump=True)
    assert easing.epoch == 1
    assert easing.applied(0, Pose2(size_m, 0.0, 0.0), P)[0].x_m == size_m


def test_without_a_duration_corrections_enter_at_once() -> None:
    easing = Easing(EasingParams(duration_s=0.0))
    there = Pose2(0.9, 0.0, 0.0)
    easing.corrected(0, Pose2.identity(), there)
    assert easing.applied(0, there, P)[0] == there
    assert easing.epoch == 0
