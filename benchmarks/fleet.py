"""What a fleet of robots costs, what it loses, and how late its poses come.

Robots (real wire messages through the product's publishing code, many to a process), a Zenoh router
and a controller on amr_slam.client.Fleet, each in processes of their own on this machine. Without
--quick ten minutes: 30,000 poses beside three busy processes, then 10 to 200 robots, a map
on a slow link, outages. Example: python benchmarks/fleet.py --write docs/fleet-scale.md
"""

from __future__ import annotations

import argparse
import os
import platform
import socket
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np

from amr_drivers.emulators.slow_link import SlowLink
from amr_slam.clouds import cloud_from_scan
from amr_slam.geometry import Pose2
from amr_slam.map import PointMap, save_map
from amr_slam.params import SlamParams
from amr_slam.simulation import ScannerModel, plan_tour, take_scan
from amr_slam.simulation.halls import hall
from amr_slam.studies.fleet.measuring import Heard, hear, hear_beside_map
from amr_slam.studies.fleet.outages import outages
from amr_slam.studies.fleet.robots import VARIANTS, pose_bytes

BEGIN: Final = "<!-- fleet: the output of `python benchmarks/fleet.py`, from here -->"
END: Final = "<!-- fleet: to here -->"
ROBOTS: Final = (10, 25, 50, 100, 150, 200)
USUAL: Final = 100
"""So many are followed by ``fleet_pose``, too, and tell what a message costs: with more, two
processors are at their end."""
PROCESSES: Final = 4
BUSY: Final = 3
FEW: Final = 5
"""In two minutes, 30,000 poses."""
LINK_BITS_PER_S: Final = 20e6
SCANS: Final = 250
_OVERHEAD_BYTES: Final = 110
"""Of a message alone in its packet: Ethernet, IP and TCP (66), TLS (22), Zenoh's header and key."""


