"""SLAM from scratch: how exactly the robot knows its own way after one tour."""

from __future__ import annotations

from typing import Final

import numpy as np

from amr_slam.slam import Verdict
from amr_slam.studies.drives import Survey
from amr_slam.studies.report import Effort, Section, Table
from amr_slam.studies.table1 import SLAM_SIGMAS_M, surveyed, worlds

_WORLDS: Final = 8


def run(effort: Effort) -> Section:
    """One drive a world and noise level, wheels and one scanner, no loop closed afterwards."""
    seeds = worlds(effort, _WORLDS)
    rows: list[tuple[str, ...]] = []
    wheels_m: list[float] = []
    for sigma_m in SLAM_SIGMAS_M:
        effort.progress(f"slam: sigma {sigma_m:g}, {len(seeds)} worlds")
        surveys: list[Survey] = []
        for seed in seeds:
            driven, own = surveyed(seed, sigma_m)
            surveys.append(own)
            wheels_m.append(driven.wheels_alone_m())
        rows.append((f"{sigma_m:g}", *_row(surveys)))
    return Section(
        title="SLAM from scratch",
        text=(
            f"{len(seeds)} laboratories of 200 m2, one tour each of about 43 m: one scanner of 541 "
            f"beams at 0.5 Hz, wheels whose radii and track differ by 0.5 % (1 sigma) from what "
            f"the odometry believes, and slip; the product's localizer and engine in mapping mode. "
            f"ATE: SE2-aligned root mean square distance of the poses at the scans, and of the "
            f"poses published meanwhile. The wheels alone: median "
            f"{np.median(wheels_m):.2f} m, worst {np.max(wheels_m):.2f} m."
        ),
        tables=(
            Table(
                title="Absolute trajectory error in mm",
                columns=(
                    "sigma",
                    "ATE median",
                    "ATE worst",
                    "published, median",
                    "published, worst",
                    "scans accepted",
                ),
                rows=tuple(rows),
            ),
        ),
    )


def _row(surveys: list[Survey]) -> tuple[str, ...]:
    at_scans = 1e3 * np.array([own.ate_m for own in surveys])
    online = 1e3 * np.array([own.online_ate_m for own in surveys])
    # The first scan founds the map: there is nothing to accept it against.
    accepted = [
        result.answer.verdict is Verdict.ACCEPTED for own in surveys for result in own.results[1:]
    ]
    return (
        f"{np.median(at_scans):.1f}",
        f"{at_scans.max():.1f}",
        f"{np.median(online):.1f}",
        f"{online.max():.1f}",
        f"{np.mean(accepted):.1%}",
    )
