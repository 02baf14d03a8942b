"""What a robot answers on Zenoh beside its newest messages: commands, and its map.

Queries come in on zenoh's threads, are checked there, and wait for nobody: one thread a desk hands
them to the loop, waits for what becomes of them, and answers, as an answer may have to wait for a
slow network.
"""

from __future__ import annotations

import json
import logging
import math
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final

import zenoh

from amr_slam.map import MapError
from amr_slam.map.file import identity
from amr_slam.wire import (
    MAX_COMMAND_BYTES,
    MAX_MAP_BYTES,
    SCHEMA_VERSION,
    Command,
    CommandReply,
    MapImage,
    WireError,
    command_of,
)

_log = logging.getLogger(__name__)

ANSWER_LIMIT_S: Final = 45.0
"""No command is left without an answer for longer."""
_RATE_HZ: Final = 2.0
_BURST: Final = 10
"""So many commands at once, so many a second then: people and controllers need fewer."""
_CLOSE_S: Final = 0.3
_MAX_BY: Final = 80
_MAP_QUERIES: Final = 2
"""Of the map and its picture, here at once."""


class NotDone(Exception):  # noqa: N818  # no fault of the program: an answer
    """Why something that was asked for was not done: one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapWanted:
    """The active map's file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageWanted:
    """A picture of the active map."""

    resolution_m: float | None
    """Side of a pixel; None: of a wall cell."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFile:
    """Where the active map is, whole."""

    path: Path
    map_id: str
    """UUID of its content."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """A PNG picture of the active map."""

    png: bytes
    georeference: MapImage


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Asked:
    """Something for the loop to do. Whoever asks may give up: then the answer is cancelled."""

    request: Command | MapWanted | ImageWanted
    by: str
    """Who, as far as zenoh tells."""
    answer: Future[Any] = field(default_factory=Future)
    """CommandReply, MapFile or Picture; or NotDone."""

    def done(self, result: object) -> None:
        """Answer it; nothing happens where nobody waits any more."""
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_result(result)

    def not_done(self, reason: str) -> None:
        """The same without success."""
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_exception(NotDone(reason))


Put = Callable[[Asked], object]
_Answering = Callable[[], None]
_Work = Callable[[], _Answering]
"""Does it; what comes back sends the answer."""


class Allowance:
    """So many at once, and so many a second then."""

    def __init__(self, rate_hz: float, burst: int, now_s: float) -> None:
        self._rate_hz, self._burst = rate_hz, burst
        self._left, self._looked_s = float(burst), now_s

    def takes(self, now_s: float) -> bool:
        """Whether one more is within it; then it is counted."""
        grown = self._left + self._rate_hz * (now_s - self._looked_s)
        self._left, self._looked_s = min(grown, float(self._burst)), now_s
        if self._left < 1.0:
            return False
        self._left -= 1.0
        return True


class _Desk:
    """One queue and one thread: asks the loop, one thing after another."""

    def __init__(self, name: str, put: Put, places: int) -> None:
        """``places``: queries that are here at once, the one in hand included."""
        self._put = put
        self._places = threading.Semaphore(places)
        self._queue: queue.SimpleQueue[_Work | None] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._asked: Asked | None = None
        self._closed = False
        # A daemon: a network that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def enter(self, work: _Work) -> bool:
        """Have the thread do it; False when there is no place left. Any thread."""
        if self._closed or not self._places.acquire(blocking=False):
            return False
        self._queue.put(work)
        return True

    def ask(self, asked: Asked) -> Any:
        """For the thread: what became of it. Raises NotDone, also where nobody answers in time."""
        with self._lock:
            if self._closed:
                raise NotDone("the robot's program is stopping")
            self._asked = asked
        self._put(asked)
        try:
            return asked.answer.result(ANSWER_LIMIT_S)
        except CancelledError:
            raise NotDone("the robot's program is stopping") from None
        except TimeoutError:
            asked.answer.cancel()
            reason = f"not done within {ANSWER_LIMIT_S:g} s; status tells whether it still happens"
            raise NotDone(reason) from None

    def close(self) -> None:
        """What is asked is given up."""
        with self._lock:
            self._closed = True
            if self._asked is not None:
                self._asked.answer.cancel()
        self._queue.put(None)
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while (work := self._queue.get()) is not None:
            try:
                answer = work()
            finally:
                self._places.release()  # before the answer: who has it may ask again
            try:
                answer()
            except zenoh.ZError as error:  # the session closes, or who asked has gone
                _log.warning("an answer could not be sent: %s", " ".join(str(error).split())[:200])


class CommandDesk:
    """``cmd/<command>``: one at a time; each gets one :class:`CommandReply`."""

    def __init__(self, session: zenoh.Session, base: str, put: Put) -> None:
        self._base = f"{base}/cmd"
        self._desk = _Desk("commands", put, places=1)
        self._allowance = Allowance(_RATE_HZ, _BURST, time.monotonic())
        self._lock = threading.Lock()
        self._queryable = session.declare_queryable(f"{self._base}/*", self._on_query)

    def close(self) -> None:
        self._desk.close()

    def _on_query(self, query: zenoh.Query) -> None:
        """On a thread of zenoh's."""
        try:
            arguments = self._checked(query)
        except WireError as error:
            self._refuse(query, str(error))
            return
        with self._lock:
            allowed = self._allowance.takes(time.monotonic())
        if not allowed:
            self._refuse(query, f"too many commands: {_RATE_HZ:g} a second is enough")
        elif not self._desk.enter(lambda: self._perform(query, arguments)):
            self._refuse(query, "another command is under way")

    def _checked(self, query: zenoh.Query) -> Command:
        key = str(query.key_expr)
        name = key.removeprefix(f"{self._base}/")
        if name == key or "*" in name or "$" in name:
            raise WireError(f"{key:.200}: a command goes to one robot, by its full key")
        payload = query.payload
        if payload is not None and len(payload) > MAX_COMMAND_BYTES:
            raise WireError(f"{name:.40}: {len(payload)} bytes, at most {MAX_COMMAND_BYTES}")
        return command_of(name, b"" if payload is None else payload.to_bytes())

    def _perform(self, query: zenoh.Query, arguments: Command) -> _Answering:
        """On the desk's thread."""
        by = _asking(query)
        _log.info("command %s %s, asked by %s", arguments.kind, arguments, by)
        try:
            reply: CommandReply = self._desk.ask(Asked(request=arguments, by=by))
        except NotDone as error:
            reply = CommandReply.refusing(f"{arguments.kind}: {error}")
            _log.info("%s", reply.error)
        else:
            _log.info("%s: done", arguments.kind)
        return lambda: _reply(query, reply)

    def _refuse(self, query: zenoh.Query, reason: str) -> None:
        _reply(query, CommandReply.refusing(reason))


