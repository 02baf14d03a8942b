"""The server: the page's own files, its WebSocket, maps, the past, and commands."""

from __future__ import annotations

import asyncio
import json
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from importlib import resources
from importlib.metadata import version
from typing import Any, Final

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from amr_slam.client import AskingError, FleetListener, ask_map_changes, call
from amr_slam.viewing.access import Access, Right
from amr_slam.viewing.hub import Hub
from amr_slam.viewing.maps import Maps, MapsError
from amr_slam.viewing.pages import Page
from amr_slam.viewing.settings import ViewSettings
from amr_slam.wire import CommandReply, WireError, command_of

_log = logging.getLogger(__name__)

_MAX_BODY_BYTES: Final = 8 * 1024
_MAX_PAGES: Final = 32
_MAX_COMMANDS: Final = 4
_MAX_LISTS: Final = 4
_LIST_S: Final = 20.0
"""Lists of changes that are asked for at once, and for how long."""
_ANSWER_S: Final = 50.0
"""A robot answers within 45 s, whatever it is asked (``serving.desk``)."""
_KINDS: Final = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class ViewServer:
    """Handlers, and what they share."""

    def __init__(self, settings: ViewSettings, access: Access) -> None:
        self.access = access
        self._settings = settings
        self._hub = Hub(settings)
        self._maps = Maps(settings.prefix)
        self._pages = 0
        self._calling = 0
        self._callers = ThreadPoolExecutor(_MAX_COMMANDS, thread_name_prefix="commands")
        self._listers = ThreadPoolExecutor(_MAX_LISTS, thread_name_prefix="changes")
        self._files = _static_files()

    def application(self) -> web.Application:
        app = web.Application(client_max_size=_MAX_BODY_BYTES, middlewares=[self._guard()])
        app.on_response_prepare.append(_add_headers)
        app.router.add_get("/ws", self._socket)
        app.router.add_get("/api/map", self._map)
        app.router.add_get("/api/changes", self._changes)
        app.router.add_get("/api/history", self._history)
        app.router.add_post("/api/command", self._command)
        app.router.add_get("/{name:[a-z0-9_]*(?:\\.[a-z]+)?}", self._file)
        app.cleanup_ctx.append(self._running)
        return app

    async def _running(self, _app: web.Application) -> Any:
        task = asyncio.create_task(self._hub.run())
        task.add_done_callback(_end_with)
        self._maps.start()
        yield
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        await asyncio.to_thread(self._hub.close)
        self._maps.close()
        for pool in (self._callers, self._listers):
            pool.shutdown(wait=False, cancel_futures=True)

    def _guard(self) -> Middleware:
        @web.middleware
        async def guard(request: web.Request, handler: Handler) -> web.StreamResponse:
            """Whatever is not meant for this server, or not from its page, ends here."""
            host, origin = request.headers.get("Host"), request.headers.get("Origin")
            if not self.access.is_ours(host):
                raise web.HTTPMisdirectedRequest(text="this server has another name\n")
            scripted = request.method != "GET" or request.path == "/ws"
            if (scripted or origin is not None) and not self.access.is_our_page(origin, host):
                raise web.HTTPForbidden(text="requests come from this server's own page only\n")
            return await handler(request)

        return guard

    def _right(self, request: web.Request) -> Right | None:
        scheme, _, token = request.headers.get("Authorization", "").partition(" ")
        return self.access.right_of(token if scheme == "Bearer" else None)

    def _looking(self, request: web.Request) -> FleetListener:
        """The session, for who may look."""
        if self._right(request) is None:
            raise web.HTTPUnauthorized(text="a token is needed\n")
        if self._hub.listener is None:
            raise web.HTTPServiceUnavailable(text=f"{self._hub.link.text}\n")
        return self._hub.listener

    async def _file(self, request: web.Request) -> web.Response:
        found = self._files.get(request.match_info["name"] or "index.html")
        if found is None:
            raise web.HTTPNotFound(text="there is no such page\n")
        body, kind = found
        return web.Response(body=body, content_type=kind, charset="utf-8")

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if self._pages >= _MAX_PAGES:
            raise web.HTTPServiceUnavailable(text=f"{_MAX_PAGES} pages are open; close some\n")
        self._pages += 1
        hello = {
            "version": version("amr-slam"),
            "allow_commands": self.access.allow_commands,
            "endpoint": self._settings.endpoint,
        }
        try:
            return await Page(self._hub, self.access, hello).serve(request)
        finally:
            self._pages -= 1

    async def _map(self, request: web.Request) -> web.Response:
        listener, robot = self._of_robot(request)
        try:
            packed = await self._maps.of(listener, robot)
        except MapsError as error:
            raise web.HTTPBadGateway(text=f"{error}\n") from error
        return web.Response(body=packed, content_type="application/octet-stream")

    async def _changes(self, request: web.Request) -> web.Response:
        listener, robot = self._of_robot(request)
        work = partial(ask_map_changes, listener.session, self._settings.prefix, robot, _LIST_S)
        try:
            found = await asyncio.get_running_loop().run_in_executor(self._listers, work)
        except AskingError as error:
            raise web.HTTPBadGateway(text=f"{error}\n") from error
        return web.Response(body=found.encode(), content_type="application/json")

    def _of_robot(self, request: web.Request) -> tuple[FleetListener, str]:
        """The session, and the robot that a request is about."""
        listener, robot = self._looking(request), request.query.get("robot", "")
        if robot not in listener.views():
            raise web.HTTPNotFound(text=f"no robot {robot:.40} is known here\n")
        return listener, robot

    async def _history(self, request: web.Request) -> web.Response:
        self._looking(request)
        packed = self._hub.history.packed(time.time())
        return web.Response(body=packed, content_type="application/octet-stream")

    async def _command(self, request: web.Request) -> web.Response:
        """``{"robot", "command", "arguments"}``; the answer is a CommandReply in any case."""
        listener = self._looking(request)
        if self._right(request) is not Right.COMMAND:
            return _reply(403, self._why_not())
        try:
            robot, name, arguments = _asked(await request.json())
            command = command_of(name, json.dumps(arguments).encode())
        except (ValueError, RecursionError) as error:
            return _reply(400, str(error))
        if robot not in listener.views():
            return _reply(404, f"no robot {robot:.40} is known here")
        if self._calling >= _MAX_COMMANDS:
            return _reply(429, "other commands are under way")
        _log.info("%s: %s, asked by %s", robot, command.kind, request.remote)
        self._calling += 1
        try:
            reply = await asyncio.get_running_loop().run_in_executor(
                self._callers,
                call, listener.session, self._settings.prefix, robot, command, _ANSWER_S,
            )  # fmt: skip
        except AskingError as error:
            return _reply(504, f"{error}: it is gone, or this view may not command it")
        finally:
            self._calling -= 1
        return web.Response(body=reply.encode(), content_type="application/json")

    def _why_not(self) -> str:
        if not self.access.allow_commands:
            return "this view is for looking only; it was started without --allow-commands"
        return "this page may look only; commands need a token for commands"


def _asked(body: object) -> tuple[str, str, dict[str, Any]]:
    """Raises ValueError."""
    if isinstance(body, dict):
        robot, name = body.get("robot"), body.get("command")
        arguments = body.get("arguments", {})
        if isinstance(robot, str) and isinstance(name, str) and isinstance(arguments, dict):
            return robot, name, arguments
    raise WireError("a command is {robot, command, arguments}")


def _reply(status: int, error: str) -> web.Response:
    body = CommandReply.refusing(error).encode()
    return web.Response(status=status, body=body, content_type="application/json")


def _static_files() -> dict[str, tuple[bytes, str]]:
    """All files of the page in memory, by name: no request becomes a path."""
    folder = resources.files("amr_slam.viewing") / "static"
    return {
        entry.name: (entry.read_bytes(), kind)
        for entry in folder.iterdir()
        for ending, kind in _KINDS.items()
        if entry.name.endswith(ending)
    }


async def _add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)


def _end_with(task: asyncio.Task[None]) -> None:
    """A hub that has failed must not leave pages that look alive."""
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.error("the view has failed", exc_info=error)
        raise SystemExit(1) from error
