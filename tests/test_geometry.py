from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.geometry import Array, Pose2, interpolate, readonly, rotation_matrix, wrap_angle

fixed = settings(derandomize=True, deadline=None, max_examples=150)

metres = st.floats(-1e3, 1e3)
angles = st.floats(-50.0, 50.0)
tiny = st.floats(-1e-6, 1e-6)
near_pi = st.builds(lambda sign, off: sign * math.pi + off, st.sampled_from([-1.0, 1.0]), tiny)
# A third near the identity, where closed forms lose digits; a third about the cut at pi.
poses = st.one_of(
    st.builds(Pose2, tiny, tiny, tiny),
    st.builds(Pose2, metres, metres, near_pi),
    st.builds(Pose2, metres, metres, angles),
)
points = st.lists(st.tuples(metres, metres), min_size=0, max_size=8).map(
    lambda rows: np.array(rows, dtype=np.float64).reshape(-1, 2)
)


def matrix(pose: Pose2) -> Array:
    """The homogeneous matrix: the oracle."""
    return np.vstack(
        [np.column_stack([pose.rotation, pose.translation]), np.array([[0.0, 0.0, 1.0]])]
    )


def assert_same(a: Pose2, b: Pose2, tolerance: float = 1e-9) -> None:
    np.testing.assert_allclose(a.translation, b.translation, rtol=tolerance, atol=tolerance)
    assert abs(math.remainder(a.theta_rad - b.theta_rad, math.tau)) <= tolerance


@fixed
@given(a=poses, b=poses, c=poses)
def test_poses_are_a_group(a: Pose2, b: Pose2, c: Pose2) -> None:
    np.testing.assert_allclose(matrix(a @ b), matrix(a) @ matrix(b), rtol=1e-9, atol=1e-9)
    assert_same((a @ b) @ c, a @ (b @ c), 1e-8)
    assert_same(a @ a.inverse(), Pose2.identity())
    assert_same(a.inverse() @ a, Pose2.identity())
    assert_same(a @ Pose2.identity(), a)
    assert_same(Pose2.identity() @ a, a)


@fixed
@given(a=poses, b=poses, cloud=points)
def test_moving_points_is_composing(a: Pose2, b: Pose2, cloud: Array) -> None:
    moved = (a @ b) @ cloud
    assert moved.shape == cloud.shape
    np.testing.assert_allclose(moved, a @ (b @ cloud), rtol=1e-8, atol=1e-8)
    one_by_one = [(a @ b @ Pose2(x, y, 0.0)).translation for x, y in cloud]
    np.testing.assert_allclose(moved, np.reshape(one_by_one, (-1, 2)), rtol=1e-8, atol=1e-8)


@fixed
@given(pose=poses)
def test_log_and_exp_undo_each_other(pose: Pose2) -> None:
    assert_same(Pose2.exp(pose.log()), pose, 1e-7)


@fixed
@given(
    x=st.one_of(metres, tiny),
    y=st.one_of(metres, tiny),
    turn=st.one_of(st.floats(-3.1, 3.1), tiny, st.floats(-2e-4, 2e-4)),
)
def test_exp_is_a_drive_at_constant_twist(x: float, y: float, turn: float) -> None:
    """Oracle: the same twist in 2^k small pieces, and log takes it back."""
    twist = np.array([x, y, turn])
    whole = Pose2.exp(twist)
    half = Pose2.exp(0.5 * twist)
    assert_same(half @ half, whole, 1e-8)
    np.testing.assert_allclose(whole.log(), twist, rtol=1e-7, atol=1e-9)


def test_exp_of_a_quarter_circle_ends_where_it_must() -> None:
    assert_same(Pose2.exp([0.5 * math.pi, 0.0, 0.5 * math.pi]), Pose2(1.0, 1.0, 0.5 * math.pi))


