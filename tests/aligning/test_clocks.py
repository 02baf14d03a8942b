"""A lab drive under ceiling cameras: noise of 1 cm, 80 ms late, marker 12 cm off, some swapped."""

from __future__ import annotations

import math

import numpy as np
import pytest
from camera_drives import MARKER, SITE_FROM_MAP, drive, seen_by_cameras

from amr_slam.aligning import AlignError, FitParams, TimedFit, Track, fit_tracks
from amr_slam.geometry import Pose2, wrap_angle
from amr_slam.recording import Trajectory

LATE_S = 0.08


def error_of(timed: TimedFit) -> tuple[float, float]:
    """Of place (m, in the middle of the pairs) and turn (rad)."""
    x_m, y_m = timed.pairs.map[:, :2].mean(axis=0).tolist()
    middle = Pose2(x_m, y_m, 0.0)
    found, true = timed.fit.site_from_map @ middle, SITE_FROM_MAP @ middle
    return found.distance_to(true), abs(wrap_angle(found.theta_rad - true.theta_rad))


@pytest.mark.parametrize("headings", [True, False])
def test_frame_marker_and_clock_are_found_together(headings: bool) -> None:
    camera, wrong = seen_by_cameras(drive(), np.random.default_rng(0), headings=headings)
    timed = fit_tracks(camera, drive(), FitParams())
    fit = timed.fit
    assert fit.problems == fit.findings == ()
    place_m, turn_rad = error_of(timed)
    assert place_m < 0.002
    assert turn_rad < math.radians(0.02)
    assert timed.clock_s == pytest.approx(-LATE_S, abs=0.008)
    assert fit.base_from_marker.distance_to(MARKER) < 0.004
    if headings:
        assert fit.base_from_marker.theta_rad == pytest.approx(MARKER.theta_rad, abs=0.002)
    # Every swapped marker is named, and no other one.
    agrees = dict(zip(timed.pairs.labels, fit.agrees.tolist(), strict=True))
    named = [not agrees.get(f"{1e-9 * stamp:.3f} s", True) for stamp in camera.stamps_ns.tolist()]
    assert sum(named) == pytest.approx(int(wrong.sum()), abs=3)
    assert sum(np.array(named) & ~wrong) <= 3
    assert fit.rms_m == pytest.approx(0.01 * math.sqrt(2.0), rel=0.1)


def test_a_third_of_swapped_markers_does_no_harm() -> None:
    camera, _ = seen_by_cameras(drive(), np.random.default_rng(1), swapped=0.33)
    timed = fit_tracks(camera, drive(), FitParams())
    assert timed.fit.problems == ()
    place_m, turn_rad = error_of(timed)
    assert place_m < 0.002
    assert turn_rad < math.radians(0.02)


def test_clocks_that_never_met_are_brought_together_by_the_motion() -> None:
    camera, _ = seen_by_cameras(drive(), np.random.default_rng(2))
    utc = Track(stamps_ns=camera.stamps_ns + 1_790_000_000 * 10**9, poses=camera.poses)
    timed = fit_tracks(utc, drive(), FitParams())
    assert timed.clock_s == pytest.approx(-1_790_000_000.0 - LATE_S, abs=0.008)
    assert error_of(timed)[0] < 0.002


def test_rounds_that_repeat_fit_at_several_times() -> None:
    once = drive()
    step_ns = int(once.stamps_ns[-1] - once.stamps_ns[0]) + 20_000_000
    twice = Trajectory(
        stamps_ns=np.concatenate([once.stamps_ns, once.stamps_ns + step_ns]),
        poses=np.concatenate([once.poses, once.poses]),
    )
    camera, _ = seen_by_cameras(once, np.random.default_rng(3))
    utc = Track(stamps_ns=camera.stamps_ns + 10**18, poses=camera.poses)
    with pytest.raises(AlignError, match=r"several clock differences fit.*--clock S"):
        fit_tracks(utc, twice, FitParams())
    told = fit_tracks(utc, twice, FitParams(), clock_s=-1e9 - LATE_S)
    assert told.fit.clock_sigma_s is None
    assert error_of(told)[0] < 0.002


def test_trajectories_of_different_drives_are_refused() -> None:
    camera, _ = seen_by_cameras(drive(), np.random.default_rng(4))
    other = Track(stamps_ns=camera.stamps_ns + 10**18, poses=camera.poses[::-1].copy())
    with pytest.raises(AlignError, match=r"at no clock difference|several clock differences"):
        fit_tracks(other, drive(), FitParams())


def test_a_straight_drive_tells_neither_marker_nor_clock() -> None:
    """At one speed ahead, a marker farther ahead and a clock that is late are the same thing."""
    stamps = np.arange(0, 60 * 10**9, 20_000_000, dtype=np.int64) + 10**9
    ahead_m = 0.3e-9 * (stamps - stamps[0])
    poses = np.column_stack([ahead_m, np.zeros_like(ahead_m), np.zeros_like(ahead_m)])
    known = Trajectory(stamps_ns=stamps, poses=poses)
    camera, _ = seen_by_cameras(known, np.random.default_rng(5), swapped=0.0)
    timed = fit_tracks(camera, known, FitParams())
    assert timed.fit.marker_sigma_m is timed.fit.clock_sigma_s is None
    assert sum("cannot be told" in finding for finding in timed.fit.findings) == 2
    assert any("on a line" in problem for problem in timed.fit.problems)
