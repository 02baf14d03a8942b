from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.fusion import Calibration, CalibrationParams, FilterParams, PoseFilter, error95_m
from amr_slam.fusion.composing import Composed
from amr_slam.fusion.ekf import MEASURED, STATES, Ekf, residual, seen
from amr_slam.fusion.trail import Trail
from amr_slam.geometry import Array, Pose2, wrap_angle
from amr_slam.odometry import DifferentialDrive
from amr_slam.samples import Motion, Outcome, SlamPose, WheelSample

S = 1_000_000_000
STEP_NS = 100_000_000
SIGMA = np.array([0.015, 0.015, 0.005])
R = np.diag(SIGMA**2)
PLAIN = FilterParams(
    fix_inflation=1.0,
    map_error_m=0.0,
    map_error_rad=0.0,
    calibration=CalibrationParams(learn=False),
)
DRIVE = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)


def arc(
    start_ns: int, forward_m: float = 0.03, turn_rad: float = 0.01, step_ns: int = STEP_NS
) -> Motion:
    left, right = forward_m - 0.25 * turn_rad, forward_m + 0.25 * turn_rad
    return DRIVE.motion(
        WheelSample(stamp_ns=start_ns, left_rad=0.0, right_rad=0.0),
        WheelSample(stamp_ns=start_ns + step_ns, left_rad=left / 0.1, right_rad=right / 0.1),
    )


def fix(stamp_ns: int, pose: Pose2, covariance: Array = R) -> SlamPose:
    return SlamPose(stamp_ns=stamp_ns, map_from_base=pose, covariance=covariance)


def driven(steps: int, params: FilterParams = PLAIN, pose: Pose2 | None = None) -> PoseFilter:
    fused = PoseFilter(params, 0, pose or Pose2(1.0, 2.0, 3.1), R)
    for k in range(steps):
        assert fused.predict(arc(k * STEP_NS)) is Outcome.ACCEPTED
    return fused


def with_derivatives(ekf: Ekf, x: Array, P: Array, motion: Composed) -> Array:
    """The Jacobian of a prediction: by differences, and by what the wheels say of their own."""
    F = np.empty((STATES, STATES))
    for column, nudge in enumerate(1e-5 * np.eye(STATES)):
        apart = ekf.predicted(x + nudge, P, motion)[0] - ekf.predicted(x - nudge, P, motion)[0]
        F[:, column] = apart / 2e-5
    turn_rad = x[2] + motion.delta.theta_rad
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    F[:3, 3:7] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ motion.by_calibration
    return F


@pytest.mark.parametrize("seed", range(20))
def test_prediction_and_update_are_filterpys(seed: int) -> None:
    rng = np.random.default_rng(seed)
    params = FilterParams()
    ekf = Ekf(params)
    sigmas = np.array([0.05, 0.05, 0.02, *0.3 * params.calibration.sigmas, 0.01, 0.01, 0.002])
    x = np.array([3.0, 3.0, 0.5, *7 * [0.0]]) * rng.normal(0.0, 1.0, STATES) + sigmas
    root = sigmas[:, None] * rng.normal(0.0, 0.3, (STATES, STATES))
    P = root @ root.T
    noise = rng.normal(0.0, 0.003, (3, 3))
    motion = Composed(
        delta=Pose2(*rng.normal(0.0, [0.5, 0.1, 0.3])),
        noise=noise @ noise.T,
        by_calibration=rng.normal(0.0, 0.5, (3, 4)),
        travel_m=0.5,
        turn_rad=0.3,
    )
    known = ExtendedKalmanFilter(dim_x=STATES, dim_z=3)
    known.predict_x = lambda _: None
    known.P, known.F = P, with_derivatives(ekf, x, P, motion)
    known.Q = ekf.predicted(x, np.zeros((STATES, STATES)), motion)[1]
    known.predict()
    prior, P_prior = ekf.predicted(x, P, motion)
    np.testing.assert_allclose(P_prior, known.P, atol=1e-9)

    z = seen(prior) + rng.normal(0.0, SIGMA)
    known.x, known.P = prior, P_prior
    known.update(z, HJacobian=lambda _: MEASURED, Hx=seen, R=R, residual=residual)
    known.x[2] = wrap_angle(float(known.x[2]))
    after, P_after = ekf.updated(prior, P_prior, z, R)
    np.testing.assert_allclose(after, known.x, atol=1e-9)
    np.testing.assert_allclose(P_after, known.P, atol=1e-9)


def pose_at(fused: PoseFilter, stamp_ns: int) -> Pose2:
    found = fused.pose_at(stamp_ns)
    assert found is not None
    return found[0]


def assert_sound(pose: Pose2, P: Array) -> None:
    assert pose.is_finite()
    assert -math.pi < pose.theta_rad <= math.pi
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] > 0.0


def assert_same(one: PoseFilter, other: PoseFilter) -> None:
    difference = one.map_from_base.as_array() - other.map_from_base.as_array()
    difference[2] = wrap_angle(float(difference[2]))
    np.testing.assert_allclose(difference, 0.0, atol=1e-9)
    np.testing.assert_allclose(one.covariance, other.covariance, atol=1e-9)
    for learned in fields(Calibration):
        ours, theirs = (getattr(fused.calibration, learned.name) for fused in (one, other))
        assert ours == pytest.approx(theirs, abs=1e-9)
    assert one.since_fix_s == other.since_fix_s
    assert one.since_fix_m == pytest.approx(other.since_fix_m, abs=1e-9)


# -- prediction


