"""A calibration in words, as lines for the configuration, and as a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.calibration.values import Calibration, Measures
from amr_slam.geometry import Array, wrap_angle
from amr_slam.pictures import style
from amr_slam.pictures.style import BLUE, VERMILION

_SURE: Final = 4.0
"""Standard deviations from which on a difference is none of chance."""
# What matters to localization: smaller differences are not worth a warning (share, m, rad, s).
_SHARE_MATTERS, _PLACE_MATTERS_M = 0.003, 0.01
_ANGLE_MATTERS_RAD, _LAG_MATTERS_S = math.radians(0.3), 0.02


def describe(calibration: Calibration) -> Iterator[str]:
    """A line a measure: configured, found, uncertainty; then what the drive does not tell."""
    rows = _rows(calibration)
    yield f"{'':28} {'configured':>12} {'found':>12} {'+- (1 sigma)':>13}"
    for name, unit, scale, given, found, sigma, _ in rows:
        numbers = f"{scale * given:12.5f} {scale * found:12.5f} {scale * sigma:13.5f}"
        yield f"{name + ' ' + unit:28} {numbers}"
    doubts = calibration.doubts()
    if doubts:
        yield "this drive does not tell:"
        yield from (f"  {doubt}" for doubt in doubts)


def drifted(calibration: Calibration) -> tuple[str, ...]:
    """Which configured measures the drive refutes by more than chance and more than matters."""
    said = []
    for name, unit, scale, given, found, sigma, matters in _rows(calibration):
        difference = found - given
        if abs(difference) > max(_SURE * sigma, matters):
            said.append(
                f"{name}: configured {scale * given:.5g} {unit}, the drive says "
                f"{scale * found:.5g} +- {scale * sigma:.2g} {unit}"
            )
    return tuple(said)


def config_lines(calibration: Calibration) -> Iterator[str]:
    """TOML to be put in the place of the configuration's own lines. What the drive does not tell
    is left as configured."""
    sigmas = calibration.sigmas
    found, given = calibration.measures, calibration.given
    doubts = " ".join(calibration.doubts())
    drive = given if "wheel radii" in doubts or "track" in doubts else found
    yield "[drive]"
    for key, sigma in zip(("radius_left_m", "radius_right_m", "track_m"), sigmas, strict=False):
        yield f"{key} = {getattr(drive, key):.6f}  # +- {sigma:.6f}"
    for index, scanner in enumerate(found.scanners):
        told = given.scanners[index] if f"{scanner.name}: " in doubts else scanner
        pose, sigma = told.base_from_lidar, sigmas[3 + 4 * index : 7 + 4 * index]
        yield f"# scanner {scanner.name}"
        yield "[scanners.mounting]"
        yield f"x_m = {pose.x_m:.4f}  # +- {sigma[0]:.4f}"
        yield f"y_m = {pose.y_m:.4f}  # +- {sigma[1]:.4f}"
        yield f"theta_deg = {math.degrees(pose.theta_rad):.3f}  # +- {math.degrees(sigma[2]):.3f}"
        yield f"lag_s = {told.lag_s:.4f}  # +- {sigma[3]:.4f}"


def plot(calibration: Calibration, path: Path) -> None:
    """The drive, and what the wheels said less what the scanners saw, before and after: a PNG or
    SVG file."""
    figure = style.sheet(9.0, 7.0)
    way, forward, turn = figure.subplot_mosaic([["way", "forward"], ["way", "turn"]]).values()
    way.plot(*calibration.path[:, :2].T, color=BLUE, linewidth=1.0)
    way.set_aspect("equal")
    seconds = 1e-9 * (calibration.stamps_ns[1:] - calibration.stamps_ns[0])
    series: list[tuple[str, str, str, Array]] = [
        ("configured", VERMILION, "x", calibration.before_error),
        ("calibrated", BLUE, "o", calibration.wheel_error),
    ]
    for label, colour, marker, error in series:
        for axes, values in ((forward, 1e3 * error[:, 0]), (turn, np.degrees(error[:, 2]))):
            axes.scatter(seconds, values, s=7.0, c=colour, marker=marker, label=label)
    style.chart(way, x="x in m", y="y in m", title="The drive")
    style.chart(
        forward, x="time in s", y="mm an interval", title="Wheels less scanners, ahead",
        legend="best",
    )  # fmt: skip
    style.chart(turn, x="time in s", y="degrees an interval", title="... in heading")
    style.save(figure, path)


_Row = tuple[str, str, float, float, float, float, float]


def _rows(calibration: Calibration) -> list[_Row]:
    """(name, unit shown, its scale, configured, found, sigma, least difference that matters)."""
    given, found = calibration.given.as_array(), calibration.measures.as_array()
    found[5::4] = given[5::4] + wrap_angle(found[5::4] - given[5::4])
    shown = _shown(calibration.measures)
    return [
        (name, unit, scale, float(g), float(f), float(s), matters * (float(g) if share else 1.0))
        for (name, unit, scale, matters, share), g, f, s in zip(
            shown, given, found, calibration.sigmas, strict=True
        )
    ]


def _shown(measures: Measures) -> list[tuple[str, str, float, float, bool]]:
    drive = ("left radius", "right radius", "track")
    rows = [(name, "mm", 1e3, _SHARE_MATTERS, True) for name in drive]
    for scanner in measures.scanners:
        rows += [
            (f"{scanner.name} x", "mm", 1e3, _PLACE_MATTERS_M, False),
            (f"{scanner.name} y", "mm", 1e3, _PLACE_MATTERS_M, False),
            (f"{scanner.name} angle", "deg", math.degrees(1.0), _ANGLE_MATTERS_RAD, False),
            (f"{scanner.name} clock lag", "ms", 1e3, _LAG_MATTERS_S, False),
        ]
    return rows
