"""Robots for asyncio programs: newest poses, liveliness, commands.

Zenoh's threads only put the newest message in its place and wake the event loop, once however
many came meanwhile: a slow program skips poses, it never falls behind.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from amr_slam.client.asking import (
    CommandRefusedError,
    ask_map,
    ask_map_changes,
    ask_map_image,
    ask_scan,
    call,
)
from amr_slam.client.listening import FleetListener, RobotView
from amr_slam.client.session import SessionError
from amr_slam.wire import (
    DEFAULT_ENDPOINT,
    MAX_MAP_BYTES,
    Command,
    CommandReply,
    MapChanges,
    MapImage,
    PoseMessage,
    ScanMessage,
    StatusMessage,
)

_CONNECT_S: Final = 5.0
_STALE_S: Final = 0.5
_FIRST_S: Final = 2.0
"""Subscribing takes a moment on the network: so long a first pose is waited for at least."""
_ANSWER_S: Final = 10.0


class StalePoseError(Exception):
    """There is no pose to drive by: none came for too long, or the robot is gone."""


class Fleet:
    """Several robots on one session. ``async with``; used in one event loop."""

    def __init__(
        self,
        endpoint: str = DEFAULT_ENDPOINT,
        robots: Sequence[str] = (),
        *,
        prefix: str = "amr",
        keys: Path | None = None,
        connect_timeout_s: float = _CONNECT_S,
        full_rate: bool = True,
    ) -> None:
        """``endpoint``: of a router or a robot; ``robots``: their names, none for all; ``keys``:
        folder that ``amr-slam keys fleet`` wrote; ``full_rate``: False for every n-th pose, which
        the robots send beside the others (5 a second of 50): a tenth of the traffic."""
        self.prefix = prefix
        self._full_rate = full_rate
        self._endpoint = endpoint
        self._robots = robots
        self._keys = keys
        self._connect_timeout_s = connect_timeout_s
        self._listener: FleetListener | None = None
        self._lock = threading.Lock()
        self._touched: set[str] = set()
        self._waiting: dict[str, set[asyncio.Future[None]]] = {}

    async def __aenter__(self) -> Self:
        """Raises SessionError when nobody answers at the endpoint in time."""
        self._loop = asyncio.get_running_loop()
        opening = asyncio.ensure_future(asyncio.to_thread(self._open))
        try:
            self._listener = await asyncio.shield(opening)
        except asyncio.CancelledError:
            with suppress(SessionError):
                (await opening).close()
            raise
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        # Handed to a thread before anything is awaited: a task (to_thread) that Ctrl-C cancels
        # before its first turn would close nothing, and the program would never end.
        closing = asyncio.get_running_loop().run_in_executor(None, self.listener.close)
        await asyncio.shield(closing)

    @property
    def listener(self) -> FleetListener:
        """The session within. Raises RuntimeError outside of ``async with``."""
        if self._listener is None:
            raise RuntimeError("use it in 'async with'")
        return self._listener

    def robot(self, name: str) -> Robot:
        """One of the robots, on this session."""
        return Robot(name, fleet=self)

    def views(self) -> dict[str, RobotView]:
        """The robots seen so far and those asked for, by name."""
        return self.listener.views()

    async def changed(self, robot: str, timeout_s: float) -> None:
        """Wait until something new is known of a robot, or ``timeout_s`` have passed."""
        future: asyncio.Future[None] = self._loop.create_future()
        waiting = self._waiting.setdefault(robot, set())
        waiting.add(future)
        # Not asyncio.wait(): that is half of what a message costs a controller of many robots.
        timer = self._loop.call_later(timeout_s, _set, future)
        try:
            await future
        finally:
            timer.cancel()
            waiting.discard(future)

    def _open(self) -> FleetListener:
        return FleetListener(
            self._endpoint,
            self._robots,
            prefix=self.prefix,
            keys=self._keys,
            connect_timeout_s=self._connect_timeout_s,
            full_rate=self._full_rate,
            queue_size=0,
            on_change=self._on_change,
        )

    def _on_change(self, robot: str) -> None:
        with self._lock:
            wakes = not self._touched
            self._touched.add(robot)
        if wakes:
            with suppress(RuntimeError):  # the loop has ended; the session is about to
                self._loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        with self._lock:
            touched, self._touched = self._touched, set()
        for robot in touched:
            for future in self._waiting.get(robot, ()):
                _set(future)


def _set(future: asyncio.Future[None]) -> None:
    if not future.done():
        future.set_result(None)


class Robot:
    """One robot. ``async with``, or from :meth:`Fleet.robot` without."""

    def __init__(
        self,
        name: str,
        *,
        endpoint: str = DEFAULT_ENDPOINT,
        prefix: str = "amr",
        keys: Path | None = None,
        connect_timeout_s: float = _CONNECT_S,
        full_rate: bool = True,
        fleet: Fleet | None = None,
    ) -> None:
        """``fleet``: whose session to use; the other arguments are for a session of its own."""
        self.name = name
        self._fleet = fleet or Fleet(
            endpoint,
            [name],
            prefix=prefix,
            keys=keys,
            connect_timeout_s=connect_timeout_s,
            full_rate=full_rate,
        )

    async def __aenter__(self) -> Self:
        """Raises SessionError when nobody answers at the endpoint in time."""
        await self._fleet.__aenter__()
        return self

    async def __aexit__(self, *exc_info: object) -> None:
        await self._fleet.__aexit__(*exc_info)

    @property
    def view(self) -> RobotView:
        """All that is known of it, with the counts of lost and refused messages."""
        return self._fleet.listener.view(self.name)

    @property
    def alive(self) -> bool:
        """The robot's program is there and connected. No word on its pose."""
        return self.view.alive

    @property
    def status(self) -> StatusMessage | None:
        """The newest; None before the first."""
        return self.view.status

    def pose(self, stale_s: float = _STALE_S) -> PoseMessage:
        """The newest pose. Raises StalePoseError when it came more than ``stale_s`` ago, on this
        machine's clock, or the robot is gone."""
        view = self.view
        if view.pose is None:
            raise StalePoseError(f"{self.name}: no pose yet")
        if not view.alive:
            raise StalePoseError(f"{self.name}: gone")
        if view.pose_age_s() > stale_s:
            raise StalePoseError(f"{self.name}: no pose for {view.pose_age_s():.2f} s")
        return view.pose

    async def poses(self, stale_s: float = _STALE_S) -> AsyncIterator[PoseMessage]:
        """The newest pose, each time there is one; those that came while the caller was busy are
        skipped. Raises StalePoseError as soon as none came for ``stale_s`` or the robot is gone;
        ask anew to go on. The first one may take 2 s.
        """
        begun_s = time.monotonic()
        given: PoseMessage | None = None
        while True:
            view = self.view
            fresh = view.pose is not None and view.alive and view.pose_age_s() <= stale_s
            if fresh and view.pose is not given and view.pose is not None:
                given = view.pose
                yield given
                continue
            waits_s = stale_s - view.pose_age_s()
            if given is None:
                waits_s = max(_FIRST_S, stale_s) - (time.monotonic() - begun_s)
            elif not view.alive:
                raise StalePoseError(f"{self.name}: gone")
            if waits_s <= 0.0:
                raise StalePoseError(f"{self.name}: no pose for {stale_s:g} s")
            await self._fleet.changed(self.name, waits_s)

    async def scans(self) -> AsyncIterator[ScanMessage]:
        """Each scan as the robot publishes it, its points in the map frame; those that came while
        the caller was busy are skipped. Raises StalePoseError when the robot is gone; however long
        no scan comes is not its affair (a robot that is lost has none to place).
        """
        following = self._fleet.listener.follow_scans(self.name)
        begun_s = time.monotonic()
        given = self.view.scan
        try:
            while True:
                view = self.view
                if view.scan is not None and view.scan is not given:
                    given = view.scan
                    yield given
                elif not view.alive and time.monotonic() - begun_s > _FIRST_S:
                    raise StalePoseError(f"{self.name}: gone")
                else:
                    await self._fleet.changed(self.name, _FIRST_S)
        finally:
            following.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stub leaves it open

    async def scan(self, points: int, timeout_s: float = _ANSWER_S) -> ScanMessage:
        """The newest scan, thinned by the robot itself to ``points`` at most: for pictures of many
        robots. Raises AskingError when no answer came, or there was no scan yet."""
        session = self._fleet.listener.session
        return await asyncio.to_thread(
            ask_scan, session, self._fleet.prefix, self.name, timeout_s, points
        )

    async def call(self, command: Command, timeout_s: float = _ANSWER_S) -> CommandReply:
        """Have a command done. Raises CommandRefusedError with the robot's reason, AskingError
        when no answer came."""
        reply = await asyncio.to_thread(
            call, self._fleet.listener.session, self._fleet.prefix, self.name, command, timeout_s
        )
        if not reply.ok:
            raise CommandRefusedError(f"{self.name}: {command.kind}: {reply.error}")
        return reply

    async def map(self, timeout_s: float = _ANSWER_S, max_bytes: int = MAX_MAP_BYTES) -> bytes:
        """The active map as .amrmap. Raises AskingError."""
        session = self._fleet.listener.session
        return await asyncio.to_thread(
            ask_map, session, self._fleet.prefix, self.name, timeout_s, max_bytes
        )

    async def map_image(
        self, timeout_s: float = _ANSWER_S, max_bytes: int = MAX_MAP_BYTES
    ) -> tuple[bytes, MapImage]:
        """A PNG of the active map, and where it lies. Raises AskingError."""
        session = self._fleet.listener.session
        return await asyncio.to_thread(
            ask_map_image, session, self._fleet.prefix, self.name, timeout_s, max_bytes
        )

    async def map_changes(self, timeout_s: float = _ANSWER_S) -> MapChanges:
        """What has changed in the place since its map was made. Raises AskingError."""
        session = self._fleet.listener.session
        return await asyncio.to_thread(
            ask_map_changes, session, self._fleet.prefix, self.name, timeout_s
        )
