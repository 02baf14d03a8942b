"""``amr-slam check``: is the configuration right, and are the devices there?"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from amr_slam.config import Config, ConfigError
from amr_slam.map import MapError, load_map
from amr_slam.odometry import joints_of
from amr_slam.samples import DriveSample, JointSample, Link, OdometrySample, Scan, WheelSample
from amr_slam.service.body import own_body
from amr_slam.service.devices import DeviceEnded, ScannerThread, WheelsThread

PROBE_S: Final = 5.0
"""Two scans of the slowest scanner, and time to push the robot."""

Received = Scan | DriveSample | DeviceEnded


def check(config: Config, config_path: Path, *, probe: bool) -> int:
    """Print a summary, and with ``probe`` what each device says within 5 s.

    0: all is well; 1: a device is not there or measures nothing. Raises ConfigError
    for a map that cannot be loaded.
    """
    _print(_summary(config, config_path))
    return _probe(config) if probe else 0


def _summary(config: Config, config_path: Path) -> Iterator[str]:
    yield f"{config_path}: robot {config.robot.name}, {config.map.mode}"
    if config.map.path is not None:
        try:
            known, map_id = load_map(config.map.path)
        except MapError as error:
            raise ConfigError(str(error), ("map", "path"), config_path) from error
        yield f"  map {known.name} {map_id}: {len(known)} points, {known.area_m2():.0f} m2"
    else:
        yield f"  new map {config.map.directory / config.map.name}.amrmap"
    for scanner in config.scanners:
        pose = scanner.mounting
        yield (
            f"  scanner {scanner.name}: {scanner.driver} at x {pose.x_m:g} m, y {pose.y_m:g} m, "
            f"{pose.theta_deg:g} deg{', upside down' if pose.upside_down else ''}"
        )
    yield f"  wheels: {config.odometry.driver}"
    yield f"  Zenoh: {config.zenoh.prefix}/{config.robot.name} on {', '.join(config.zenoh.listen)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Probed:
    """What was seen of a device."""

    name: str
    line: str
    """To print."""
    complaint: str | None
    """Why it is not well."""
    link: Link


def listen(config: Config) -> tuple[list[Probed], list[Received]]:
    """Every device, opened by the daemon's own threads for :data:`PROBE_S`, and all that came."""
    received: list[Received] = []
    # Every scan, not one in a scan period: a few tell what never moves.
    settings = [replace(scanner, poll_period_s=0.0) for scanner in config.scanners]
    scanners = [ScannerThread(s, received.append, PROBE_S) for s in settings]
    wheels = WheelsThread(config.odometry, received.append, PROBE_S, config.localizer.wheels_late_s)
    devices: Sequence[ScannerThread | WheelsThread] = (*scanners, wheels)
    if sys.stderr.isatty():
        sys.stderr.write(f"listening for {PROBE_S:g} s; push the robot to see its wheels count\n")
    for device in devices:
        device.start()
    time.sleep(PROBE_S)
    now_ns = time.monotonic_ns()
    probed = []
    for device in devices:
        line, complaint = _seen(device, now_ns, list(received))
        link = device.health(now_ns).link
        probed.append(Probed(name=device.name, line=line, complaint=complaint, link=link))
    for device in devices:
        device.ask_to_stop()
    for device in devices:
        device.join(1.0)
    return probed, received


def _probe(config: Config) -> int:
    probed, received = listen(config)
    _print(one.line for one in probed)
    for scanner in config.scanners:
        scans = [r for r in received if isinstance(r, Scan) and r.scanner == scanner.name]
        _print(f"{scanner.name}: {line}" for line in own_body(scans, scanner.mounting.mounting))
    return 0 if all(one.complaint is None for one in probed) else 1


def _seen(
    device: ScannerThread | WheelsThread, now_ns: int, received: Sequence[Received]
) -> tuple[str, str | None]:
    """(what to print of a device, why it is not well)."""
    ended = [r for r in received if isinstance(r, DeviceEnded) and r.name == device.name]
    if ended:
        complaint = ended[0].unusable or "the driver has failed"
        return f"{device.name}: FAILED: {complaint}", complaint
    health, info = device.health(now_ns), device.info
    complaint = health.detail or "nothing received"
    if health.link is Link.LOST or info is None:
        return f"{device.name}: NOT THERE: {complaint}", complaint
    facts = "".join(f", {name} {value}" for name, value in info.facts)
    line = f"{device.name}: {info.model} on {info.address}{facts}"
    if isinstance(device, ScannerThread):
        line += _scans_seen([r for r in received if isinstance(r, Scan)], device.name)
    else:
        line += _wheels_seen([r for r in received if isinstance(r, DriveSample)])
    line += f"; {health.samples} samples, {health.rate_hz:.1f} Hz, {health.errors} errors"
    if health.link is not Link.OK or health.detail is not None:
        return f"{line}; NOT WELL: {complaint}", complaint
    return line, None


def _scans_seen(scans: Sequence[Scan], name: str) -> str:
    own = [scan for scan in scans if scan.scanner == name]
    if not own:
        return ""
    ranges = own[-1].ranges_m
    measured = ranges[np.isfinite(ranges)]
    nearest = f", nearest {measured.min():.2f} m" if len(measured) else ""
    return f"; {len(measured)} of {len(ranges)} beams measure{nearest}"


def _wheels_seen(samples: Sequence[DriveSample]) -> str:
    """How far the wheels have turned meanwhile, or what the vehicle integrated."""
    if not samples:
        return ""
    first, last = samples[0], samples[-1]
    if isinstance(first, OdometrySample) and isinstance(last, OdometrySample):
        moved = first.odom_from_base.inverse() @ last.odom_from_base
        return (
            f"; moved ahead {moved.x_m:+.2f} m, left {moved.y_m:+.2f} m, "
            f"turned {math.degrees(moved.theta_rad):+.1f} deg"
        )
    turned = ", ".join(
        f"{name} {end - start:+.2f} rad"
        for name, start, end in zip(
            joints_of(last), _angles_rad(first), _angles_rad(last), strict=True
        )
    )
    anew = last.segment - first.segment
    return f"; turned {turned}" + (f" (counting began anew {anew} times)" if anew else "")


def _angles_rad(sample: DriveSample) -> tuple[float, ...]:
    if isinstance(sample, WheelSample):
        return sample.left_rad, sample.right_rad
    return sample.angles_rad if isinstance(sample, JointSample) else ()


def _print(lines: Iterator[str]) -> None:
    for line in lines:
        sys.stdout.write(line + "\n")
    sys.stdout.flush()
