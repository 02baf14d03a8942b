from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from amr_slam.samples import Scan
from amr_slam.simulation import (
    SCANNERS,
    World,
    blocked,
    corridors,
    free_poses,
    hall,
    laboratory,
    moved_furniture,
    offices,
    plan_tour,
    take_scan,
)
from amr_slam.simulation.disturbances import _things


@functools.cache
def scan_in_laboratory(seed: int) -> Scan:
    world, rng = laboratory(seed), np.random.default_rng(seed)
    return take_scan(SCANNERS["S300"], world, free_poses(world, rng, 1, 0.5)[0], rng)


def rows(world: World) -> set[tuple[float, ...]]:
    return {tuple(row) for row in world.segments_m.tolist()}


@pytest.mark.parametrize("share", [0.0, 0.1, 0.25, 0.4])
def test_the_wanted_share_of_beams_is_blocked_and_none_looks_further(share: float) -> None:
    for seed in range(6):
        scan = scan_in_laboratory(seed)
        busy = blocked(scan, np.random.default_rng(seed), share, sigma_m=0.02)
        assert not np.any(busy.ranges_m > scan.ranges_m)
        assert np.mean(busy.ranges_m < scan.ranges_m) == pytest.approx(share, abs=0.02)
        assert np.nanmin(busy.ranges_m) > 0.3 or np.nanmin(scan.ranges_m) <= 0.3
        again = blocked(scan, np.random.default_rng(seed), share, sigma_m=0.02)
        np.testing.assert_array_equal(busy.ranges_m, again.ranges_m)


def test_blocked_beams_lie_next_to_each_other() -> None:
    scan = scan_in_laboratory(1)
    busy = blocked(scan, np.random.default_rng(2), 0.3)
    shorter = busy.ranges_m < scan.ranges_m
    groups = int(np.sum(np.diff(np.concatenate([[0], shorter.astype(int)])) == 1))
    assert shorter.sum() / groups > 8


def test_things_in_the_way_are_as_wide_as_people_and_pallets() -> None:
    """In an empty distance, one thing covers what 0.3 to 1 m cover at 0.5 to 4 m."""
    far = Scan(
        scanner="front",
        stamp_ns=0,
        ranges_m=np.full(541, np.inf),
        angle_min_rad=-2.356,
        angle_step_rad=np.radians(0.5),
    )
    for seed in range(200):
        one = blocked(far, np.random.default_rng(seed), 3 / 541)
        hit = np.flatnonzero(np.isfinite(one.ranges_m))
        assert len(hit) == 3
        assert 0.5 <= one.ranges_m[hit].min() <= 4.5
        assert np.ptp(hit) == 2
    not_measured = replace(far, ranges_m=np.full(541, np.nan))
    kept = blocked(not_measured, np.random.default_rng(0), 0.4)
    assert np.isnan(kept.ranges_m).all()


@pytest.mark.parametrize("make", [hall, offices])
def test_moved_furniture_leaves_the_walls_and_the_rest_alone(
    make: Callable[[int, float], World],
) -> None:
    world = make(3, 400.0)
    things, fixed = _things(world)
    assert len(things) >= 8
    for share in (0.0, 0.5, 1.0):
        later = moved_furniture(world, np.random.default_rng(1), share)
        np.testing.assert_array_equal(later.outline_m, world.outline_m)
        assert rows(fixed) <= rows(later)
        stayed = sum(
            {tuple(row) for row in thing.corners_m.tolist()}
            <= {row[:2] for row in (*rows(later), *map(tuple, later.table_tops_m.tolist()))}
            for thing in things
        )
        assert stayed == len(things) - round(share * len(things))
        found, _ = _things(later)
        assert len(found) > 0.5 * len(things)


def test_there_is_still_a_way_after_the_furniture_moved() -> None:
    world = hall(5, 200.0)
    later = moved_furniture(world, np.random.default_rng(0), 0.6)
    path = plan_tour(later).path_m
    assert later.clearance(np.array(path)).min() > 0.35
    assert rows(moved_furniture(world, np.random.default_rng(0), 0.6)) == rows(later)


def test_walls_and_blocks_between_corridors_are_no_furniture() -> None:
    for seed in range(3):
        things, _ = _things(corridors(seed, 400.0))
        assert all(np.ptp(thing.corners_m, axis=0).max() < 1.3 for thing in things)


def test_inner_walls_stay_when_all_furniture_moves() -> None:
    """Only the ends of walls are 10 to 20 cm long in offices: legs are thinner, cupboards more."""
    world = offices(3, 400.0)
    length = np.hypot(*(world.segments_m[:, 2:] - world.segments_m[:, :2]).T)
    ends = {tuple(row) for row in world.segments_m[(length > 0.09) & (length < 0.21)].tolist()}
    assert len(ends) > 40
    assert ends <= rows(moved_furniture(world, np.random.default_rng(0), 1.0))
