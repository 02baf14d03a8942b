"""The pose between two scans: the product and its rivals at several speeds and wheel errors."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.evaluation import ErrorSummary
from amr_slam.fusion import FilterParams
from amr_slam.geometry import Pose2
from amr_slam.studies.fusion.methods import (
    HELD,
    METHODS,
    PRODUCT,
    UNDELAYED,
    WHEELS,
    held,
    undelayed,
    wheels_alone,
)
from amr_slam.studies.fusion.product import estimates, localizer
from amr_slam.studies.fusion.simulated import (
    DRIVE,
    Recording,
    Scenario,
    WheelErrors,
    record,
    start_covariance,
)
from amr_slam.studies.report import Effort, Section, Table

SPEEDS_MPS: Final = (0.3, 1.0, 2.0)
WHEEL_ERRORS: Final = (0.01, 0.03, 0.10)
_RUNS: Final = 3


def errors_m(drive: Recording) -> dict[str, list[float]]:
    """Each method's position errors at every wheel sample of a drive."""
    start, spread = drive.truth[0], start_covariance()
    robot = localizer(FilterParams(), start, spread)
    paths: dict[str, list[Pose2]] = {
        PRODUCT: [estimate.map_from_base for estimate, _ in estimates(drive, robot)],
        WHEELS: list(wheels_alone(drive.wheels, DRIVE, start)),
        HELD: list(held(drive.wheels, drive.fixes, start)),
        UNDELAYED: list(undelayed(drive.wheels, drive.fixes, DRIVE, start, spread)),
    }
    return {
        name: [pose.distance_to(truth) for pose, truth in zip(path, drive.truth, strict=True)]
        for name, path in paths.items()
    }


def study(effort: Effort) -> Section:
    """rms / p95 / max of the 50 Hz pose with a scan every 2 s."""
    runs = effort.trials(_RUNS)
    rows = []
    for speed in SPEEDS_MPS:
        for size in WHEEL_ERRORS:
            scenario = Scenario(name="driving", speed_mps=speed, turn_radps=0.4)
            seen: dict[str, list[float]] = {name: [] for name in METHODS}
            for run in range(runs):
                rng = np.random.default_rng((effort.seed, run, round(1e3 * size)))
                travel, yaw, bend = size * rng.choice([-1.0, 1.0], 3)
                wrong = WheelErrors(
                    travel=travel, yaw=yaw, bend_radpm=0.2 * bend, lag_s=rng.normal(0.0, 0.02)
                )
                drive = record(scenario, wrong, rng, wheel_hz=50.0)
                for name, far in errors_m(drive).items():
                    seen[name] += far
            cells = [_summary(seen[name]) for name in METHODS]
            rows.append((f"{speed:.1f} m/s", f"{100.0 * size:.0f} %", *cells))
            effort.progress(" | ".join(rows[-1]))
    return Section(
        title="The pose between two scans",
        text=_TEXT.format(runs=runs),
        tables=(
            Table(
                title="Position error in m, rms / p95 / max",
                columns=("speed", "wheels wrong by", *METHODS),
                rows=tuple(rows),
            ),
        ),
    )


def _summary(far: list[float]) -> str:
    one = ErrorSummary.of(np.array(far))
    return f"{one.rms:.3f} / {one.p95:.3f} / {one.max:.2f}"


_TEXT: Final = """Wheels at 50 Hz, a fix every 2 s that is 0.2 to 0.8 s old, {runs} drives of 60 s
a row, all samples from the first one on. *Wheels wrong by* e: travel and turns are off by e, plus
or minus at random, and the path bends by 0.2 e rad/m; the clocks differ by 0.02 s (1 sigma), and
1 % of the root of the way is noise. The product starts with its defaults: it has to learn the
wheels within these 60 s, and its worst errors are those of the first seconds. *Fixes taken as of
now*: an EKF of x, y and theta that knows neither delays nor calibration."""
