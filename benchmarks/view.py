"""A page of ``amr-slam view`` with many robots: frame time, memory, and how soon it tells a robot
that froze.

Robots that drive through a hall, a router, the view and Chromium are processes of their own, on
this machine. Frames are those of the browser: the time between two chances to draw.

Example: python benchmarks/view.py --minutes 10
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import socket
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import CDPSession, Page

from amr_slam.studies.browsing import browser, read, view_process, wait_for
from amr_slam.studies.fleet.processes import program

START_S = 400.0  # processors may be busy
WARM_S = 20.0
SAMPLE_S = 15.0
RECORD_FRAMES = """() => {
    window.frames_ms = [];
    let last = performance.now();
    const next = (now) => {
        window.frames_ms.push(now - last);
        last = now;
        requestAnimationFrame(next);
    };
    requestAnimationFrame(next);
}"""


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print a table, and with ``--json`` a file of it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robots", type=int, default=100)
    parser.add_argument("--hz", type=float, default=10.0)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--json", type=Path, help="the figures, for comparison")
    arguments = parser.parse_args(argv)
    figures = measure(arguments.robots, arguments.hz, arguments.minutes)
    for name, value in figures.items():
        print(f"{name:32} {value}")
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0


def measure(robots: int, hz: float, minutes: float) -> dict[str, Any]:
    """The figures by what they are called."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    with ExitStack() as opened:
        folder = opened.enter_context(tempfile.TemporaryDirectory())
        opened.enter_context(program("router", endpoint))
        options = [
            "--count", str(robots), "--hz", str(hz), "--area", "700", "--seed", "5",
            "--scanning", "1",
        ]  # fmt: skip
        drivers = opened.enter_context(program("driving", endpoint, folder, *options))
        view = opened.enter_context(view_process(endpoint))
        page = opened.enter_context(browser()).new_page(viewport={"width": 1440, "height": 900})
        page.goto(view.address)
        wait_for(page, f"v.layer.map && v.store.robots.size >= {robots}", START_S)
        read(page, "v.choose('amr01')")
        page.wait_for_timeout(1000.0 * WARM_S)
        page.evaluate(RECORD_FRAMES)
        tools = page.context.new_cdp_session(page)
        poses = _poses(page)
        begun_s = time.monotonic()
        heap, server = [], []
        while time.monotonic() - begun_s < 60.0 * minutes:
            page.wait_for_timeout(1000.0 * min(SAMPLE_S, 60.0 * minutes))
            heap.append(_heap_mb(tools))
            server.append(_resident_mb(view.process.pid))
        seconds = time.monotonic() - begun_s
        drawn = np.array(read(page, "v.drawn"))
        frames = np.array(page.evaluate("window.frames_ms"))
        return {
            "robots": robots,
            "minutes": round(seconds / 60.0, 1),
            "poses a second on the page": round((_poses(page) - poses) / seconds),
            "frame p50 ms": round(float(np.percentile(frames, 50)), 1),
            "frame p95 ms": round(float(np.percentile(frames, 95)), 1),
            "frame p99 ms": round(float(np.percentile(frames, 99)), 1),
            "drawing p95 ms": round(float(np.percentile(drawn, 95)), 1),
            "heap MB, first third": round(float(np.mean(heap[: -(-len(heap) // 3)])), 1),
            "heap MB, last third": round(float(np.mean(heap[-(-len(heap) // 3) :])), 1),
            "server MB, begin and end": f"{server[0]:.0f}, {server[-1]:.0f}",
            "frozen robot is stale after s": _frozen_s(page, drivers.pid, robots),
            "load average": round(os.getloadavg()[0], 1),
        }


def _poses(page: Page) -> int:
    """Poses of all robots that were sent until the newest one that the page has."""
    return int(
        read(page, "[...v.store.robots.values()].reduce((n, r) => n + (r.pose?.seq ?? 0), 0)")
    )


def _heap_mb(tools: CDPSession) -> float:
    """What the page's script holds, after its garbage is gone."""
    tools.send("HeapProfiler.collectGarbage")
    return float(tools.send("Runtime.getHeapUsage")["usedSize"]) / 2**20


def _resident_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"process {pid} has ended")


def _frozen_s(page: Page, pid: int, robots: int) -> float:
    """From a robot's process being stopped to the page showing it as stale."""
    name = f"amr{robots:02d}"
    begun_s = time.monotonic()
    os.kill(pid, signal.SIGSTOP)
    try:
        wait_for(page, f"['stale', 'absent'].includes(v.store.state(v.store.robots.get('{name}')))")
        return round(time.monotonic() - begun_s, 2)
    finally:
        os.kill(pid, signal.SIGCONT)


if __name__ == "__main__":
    sys.exit(main())
