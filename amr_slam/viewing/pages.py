"""One page's WebSocket: what has changed since it was last told, at the page's own pace."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from contextlib import suppress
from typing import Any, Final

from aiohttp import WSMsgType, web

from amr_slam.viewing.access import Access, Right
from amr_slam.viewing.hub import MAX_SCANS, Hub, told_scan, told_status

_log = logging.getLogger(__name__)

_MAX_MESSAGE_BYTES: Final = 8 * 1024
_FIRST_WORD_S: Final = 5.0
_SEND_S: Final = 10.0
_REFUSED: Final = 4401
"""The WebSocket's closing code for a page without the right to look (4000 to 4999 are free)."""


class _WrongError(Exception):
    """What a page has sent makes no sense: one line."""


class Page:
    """One browser tab. A slow one skips states, and holds up nobody."""

    def __init__(self, hub: Hub, access: Access, hello: dict[str, Any]) -> None:
        self._hub = hub
        self._access = access
        self._hello = hello
        self._sent: dict[str, str] = {}
        self._statuses: dict[str, object] = {}
        self._scans: dict[str, object] = {}
        self._scans_of: frozenset[str] = frozenset()
        self._notices: list[str] = []

    async def serve(self, request: web.Request) -> web.WebSocketResponse:
        """Until the page goes. Its first message names its token."""
        socket = web.WebSocketResponse(
            max_msg_size=_MAX_MESSAGE_BYTES, heartbeat=10.0, compress=False
        )
        await socket.prepare(request)
        right = await self._right(socket)
        if right is None:
            await socket.close(code=_REFUSED, message=b"a token is needed")
            return socket
        sending = asyncio.create_task(self._send(socket, right))
        try:
            async for message in socket:
                if message.type is not WSMsgType.TEXT:
                    break
                try:
                    self._hear(message.data)
                except _WrongError as error:
                    self._notices.append(str(error))
        finally:
            sending.cancel()
            with suppress(asyncio.CancelledError, ConnectionError):
                await sending
            self._hub.unwant_scans(self._scans_of)
        return socket

    async def _right(self, socket: web.WebSocketResponse) -> Right | None:
        try:
            said = json.loads(await socket.receive_str(timeout=_FIRST_WORD_S))
        except (TimeoutError, TypeError, ValueError, RecursionError):
            return None
        token = said.get("token") if isinstance(said, dict) else None
        return self._access.right_of(token if isinstance(token, str) else None)

    async def _send(self, socket: web.WebSocketResponse, right: Right) -> None:
        hello = json.dumps({"type": "hello", "right": right, **self._hello})
        await socket.send_str(hello)
        while True:
            try:
                await asyncio.wait_for(socket.send_str(self._news()), _SEND_S)
            except TimeoutError:
                await socket.close()
                return
            await self._hub.next_tick()

    def _news(self) -> str:
        """A tick, as JSON. Sent even where nothing is new: a page that hears none is blind."""
        hub = self._hub
        robots = [told for name, told in hub.robots.items() if self._sent.get(name) is not told]
        self._sent = dict(hub.robots)
        views = hub.views()
        statuses, scans = [], []
        for name, view in views.items():
            if view.status is not None and self._statuses.get(name) is not view.status:
                self._statuses[name] = view.status
                statuses.append(told_status(view.status))
        for name in self._scans_of:
            scan = views[name].scan if name in views else None
            if scan is not None and self._scans.get(name) is not scan:
                self._scans[name] = scan
                scans.append(told_scan(scan))
        rest = {
            "type": "tick",
            "time_s": time.time(),
            "monotonic_s": time.monotonic(),
            "link": {"up": hub.link.up, "text": hub.link.text},
            "statuses": statuses,
            "scans": scans,
            "notices": self._notices,
        }
        self._notices = []
        return f'{json.dumps(rest, separators=(",", ":"))[:-1]},"robots":[{",".join(robots)}]}}'

    def _hear(self, text: str) -> None:
        """``{"scans": [robot, ...]}``: whose scans the page shows from now on."""
        try:
            said = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise _WrongError("the page has sent what is no JSON") from error
        names = said.get("scans") if isinstance(said, dict) else None
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise _WrongError("the page has sent what nobody understands")
        views = self._hub.views()
        unknown = sorted(set(names) - set(views))
        if unknown:
            raise _WrongError(f"no robot {unknown[0]:.40} is known here")
        wanted = frozenset(names[:MAX_SCANS])
        self._hub.want_scans(wanted - self._scans_of)
        self._hub.unwant_scans(self._scans_of - wanted)
        # What is there from before nobody can date: the next one is shown.
        self._scans |= {name: views[name].scan for name in wanted - self._scans_of}
        self._scans_of = wanted
