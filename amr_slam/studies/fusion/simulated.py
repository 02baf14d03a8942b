"""Drives, wheels and fixes with known errors: the input of the fusion without any scan.

Fix errors are drawn as the registration's were found to be (:mod:`.pipeline`): white noise of the
claimed covariance, and the map's own error, which fixes nearby share.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from amr_slam.geometry import Array, Pose2
from amr_slam.odometry import DifferentialDrive
from amr_slam.samples import SlamPose, WheelSample

DRIVE: Final = DifferentialDrive(radius_left_m=0.1, radius_right_m=0.1, track_m=0.5)
_RADIUS_M: Final = 0.1
_TRACK_M: Final = 0.5
_MAP_ERROR: Final = np.array([0.005, 0.005, 0.0015])
_MAP_RANGE_M: Final = 5.0
# What a scan tells: in a room, with one scanner of two, along a corridor (m, m, rad).
ROOM: Final = np.array([0.004, 0.004, 0.0015])
ONE_SCANNER: Final = np.array([0.008, 0.004, 0.003])
CORRIDOR: Final = np.array([0.5, 0.004, 0.002])


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """How the robot drives and what goes wrong."""

    name: str
    duration_s: float = 60.0
    speed_mps: Annotated[float, Ge(0)] = 0.5
    turn_radps: float = 0.3
    """Amplitude of the turning speed."""
    on_the_spot: bool = False
    """Turns, and drives only a little between."""
    fix_sigma: tuple[float, float, float] = (0.004, 0.004, 0.0015)
    """Of a fix: along, across, heading."""
    outage_s: tuple[float, float] = (math.inf, math.inf)
    """No fix between these."""
    slips: float = 0.0
    """Slips a minute: one wheel spins, up to 0.3 m, within up to a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WheelErrors:
    """What the odometry is wrong by."""

    travel: float = 0.0
    yaw: float = 0.0
    bend_radpm: float = 0.0
    lag_s: float = 0.0
    """The wheels' stamps are later than the scans' by this."""
    random_m2_per_m: float = 1e-4
    """Variance of each wheel's way."""

    @staticmethod
    def drawn(rng: np.random.Generator, size: float, lag_s: float = 0.02) -> WheelErrors:
        """Scales off by ``size`` (1 sigma), the bend by 0.2 ``size`` rad/m, the clocks by
        ``lag_s``."""
        travel, yaw, bend, lag = rng.normal(0.0, 1.0, 4)
        return WheelErrors(
            travel=size * travel, yaw=size * yaw, bend_radpm=0.2 * size * bend, lag_s=lag_s * lag
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Recording:
    """One drive: what came out of the devices, and the truth."""

    wheels: tuple[WheelSample, ...]
    truth: tuple[Pose2, ...]
    """At each wheel sample's instant on the scans' clock (its stamp)."""
    fixes: tuple[tuple[int, SlamPose], ...]
    """With the instant (ns) of arrival, in that order."""
    slips_ns: tuple[tuple[int, int], ...] = ()
    """Begin and end of each slip, on the scans' clock."""

    def newest_scan_ns(self, stamp_ns: int) -> int:
        """Stamp of the newest scan whose fix has come by an instant; 0 before the first."""
        return max((fix.stamp_ns for at_ns, fix in self.fixes if at_ns <= stamp_ns), default=0)

    def fixes_since_slip(self, stamp_ns: int) -> int:
        """How many fixes of scans after the last slip have come by an instant; 0: of that slip
        nobody can know all. All fixes of the drive before the first slip."""
        come = [fix.stamp_ns for at_ns, fix in self.fixes if at_ns <= stamp_ns]
        ends = [end for begin, end in self.slips_ns if begin <= stamp_ns]
        return min((sum(one >= end for one in come) for end in ends), default=len(self.fixes))


def record(
    scenario: Scenario,
    errors: WheelErrors,
    rng: np.random.Generator,
    *,
    wheel_hz: Annotated[float, Gt(0)] = 20.0,
    scan_period_s: float = 2.0,
) -> Recording:
    """Drive once. Registration takes 0.2 to 0.8 s."""
    dt_s = 1.0 / wheel_hz
    # The wheels' clock is late: what they report at t happened at t - lag. The steps end where the
    # wheels are read, as noise between two steps would be smoothed.
    margin_s = 1.0
    times = np.arange(-margin_s, scenario.duration_s + margin_s, dt_s) - errors.lag_s
    speeds, turns = _speeds(scenario, times, rng)
    poses = _path(speeds * dt_s, turns * dt_s)
    at = np.arange(0.0, scenario.duration_s, dt_s)
    truth = tuple(Pose2.from_array(row) for row in _interpolated(times, poses, at))
    wheels, slips = _wheels(scenario, errors, rng, times, speeds, turns, at)
    stamps = np.arange(0.5 * scan_period_s, scenario.duration_s - 1.0, scan_period_s)
    stamps = stamps + rng.uniform(-0.02, 0.02, len(stamps))
    way = np.interp(stamps, times, np.cumsum((np.abs(speeds) + np.abs(turns)) * dt_s))
    fixes = _fixes(scenario, rng, stamps, _interpolated(times, poses, stamps), way)
    return Recording(wheels=wheels, truth=truth, fixes=fixes, slips_ns=slips)


def _speeds(scenario: Scenario, times: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Ahead and turning: drives and halts, accelerating by 0.5 m/s2 at most."""
    phase, period = rng.uniform(0.0, math.tau), rng.uniform(12.0, 20.0)
    wave = np.sin(math.tau * times / period + phase)
    ramp = np.clip(2.0 * wave + 1.2, 0.0, 1.0)
    speeds = scenario.speed_mps * ramp
    turns = scenario.turn_radps * np.sin(math.tau * times / rng.uniform(7.0, 11.0) + phase)
    if scenario.on_the_spot:
        speeds = 0.2 * scenario.speed_mps * ramp
    return speeds, turns if scenario.on_the_spot else turns * ramp


def _path(ways: Array, turns: Array) -> Array:
    """(n, 3) unwrapped poses before each step."""
    headings = np.concatenate([[0.0], np.cumsum(turns)[:-1]])
    middle = headings + 0.5 * turns
    x = np.concatenate([[0.0], np.cumsum(ways * np.cos(middle))[:-1]])
    y = np.concatenate([[0.0], np.cumsum(ways * np.sin(middle))[:-1]])
    return np.column_stack([x, y, headings])


def _interpolated(times: Array, poses: Array, at: Array) -> Array:
    return np.column_stack([np.interp(at, times, poses[:, k]) for k in range(3)])


def _wheels(
    scenario: Scenario,
    errors: WheelErrors,
    rng: np.random.Generator,
    times: Array,
    speeds: Array,
    turns: Array,
    at: Array,
) -> tuple[tuple[WheelSample, ...], tuple[tuple[int, int], ...]]:
    """What the wheels tell, and when they slipped (:attr:`Recording.slips_ns`)."""
    dt_s = times[1] - times[0]
    ways, turned = speeds * dt_s, turns * dt_s
    reported = ways / (1.0 + errors.travel)
    reported_turn = (turned - errors.bend_radpm * reported) / (1.0 + errors.yaw)
    left = reported - 0.5 * _TRACK_M * reported_turn
    right = reported + 0.5 * _TRACK_M * reported_turn
    both = np.column_stack([left, right])
    both += rng.normal(0.0, 1.0, both.shape) * np.sqrt(errors.random_m2_per_m * np.abs(both))
    scrub = rng.normal(0.0, 1.0, len(both)) * np.sqrt(DRIVE.yaw_rad2_per_m * np.abs(both).mean(1))
    both += 0.5 * _TRACK_M * np.column_stack([-scrub, scrub])
    slips = _slips(scenario, rng)
    for begin, end, wheel, size_m in slips:
        inside = (times >= begin) & (times < end)
        both[inside, wheel] += size_m / max(1, int(inside.sum()))
    summed = np.vstack([np.zeros(2), np.cumsum(both, axis=0)[:-1]])
    angles = np.column_stack(
        [np.interp(at - errors.lag_s, times, summed[:, k]) / _RADIUS_M for k in range(2)]
    )
    samples = tuple(
        WheelSample(stamp_ns=round(1e9 * t), left_rad=float(left), right_rad=float(right))
        for t, (left, right) in zip(at, angles, strict=True)
    )
    return samples, tuple((round(1e9 * begin), round(1e9 * end)) for begin, end, *_ in slips)


def _slips(scenario: Scenario, rng: np.random.Generator) -> list[tuple[float, float, int, float]]:
    """(begin s, end s, wheel, way in m that it spins)."""
    if not scenario.slips:
        return []
    count = round(scenario.slips * scenario.duration_s / 60.0)
    begins = rng.uniform(10.0, scenario.duration_s - 5.0, count)
    return [
        (begin, begin + rng.uniform(0.2, 1.0), int(rng.integers(2)), rng.uniform(0.05, 0.3))
        for begin in begins
    ]


def _fixes(
    scenario: Scenario, rng: np.random.Generator, stamps: Array, poses: Array, way: Array
) -> tuple[tuple[int, SlamPose], ...]:
    shared = rng.standard_normal(3)
    found = []
    for row, (stamp, pose) in enumerate(zip(stamps, poses, strict=True)):
        kept = math.exp(-(way[row] - way[max(row - 1, 0)]) / _MAP_RANGE_M)
        shared = kept * shared + math.sqrt(1.0 - kept**2) * rng.standard_normal(3)
        along = Pose2(0.0, 0.0, float(pose[2])).adjoint()
        sigmas = np.array(scenario.fix_sigma)
        error = along @ (rng.standard_normal(3) * sigmas) + shared * _MAP_ERROR
        covariance = along @ np.diag(sigmas**2) @ along.T
        arrives_s = stamp + rng.uniform(0.2, 0.8)
        if scenario.outage_s[0] <= stamp < scenario.outage_s[1]:
            continue
        fix = SlamPose(
            stamp_ns=round(1e9 * stamp),
            map_from_base=Pose2.from_array(pose + error),
            covariance=0.5 * (covariance + covariance.T),
        )
        found.append((round(1e9 * arrives_s), fix))
    return tuple(sorted(found, key=lambda item: item[0]))


def start_covariance() -> Array:
    """(3, 3) of the pose that a drive begins with."""
    return np.asarray(np.diag(np.square([0.02, 0.02, 0.01])))


Errors = NDArray[np.float64]
