"""Simulated rooms, scans and maps for the tests of the core. The map's frame is the world's."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from amr_slam.clouds import Cloud, CloudParams, cloud_from_scan, merge
from amr_slam.geometry import Array, Pose2
from amr_slam.map import MapParams, PointMap
from amr_slam.registration.alignment import Target
from amr_slam.simulation import (
    PERSON_RADIUS_M,
    ScannerModel,
    World,
    laboratory,
    opposite_scanners,
    plan_tour,
    take_scan,
)

EXACT = ScannerModel(quantum_m=0.0)
"""Reports what is there."""


def world_of(segments_m: Array) -> World:
    return World(
        seed=0,
        outline_m=segments_m[:, :2],
        segments_m=segments_m,
        table_tops_m=np.empty((0, 4)),
    )


def room(width_m: float = 8.0, height_m: float = 6.0) -> World:
    """A bare rectangle with one corner in the origin."""
    w, h = width_m, height_m
    return world_of(np.array([[0, 0, w, 0], [w, 0, w, h], [w, h, 0, h], [0, h, 0, 0]], dtype=float))


def corridor(length_m: float = 80.0, width_m: float = 2.0) -> World:
    """Two walls along x, far longer than any scanner looks."""
    x, y = 0.5 * length_m, 0.5 * width_m
    return world_of(np.array([[-x, -y, x, -y], [x, y, -x, y]]))


@functools.cache
def lab(seed: int) -> World:
    return laboratory(seed)


def cloud_at(
    world: World,
    pose: Pose2,
    rng: np.random.Generator,
    *,
    sigma_m: float = 0.0,
    sigma_xy_m: float = 0.0,
    stamp_ns: int = 0,
    people_m: Array | None = None,
) -> Cloud:
    """What both scanners of a standing robot see from ``pose``, in the base frame.

    ``people_m`` (k, 2): where people stand.
    """
    model = replace(EXACT, sigma_range_m=sigma_m, sigma_xy_m=sigma_xy_m, sweep_s=0.0)
    standing = None
    if people_m is not None:
        standing = np.broadcast_to(people_m, (model.beams, *people_m.shape))
    clouds = []
    for mounted in opposite_scanners(model):
        scan = take_scan(
            mounted,
            world,
            pose,
            rng,
            stamp_ns=stamp_ns,
            people_m=standing,
            person_radius_m=PERSON_RADIUS_M,
        )
        cloud = cloud_from_scan(scan, mounted.base_from_lidar, CloudParams())
        clouds.append((cloud, Pose2.identity()))
    return merge(clouds)


@functools.cache
def tour_poses(seed: int, spacing_m: float = 0.6) -> tuple[Pose2, ...]:
    """Along the tour of a laboratory, looking ahead."""
    path = plan_tour(lab(seed)).path_m
    step = round(spacing_m / 0.05)
    ahead = np.roll(path, -4, axis=0) - path
    return tuple(
        Pose2(path[i, 0], path[i, 1], math.atan2(ahead[i, 1], ahead[i, 0]))
        for i in range(0, len(path), step)
    )


@functools.cache
def mapped_lab(seed: int, sigma_m: float = 0.01) -> PointMap:
    """The map of a laboratory from its tour at the true poses. Shared: nobody may insert."""
    grown = PointMap(MapParams(), f"lab{seed}")
    rng = np.random.default_rng(1000 + seed)
    for i, pose in enumerate(tour_poses(seed)):
        cloud = cloud_at(lab(seed), pose, rng, sigma_m=sigma_m, stamp_ns=i * 2_000_000_000)
        grown.insert(cloud, pose)
    return grown


def covered_poses(seed: int, count: int, draw: int = 0) -> Iterator[Pose2]:
    """Random free poses within a metre of the tour: the map knows what is seen from there."""
    world, rng = lab(seed), np.random.default_rng([seed, draw])
    path = np.array([pose.translation for pose in tour_poses(seed)])
    low, high = world.outline_m.min(axis=0), world.outline_m.max(axis=0)
    found = 0
    while found < count:
        place = rng.uniform(low, high)
        near = np.hypot(*(path - place).T).min() < 1.0
        if near and world.clearance(place[None])[0] > 0.4:
            found += 1
            yield Pose2(place[0], place[1], rng.uniform(-math.pi, math.pi))


def heading_error_rad(a: Pose2, b: Pose2) -> float:
    return abs((a.inverse() @ b).theta_rad)


def plain_cloud(
    points_m: Array, normals: Array | None = None, sigma_m: float = 0.0, weight: float = 1.0
) -> Cloud:
    """Points as if seen from the origin, all of one weight; normals unknown unless given."""
    return Cloud(
        stamp_ns=0,
        points_m=points_m,
        normals=np.zeros_like(points_m) if normals is None else normals,
        origins_m=np.zeros_like(points_m),
        weights=np.full(len(points_m), weight),
        scanners=np.zeros(len(points_m), dtype=np.int8),
        sigma_m=sigma_m,
        across_m=sigma_m,
    )


def exact_target(world: World, spacing_m: float = 0.05) -> Target:
    """The walls themselves, free space to the left of each segment."""
    points, normals = [], []
    for x1, y1, x2, y2 in world.segments_m:
        length = math.hypot(x2 - x1, y2 - y1)
        along = np.arange(0.5 * spacing_m, length, spacing_m)[:, None]
        direction = np.array([x2 - x1, y2 - y1]) / length
        points.append(np.array([x1, y1]) + along * direction)
        normals.append(np.broadcast_to([-direction[1], direction[0]], (len(along), 2)))
    return Target(
        points_m=np.concatenate(points), normals=np.concatenate(normals), spacing_m=spacing_m
    )