@pytest.mark.parametrize("turn", [9.9e-5, 1.01e-4, -9.9e-5, -1.01e-4])
def test_series_and_closed_form_meet(turn: float) -> None:
    """An arc of length 1 about the switch between the two: exact by its chord."""
    pose = Pose2.exp([1.0, 0.0, turn])
    chord = 2.0 / turn * math.sin(0.5 * turn)
    assert pose.x_m == pytest.approx(chord * math.cos(0.5 * turn), rel=1e-12)
    assert pose.y_m == pytest.approx(chord * math.sin(0.5 * turn), rel=1e-7)
    np.testing.assert_allclose(pose.log(), [1.0, 0.0, turn], rtol=1e-9, atol=1e-11)


@fixed
@given(pose=poses, x=st.floats(-2, 2), y=st.floats(-2, 2), turn=st.floats(-1, 1))
def test_adjoint_carries_a_twist_to_the_other_side(
    pose: Pose2, x: float, y: float, turn: float
) -> None:
    twist = np.array([x, y, turn])
    assert_same(pose @ Pose2.exp(twist), Pose2.exp(pose.adjoint() @ twist) @ pose, 1e-6)


@fixed
@given(angle=st.one_of(st.floats(-1e6, 1e6), near_pi, st.integers(-9, 9).map(lambda k: k * 1.0)))
def test_wrapped_angles_keep_their_direction_and_range(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-8)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-8)
    assert wrap_angle(wrapped) == wrapped
    array = wrap_angle(np.array([[angle]]))
    assert array.shape == (1, 1)
    assert abs(math.remainder(array[0, 0] - wrapped, math.tau)) < 1e-9


@fixed
@given(turns=st.integers(-1000, 1000))
def test_pi_stays_pi_whichever_way_it_came(turns: int) -> None:
    for angle in (math.pi, -math.pi):
        array = wrap_angle(np.array([angle]))
        assert wrap_angle(angle) == math.pi
        assert array[0] == math.pi
    far = math.pi * (2 * turns + 1)
    assert -math.pi < wrap_angle(far) <= math.pi
    assert -math.pi < wrap_angle(np.array([far]))[0] <= math.pi


@pytest.mark.parametrize("cut", [-math.pi, math.pi, 3.0 * math.pi, -3.0 * math.pi])
def test_a_hair_beside_the_cut_is_in_range(cut: float) -> None:
    """The modulus rounds: nothing may come out as minus pi."""
    for towards in (-math.inf, math.inf):
        angle = cut
        for _ in range(4):
            angle = math.nextafter(angle, towards)
            assert -math.pi < wrap_angle(angle) <= math.pi
            assert -math.pi < wrap_angle(np.array([angle]))[0] <= math.pi


@fixed
@given(a=poses, b=poses)
def test_interpolation_meets_both_ends_and_halves(a: Pose2, b: Pose2) -> None:
    if abs(abs((a.inverse() @ b).theta_rad) - math.pi) < 1e-3:
        return  # half a turn has two shortest ways
    assert_same(interpolate(a, b, 0.0), a, 1e-6)
    assert_same(interpolate(a, b, 1.0), b, 1e-6)
    middle = interpolate(a, b, 0.5)
    np.testing.assert_allclose(
        (a.inverse() @ middle).log(), (middle.inverse() @ b).log(), rtol=1e-5, atol=1e-5
    )


def test_not_finite_is_told() -> None:
    assert Pose2(1.0, 2.0, 3.0).is_finite()
    for values in ([math.nan, 0, 0], [0, math.inf, 0], [0, 0, math.nan]):
        assert not Pose2.from_array(values).is_finite()


def test_values_cannot_be_changed() -> None:
    source = np.zeros((3, 2))
    copy = readonly(source)
    source[:] = 1.0
    assert not copy.any()
    with pytest.raises(ValueError, match="read-only"):
        copy[0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        Pose2.identity().x_m = 1.0  # type: ignore[misc]  # what is tested
    np.testing.assert_allclose(
        rotation_matrix(0.5 * math.pi) @ np.array([1.0, 0.0]), [0.0, 1.0], atol=1e-15
    )
