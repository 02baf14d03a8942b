"""A fleet controller on ``amr_slam.client.Fleet``: ``controller ENDPOINT --count 100``.

Follows each robot by ``Robot.poses()`` until standard input ends; each line on it begins a new
measurement and ends the one before, which is told in one line of JSON.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from amr_slam.client import Fleet, Robot, RobotView, StalePoseError
from amr_slam.studies.fleet.programs import memory_mb, ready, say
from amr_slam.studies.fleet.robots import name_of

_FIRST_S = 60.0
_STALE_S = 2.0


class _Measured:
    """What came in since :meth:`begin`."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self.latencies_s: list[float] = []
        """From the pose's making to the loop that uses it."""
        self.stale = 0
        self.begin()

    def begin(self) -> None:
        self.latencies_s.clear()
        self.stale = 0
        self._before = self._fleet.views()
        self._begun_s, self._used_s = time.monotonic(), time.process_time()

    def told(self) -> dict[str, Any]:
        views = self._fleet.views()
        seconds = time.monotonic() - self._begun_s

        def grown(count: Callable[[RobotView], int]) -> int:
            return sum(
                count(view) - count(self._before.get(name, RobotView(robot=name)))
                for name, view in views.items()
            )

        return {
            "seconds": seconds,
            "received": grown(lambda view: view.poses),
            "lost": grown(lambda view: view.lost),
            "restarts": grown(lambda view: view.restarts),
            "refused": grown(lambda view: view.refused),
            "stale": self.stale,
            "alive": sum(view.alive for view in views.values()),
            "heard": sum(view.pose is not None for view in views.values()),
            "used": len(self.latencies_s),
            "latency_s": quantiles(self.latencies_s),
            "cpu_percent": 100.0 * (time.process_time() - self._used_s) / seconds,
            "memory_mb": memory_mb(),
        }


def quantiles(values: Sequence[float]) -> list[float]:
    """Median, 99 % and the largest; NaN of nothing."""
    ordered = sorted(values) or [math.nan]
    last = len(ordered) - 1
    return [ordered[round(share * last)] for share in (0.5, 0.99, 1.0)]


async def _follow(robot: Robot, measured: _Measured) -> None:
    stale_s = _FIRST_S
    while True:
        try:
            async for pose in robot.poses(stale_s):
                stale_s = _STALE_S
                measured.latencies_s.append(time.monotonic() - pose.stamp)
        except StalePoseError:
            measured.stale += 1
            await asyncio.sleep(0.1)


async def _control(arguments: argparse.Namespace) -> None:
    names = [name_of(arguments.first + n) for n in range(arguments.count)]
    loop, ended = asyncio.get_running_loop(), asyncio.Event()
    async with Fleet(arguments.endpoint, names, full_rate=not arguments.every_nth) as fleet:
        measured = _Measured(fleet)

        def tell() -> None:
            say(measured.told())
            measured.begin()

        def read() -> None:
            for _ in sys.stdin:
                loop.call_soon_threadsafe(tell)
            loop.call_soon_threadsafe(ended.set)

        following = [asyncio.ensure_future(_follow(fleet.robot(name), measured)) for name in names]
        threading.Thread(target=read, daemon=True).start()
        ready()
        await ended.wait()
        for task in following:
            task.cancel()
        await asyncio.gather(*following, return_exceptions=True)


def main(argv: Sequence[str] | None = None) -> int:
    """Follow until standard input ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("endpoint", help="of the router")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--every-nth", action="store_true", help="what is sent for fleets")
    asyncio.run(_control(parser.parse_args(argv)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
