"""``amr-slam view``: the robots on a map in a browser. Only this package knows of HTTP."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable
from dataclasses import replace

from aiohttp import web

from amr_slam.viewing.access import bracketed, grant, names_of, tls
from amr_slam.viewing.app import ViewServer
from amr_slam.viewing.settings import ViewError, ViewSettings

__all__ = ["ViewError", "ViewSettings", "view"]


def view(settings: ViewSettings, on_ready: Callable[[str], None]) -> None:
    """Serve until Ctrl-C or SIGTERM; ``on_ready`` is told the address to open.

    Raises ViewError for settings that give too much away or cannot be had, and OSError.
    """
    asyncio.run(_serve(settings, on_ready))


async def _serve(settings: ViewSettings, on_ready: Callable[[str], None]) -> None:
    context = tls(settings)
    access, token = grant(settings)
    server = ViewServer(settings, access)
    runner = web.AppRunner(
        server.application(), access_log=None, shutdown_timeout=1.0, handle_signals=False
    )
    await runner.setup()
    try:
        try:
            site = web.TCPSite(runner, settings.host, settings.port, ssl_context=context)
            await site.start()
        except OSError as error:
            raise ViewError(
                f"{settings.host}:{settings.port}: {error.strerror or error}"
            ) from error
        port = int(runner.addresses[0][1])
        server.access = replace(access, hosts=names_of(settings, port))
        address = f"{access.scheme}://{bracketed(settings.host)}:{port}/"
        on_ready(f"{address}#token={token}" if token else address)
        await _until_told()
    finally:
        await runner.cleanup()


async def _until_told() -> None:
    told = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, told.set)
    await told.wait()