def main() -> int:
    """Measure, and print or write Markdown."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="short measurements: three minutes")
    parser.add_argument("--write", metavar="PAGE", type=Path, help="put the tables into this page")
    arguments = parser.parse_args()
    lines = []
    for line in measured(quick=arguments.quick):
        lines.append(line)
        print(line, flush=True)
    if arguments.write is not None:
        put_between(arguments.write, "\n".join(lines))
    return 0


def measured(*, quick: bool) -> Iterator[str]:
    """The tables, line by line."""
    yield (
        f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, "
        f"{datetime.now(UTC):%d %B %Y}{', short measurements' if quick else ''}; load average "
        f"before: {os.getloadavg()[0]:.1f}."
    )
    yield from beside_busy_processes(quick=quick)
    most: list[Heard] = []
    yield from many_robots(most, quick=quick)
    yield from arithmetic(most[0])
    yield from beside_a_map()
    yield from after_outages(tries=2 if quick else 10)


def beside_busy_processes(*, quick: bool) -> Iterator[str]:
    """Some robots, while others want the processors."""
    yield f"\n**{FEW} robots at 50 Hz beside {BUSY} busy processes**\n"
    yield "| quality of service | poses | lost | latency ms, median / p99 / max | longest put ms |"
    yield "|---|--:|--:|--:|--:|"
    for name, seconds in (
        ("the product's: DROP, queue of 16", 10.0 if quick else 120.0),
        *((name, 10.0 if quick else 20.0) for name in VARIANTS),
    ):
        heard = hear(
            free_endpoint(),
            seconds,
            robots=FEW,
            processes=1,
            busy_processes=BUSY,
            qos=name if name in VARIANTS else None,
        )
        yield (
            f"| {name} | {heard.received} | {heard.lost} | {latencies(heard)} "
            f"| {1e3 * heard.longest_put_s:.1f} |"
        )


def many_robots(most: list[Heard], *, quick: bool) -> Iterator[str]:
    """Until the machine has no more; ``most`` gets what was heard of the USUAL number."""
    yield f"\n**Robots at 50 Hz in {PROCESSES} processes, one router, one controller**\n"
    yield (
        "| robots | sent 1/s | at the controller 1/s | lost | latency ms, median / p99 / max "
        "| processor %: robots / router / controller | MB a robot |"
    )
    yield "|---|--:|--:|--:|--:|--:|--:|"
    seconds = 5.0 if quick else 20.0
    for robots in ROBOTS:
        heard = hear(free_endpoint(), seconds, robots=robots, processes=PROCESSES)
        yield row(str(robots), heard.offered_hz, heard)
        if robots == USUAL:
            most.append(heard)
    heard = hear(free_endpoint(), seconds, robots=USUAL, processes=PROCESSES, every_nth=True)
    yield row(f"{USUAL}, by `fleet_pose`", heard.offered_hz, heard)


def row(name: str, offered_hz: float, heard: Heard) -> str:
    """Of the table of robots."""
    used = " / ".join(f"{heard.cpu_percent[part]:.0f}" for part in heard.cpu_percent)
    return (
        f"| {name} | {offered_hz:.0f} | {heard.rate_hz:.0f} | {heard.lost} | {latencies(heard)} "
        f"| {used} | {heard.memory_mb_each:.1f} |"
    )


def arithmetic(most: Heard) -> Iterator[str]:
    """What larger fleets come to, by the processor time of a message as measured here."""
    size = pose_bytes() + _OVERHEAD_BYTES
    router_s, controller_s = (
        most.cpu_percent[part] / 100.0 / most.rate_hz for part in ("router", "controller")
    )
    yield (
        f"\n**What this comes to**: {pose_bytes()} bytes a pose, {_OVERHEAD_BYTES} more on the "
        f"wire; {1e6 * router_s:.0f} us of processor time a message in the router and "
        f"{1e6 * controller_s:.0f} us in the controller.\n"
    )
    yield "| followed | messages 1/s | Mbit/s | processors for routing | for a Python controller |"
    yield "|---|--:|--:|--:|--:|"
    for what, rate_hz in (
        ("100 robots, every pose (50 Hz)", 100 * 50.0),
        ("100 robots, `fleet_pose` (5 Hz)", 100 * 5.0),
        ("10,000 robots, every pose", 10_000 * 50.0),
        ("10,000 robots, `fleet_pose`", 10_000 * 5.0),
        ("10,000 robots, thinned to 1 Hz by the halls' routers", 10_000 * 1.0),
    ):
        yield (
            f"| {what} | {rate_hz:,.0f} | {8e-6 * size * rate_hz:,.1f} | {router_s * rate_hz:,.2f} "
            f"| {controller_s * rate_hz:,.2f} |"
        )


def beside_a_map() -> Iterator[str]:
    """A download through the robot's own link."""
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "hall.amrmap"
        save_map(large_map(), path)
        size_mb = path.stat().st_size / 1e6
        router = free_endpoint()
        with SlowLink(router, LINK_BITS_PER_S) as link:
            heard, took_s = hear_beside_map(router, link.endpoint, path)
    yield (
        f"\n**A map of {size_mb:.1f} MB through the robot's link of "
        f"{LINK_BITS_PER_S / 1e6:.0f} Mbit/s** took {took_s:.1f} s; meanwhile {heard.received} "
        f"poses came, {heard.lost} were lost, latency ms median / p99 / max: {latencies(heard)}; "
        f"the longest put took {1e3 * heard.longest_put_s:.1f} ms."
    )


def after_outages(tries: int) -> Iterator[str]:
    """Router and robot."""
    found = outages(free_endpoint(), tries)
    yield (
        f"\n**Outages**, the longest of {tries}: poses {found.back_s:.2f} s after the router's "
        f"return; `alive` fallen {found.gone_s:.2f} s after the robot froze; no put took longer "
        f"than {1e3 * found.longest_put_s:.1f} ms."
    )


def latencies(heard: Heard) -> str:
    """In ms."""
    return " / ".join(f"{1e3 * seconds:.1f}" for seconds in heard.latency_s)


def large_map() -> PointMap:
    """A hall, mapped from true poses."""
    world, params, scanner = hall(3, 2000.0), SlamParams(), ScannerModel(sigma_range_m=0.01)
    grown, rng = PointMap(params.map), np.random.default_rng(0)
    path = plan_tour(world).path_m
    for position in path[:: max(1, len(path) // SCANS)]:
        pose = Pose2.from_array((*position, rng.uniform(-np.pi, np.pi)))
        scan = take_scan(scanner, world, pose, rng)
        grown.insert(cloud_from_scan(scan, Pose2.identity(), params.clouds), pose)
    return grown


def put_between(page: Path, text: str) -> None:
    """Replace what stands between the page's two marks. Raises ValueError without them."""
    before, _, rest = page.read_text("utf-8").partition(BEGIN)
    _, found, after = rest.partition(END)
    if not found:
        raise ValueError(f"{page}: no place for the tables")
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", "utf-8")


def free_endpoint() -> str:
    """On loopback."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return f"tcp/127.0.0.1:{free.getsockname()[1]}"


if __name__ == "__main__":
    sys.exit(main())
