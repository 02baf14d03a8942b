"""Two scanners are two witnesses: a place must satisfy each on its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from labs import cloud_at, lab, mapped_lab, tour_poses

from amr_slam.clouds import Cloud
from amr_slam.evidence import assess
from amr_slam.params import SlamParams
from amr_slam.registration import icp

PARAMS = SlamParams()
TRUTH = tour_poses(0)[30]


def agreeing(cloud: Cloud) -> float:
    target = mapped_lab(0).target()
    alignment = icp.align(cloud, target, TRUTH, PARAMS.icp)
    return assess(cloud, target, replace(alignment, target_from_source=TRUTH), PARAMS).agreeing


def seen() -> Cloud:
    return cloud_at(lab(0), TRUTH, np.random.default_rng(0), sigma_m=0.01)


def test_both_scanners_are_in_the_cloud() -> None:
    cloud = seen()
    assert set(cloud.scanners.tolist()) == {0, 1}
    for scanner in (0, 1):
        alone = cloud.take(np.flatnonzero(cloud.scanners == scanner))
        assert len(np.unique(alone.origins_m, axis=0)) == 1
        assert agreeing(alone) > 0.85


def test_a_scanner_that_contradicts_is_not_outvoted_by_the_other() -> None:
    cloud = seen()
    rear = (cloud.scanners == 1)[:, None]
    # As if the rear scanner were mounted the wrong way round.
    away = replace(cloud, points_m=np.where(rear, 2.0 * cloud.origins_m - cloud.points_m,
                                            cloud.points_m))  # fmt: skip
    assert agreeing(cloud) > 0.85
    assert agreeing(away) < 0.4


def test_a_scanner_that_sees_next_to_nothing_is_no_witness() -> None:
    cloud = seen()
    rear = np.flatnonzero(cloud.scanners == 1)
    few = cloud.take(np.concatenate([np.flatnonzero(cloud.scanners == 0), rear[:20]]))
    off = replace(few, points_m=np.where((few.scanners == 1)[:, None], 0.5 * few.points_m,
                                         few.points_m))  # fmt: skip
    assert agreeing(off) > 0.85