def test_prediction_is_the_stepwise_ekf_of_the_textbook() -> None:
    x, P = np.array([1.0, 2.0, 3.1]), R
    fused = PoseFilter(PLAIN, 0, Pose2.from_array(x), P)
    for k in range(60):
        motion = arc(k * STEP_NS, 0.03 + 0.001 * k, 0.05 * math.sin(k))
        c, s = math.cos(x[2]), math.sin(x[2])
        dx, dy = motion.delta.x_m, motion.delta.y_m
        F = np.array([[1, 0, -s * dx - c * dy], [0, 1, c * dx - s * dy], [0, 0, 1]])
        x = x + np.array([c * dx - s * dy, s * dx + c * dy, motion.delta.theta_rad])
        turned = np.eye(3)
        turned[:2, :2] = Pose2(0.0, 0.0, x[2]).rotation
        P = F @ P @ F.T + turned @ motion.covariance @ turned.T
        fused.predict(motion)
    np.testing.assert_allclose(fused.map_from_base.as_array()[:2], x[:2], atol=1e-12)
    assert fused.map_from_base.theta_rad == pytest.approx(wrap_angle(float(x[2])), abs=1e-12)
    np.testing.assert_allclose(fused.covariance, P, atol=1e-15, rtol=1e-9)


def test_standing_keeps_the_covariance_for_ever() -> None:
    fused = PoseFilter(PLAIN, 0, Pose2(5.0, -3.0, 1.0), R)
    for k in range(400):
        fused.predict(arc(k * STEP_NS, 0.0, 0.0))
    np.testing.assert_array_equal(fused.covariance, R)
    assert fused.map_from_base == Pose2(5.0, -3.0, 1.0)


def test_far_dead_reckoning_is_the_wheels_alone() -> None:
    """Across many cuts of the history nothing is lost, and P only grows."""
    fused = driven(600, pose=Pose2.identity())
    by_hand = Pose2.identity()
    for _ in range(600):
        by_hand = by_hand @ arc(0).delta
    np.testing.assert_allclose(fused.map_from_base.as_array(), by_hand.as_array(), atol=1e-10)
    np.testing.assert_allclose(fused.odom_from_base.as_array(), by_hand.as_array(), atol=1e-12)
    assert fused.since_fix_s == pytest.approx(60.0)
    assert fused.since_fix_m == pytest.approx(18.0, rel=1e-4)
    assert np.trace(fused.covariance) > np.trace(driven(300).covariance)


def test_only_the_motion_that_continues_is_taken() -> None:
    fused = driven(5)
    before = fused.map_from_base
    broken = arc(5 * STEP_NS)
    nan = replace(broken, delta=Pose2(math.nan, 0.0, 0.0))
    indefinite = replace(broken, covariance=np.diag([1.0, -1.0, 1.0]))
    skewed = replace(broken, covariance=np.eye(3) + np.eye(3, k=1))
    infinite = replace(broken, covariance=np.diag([math.inf, 1.0, 1.0]))
    for motion in (nan, indefinite, skewed, infinite, arc(6 * STEP_NS)):
        assert fused.predict(motion) is Outcome.INVALID
    assert fused.predict(arc(4 * STEP_NS)) is Outcome.DUPLICATE
    assert fused.predict(arc(3 * STEP_NS)) is Outcome.LATE
    assert fused.map_from_base == before
    assert fused.stamp_ns == 5 * STEP_NS


# -- corrections


def test_a_fix_corrects_at_its_own_stamp_and_wheels_are_replayed() -> None:
    """Against the equations: update at the stamp, then the exact motion since."""
    fused = driven(50)
    at_ns = 2 * S + 30_000_000
    prior = fused.pose_at(at_ns)
    assert prior is not None
    z = prior[0].as_array() + np.array([0.02, -0.01, 0.004])
    gain = prior[1] @ np.linalg.inv(prior[1] + R)
    x = prior[0].as_array() + gain @ (z - prior[0].as_array())
    assert fused.correct(fix(at_ns, Pose2.from_array(z))) is Outcome.ACCEPTED
    since = fused.motion_between(at_ns, fused.stamp_ns)
    assert since is not None
    expected = Pose2.from_array(x) @ since.delta
    np.testing.assert_allclose(fused.map_from_base.as_array(), expected.as_array(), atol=1e-12)
    np.testing.assert_allclose(pose_at(fused, at_ns).as_array(), x, atol=1e-12)
    assert fused.since_fix_s == pytest.approx(5.0 - 2.03)
    assert fused.since_fix_m == pytest.approx(0.03 * 29.7, rel=1e-3)
    before = fused.pose_at(at_ns - 1)
    assert before is not None
    np.testing.assert_allclose(before[0].as_array(), prior[0].as_array(), atol=1e-6)


def test_the_yaw_innovation_is_wrapped() -> None:
    fused = driven(0, pose=Pose2(0.0, 0.0, math.pi - 0.002))
    fused.predict(arc(0, 0.0, 0.0))
    assert fused.correct(fix(STEP_NS, Pose2(0.0, 0.0, -math.pi + 0.006))) is Outcome.ACCEPTED
    assert fused.map_from_base.theta_rad == pytest.approx(-math.pi + 0.002, abs=1e-9)