_Finding = Callable[[zenoh.Query], _Answering]


class MapDesk:
    """``map`` and ``map/image``: answered one after another."""

    def __init__(self, session: zenoh.Session, base: str, put: Put) -> None:
        self._map_key, self._image_key = f"{base}/map", f"{base}/map/image"
        self._desk = _Desk("maps", put, places=_MAP_QUERIES)
        self._queryables = (
            session.declare_queryable(self._map_key, partial(self._on_query, self._find_map)),
            session.declare_queryable(self._image_key, partial(self._on_query, self._find_image)),
        )

    def close(self) -> None:
        self._desk.close()

    def _on_query(self, find: _Finding, query: zenoh.Query) -> None:
        """On a thread of zenoh's."""
        if not self._desk.enter(lambda: self._perform(find, query)):
            _refuse_map(query, "busy with the queries before this one: ask again")

    def _perform(self, find: _Finding, query: zenoh.Query) -> _Answering:
        try:
            return find(query)
        except (NotDone, MapError) as error:
            return partial(_refuse_map, query, str(error))

    def _find_map(self, query: zenoh.Query) -> _Answering:
        found: MapFile = self._desk.ask(Asked(request=MapWanted(), by=_asking(query)))
        data = _read(found)
        attachment = json.dumps({"v": SCHEMA_VERSION, "map": found.map_id}).encode()
        encoding = zenoh.Encoding.APPLICATION_OCTET_STREAM.with_schema("amrmap")
        return partial(_send, query, self._map_key, data, encoding, attachment)

    def _find_image(self, query: zenoh.Query) -> _Answering:
        wanted = ImageWanted(resolution_m=_resolution_m(query.parameters))
        image: Picture = self._desk.ask(Asked(request=wanted, by=_asking(query)))
        attachment = image.georeference.encode()
        return partial(
            _send, query, self._image_key, image.png, zenoh.Encoding.IMAGE_PNG, attachment
        )


def _reply(query: zenoh.Query, reply: CommandReply) -> None:
    with query:
        key = str(query.key_expr)
        if "*" in key:  # no key to reply under
            query.reply_err(reply.encode(), encoding=zenoh.Encoding.APPLICATION_JSON)
        else:
            query.reply(key, reply.encode(), encoding=zenoh.Encoding.APPLICATION_JSON)


def _send(
    query: zenoh.Query, key: str, payload: bytes, encoding: zenoh.Encoding, attachment: bytes
) -> None:
    with query:
        query.reply(key, payload, encoding=encoding, attachment=attachment)


def _read(found: MapFile) -> bytes:
    """Raises NotDone and MapError."""
    try:
        with found.path.open("rb") as stream:
            data = stream.read(MAX_MAP_BYTES + 1)
    except OSError as error:
        raise NotDone(f"cannot read the map's file: {error.strerror or error}") from error
    if len(data) > MAX_MAP_BYTES:
        raise NotDone(f"the map's file is larger than {MAX_MAP_BYTES >> 20} MiB: copy it")
    if str(identity(data)) != found.map_id:
        raise NotDone("the map's file has been replaced since it was loaded")
    return data


def _resolution_m(parameters: zenoh.Parameters) -> float | None:
    text = parameters.get("resolution")
    if text is None:
        return None
    try:
        resolution_m = float(text)
    except ValueError:
        resolution_m = math.nan
    if not 0.001 <= resolution_m <= 100.0:
        raise NotDone("resolution should be metres for a pixel, 0.001 to 100")
    return resolution_m


def _refuse_map(query: zenoh.Query, reason: str) -> None:
    with query:
        query.reply_err(
            CommandReply.refusing(reason).encode(),
            encoding=zenoh.Encoding.APPLICATION_JSON,
        )


def _asking(query: zenoh.Query) -> str:
    """Who asks: zenoh tells no more than the session, and that only where the asking side adds it.
    With access control, the router's log names certificates."""
    source = query.source_info
    return "somebody" if source is None else f"session {source.source_id.zid}"[:_MAX_BY]
