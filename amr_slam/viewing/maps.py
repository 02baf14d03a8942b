"""Maps for pages: asked of a robot once for all pages, drawn in another process, and kept."""

from __future__ import annotations

import asyncio
import importlib
import multiprocessing
import resource
from collections import OrderedDict
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Final

from amr_slam.client import AskingError, FleetListener, ask_map

_KEPT: Final = 4
_ASK_S: Final = 30.0
_DRAW_S: Final = 60.0
_MAX_MEMORY_BYTES: Final = 3 * 2**30
"""Of the process that draws: a few hundred kilobytes may unfold to gigabytes."""
_Key = tuple[str, int]
"""UUID of a map, and its version."""


class MapsError(Exception):
    """There is no map to be had: one line."""


class Maps:
    """The newest few maps, as :func:`amr_slam.viewing.drawing.drawn` gives them."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._kept: OrderedDict[_Key, bytes] = OrderedDict()
        self._one_at_a_time = asyncio.Lock()
        self._pool: ProcessPoolExecutor | None = None
        self._ready: asyncio.Future[None] | None = None

    def start(self) -> None:
        """Have the process ready before the first map; what it imports takes it seconds, or a
        minute on a busy computer, which are not the map's."""
        self._pool = ProcessPoolExecutor(
            1, multiprocessing.get_context("spawn"), initializer=_limit
        )
        self._ready = asyncio.get_running_loop().run_in_executor(self._pool, _import)

    async def of(self, listener: FleetListener, robot: str) -> bytes:
        """The map that a robot has now. Raises MapsError."""
        async with self._one_at_a_time:
            status = listener.view(robot).status
            key = (
                None
                if status is None or status.map is None
                else (status.map.id, status.map.version)
            )
            if key is not None and key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            try:
                data = await asyncio.to_thread(
                    ask_map, listener.session, self._prefix, robot, _ASK_S
                )
            except AskingError as error:
                raise MapsError(str(error)) from error
            packed = await self._draw(robot, data)
            if key is not None:
                self._kept[key] = packed
                while len(self._kept) > _KEPT:
                    self._kept.popitem(last=False)
            return packed

    async def _draw(self, robot: str, data: bytes) -> bytes:
        if self._pool is None:
            self.start()
        assert self._ready is not None
        work = partial(_drawn, data)
        try:
            await asyncio.shield(self._ready)
            running = asyncio.get_running_loop().run_in_executor(self._pool, work)
            return await asyncio.wait_for(running, _DRAW_S)
        except ValueError as error:
            raise MapsError(f"{robot}: its map cannot be drawn: {error}") from error
        except MemoryError as error:
            self._end()  # what is left of its memory serves no other map
            raise MapsError(f"{robot}: its map needs more memory than one may take") from error
        except TimeoutError as error:
            self._end()
            raise MapsError(f"{robot}: its map takes more than {_DRAW_S:g} s to draw") from error
        except BrokenProcessPool as error:
            self._end()
            raise MapsError(f"{robot}: its map cannot be drawn: out of memory") from error

    def _end(self) -> None:
        """A new process is for the next map."""
        pool, self._pool = self._pool, None
        if pool is None:
            return
        for process in multiprocessing.active_children():
            if process.pid in pool._processes:  # noqa: SLF001 - it has no way to stop what it runs
                process.kill()
        pool.shutdown(wait=False, cancel_futures=True)

    def close(self) -> None:
        """Idempotent."""
        self._end()


def _limit() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MAX_MEMORY_BYTES, _MAX_MEMORY_BYTES))


def _import() -> None:
    importlib.import_module("amr_slam.viewing.drawing")


def _drawn(data: bytes) -> bytes:
    """In the process that draws: it alone needs what knows maps."""
    drawing = importlib.import_module("amr_slam.viewing.drawing")
    packed: bytes = drawing.drawn(data)
    return packed