@pytest.mark.parametrize(
    ("d2", "outcome"),
    [
        (16.2, Outcome.ACCEPTED),
        (16.4, Outcome.INFLATED),
        (30.6, Outcome.INFLATED),
        (30.8, Outcome.GATED),
    ],
)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_gate_is_on_the_squared_distance(d2: float, outcome: Outcome, axis: int) -> None:
    fused = driven(20)
    at_ns = 10 * STEP_NS
    prior = fused.pose_at(at_ns)
    assert prior is not None
    before = pose_at(fused, fused.stamp_ns)
    S_ = prior[1] + R
    offset = np.zeros(3)
    offset[axis] = math.sqrt(d2 / np.linalg.inv(S_)[axis, axis])
    far = fix(at_ns, Pose2.from_array(prior[0].as_array() + offset))
    assert fused.correct(far) is outcome
    innovation = fused.last_innovation
    assert innovation is not None
    assert innovation.d2 == pytest.approx(d2)
    assert (innovation.stamp_ns, innovation.dof, innovation.outcome) == (at_ns, 3, outcome)
    if outcome is Outcome.GATED:
        np.testing.assert_allclose(
            fused.map_from_base.as_array(), before.as_array(), rtol=0, atol=1e-12
        )
    else:
        P, scale = prior[1], 1.0
        if outcome is Outcome.INFLATED:  # the wheels slipped, or the fix is poor: half and half
            motion = fused.motion_between(0, at_ns)
            assert motion is not None
            turn = Pose2(0.0, 0.0, prior[0].theta_rad).adjoint()
            P, scale = P + 100.0 * turn @ motion.covariance @ turn.T, d2 / 16.27
        gain = P @ np.linalg.inv(P + scale * R)
        moved = pose_at(fused, at_ns).as_array() - prior[0].as_array()
        np.testing.assert_allclose(moved, gain @ offset, atol=1e-12)


@pytest.mark.parametrize("jump_m", [1.0, 20.0])
def test_two_outliers_move_the_published_pose_less_than_a_centimetre(jump_m: float) -> None:
    clean, hit = driven(0, FilterParams()), driven(0, FilterParams())
    for k in range(200):
        for fused in (clean, hit):
            fused.predict(arc(k * STEP_NS))
        if k % 20 == 19:
            at_ns = (k - 5) * STEP_NS
            good = pose_at(clean, at_ns)
            clean.correct(fix(at_ns, good))
            outlier = k in {99, 119}
            shifted = Pose2(good.x_m + jump_m * outlier, good.y_m, good.theta_rad)
            taken = hit.correct(fix(at_ns, shifted))
            assert taken is (Outcome.GATED if outlier else Outcome.ACCEPTED)
        now_ns = hit.stamp_ns + 15_000_000
        apart = hit.estimate_at(now_ns).map_from_base.distance_to(
            clean.estimate_at(now_ns).map_from_base
        )
        assert apart < 0.01


def test_each_reason_to_refuse_a_fix() -> None:
    fused = driven(150)
    now_ns, good = fused.stamp_ns, fused.map_from_base
    params = PLAIN
    late_ns = now_ns - round(params.history_s * S) - 1
    assert fused.correct(fix(late_ns, good)) is Outcome.LATE
    assert fused.correct(fix(now_ns + 5_000_001, good)) is Outcome.FUTURE
    assert fused.correct(fix(now_ns - S, pose_at(fused, now_ns - S))) is Outcome.ACCEPTED
    assert fused.correct(fix(now_ns - S, pose_at(fused, now_ns - S))) is Outcome.DUPLICATE
    bad: list[tuple[Pose2, Array]] = [
        (Pose2(math.nan, 0.0, 0.0), R),
        (Pose2(0.0, math.inf, 0.0), R),
        (Pose2(0.0, 0.0, math.nan), R),
        (good, np.diag([1e-4, 1e-4, math.nan])),
        (good, np.diag([1e-4, -1e-4, 1e-4])),
        (good, np.zeros((3, 3))),
        (good, np.eye(3) + np.eye(3, k=1)),
        (good, np.eye(2)),
        (Pose2(1e12, 0.0, 0.0), R),
    ]
    before = fused.map_from_base, fused.covariance.copy()
    for pose, covariance in bad:
        assert fused.correct(fix(now_ns - 2 * S, pose, covariance)) is Outcome.INVALID
        assert fused.reset(now_ns, pose, covariance) is Outcome.INVALID
        with pytest.raises(ValueError, match="first pose"):
            PoseFilter(params, 0, pose, covariance)
    assert fused.map_from_base == before[0]
    np.testing.assert_array_equal(fused.covariance, before[1])
    assert fused.epoch == 0


def test_numbers_gone_wrong_leave_the_last_good_state(monkeypatch: pytest.MonkeyPatch) -> None:
    fused = driven(20)
    before = fused.map_from_base

    def overflow(*_: object) -> tuple[Array, Array]:
        return np.full(3, math.nan), np.full((3, 3), math.inf)

    monkeypatch.setattr(Ekf, "updated", overflow)
    assert fused.correct(fix(S, pose_at(fused, S))) is Outcome.INVALID
    np.testing.assert_allclose(fused.map_from_base.as_array(), before.as_array(), atol=1e-12)
    assert_sound(fused.map_from_base, fused.covariance)


def test_no_correction_goes_below_the_floor_in_any_direction() -> None:
    fused = driven(0, pose=Pose2(0.0, 0.0, 0.7))
    thin = Pose2(0.0, 0.0, 0.7).adjoint() @ np.diag([1e-9, 1e-4, 1e-9])
    accepted = Outcome.ACCEPTED
    thin = thin @ Pose2(0.0, 0.0, 0.7).adjoint().T
    for k in range(20):
        fused.predict(arc(k * STEP_NS, 0.0, 0.0))
        covariance = 0.5 * (thin + thin.T)
        assert fused.correct(fix(fused.stamp_ns, fused.map_from_base, covariance)) is accepted
    variances = np.linalg.eigvalsh(fused.covariance[:2, :2])
    assert variances[0] >= PLAIN.floor_xy_m**2 * (1.0 - 1e-9)
    assert fused.covariance[2, 2] >= PLAIN.floor_yaw_rad**2 * (1.0 - 1e-9)


