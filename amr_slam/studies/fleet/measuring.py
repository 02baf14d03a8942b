"""What is lost, and how late poses come: busy processors, many robots, a map beside them."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from amr_slam.client import ask_map, close_session, open_client
from amr_slam.service.usage import Usage
from amr_slam.studies.fleet.processes import busy, program, wait_until
from amr_slam.studies.fleet.robots import name_of

_HZ: Final = 50.0
_SETTLE_S: Final = 2.0
_MAP_S: Final = 120.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """What a controller has heard in a while."""

    robots: int
    seconds: float
    received: int
    lost: int
    latency_s: tuple[float, float, float]
    """From making a pose to the controller's loop: median, 99 %, largest."""
    cpu_percent: dict[str, float]
    """Of one processor: robots (all), router, controller."""
    memory_mb_each: float
    """Resident memory that a robot adds to its process (many share one)."""
    longest_put_s: float
    """For which publishing kept a robot's loop."""

    @property
    def rate_hz(self) -> float:
        """Messages a second at the controller."""
        return self.received / self.seconds

    @property
    def offered_hz(self) -> float:
        """Messages a second that all robots ought to send."""
        return self.robots * _HZ


def hear(
    endpoint: str,
    seconds: float,
    *,
    robots: int = 1,
    processes: int = 1,
    busy_processes: int = 0,
    every_nth: bool = False,
    qos: str | None = None,
) -> Heard:
    """``robots`` at 50 Hz, spread over ``processes``, through one router to one controller, while
    ``busy_processes`` others want a whole processor each."""
    with ExitStack() as opened:
        router = opened.enter_context(program("router", endpoint))
        fleet = [
            opened.enter_context(
                program(
                    "robots", endpoint, "--first", str(first), "--count", str(count),
                    *(() if qos is None else ("--qos", qos)),
                )
            )
            for first, count in _shares(robots, processes)
        ]  # fmt: skip
        controller = opened.enter_context(
            program(
                "controller", endpoint, "--count", str(robots),
                *(("--every-nth",) if every_nth else ()),
            )
        )  # fmt: skip
        wait_until(controller, robots)
        time.sleep(_SETTLE_S)
        opened.enter_context(busy(busy_processes))
        parts = {
            "robots": [one.pid for one in fleet],
            "router": [router.pid],
            "controller": [controller.pid],
        }
        with _used(parts) as cpu_percent:
            controller.ask()
            time.sleep(seconds)
            told = controller.ask()
        ends = [one.end() for one in fleet]
        controller.stop()
        router.stop()
    return _heard(robots, told, cpu_percent, ends)


def hear_beside_map(endpoint: str, seen_at: str, path: Path) -> tuple[Heard, float]:
    """One robot, while the map at ``path`` is fetched from it by a program of its own through the
    same link; also the seconds that took. ``endpoint``: where the router listens; ``seen_at``:
    where the robot finds it, over a slower link say."""
    with (
        program("router", endpoint) as router,
        program("robots", seen_at, "--map", str(path)) as robot,
        program("controller", endpoint) as controller,
    ):
        wait_until(controller, 1)
        session = open_client(endpoint, None, timeout_s=5.0)
        try:
            time.sleep(_SETTLE_S)
            controller.ask()
            begun_s = time.monotonic()
            ask_map(session, "amr", name_of(0), _MAP_S)
            took_s = time.monotonic() - begun_s
            told = controller.ask()
        finally:
            close_session(session)
        ends = [robot.end()]
        controller.stop()
        router.stop()
    return _heard(1, told, {}, ends), took_s


def _shares(robots: int, processes: int) -> Iterator[tuple[int, int]]:
    """(First, count) for each process."""
    for n in range(processes):
        first, last = n * robots // processes, (n + 1) * robots // processes
        if last > first:
            yield first, last - first


@contextmanager
def _used(parts: dict[str, list[int]]) -> Iterator[dict[str, float]]:
    """Filled at the end: processor time of the processes since the beginning, in per cent."""
    meters = {name: Usage() for name in parts}
    for name, meter in meters.items():
        meter.look(parts[name])
    found: dict[str, float] = {}
    yield found
    for name, meter in meters.items():
        found[name], _ = meter.look(parts[name])


def _heard(
    robots: int,
    told: dict[str, Any],
    cpu_percent: dict[str, float],
    ends: Sequence[dict[str, Any]],
) -> Heard:
    median_s, p99_s, longest_s = told["latency_s"]
    return Heard(
        robots=robots,
        seconds=told["seconds"],
        received=told["received"],
        lost=told["lost"],
        latency_s=(median_s, p99_s, longest_s),
        cpu_percent=cpu_percent,
        memory_mb_each=sum(end["memory_mb_each"] for end in ends) / len(ends),
        longest_put_s=max(end["longest_put_s"] for end in ends),
    )
