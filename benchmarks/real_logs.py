"""Replay recordings of real robots at 0.5 Hz and compare with published references.

Prints a Markdown table: positions in m as rms / median, relations (Kuemmerle et al.) as the mean
of m and degrees, memory as the most that the command took. The logs are no part of the repository:
they are looked for under ``$AMR_SLAM_SHARED/data/logs``, by default beside the repository in
``../shared/data/logs``.

Examples: python benchmarks/real_logs.py intel --keep out/logs
          python benchmarks/real_logs.py mit_killian --scan-period 0
          python benchmarks/real_logs.py intel --no-loops
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from amr_slam.evaluation import TrajectoryError, absolute_trajectory_error, relations_error
from amr_slam.recording import RecordingError, Trajectory, read_log, read_relations, read_tum
from amr_slam.samples import OdometrySample

REPO: Final = Path(__file__).resolve().parent.parent
LOGS: Final = Path(os.environ.get("AMR_SLAM_SHARED", REPO.parent / "shared")) / "data/logs"
README_LOGS: Final = ("intel", "mit_csail", "acapulco", "fhw", "seattle")
SCAN_PERIOD_S: Final = 2.0
MAX_GAP_S: Final = 2.0
"""A reference's stamp counts where poses no farther apart than this enclose it."""

HEADER: Final = (
    "| log | duration s | scans | x real time | reference (stamps) | wheels alone | online | final "
    "| relations | refused | epochs | MB |\n|---|--:|--:|--:|---|--:|--:|--:|--:|--:|--:|--:|"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """What ``amr-slam replay`` made of one log."""

    report: dict[str, Any]
    took_s: float
    """Processor time of the whole command, from its start to its end."""
    most_mb: float
    """Memory."""
    wheels: Trajectory
    online: Trajectory
    final: Trajectory


def main() -> int:
    """Parse, replay log by log, print a row for each reference."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="*", default=README_LOGS, help="names without their endings")
    parser.add_argument(
        "--scan-period", type=float, default=SCAN_PERIOD_S, help="s between scans; 0 takes all"
    )
    parser.add_argument("--no-loops", action="store_true", help="close none, to compare")
    parser.add_argument("--keep", type=Path, help="folder for trajectories, maps and reports")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print(HEADER, flush=True)
        try:
            for name in arguments.logs:
                run = replayed(
                    LOGS / f"{name}.log.gz",
                    folder,
                    arguments.scan_period,
                    loops=not arguments.no_loops,
                )
                for row in rows(name, run):
                    print(row, flush=True)
        except (RecordingError, ValueError, OSError, subprocess.CalledProcessError) as error:
            print(f"real_logs: {error}", file=sys.stderr)
            return 1
    return 0


def replayed(log: Path, folder: Path, scan_period_s: float, *, loops: bool) -> Run:
    """Replay as the README tells everybody to. Raises what reading and the command raise."""
    wheels = [s for s in read_log(log).samples if isinstance(s, OdometrySample)]
    base = folder / log.name.split(".", 1)[0]
    online, final, report = (base.with_suffix(e) for e in (".tum", ".final.tum", ".json"))
    command = [
        *(sys.executable, "-m", "amr_slam", "replay", str(log)),
        *(["--scan-period", f"{scan_period_s:g}"] if scan_period_s > 0.0 else []),
        *([] if loops else ["--no-loops"]),
        *("--lidar", "0,0,0"),
        *("--out", str(online), "--out-final", str(final)),
        *("--map-out", str(base.with_suffix(".amrmap")), "--report", str(report)),
    ]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(child.pid, 0)
    if status:
        raise subprocess.CalledProcessError(os.waitstatus_to_exitcode(status), command)
    return Run(
        report=json.loads(report.read_text("utf-8")),
        took_s=usage.ru_utime + usage.ru_stime,
        most_mb=usage.ru_maxrss / 1024.0,
        wheels=Trajectory(
            stamps_ns=np.array([sample.stamp_ns for sample in wheels], dtype=np.int64),
            poses=np.array([sample.odom_from_base.as_array() for sample in wheels]),
        ),
        online=read_tum(online),
        final=read_tum(final),
    )


def rows(name: str, run: Run) -> Iterator[str]:
    """One line of the table for each reference of a log. Raises ValueError where it has none."""
    references = sorted(LOGS.glob(f"{name}.corrected*.tum"))
    if not references:
        raise ValueError(f"{LOGS}: no reference for {name}")
    report = run.report
    for path in references:
        reference = read_tum(path)
        wheels, online, final = (
            absolute_trajectory_error(trajectory, reference, max_gap_s=MAX_GAP_S)
            for trajectory in (run.wheels, run.online, run.final)
        )
        kind = path.name.removeprefix(f"{name}.").removesuffix(".tum")
        cells = (
            name,
            f"{report['duration_s']:.0f}",
            f"{report['scans_used']} of {report['scans_in_log']}",
            f"{report['duration_s'] / run.took_s:.0f}",
            f"{kind} ({online.matched} of {len(reference)})",
            f"{wheels.position_m.rms:.2f}",
            _rms_median(online),
            _rms_median(final),
            _relations(name, run.final),
            f"{report['refused_by_fusion']}",
            f"{report['epoch']}",
            f"{run.most_mb:.0f}",
        )
        yield f"| {' | '.join(cells)} |"


def _relations(name: str, final: Trajectory) -> str:
    path = LOGS / f"{name}.relations"
    if not path.exists():
        return ""
    error = relations_error(final, read_relations(path), max_gap_s=MAX_GAP_S)
    return f"{error.position_m.mean:.3f} / {error.heading_deg.mean:.2f}"


def _rms_median(error: TrajectoryError) -> str:
    return f"{error.position_m.rms:.3f} / {error.position_m.median:.3f}"


if __name__ == "__main__":
    sys.exit(main())
