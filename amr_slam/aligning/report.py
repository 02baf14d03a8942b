"""What an alignment is worth, in words."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from amr_slam.aligning.fit import Fit
from amr_slam.aligning.matching import PlanFit
from amr_slam.aligning.pairs import PosePairs
from amr_slam.geometry import Pose2

_ALL_SHOWN: Final = 30
"""So few pairs are all listed ..."""
_RUNS_SHOWN: Final = 10
"""... of more, these of the ones that were left out, the farthest first."""


def pairs_report(pairs: PosePairs, fit: Fit, clock_s: float | None) -> str:
    """Of pairs of poses or landmarks.

    ``clock_s``: what was added to the site's stamps, None where there are none."""
    left_out = int((~fit.agrees).sum())
    lines = [f"pairs       {len(pairs)}: {len(pairs) - left_out} agree, {left_out} left out"]
    lines += [f"            left out: {run}" for run in _strangers(pairs, fit)]
    lines += _transform(fit.site_from_map, fit.sigma_m, fit.sigma_rad)
    marker = fit.base_from_marker
    if fit.marker_sigma_m is not None:
        lines.append(
            f"marker      x {marker.x_m:+.3f} m, y {marker.y_m:+.3f} m, heading "
            f"{math.degrees(marker.theta_rad):+.2f} deg on the robot "
            f"(1 sigma {1000.0 * fit.marker_sigma_m:.1f} mm)"
        )
    if clock_s is not None:
        sigma = fit.clock_sigma_s
        told = "as given" if sigma is None else f"1 sigma {1000.0 * sigma:.1f} ms"
        lines.append(f"clock       camera's stamp {clock_s:+.3f} s is the map's ({told})")
    lines.append(_scale(fit.scale, fit.scale_sigma))
    rms_rad = fit.rms_rad
    turn = "" if rms_rad is None else f" {math.degrees(rms_rad):.2f} deg"
    most = float(fit.sizes_m[fit.agrees].max())
    lines.append(
        f"residuals   rms {fit.rms_m:.3f} m{turn}, p95 {fit.p95_m:.3f} m, max {most:.3f} m"
    )
    if len(pairs) <= _ALL_SHOWN:
        lines += _table(pairs, fit)
    return _text(lines, fit.findings)


def plan_report(fit: PlanFit) -> str:
    """Of a floor plan."""
    exact = fit.exact
    shares = (
        f"floor plan  {fit.explained:.0%} of its walls where the map has looked are in the map; "
        f"{fit.shared:.0%} of the map's walls are in the plan"
    )
    lines = [shares]
    if fit.rival is not None:
        at, share = fit.rival
        lines.append(
            f"elsewhere   x {at.x_m:+.2f} m, y {at.y_m:+.2f} m, theta "
            f"{math.degrees(at.theta_rad):+.1f} deg fits {share:.0%} as well"
        )
    lines += _transform(exact.site_from_map, exact.sigma_m, exact.sigma_rad)
    lines.append(_scale(exact.scale, exact.scale_sigma))
    most = float(np.abs(exact.offsets_m).max())
    lines.append(
        f"residuals   rms {exact.rms_m:.3f} m, p95 {exact.p95_m:.3f} m, max {most:.3f} m "
        f"of {len(exact.points_m)} wall points"
    )
    return _text(lines, fit.findings)


def _transform(site_from_map: Pose2, sigma_m: float, sigma_rad: float) -> list[str]:
    pose = site_from_map
    place = (
        f"x {pose.x_m:+.3f} m, y {pose.y_m:+.3f} m, theta {math.degrees(pose.theta_rad):+.3f} deg"
    )
    sure = f"{1000.0 * sigma_m:.1f} mm, {math.degrees(sigma_rad):.3f} deg"
    return [
        f"transform   {place}: where the map's origin comes to lie",
        f"sure to     {sure} (1 sigma, in the middle of what was compared)",
    ]


def _scale(scale: float, sigma: float) -> str:
    return f"scale       {scale:.4f} (1 sigma {sigma:.4f}), measured, not applied"


def _text(lines: list[str], findings: tuple[str, ...]) -> str:
    return "".join(f"{line}\n" for line in [*lines, *(f"finding     {one}" for one in findings)])


def _table(pairs: PosePairs, fit: Fit) -> Iterator[str]:
    width = max(len("pair"), *(len(label) for label in pairs.labels))
    headed = bool(np.isfinite(fit.offsets_rad).any())
    yield f"  {'pair':{width}}    dx m    dy m     m" + ("     deg" if headed else "")
    for row, label in enumerate(pairs.labels):
        dx, dy = fit.offsets_m[row].tolist()
        turn = float(fit.offsets_rad[row])
        told = f" {math.degrees(turn):+7.2f}" if math.isfinite(turn) else " " * (8 * headed)
        yield (
            f"  {label:{width}} {dx:+7.3f} {dy:+7.3f} {math.hypot(dx, dy):5.3f}{told}"
            + ("" if fit.agrees[row] else "  left out")
        )


def _strangers(pairs: PosePairs, fit: Fit) -> list[str]:
    """Runs of pairs that contradict the others, by their labels."""
    rows = np.flatnonzero(~fit.agrees)
    if not len(rows):
        return []
    runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    runs.sort(key=lambda run: -float(fit.sizes_m[run].max()))
    told = []
    for run in runs[:_RUNS_SHOWN]:
        first, last = pairs.labels[run[0]], pairs.labels[run[-1]]
        span = first if len(run) == 1 else f"{first} to {last} ({len(run)} pairs)"
        turn = np.abs(fit.offsets_rad[run])
        turned = (
            f", {math.degrees(float(np.nanmax(turn))):.0f} deg" if np.isfinite(turn).any() else ""
        )
        told.append(f"{span}: {float(fit.sizes_m[run].max()):.2f} m{turned} off")
    if len(runs) > _RUNS_SHOWN:
        told.append(f"and {len(runs) - _RUNS_SHOWN} more: --residuals lists all")
    return told
