"""What a scanner measures in a world, with the noise of the paper's section 3.1."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from amr_slam.geometry import Array, Pose2
from amr_slam.samples import Scan
from amr_slam.simulation.casting import cast
from amr_slam.simulation.world import World


@dataclass(frozen=True, slots=True, kw_only=True)
class ScannerModel:
    """A scanner on the robot. The defaults are those of a SICK S300."""

    name: str = "front"
    base_from_lidar: Pose2 = field(default_factory=Pose2.identity)
    """Mounting: the lidar frame in the base frame."""
    beams: Annotated[int, Ge(2)] = 541
    """270 degrees at half a degree."""
    angle_min_rad: float = math.radians(-135.0)
    angle_step_rad: Annotated[float, Gt(0)] = math.radians(0.5)
    range_max_m: Annotated[float, Gt(0)] = 30.0
    """Beyond it nothing returns."""
    quantum_m: Annotated[float, Ge(0)] = 0.01
    """Step of the reported ranges (S300: whole centimetres); 0 reports them exactly."""
    sigma_xy_m: Annotated[float, Ge(0)] = 0.0
    """Gaussian noise added to both x and y of each measured point (paper, section 3.1)."""
    sigma_range_m: Annotated[float, Ge(0)] = 0.0
    """Gaussian noise along the beam, as real scanners have it: about 0.01 m."""
    sweep_s: Annotated[float, Ge(0)] = 0.03
    """First beam to last: three quarters of a mirror turn of 40 ms."""
    phase_s: Annotated[float, Ge(0)] = 0.0
    """Start of the first sweep: two scanners do not turn in step."""

    @property
    def angles_rad(self) -> Array:
        """(beams,) directions in the lidar frame."""
        return self.angle_min_rad + self.angle_step_rad * np.arange(self.beams, dtype=np.float64)


def opposite_scanners(model: ScannerModel) -> tuple[ScannerModel, ScannerModel]:
    """``model`` mounted at the front left and at the rear right corner, each looking outwards:
    together they see all around, as the paper's two scanners do."""

    quarter = 0.25 * math.pi
    front, rear = Pose2(0.24, 0.2, quarter), Pose2(-0.24, -0.2, quarter - math.pi)
    return (
        replace(model, name="front", base_from_lidar=front),
        replace(model, name="rear", base_from_lidar=rear, phase_s=model.phase_s + 0.013),
    )


def take_scan(
    model: ScannerModel,
    world: World,
    world_from_base: Pose2 | Array,
    rng: np.random.Generator,
    *,
    stamp_ns: int = 0,
    seq: int | None = None,
    people_m: Array | None = None,
    person_radius_m: float = 0.0,
) -> Scan:
    """One scan from a standing robot (a pose), or a moving one: (beams, 3) x, y, theta, the base
    in the world at the time of each beam. ``people_m``: (beams, k, 2), see :func:`cast`."""
    if isinstance(world_from_base, Pose2):
        world_from_base = np.broadcast_to(world_from_base.as_array(), (model.beams, 3))
    mounting = model.base_from_lidar
    theta = world_from_base[:, 2]
    c, s = np.cos(theta), np.sin(theta)
    origins = world_from_base[:, :2] + np.column_stack(
        [c * mounting.x_m - s * mounting.y_m, s * mounting.x_m + c * mounting.y_m]
    )
    angles = theta + mounting.theta_rad + model.angles_rad

    def measure(directions: Array) -> Array:
        return cast(origins, directions, world.segments_m, people_m, person_radius_m)

    ranges = measure(angles)
    if model.sigma_xy_m > 0.0:
        ranges = _with_xy_noise(ranges, angles, model.sigma_xy_m, measure, rng)
    if model.sigma_range_m > 0.0:
        ranges = ranges + rng.normal(0.0, model.sigma_range_m, model.beams)
    if model.quantum_m > 0.0:
        ranges = np.round(ranges / model.quantum_m) * model.quantum_m
    ranges[~(ranges > 0.0)] = np.nan
    ranges[ranges >= model.range_max_m] = np.inf
    return Scan(
        scanner=model.name,
        stamp_ns=stamp_ns,
        ranges_m=ranges,
        angle_min_rad=model.angle_min_rad,
        angle_step_rad=model.angle_step_rad,
        sweep_s=model.sweep_s,
        range_max_m=model.range_max_m,
        seq=seq,
    )


def _with_xy_noise(
    ranges: Array,
    angles: Array,
    sigma_m: float,
    measure: Callable[[Array], Array],
    rng: np.random.Generator,
) -> Array:
    """Ranges as if noise in x and y had moved each measured point.

    A scan cannot tell noise across a beam by its range. So the point that the noise carries onto
    the beam is measured instead: all beams stay, and the noise is the same in all directions.
    """
    across, along = rng.normal(0.0, sigma_m, (2, len(ranges)))
    turn = np.where(np.isfinite(ranges), np.arctan2(across, ranges), 0.0)
    noisy: Array = measure(angles - turn) * np.cos(turn) + along
    return noisy
