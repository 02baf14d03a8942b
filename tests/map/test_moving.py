"""A map in another frame is the same map."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from labs import cloud_at, covered_poses, heading_error_rad, lab, mapped_lab

from amr_slam.clouds import Cloud
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap, Reframing, load_map, moved, save_map
from amr_slam.map.rays import nothing
from amr_slam.params import preset
from amr_slam.slam_request import SlamRequest

SITE_FROM_MAP = Pose2(103.4, -57.2, math.radians(33.0))
TOLD = Reframing(
    map_id="6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11", by="pairs.csv", x_m=1.0, y_m=2.0,
    theta_rad=0.5, rms_m=0.01, used=40, left_out=2, scale=1.001,
)  # fmt: skip


def forgetful(known: PointMap) -> PointMap:
    """The same map with the rays of every second scan forgotten."""
    copied = moved(known, Pose2.identity())
    copied.rays = [nothing(rays.across_m) if i % 2 else rays for i, rays in enumerate(copied.rays)]
    return copied


def found(known: PointMap, cloud: Cloud) -> Pose2:
    """Where a search of the whole map has one scan."""
    engine = SlamEngine(preset("default"), known, "localization")
    result = engine.update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None))
    assert result.fix is not None
    return result.fix.map_from_base


@pytest.mark.parametrize("forgotten", [False, True])
def test_poses_in_the_moved_map_are_the_old_ones_moved(forgotten: bool) -> None:
    known = forgetful(mapped_lab(3)) if forgotten else mapped_lab(3)
    there = moved(known, SITE_FROM_MAP)
    rng = np.random.default_rng(5)
    for pose in covered_poses(3, 6):
        cloud = cloud_at(lab(3), pose, rng, sigma_m=0.01)
        expected = SITE_FROM_MAP @ found(known, cloud)
        seen = found(there, cloud)
        assert seen.distance_to(expected) < 0.01
        assert heading_error_rad(seen, expected) < math.radians(0.15)


@pytest.mark.parametrize("forgotten", [False, True])
def test_all_that_a_map_holds_is_moved(forgotten: bool) -> None:
    known = forgetful(mapped_lab(3)) if forgotten else mapped_lab(3)
    there = moved(known, SITE_FROM_MAP)
    for (stamp_ns, before), (same_ns, after) in zip(known.path, there.path, strict=True):
        assert same_ns == stamp_ns
        assert after.distance_to(SITE_FROM_MAP @ before) < 1e-9
    assert there.noises_m == known.noises_m
    for saw, kept in zip(known.rays, there.rays, strict=True):
        assert abs(kept.quantum_m - saw.quantum_m) < 1e-9
        np.testing.assert_allclose(kept.ends, saw.ends, atol=1)
    assert there.area_m2() == pytest.approx(known.area_m2(), rel=0.02)
    old, new = known.target(), there.target()
    assert len(new) > 0.95 * len(old)
    # Nearly every wall point has its image, facing the same way.
    image = SITE_FROM_MAP @ np.array(old.points_m)
    distance, row = new.tree.query(image)
    assert np.percentile(distance, 95.0) < 0.05
    assert np.median(distance) < 0.015
    both = np.any(old.normals != 0.0, axis=1)
    facing = np.sum(old.normals @ SITE_FROM_MAP.rotation.T * new.normals[row], axis=1)
    assert np.mean(facing[both] > 0.7) > 0.95


def test_there_and_back_again_leaves_the_walls_in_place() -> None:
    known = mapped_lab(3)
    again = moved(moved(known, SITE_FROM_MAP), SITE_FROM_MAP.inverse())
    distance = again.target().tree.query(known.target().points_m)[0]
    assert np.percentile(distance, 99.0) < 0.02


def test_an_empty_map_moves_too() -> None:
    empty = PointMap(mapped_lab(3).params, "empty")
    assert len(moved(empty, SITE_FROM_MAP)) == 0


def test_where_a_frame_comes_from_is_kept_in_the_file(tmp_path: Path) -> None:
    grown = moved(mapped_lab(3), Pose2.identity())
    plain = save_map(grown, tmp_path / "plain.amrmap")
    grown.reframings = (TOLD, replace(TOLD, by="plan.png"))
    map_id = save_map(grown, tmp_path / "told.amrmap")
    assert map_id == plain  # the content is the same
    loaded, _ = load_map(tmp_path / "told.amrmap")
    assert loaded.reframings == grown.reframings
    assert load_map(tmp_path / "plain.amrmap")[0].reframings == ()
    assert moved(loaded, SITE_FROM_MAP).reframings == grown.reframings