# -- any order of arrival

fixes_of = st.lists(
    st.tuples(
        st.integers(1, 8 * S),
        st.floats(-0.06, 0.06),
        st.floats(-0.06, 0.06),
        st.floats(-0.02, 0.02),
        st.integers(0, 9 * S),
    ),
    min_size=1,
    max_size=7,
    unique_by=lambda item: item[0],
)


def replayed(arrivals: Sequence[tuple[int, SlamPose]], params: FilterParams = PLAIN) -> PoseFilter:
    """Wheels for 9 s; each fix handed over at its time of arrival (ns)."""
    fused = PoseFilter(params, 0, Pose2(1.0, 2.0, 3.1), R)
    waiting = sorted(arrivals, key=lambda item: item[0])
    for k in range(90):
        fused.predict(arc(k * STEP_NS, 0.03, 0.1 * math.sin(0.2 * k)))
        while waiting and waiting[0][0] <= fused.stamp_ns:
            _, slam = waiting.pop(0)
            taken = fused.correct(slam)
            assert taken in {Outcome.ACCEPTED, Outcome.INFLATED, Outcome.GATED}
        if k % 10 == 0:
            assert_sound(fused.map_from_base, fused.covariance)
    for _, slam in waiting:
        fused.correct(slam)
    return fused


@pytest.mark.parametrize("params", [PLAIN, FilterParams()], ids=["plain", "learning"])
@settings(derandomize=True, deadline=None, max_examples=20)
@given(items=fixes_of)
def test_any_order_of_arrival_gives_the_same_state(
    params: FilterParams, items: list[tuple[int, float, float, float, int]]
) -> None:
    truth = replayed([], params)
    slam = [
        fix(at, Pose2.from_array(pose_at(truth, at).as_array() + np.array([dx, dy, dt])))
        for at, dx, dy, dt, _ in items
    ]
    in_order = replayed([(s.stamp_ns, s) for s in slam], params)
    as_they_came = replayed(
        [(s.stamp_ns + item[4], s) for s, item in zip(slam, items, strict=True)], params
    )
    all_at_the_end = replayed([(100 * S, s) for s in reversed(slam)], params)
    # Up to 5 ms before the wheels reach the stamp: taken at once, put in its place afterwards.
    early = replayed([(s.stamp_ns - 5_000_000, s) for s in slam], params)
    for other in (as_they_came, all_at_the_end, early):
        assert_same(in_order, other)


def test_a_fix_ahead_of_the_wheels_finds_its_place_when_they_come() -> None:
    early, in_order = driven(20), driven(20)
    at_ns = 2 * S + 4_000_000
    slam = fix(at_ns, Pose2.from_array(in_order.map_from_base.as_array() + SIGMA))
    assert early.correct(slam) is Outcome.ACCEPTED
    assert early.since_fix_m == pytest.approx(0.0)
    for fused in (early, in_order):
        fused.predict(arc(2 * S))
    assert in_order.correct(slam) is Outcome.ACCEPTED
    assert_same(early, in_order)


def test_a_fix_across_a_cut_of_the_history_is_the_same_late() -> None:
    prompt, late = driven(0), driven(0)
    for k in range(140):
        for fused in (prompt, late):
            fused.predict(arc(k * STEP_NS))
        if k == 60:
            at_ns = 5 * S + 12_345
            slam = fix(at_ns, Pose2.from_array(pose_at(prompt, at_ns).as_array() + SIGMA))
            assert prompt.correct(slam) is Outcome.ACCEPTED
    assert late.correct(slam) is Outcome.ACCEPTED
    assert_same(prompt, late)
    for fused in (prompt, late):
        for k in range(140, 300):
            fused.predict(arc(k * STEP_NS))
    assert_same(prompt, late)


def test_a_late_fix_vindicates_one_that_was_gated() -> None:
    fused = driven(60)
    seen = {at: pose_at(fused, at).as_array() for at in (4 * S, 5 * S)}
    slip = np.array([-0.115, 0.0, 0.0])
    assert fused.correct(fix(5 * S, Pose2.from_array(seen[5 * S] + 1.2 * slip))) is Outcome.GATED
    assert fused.since_fix_s == pytest.approx(6.0)
    assert fused.correct(fix(4 * S, Pose2.from_array(seen[4 * S] + slip))) is Outcome.INFLATED
    assert fused.since_fix_s == pytest.approx(1.0)
    assert fused.map_from_base.x_m < seen[5 * S][0] - 0.05


# -- reset, queries, extrapolation


