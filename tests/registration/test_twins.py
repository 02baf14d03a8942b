"""Each compiled loop and its numpy twin say the same, of orderly and of broken input."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import TypeVar

import numpy as np
import pytest
from labs import cloud_at, exact_target, lab, mapped_lab, plain_cloud, tour_poses

from amr_slam.clouds import Cloud
from amr_slam.compiled import ENABLED
from amr_slam.geometry import Array, Pose2
from amr_slam.registration import casting, field, fit, icp, kernels, lookup, rdnm
from amr_slam.registration.alignment import Target
from amr_slam.registration.field import FieldParams
from amr_slam.registration.icp import IcpParams, Prior
from amr_slam.registration.rdnm import RdnmParams

pytestmark = pytest.mark.skipif(not ENABLED, reason="nothing is compiled")

T = TypeVar("T")
Twins = Callable[[ModuleType, Callable[[], T]], tuple[T, T]]


@pytest.fixture
def twins(monkeypatch: pytest.MonkeyPatch) -> Twins[T]:
    """The results of a call as compiled, and as the module does it in numpy."""

    def both(module: ModuleType, call: Callable[[], T]) -> tuple[T, T]:
        compiled = call()
        with monkeypatch.context() as patch:
            patch.setattr(module, "ENABLED", False)
            return compiled, call()

    return both


def scattered(seed: int) -> Target:
    """Points anywhere, some without a normal, and space that was seen free."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-3.0, 4.0, (150, 2))
    angle = rng.uniform(-math.pi, math.pi, 150)
    normals = np.column_stack([np.cos(angle), np.sin(angle)])
    normals[rng.random(150) < 0.3] = 0.0
    cells = np.unique(np.floor(rng.uniform(-30, 40, (800, 2))), axis=0)
    return Target(points_m=points, normals=normals, free_m=0.1 * cells + 0.05)


def broken_cloud(seed: int) -> Cloud:
    """A scan of which some points know no normal, and some are far outside of any map."""
    pose = tour_poses(0)[30]
    cloud = cloud_at(lab(0), pose, np.random.default_rng(seed), sigma_m=0.02)
    points, normals = cloud.points_m.copy(), cloud.normals.copy()
    points[::50] += 500.0
    points[25::50] -= 500.0
    normals[::7] = 0.0
    return replace(cloud, points_m=points, normals=normals)


def starts() -> Array:
    """Poses near the truth, in the middle of nowhere, and turned."""
    rng = np.random.default_rng(3)
    near = tour_poses(0)[30].as_array() + rng.normal(0.0, [0.2, 0.2, 0.1], (12, 3))
    anywhere = rng.uniform([-2.0, -2.0, -3.1], [16.0, 14.0, 3.1], (12, 3))
    return np.concatenate([near, anywhere, [[1e4, -1e4, 0.5]]])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_lookups_hold_the_same_rows(seed: int, twins: Twins[lookup.Lookup]) -> None:
    target = scattered(seed)
    compiled, plain = twins(
        lookup,
        lambda: lookup.build(target.points_m, target.normals, target.free_m, 0.1, 0.7),
    )
    rng = np.random.default_rng(seed)
    queries = rng.uniform(-4.5, 5.5, (20_000, 2))
    facing = rng.normal(size=(20_000, 2))
    facing[::4] = 0.0
    found = compiled.rows(queries, facing)
    np.testing.assert_array_equal(found, plain.rows(queries, facing))
    assert 0.3 < np.mean(found >= 0) < 1.0


@pytest.mark.parametrize("with_prior", [False, True])
def test_refinements_agree(with_prior: bool, twins: Twins[icp.Refined]) -> None:
    cloud, target = broken_cloud(0), mapped_lab(0).target()
    prior = Prior(
        target_from_source=tour_poses(0)[30] @ Pose2(0.05, 0.02, 0.01),
        information=np.array([[900.0, 20.0, 3.0], [20.0, 400.0, -5.0], [3.0, -5.0, 2500.0]]),
    )
    compiled, plain = twins(
        icp,
        lambda: icp.refine(cloud, target, starts(), IcpParams(), prior if with_prior else None),
    )
    np.testing.assert_array_equal(compiled.iterations, plain.iterations)
    np.testing.assert_array_equal(compiled.converged, plain.converged)
    np.testing.assert_allclose(compiled.poses, plain.poses, atol=1e-7)
    moved = np.hypot(*(compiled.poses - starts())[:, :2].T)
    assert np.all(compiled.converged[:12])
    assert np.median(moved[:12]) > 0.1


