"""Known transforms are found again, within what is claimed, whatever a part of the pairs says."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam.aligning import AlignError, Fit, FitParams, PosePairs, fit_pairs
from amr_slam.geometry import Array, Pose2, wrap_angle

SETTINGS = settings(derandomize=True, max_examples=40, deadline=None)
NOISE_M, NOISE_RAD = 0.01, math.radians(0.5)
POSES = st.builds(
    Pose2,
    st.floats(-1e4, 1e4),
    st.floats(-1e4, 1e4),
    st.floats(-math.pi, math.pi, exclude_min=True),
)


def pairs_of(
    site_from_map: Pose2,
    known: Array,
    rng: np.random.Generator,
    marker: Pose2 | None = None,
    *,
    headings: bool = True,
    scale: float = 1.0,
) -> PosePairs:
    """What noisy cameras say of poses (n, 3) of the base in the map."""
    marker = marker or Pose2.identity()
    seen = np.array(
        [(site_from_map @ Pose2.from_array(pose) @ marker).as_array() for pose in known]
    )
    seen[:, :2] = scale * seen[:, :2] + rng.normal(0.0, NOISE_M, (len(seen), 2))
    seen[:, 2] = wrap_angle(seen[:, 2] + rng.normal(0.0, NOISE_RAD, len(seen)))
    if not headings:
        seen[:, 2], known = np.nan, np.column_stack([known[:, :2], np.full(len(known), np.nan)])
    return PosePairs(labels=tuple(map(str, range(len(known)))), site=seen, map=known)


def places(rng: np.random.Generator, count: int = 60, size_m: float = 20.0) -> Array:
    """Poses (n, 3) all over a hall."""
    return np.column_stack(
        [rng.uniform(0.0, size_m, (count, 2)), rng.uniform(-math.pi, math.pi, count)]
    )


def error_of(fit: Fit, truth: Pose2, known: Array) -> tuple[float, float]:
    """In the middle of the pairs, by what is claimed there: of place and turn."""
    x_m, y_m = known[:, :2].mean(axis=0).tolist()
    middle = Pose2(x_m, y_m, 0.0)
    found, true = fit.site_from_map @ middle, truth @ middle
    turn = abs(wrap_angle(found.theta_rad - true.theta_rad))
    return found.distance_to(true) / fit.sigma_m, turn / fit.sigma_rad


@SETTINGS
@given(truth=POSES, seed=st.integers(0, 1000), headings=st.booleans())
def test_a_known_transform_is_found_within_its_noise(
    truth: Pose2, seed: int, headings: bool
) -> None:
    rng = np.random.default_rng(seed)
    known = places(rng)
    marker = Pose2(0.1, -0.06, math.radians(5.0)) if headings else Pose2.identity()
    fit = fit_pairs(pairs_of(truth, known, rng, marker, headings=headings), FitParams())
    assert fit.problems == ()
    assert max(error_of(fit, truth, known)) < 5.0
    assert fit.sigma_m < 0.005
    assert math.degrees(fit.sigma_rad) < 0.02
    assert fit.agrees.all()
    assert fit.rms_m == pytest.approx(NOISE_M * math.sqrt(2.0), rel=0.35)
    assert fit.scale == pytest.approx(1.0, abs=5.0 * fit.scale_sigma)
    if headings:
        off = fit.base_from_marker.distance_to(marker)
        assert fit.marker_sigma_m is not None
        assert off < 5.0 * fit.marker_sigma_m
        assert fit.base_from_marker.theta_rad == pytest.approx(marker.theta_rad, abs=0.01)


@SETTINGS
@given(truth=POSES, seed=st.integers(0, 1000), wrong=st.integers(1, 18), headings=st.booleans())
def test_pairs_that_contradict_are_named_and_do_not_matter(
    truth: Pose2, seed: int, wrong: int, headings: bool
) -> None:
    rng = np.random.default_rng(seed)
    known = places(rng)
    good = pairs_of(truth, known, rng, headings=headings)
    site = good.site.copy()
    # Another robot's marker: all of them consistent with each other, 3 m beside.
    site[:wrong, :2] += [3.0, 1.0]
    pairs = PosePairs(labels=good.labels, site=site, map=good.map)
    fit = fit_pairs(pairs, FitParams())
    assert fit.problems == ()
    np.testing.assert_array_equal(fit.agrees, np.arange(60) >= wrong)
    assert max(error_of(fit, truth, known)) < 5.0


def test_what_is_claimed_is_true_on_average() -> None:
    """Normalized squared errors of place and turn over many fits: their mean is their number."""
    squares = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        known, truth = places(rng), Pose2(3.0, -2.0, 1.0)
        fit = fit_pairs(pairs_of(truth, known, rng, Pose2(0.1, 0.05, 0.1)), FitParams())
        place, turn = error_of(fit, truth, known)
        squares.append((0.5 * place**2, turn**2))
    mean = np.mean(squares, axis=0)
    assert ((mean > 0.5) & (mean < 1.6)).all(), mean


def test_a_stretched_camera_frame_is_a_finding_and_not_absorbed() -> None:
    rng = np.random.default_rng(0)
    known, truth = places(rng), Pose2(3.0, -2.0, 1.0)
    fit = fit_pairs(pairs_of(truth, known, rng, headings=False, scale=1.01), FitParams())
    assert fit.scale == pytest.approx(1.01, abs=4.0 * fit.scale_sigma)
    assert any("larger than the map by 1.0" in finding for finding in fit.findings)
    assert fit.rms_m > 0.05  # a rigid motion cannot take it in
    plain = fit_pairs(pairs_of(truth, known, rng, headings=False), FitParams())
    assert plain.findings == ()


@pytest.mark.parametrize("headings", [True, False])
def test_pairs_in_one_spot_tell_no_turn(headings: bool) -> None:
    rng = np.random.default_rng(0)
    pairs = pairs_of(Pose2(1.0, 2.0, 0.5), places(rng, size_m=0.01), rng, headings=headings)
    with pytest.raises(AlignError, match=r"one spot"):
        fit_pairs(pairs, FitParams())


def test_pairs_near_to_each_other_tell_too_little() -> None:
    rng = np.random.default_rng(1)
    known = places(rng, 8, size_m=0.6)
    fit = fit_pairs(pairs_of(Pose2(1.0, 2.0, 0.5), known, rng, headings=False), FitParams())
    assert any("take them all over the map" in problem for problem in fit.problems)


def test_on_a_line_a_mirrored_frame_fits_as_well() -> None:
    rng = np.random.default_rng(0)
    known = places(rng)
    known[:, 1] = 0.0
    truth = Pose2(1.0, 2.0, 0.5)
    fit = fit_pairs(pairs_of(truth, known, rng, headings=False), FitParams())
    assert any("on a line" in problem for problem in fit.problems)
    # Headings that turn tell the way round, also on a line.
    told = fit_pairs(pairs_of(truth, known, rng), FitParams())
    assert told.problems == ()
    assert max(error_of(told, truth, known)) < 5.0


def test_a_mirrored_frame_is_called_so() -> None:
    rng = np.random.default_rng(0)
    pairs = pairs_of(Pose2(1.0, 2.0, 0.5), places(rng), rng, headings=False)
    flipped = PosePairs(labels=pairs.labels, site=pairs.site * [1.0, -1.0, 1.0], map=pairs.map)
    fit = fit_pairs(flipped, FitParams())
    assert any("mirrored" in problem for problem in fit.problems)


def test_other_units_are_called_so() -> None:
    rng = np.random.default_rng(0)
    pairs = pairs_of(Pose2(1.0, 2.0, 0.5), places(rng), rng, headings=False)
    mm = PosePairs(labels=pairs.labels, site=pairs.site * [1e3, 1e3, 1.0], map=pairs.map)
    with pytest.raises(AlignError, match=r"1e\+03 times those in the map: other units"):
        fit_pairs(mm, FitParams())


def test_without_turns_the_marker_is_not_told() -> None:
    rng = np.random.default_rng(0)
    known = places(rng)
    known[:, 2] = 0.3  # a robot that never turns
    fit = fit_pairs(pairs_of(Pose2(1.0, 2.0, 0.5), known, rng, Pose2(0.1, 0.0, 0.0)), FitParams())
    assert fit.marker_sigma_m is None
    assert any("cannot be told" in finding for finding in fit.findings)


def test_a_marker_that_is_known_is_used() -> None:
    rng = np.random.default_rng(0)
    known, truth, marker = places(rng, 6), Pose2(1.0, 2.0, 0.5), Pose2(0.3, 0.1, 0.2)
    fit = fit_pairs(pairs_of(truth, known, rng, marker), FitParams(), marker)
    assert fit.base_from_marker == marker
    assert fit.problems == ()
    assert max(error_of(fit, truth, known)) < 5.0


def test_two_landmarks_are_enough_and_one_is_not() -> None:
    rng = np.random.default_rng(0)
    known = np.array([[0.0, 0.0, np.nan], [8.0, 3.0, np.nan]])
    truth = Pose2(1.0, 2.0, 0.5)
    pairs = pairs_of(truth, np.nan_to_num(known), rng, headings=False)
    fit = fit_pairs(pairs, FitParams(), ordered=False)
    assert fit.problems == ()
    assert fit.site_from_map.distance_to(truth) < 0.05
    assert 0.002 < fit.sigma_m < 0.02  # nothing of the noise can be seen in two points
    with pytest.raises(AlignError, match=r"1 pairs are too few"):
        fit_pairs(pairs.take(np.array([0])), FitParams())