def test_after_an_outage_the_caller_can_reset_within_one_fix() -> None:
    fused = driven(130)
    odom = fused.odom_from_base
    at_ns = fused.stamp_ns - S
    off = pose_at(fused, at_ns)
    there = Pose2(off.x_m + 2.0, off.y_m - 1.0, off.theta_rad)
    assert fused.correct(fix(at_ns, there)) is Outcome.GATED
    assert fused.reset(at_ns, there, R) is Outcome.RESET
    assert fused.epoch == 1
    assert fused.odom_from_base == odom
    since = fused.motion_between(at_ns, fused.stamp_ns)
    assert since is not None
    np.testing.assert_allclose(
        fused.map_from_base.as_array(), (there @ since.delta).as_array(), atol=1e-12
    )
    assert fused.since_fix_s == pytest.approx(1.0)
    assert fused.correct(fix(at_ns - 1, off)) is Outcome.LATE
    assert fused.correct(fix(at_ns, there)) is Outcome.DUPLICATE
    assert fused.pose_at(at_ns - 1) is None
    assert fused.reset(fused.stamp_ns + S, there, R) is Outcome.FUTURE
    assert fused.reset(-S, there, R) is Outcome.LATE
    for k in range(130, 400):
        fused.predict(arc(k * STEP_NS))
    assert_sound(fused.map_from_base, fused.covariance)


def test_motions_between_instants_compose_and_reverse() -> None:
    fused = driven(50)
    a, b, c = S + 12_345_678, 2 * S + 87_654_321, 4 * S
    ab, bc, ac = (fused.motion_between(*ends) for ends in ((a, b), (b, c), (a, c)))
    assert ab is not None
    assert bc is not None
    assert ac is not None
    np.testing.assert_allclose((ab.delta @ bc.delta).as_array(), ac.delta.as_array(), atol=1e-12)
    carry = bc.delta.inverse().adjoint()
    composed = carry @ ab.covariance @ carry.T + bc.covariance
    # Where a question cuts a step, its noise is shared by time: exact to a thousandth.
    np.testing.assert_allclose(composed, ac.covariance, atol=1e-7, rtol=2e-3)
    back = fused.motion_between(c, a)
    assert back is not None
    np.testing.assert_allclose((ac.delta @ back.delta).as_array(), np.zeros(3), atol=1e-12)
    assert np.linalg.eigvalsh(back.covariance)[0] > -1e-15
    assert fused.motion_between(-1, a) is None
    assert fused.motion_between(a, fused.stamp_ns + 5_000_001) is None
    assert fused.pose_at(fused.stamp_ns + 5_000_001) is None
    ahead = fused.estimate_at(fused.stamp_ns + 5_000_000)
    assert pose_at(fused, fused.stamp_ns + 5_000_000) == ahead.map_from_base


def test_a_gap_shows_in_every_motion_over_it() -> None:
    fused = driven(10)
    fused.predict(DRIVE.silence(S, 2 * S))
    fused.predict(arc(2 * S))
    over = fused.motion_between(S - STEP_NS, 2 * S + STEP_NS)
    before, after = fused.motion_between(0, S), fused.motion_between(2 * S, 2 * S + STEP_NS)
    assert over is not None
    assert over.gap
    assert before is not None
    assert not before.gap
    assert after is not None
    assert not after.gap
    assert math.sqrt(fused.covariance[0, 0]) == pytest.approx(2.0 * 1.02, rel=0.1)


def test_a_gap_longer_than_the_history_is_survived() -> None:
    fused = driven(10)
    fused.predict(DRIVE.silence(S, 31 * S))
    for k in range(200):
        assert fused.predict(arc(31 * S + k * STEP_NS)) is Outcome.ACCEPTED
    assert_sound(fused.map_from_base, fused.covariance)


def test_extrapolation_goes_on_for_a_tenth_of_a_second() -> None:
    fused = driven(20)
    now_ns = fused.stamp_ns
    at_rest = fused.estimate_at(now_ns)
    assert at_rest.map_from_base == fused.map_from_base
    assert at_rest.vx_mps == pytest.approx(0.3, rel=1e-3)
    assert at_rest.omega_radps == pytest.approx(0.1, rel=1e-9)
    soon = fused.estimate_at(now_ns + 50_000_000)
    expected = fused.map_from_base @ Pose2.exp([0.015, 0.0, 0.005])
    np.testing.assert_allclose(soon.map_from_base.as_array(), expected.as_array(), atol=1e-9)
    assert soon.stamp_ns == now_ns + 50_000_000
    assert np.linalg.eigvalsh(soon.covariance - at_rest.covariance)[2] > 0.0
    far = fused.estimate_at(now_ns + 5 * S)
    assert far.stamp_ns == now_ns + 100_000_000
    assert np.trace(far.covariance) > np.trace(soon.covariance)
    assert fused.estimate_at(now_ns - S).stamp_ns == now_ns
    assert fused.map_from_base == at_rest.map_from_base
    fresh = driven(0).estimate_at(10_000_000)
    assert (fresh.vx_mps, fresh.omega_radps, fresh.stamp_ns) == (0.0, 0.0, 10_000_000)


