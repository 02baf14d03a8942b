"""Opens every device for a few seconds, as ``check --probe`` does, and tries the map on what is
seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from amr_slam.clouds import cloud_from_scan
from amr_slam.config import Config
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Verdict
from amr_slam.map import MapError, PointMap, load_newest
from amr_slam.samples import Link, Scan
from amr_slam.service import probe
from amr_slam.service.doctor.findings import Finding, advice
from amr_slam.slam_request import SlamRequest

_FITS: Final = 0.3
"""Odds of the best place of one scan, below which it says that the map is of another place."""


def look_at_map(config: Config) -> tuple[list[Finding], PointMap | None]:
    """Whether it is there and whole."""
    if config.map.path is None:
        where = config.map.directory / f"{config.map.name}.amrmap"
        return [Finding(part="map", what=f"mapping: {where}")], None
    try:
        loaded = load_newest(config.map.path)
    except MapError as error:
        do = "copy the map onto the robot again, or map anew (docs/commissioning.md, 5)"
        return [Finding(part="map", what=str(error), do=do)], None
    if loaded.complaint is not None:
        do = "drive by it only if the hall has not changed since; copy the right map anew"
        return [Finding(part="map", what=loaded.complaint, do=do)], loaded.map
    area_m2 = loaded.map.area_m2()
    what = f"{config.map.path}: {loaded.map.name}, {len(loaded.map.path)} scans, {area_m2:.0f} m2"
    return [Finding(part="map", what=what)], loaded.map


def look_at_devices(config: Config, known: PointMap | None) -> Iterator[Finding]:
    """Takes :data:`probe.PROBE_S`."""
    devices, received = probe.listen(config)
    for device in devices:
        do = None
        if device.complaint is not None:
            otherwise = "the table 'What health says' on the driver's page in docs/drivers"
            do = advice(device.complaint, otherwise)
        yield Finding(part=device.name, what=device.line.partition(": ")[2], do=do)
    lost = [device.name for device in devices if device.link is Link.LOST]
    if known is not None and not lost:
        yield from _tried([one for one in received if isinstance(one, Scan)], config, known)


def _tried(scans: Sequence[Scan], config: Config, known: PointMap) -> Iterator[Finding]:
    """The newest scan of each scanner, anywhere in the map."""
    engine = SlamEngine(config.slam, known, "localization")
    newest = {scan.scanner: scan for scan in scans}
    for scanner in config.scanners:
        scan = newest.get(scanner.name)
        if scan is None:
            continue
        mounting = scanner.mounting.mounting
        cloud = cloud_from_scan(
            mounting.masked(scan),
            mounting.base_from_lidar,
            config.slam.clouds,
            upside_down=mounting.upside_down,
        )
        request = SlamRequest(cloud=cloud, map_from_base=None, covariance=None)
        answer = engine.update(request).answer
        if answer.verdict is not Verdict.UNKNOWN or sum(answer.odds) >= _FITS:
            yield Finding(part="map", what=f"what {scanner.name} sees fits into it")
        else:
            yield Finding(
                part="map",
                what=f"what {scanner.name} sees fits nowhere in it: {answer.reason}",
                do="is it this hall's map? Is something right before the scanner? Is the "
                "scanner's mounting right (check --probe)? Else the hall has changed: map anew",
            )