@pytest.mark.parametrize("walls", [scattered(0), exact_target(lab(0))], ids=["points", "lab"])
def test_rays_agree(walls: Target, twins: Twins[Array]) -> None:
    rng = np.random.default_rng(0)
    origins = rng.uniform(-4.0, 12.0, (3000, 2))
    angle = rng.uniform(-math.pi, math.pi, 3000)
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    origins[::300] = math.nan
    origins[150::300] = 1e3
    compiled, plain = twins(casting, lambda: casting.ranges(walls, origins, directions, 12.0))
    assert 0.05 < np.mean(np.isfinite(compiled)) < 1.0
    np.testing.assert_allclose(compiled, plain, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1])
def test_distances_agree(seed: int, twins: Twins[Array]) -> None:
    target = scattered(seed)
    queries = np.random.default_rng(seed).uniform(-5.0, 6.0, (4000, 2))
    queries[::100] = math.nan
    queries[50::100, 0] = math.inf
    queries[75::100, 1] = -1e7
    compiled, plain = twins(fit, lambda: fit.distances(target, queries))
    np.testing.assert_allclose(compiled, plain, atol=1e-12)
    assert np.isinf(compiled[::100]).all()
    exact = np.asarray(target.tree.query(queries[1::100])[0])
    near = exact < 0.5
    np.testing.assert_allclose(compiled[1::100][near], exact[near], atol=0.02)


@pytest.mark.parametrize("scale_m", [0.25, 0.9])
def test_fits_agree(scale_m: float, twins: Twins[Array]) -> None:
    cloud, target = broken_cloud(1), mapped_lab(0).target()
    compiled, plain = twins(fit, lambda: fit.scores(cloud, target, starts(), scale_m))
    np.testing.assert_allclose(compiled, plain, atol=1e-12)
    assert compiled[:12].max() > 0.5
    assert compiled.min() < 0.0
    assert compiled[-1] == 0.0  # far from all that is known nothing speaks, for or against


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_signatures_match_alike(seed: int, twins: Twins[rdnm.Single]) -> None:
    rng = np.random.default_rng(seed)
    params = RdnmParams(sections=24)
    scan = np.where(rng.random(24) < 0.3, math.nan, rng.uniform(0.2, 20.0, 24))
    map_side = np.where(rng.random((40, 24)) < 0.2, math.nan, rng.uniform(0.0, 80.0, (40, 24)))
    map_side[0] = math.nan  # a place that knows nothing at all
    compiled, plain = twins(rdnm, lambda: rdnm.match(scan, rdnm.pack(map_side), params))
    np.testing.assert_allclose(compiled, plain, rtol=1e-5)
    np.testing.assert_allclose(compiled[0], params.unseen_m, rtol=1e-5)


@pytest.mark.parametrize("seed", [0, 1])
def test_fields_sum_alike(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(-30, 101, (40, 55)).astype(np.int8)
    cells = rng.integers(-60, 61, (12, 30, 2)).astype(np.int32)
    rows, columns = (rng.integers(-3, size, 500).astype(np.int32) for size in (43, 58))
    headings = rng.integers(0, 12, 500).astype(np.int32)
    given = (cells, values, rows, columns, headings)
    np.testing.assert_array_equal(kernels.sum_field(*given), field._sum_in_numpy(*given))


def test_searches_find_the_same(twins: Twins[Array]) -> None:
    cloud, params = broken_cloud(2), FieldParams()
    whole = mapped_lab(0)
    places = whole.places(params.spacing_m, 0.3)
    compiled, plain = twins(field, lambda: field.search(cloud, whole.field(params), places, params))
    np.testing.assert_array_equal(compiled, plain)


@pytest.mark.parametrize("points", [0, 1])
def test_next_to_nothing_is_survived_by_both(points: int, twins: Twins[Array]) -> None:
    cloud, target = plain_cloud(np.ones((points, 2))), scattered(0)
    pose = Pose2.identity()
    compiled, plain = twins(fit, lambda: fit.distances(target, pose @ cloud.points_m))
    np.testing.assert_array_equal(compiled, plain)
    assert len(compiled) == points