def test_extrapolation_is_as_unsure_as_the_wheels_would_have_been() -> None:
    steady = FilterParams(acceleration_mps2=0.0, turn_acceleration_radps2=0.0)
    fused = driven(20, steady)
    ahead = fused.estimate_at(fused.stamp_ns + STEP_NS)
    fused.predict(arc(fused.stamp_ns))
    np.testing.assert_allclose(
        ahead.map_from_base.as_array(), fused.map_from_base.as_array(), atol=1e-12
    )
    np.testing.assert_allclose(ahead.covariance, fused.covariance, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(
        ahead.odom_from_base.as_array(), fused.odom_from_base.as_array(), atol=1e-12
    )


def test_the_second_gate_must_be_the_wider() -> None:
    with pytest.raises(ValueError, match="gate_d2_inflated"):
        FilterParams(gate_d2=20.0, gate_d2_inflated=10.0)


def test_the_trail_refuses_what_does_not_continue_it() -> None:
    trail = Trail(0)
    with pytest.raises(ValueError, match="does not continue"):
        trail.append(arc(1))
    with pytest.raises(ValueError, match="outside the trail"):
        trail.between(0, 1)


# -- is the covariance true?


def nees_of_one_run(seed: int, params: FilterParams, correlation: float) -> list[float]:
    """30 s at 10 Hz; a fix every 2 s, 0.3 to 3 s old on arrival, so that some overtake others.

    ``correlation``: of the errors of successive fixes.
    """
    rng = np.random.default_rng(seed)
    dt_s = 0.1
    error = rng.standard_normal(3)
    truth = Pose2.identity()
    fused = PoseFilter(params, 0, Pose2.from_array(error * SIGMA), R)
    under_way: list[tuple[int, SlamPose]] = []
    nees = []
    for k in range(300):
        turn = 0.03 * math.sin(0.02 * k + seed)
        motion = arc(k * STEP_NS, 0.3 * dt_s, turn)
        fused.predict(motion)
        left, right = 0.03 - 0.25 * turn, 0.03 + 0.25 * turn
        left += rng.normal(0.0, math.sqrt(DRIVE.wheel_m2_per_m * abs(left)))
        right += rng.normal(0.0, math.sqrt(DRIVE.wheel_m2_per_m * abs(right)))
        scrub = rng.normal(0.0, math.sqrt(DRIVE.yaw_rad2_per_m * 0.03))
        truth = truth @ Pose2.exp([0.5 * (left + right), 0.0, (right - left) / 0.5 + scrub])
        now_ns = motion.end_ns
        if k % 20 == 19:
            fresh = math.sqrt(1.0 - correlation**2)
            error = correlation * error + fresh * rng.standard_normal(3)
            found = Pose2.from_array(truth.as_array() + error * SIGMA)
            under_way.append((now_ns + round(rng.uniform(0.3, 3.0) * S), fix(now_ns, found)))
        for item in [item for item in under_way if item[0] <= now_ns]:
            fused.correct(item[1])
            under_way.remove(item)
        if k % 10 == 9 and k >= 40:
            off = fused.map_from_base.as_array() - truth.as_array()
            off[2] = wrap_angle(float(off[2]))
            nees.append(float(off @ np.linalg.solve(fused.covariance, off)))
    return nees


def test_the_covariance_is_true() -> None:
    """Normalized error squared of 100 runs: 3 is honest, [2.26, 3.87] is 99.9 % of chi2."""
    runs = [nees_of_one_run(seed, PLAIN, 0.0) for seed in range(100)]
    assert 2.26 <= float(np.mean(runs)) <= 3.87


def test_fixes_of_one_map_share_its_error() -> None:
    """However many fixes a standing robot gets, it knows the place no better than the map does."""
    params = FilterParams(floor_xy_m=0.0, floor_yaw_rad=0.0)
    fused = PoseFilter(params, 0, Pose2.identity(), R)
    fused.predict(arc(0, 0.0, 0.0, step_ns=30 * S))
    for k in range(1, 200):
        fused.correct(fix(21 * S + k * 1_000_000, Pose2(0.001, 0.0, 0.0), 0.1 * R))
    sigmas = np.sqrt(np.diag(fused.covariance))
    # What was known at the start tells something of the map's error there.
    assert 0.9 * params.map_error_m < sigmas[0] < params.map_error_m
    assert 0.9 * params.map_error_rad < sigmas[2] < params.map_error_rad


# -- what is learned of the wheels


def wrong_wheels(
    travel: float = 0.0, yaw: float = 0.0, bend: float = 0.0, lag_s: float = 0.0
) -> tuple[PoseFilter, list[Pose2]]:
    """60 s of driving with wheels that are wrong, an exact fix every 2 s; the filter, the truth."""
    fused = PoseFilter(FilterParams(), 0, Pose2.identity(), R)
    step_s, late = 0.02, round(lag_s / 0.02)
    ways = [0.02 * max(0.0, math.sin(0.05 * 2.0 * k * step_s + 1.0)) for k in range(3000)]
    turns = [0.016 * math.sin(0.4 * k * step_s) for k in range(3000)]
    truth = [Pose2.identity()]
    for way, turn in zip(ways, turns, strict=True):
        truth.append(truth[-1] @ Pose2.exp([way, 0.0, turn]))
    for k in range(3000):
        at = k - late
        way, turn = (ways[at], turns[at]) if 0 <= at < 3000 else (0.0, 0.0)
        seen = way / (1.0 + travel)
        fused.predict(arc(k * STEP_NS // 5, seen, (turn - bend * seen) / (1.0 + yaw), STEP_NS // 5))
        if k % 100 == 99:
            fused.correct(fix((k - 24) * STEP_NS // 5, truth[k - 24], 0.1 * R))
    return fused, truth


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"travel": 0.04},
        {"yaw": -0.08},
        {"bend": 0.03},
        {"lag_s": 0.1},
        {"lag_s": -0.1},
        {"travel": -0.03, "yaw": 0.05, "bend": -0.02, "lag_s": 0.06},
    ],
)
def test_wheels_are_learned_while_driving(wrong: dict[str, float]) -> None:
    fused, truth = wrong_wheels(**wrong)
    known, believed = fused.calibration, FilterParams().calibration
    for value, sigma, before, true in (
        (known.travel, known.travel_sigma, believed.travel_sigma, wrong.get("travel", 0.0)),
        (known.yaw, known.yaw_sigma, believed.yaw_sigma, wrong.get("yaw", 0.0)),
        (known.bend_radpm, known.bend_sigma_radpm, believed.bend_radpm, wrong.get("bend", 0.0)),
        (known.lag_s, known.lag_sigma_s, believed.lag_sigma_s, wrong.get("lag_s", 0.0)),
    ):
        assert abs(value - true) < 3.0 * sigma + 0.002
        assert sigma < 0.5 * before
    # Between two fixes the pose is right although the wheels are not.
    assert fused.map_from_base.distance_to(truth[-1]) < 0.01


def test_a_standing_robot_learns_nothing_and_forgets_nothing() -> None:
    fused, _ = wrong_wheels(travel=0.04, yaw=-0.08)
    known, place = fused.calibration, fused.map_from_base
    rng = np.random.default_rng(0)
    for _ in range(100):
        fused.predict(arc(fused.stamp_ns, 0.0, 0.0, 2 * S))
        off = place.as_array() + rng.normal(0.0, 0.003, 3)
        assert fused.correct(fix(fused.stamp_ns - S, Pose2.from_array(off))) is Outcome.ACCEPTED
    after = fused.calibration
    # Where the robot stands becomes known better, and with it how it came there: a hair.
    assert after.travel == pytest.approx(known.travel, abs=known.travel_sigma)
    assert after.lag_s == pytest.approx(known.lag_s, abs=known.lag_sigma_s)
    # (The way since the last fix on the drive counts yet.)
    assert after.travel_sigma <= 1.02 * known.travel_sigma
    assert after.yaw_sigma <= 1.02 * known.yaw_sigma


def test_wheels_that_report_reverse_as_forward_are_outvoted() -> None:
    """For 40 s the robot drives back and forth and its wheels know no backwards; then they do."""
    params = FilterParams()
    fused = PoseFilter(params, 0, Pose2.identity(), R)
    truth = [Pose2.identity()]
    silent_s = 0.0
    for k in range(3000):
        way = 0.006 * math.sin(0.02 * k * 0.3)
        truth.append(truth[-1] @ Pose2.exp([way, 0.0, 0.002]))
        said = abs(way) if k < 2000 else way
        fused.predict(arc(k * STEP_NS // 5, said, 0.002, STEP_NS // 5))
        if k % 100 == 99:
            fused.correct(fix((k - 24) * STEP_NS // 5, truth[k - 24]))
            silent_s = max(silent_s, fused.since_fix_s)
    assert silent_s < 14.0
    assert fused.map_from_base.distance_to(truth[-1]) < 0.05
    known = fused.calibration
    assert abs(known.travel) <= params.calibration.travel_limit
    assert abs(known.lag_s) <= params.calibration.lag_limit_s


def test_what_a_motion_owes_to_the_calibration_is_its_derivative() -> None:
    trail = Trail(0)
    for k in range(300):
        trail.append(arc(k * STEP_NS // 5, 0.01 * (1.0 + math.sin(0.03 * k)), 0.02, STEP_NS // 5))
    for ends in ((S, 4 * S), (4 * S + 7_654_321, S + 1_234_567)):
        composed = trail.compose(*ends)
        for column, step in enumerate((1e-5, 1e-5, 1e-5, 1e-3)):
            nudged = [trail.compose(*ends, way * step * np.eye(4)[column]) for way in (-1.0, 1.0)]
            slope = (nudged[0].delta.inverse() @ nudged[1].delta).log() / (2.0 * step)
            # The lag's speeds are means over 0.4 s.
            atol = 0.02 if column == 3 else 1e-3
            np.testing.assert_allclose(composed.by_calibration[:, column], slope, atol=atol)


def test_what_the_wheels_missed_is_spread_over_the_steps_by_their_noise() -> None:
    """All that a fix says of the way is found again in its steps, and the way itself stays."""
    trail = Trail(0)
    for k in range(100):
        trail.append(arc(k * STEP_NS, 0.03 * (1.0 + math.sin(0.1 * k)), 0.02, STEP_NS))
    plain = trail.compose(S, 6 * S)
    pull = np.array([2.0, -3.0, 1.5])
    pulled = trail.compose(S, 6 * S, pull=pull)
    assert pulled.delta == plain.delta
    np.testing.assert_array_equal(pulled.noise, plain.noise)
    missed = plain.noise @ pull
    # A turn's error is the scale's share of the whole turn, a bend's of the whole way.
    assert pulled.by_calibration[2, 1] == pytest.approx(plain.delta.theta_rad + missed[2])
    far = trail.compose(S, 6 * S, pull=np.zeros(3))
    np.testing.assert_array_equal(far.by_calibration, plain.by_calibration)


def test_the_noise_is_of_what_the_wheels_report() -> None:
    """Wheels that report half of the way and a quarter of the turn: the rest is noise, too."""
    trail = Trail(0)
    for k in range(20):
        trail.append(arc(k * STEP_NS, turn_rad=0.0))
    plain, stretched = (
        trail.compose(0, 20 * STEP_NS, np.array(known)).noise
        for known in ([0.0] * 4, [1.0, 3.0, 0.0, 0.0])
    )
    assert stretched[0, 0] == pytest.approx(4.0 * plain[0, 0])
    assert stretched[2, 2] == pytest.approx(16.0 * plain[2, 2])


@pytest.mark.parametrize("rate_hz", [10, 100])
def test_turns_that_are_noise_lead_to_no_other_part_of_the_map(rate_hz: int) -> None:
    trail, step_ns = Trail(0), S // rate_hz
    for k in range(2 * rate_hz):
        shaking = 0.005 if k % 2 else -0.005
        trail.append(arc(k * step_ns, 0.5 / rate_hz, 0.05 / rate_hz + shaking, step_ns))
    composed = trail.compose(0, 2 * S)
    assert composed.travel_m == pytest.approx(1.0, rel=1e-3)
    assert composed.turn_rad == pytest.approx(0.1, rel=1e-6)
    assert composed.turn_rad == pytest.approx(abs(composed.delta.theta_rad))
    assert trail.compose(2 * S, 0).turn_rad == composed.turn_rad


def test_noise_teaches_next_to_nothing_of_the_wheels() -> None:
    """Straight ahead, all turns that the wheels report are noise: no reason to believe that they
    report too much of them. Taken as they come, they make the yaw scale -0.29, sure to 0.08."""
    learned = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        fused, truth = PoseFilter(FilterParams(), 0, Pose2.identity(), 0.01 * R), Pose2.identity()
        for k in range(600):
            truth = truth @ Pose2.exp([0.05, 0.0, 0.0])
            fused.predict(arc(k * STEP_NS, 0.05, rng.normal(0.0, 0.0067)))
            if k % 20 == 19:
                fused.correct(fix(fused.stamp_ns, truth, 0.01 * R))
        learned.append(fused.calibration.yaw)
        assert fused.calibration.yaw_sigma > 0.095
    assert abs(float(np.mean(learned))) < 0.1


# -- wheels that slip


def slipped(size_m: float) -> tuple[PoseFilter, list[Outcome], list[float]]:
    """Within the 31st second the left wheel spins by ``size_m``; exact fixes every 2 s."""
    fused = PoseFilter(FilterParams(), 0, Pose2.identity(), R)
    truth, outcomes, errors = Pose2.identity(), [], []
    for k in range(500):
        extra = 0.1 * size_m if 300 <= k < 310 else 0.0
        truth = truth @ arc(0).delta
        fused.predict(arc(k * STEP_NS, 0.03 + 0.5 * extra, 0.01 - 2.0 * extra))
        if k % 20 == 19:
            outcomes.append(fused.correct(fix(fused.stamp_ns, truth)))
            errors.append(fused.map_from_base.distance_to(truth))
    return fused, outcomes, errors


@pytest.mark.parametrize("size_m", [0.05, 0.15, 0.3])
def test_a_slip_is_recovered_within_two_fixes(size_m: float) -> None:
    fused, outcomes, errors = slipped(size_m)
    assert outcomes[:15] == [Outcome.ACCEPTED] * 15
    assert outcomes[15] in {Outcome.INFLATED, Outcome.GATED}
    assert max(errors[16:]) < 0.02
    assert outcomes[18:] == [Outcome.ACCEPTED] * 7
    assert fused.epoch == 0


def test_after_a_contradiction_the_covariance_covers_both() -> None:
    fused = driven(40, FilterParams())
    fused.correct(fix(2 * S, pose_at(fused, 2 * S)))
    there = pose_at(fused, 4 * S)
    off = there @ Pose2(-0.2, 0.0, 0.0)
    assert fused.correct(fix(4 * S, off)) is Outcome.GATED
    assert fused.map_from_base.distance_to(there) < 1e-9
    assert error95_m(fused.covariance) > 0.2
    assert_sound(fused.map_from_base, fused.covariance)
    far = driven(40, FilterParams())
    claim = error95_m(far.covariance)
    # Not by slipping: that fix is wrong, and nothing is doubted.
    assert far.correct(fix(4 * S, there @ Pose2(20.0, 0.0, 0.0))) is Outcome.GATED
    assert error95_m(far.covariance) == pytest.approx(claim)


def test_a_speed_that_no_robot_reaches_is_doubted() -> None:
    calm, hasty = driven(0, FilterParams()), driven(0, FilterParams())
    for k in range(100):
        for fused, way in ((calm, 0.006), (hasty, 0.03 if k >= 80 else 0.006)):
            fused.predict(arc(k * STEP_NS // 5, way, 0.0, STEP_NS // 5))
    assert calm.last_leap is None
    assert hasty.last_leap is not None
    assert 1.6 <= 1e-9 * hasty.last_leap.stamp_ns <= 2.0
    assert np.trace(hasty.covariance) > 5.0 * np.trace(calm.covariance)


# -- the error in one number


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.2, 0.4, 0.6, 0.8, 0.95, 1.0])
def test_error95_is_exceeded_in_one_case_of_twenty(ratio: float) -> None:
    rng = np.random.default_rng(7)
    turned = Pose2(0.0, 0.0, 0.6).rotation
    covariance = turned @ np.diag([0.03**2, (0.03 * ratio) ** 2]) @ turned.T
    errors = rng.standard_normal((400_000, 2)) * np.array([0.03, 0.03 * ratio]) @ turned.T
    within = float(np.mean(np.hypot(errors[:, 0], errors[:, 1]) <= error95_m(covariance)))
    # 4 sigma of the count; the factor's own 0.04 % is a tenth of it.
    assert abs(within - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / 400_000) + 1e-4


def test_error95_of_the_two_known_cases() -> None:
    assert error95_m(np.eye(3)) == pytest.approx(math.sqrt(-2.0 * math.log(0.05)), rel=4e-4)
    assert error95_m(np.diag([4.0, 0.0])) == pytest.approx(2.0 * 1.959964, rel=4e-4)
    assert error95_m(np.zeros((3, 3))) == 0.0
