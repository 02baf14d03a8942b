"""``cmd/<command>``."""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Mapping
from typing import Final

import zenoh

from amr_slam.serving.asked import Asked, NotDone
from amr_slam.serving.desk import Allowance, Answering, Desk, asking
from amr_slam.wire import MAX_COMMAND_BYTES, Command, CommandReply, WireError, command_of

_log = logging.getLogger(__name__)

RATE_HZ: Final = 2.0
BURST: Final = 10
"""So many commands at once, so many a second then: people and controllers need fewer."""


class CommandDesk:
    """``cmd/<command>``: one at a time; each gets one :class:`CommandReply`."""

    def __init__(self, session: zenoh.Session, base: str, desk: Desk) -> None:
        """``desk``: with one place, and for all that commands; whoever made it closes it."""
        self._base = f"{base}/cmd"
        self._desk = desk
        self._allowance = Allowance(RATE_HZ, BURST, time.monotonic())
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._queryable = session.declare_queryable(f"{self._base}/*", self._on_query)

    def counts(self) -> Mapping[str, int]:
        """What became of the commands so far, by kind. Any thread."""
        with self._lock:
            return dict(self._counts)

    def _on_query(self, query: zenoh.Query) -> None:
        """On a thread of zenoh's."""
        if "/cmd/" not in str(query.key_expr):  # somebody who asks for all that there is
            query.drop()  # type: ignore[no-untyped-call]
            return
        try:
            arguments = self._checked(query)
        except WireError as error:
            self._refuse(query, "invalid", str(error))
            return
        with self._lock:
            allowed = self._allowance.takes(time.monotonic())
        if not allowed:
            self._refuse(query, "busy", f"too many commands: {RATE_HZ:g} a second is enough")
        elif not self._desk.enter(lambda: self._perform(query, arguments)):
            self._refuse(query, "busy", "another command is under way")

    def _checked(self, query: zenoh.Query) -> Command:
        key = str(query.key_expr)
        name = key.removeprefix(f"{self._base}/")
        if name == key or "*" in name or "$" in name:
            raise WireError(f"{key:.200}: a command goes to one robot, by its full key")
        payload = query.payload
        if payload is not None and len(payload) > MAX_COMMAND_BYTES:
            raise WireError(f"{name:.40}: {len(payload)} bytes, at most {MAX_COMMAND_BYTES}")
        return command_of(name, b"" if payload is None else payload.to_bytes())

    def _perform(self, query: zenoh.Query, arguments: Command) -> Answering:
        """On the desk's thread."""
        reply = perform(self._desk, arguments, asking(query))
        self._count("done" if reply.ok else "refused")
        return lambda: _reply(query, reply)

    def _refuse(self, query: zenoh.Query, kind: str, reason: str) -> None:
        self._count(kind)
        _reply(query, CommandReply.refusing(reason))

    def _count(self, kind: str) -> None:
        with self._lock:
            self._counts[kind] += 1


def perform(desk: Desk, arguments: Command, by: str) -> CommandReply:
    """Have the loop do it, and wait for what becomes of it. For the desk's thread."""
    told = arguments.model_dump_json(exclude={"v"})
    _log.info("command %s %s, asked by %s", arguments.kind, told, by)
    try:
        reply: CommandReply = desk.ask(Asked(request=arguments, by=by))
    except NotDone as error:
        reply = CommandReply.refusing(f"{arguments.kind}: {error}")
        _log.info("%s", reply.error)
    else:
        _log.info("%s: done", arguments.kind)
    return reply


def _reply(query: zenoh.Query, reply: CommandReply) -> None:
    with query:
        key = str(query.key_expr)
        if "*" in key:  # no key to reply under
            query.reply_err(reply.encode(), encoding=zenoh.Encoding.APPLICATION_JSON)
        else:
            query.reply(key, reply.encode(), encoding=zenoh.Encoding.APPLICATION_JSON)
