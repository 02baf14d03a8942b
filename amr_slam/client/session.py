"""Zenoh sessions, opened and closed with bounds on time and memory, and errors in one line."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import zenoh

from amr_slam.credentials import CredentialsError, read_credentials
from amr_slam.wire import MAX_MAP_BYTES

_log = logging.getLogger(__name__)

_MAX_INBOUND_BYTES: Final = 1 << 20  # zenoh's own default is 1 GiB: anyone could fill the memory
_QUEUE_BATCHES: Final = 16  # the default of 2 loses poses when the processor is busy
_HANDSHAKE_MS: Final = 2000  # closing waits for one with a frozen router; zenoh's own is 10 s
# Bytes that the kernel takes ahead of a slow link, where nothing overtakes any more. Left to itself
# it takes megabytes, and poses wait behind a map for seconds (docs/fleet-scale.md).
_SEND_BUFFERS: Final = {f"transport/link/{link}/so_sndbuf": 1 << 16 for link in ("tcp", "tls")}
_RETRY: Final = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}


class SessionError(Exception):
    """The session could not be opened: port in use, nobody at the endpoint, a name that makes no
    key. One line."""


def open_session(
    options: dict[str, Any], endpoints: Sequence[str], keys: Path | None
) -> zenoh.Session:
    """A session with these options by path, beside those that all have. Raises SessionError."""
    common: dict[str, Any] = {
        "connect/retry": _RETRY,
        "transport/unicast/open_timeout": _HANDSHAKE_MS,
        "transport/unicast/accept_timeout": _HANDSHAKE_MS,
        "transport/link/rx/max_message_size": _MAX_INBOUND_BYTES,
        "transport/link/tx/queue/size/real_time": _QUEUE_BATCHES,
        # Messages are small, and a killed process leaves its shared memory behind.
        "transport/shared_memory/enabled": False,
    }
    try:
        if keys is not None:
            options = options | read_credentials(keys).options()
    except CredentialsError as error:
        raise SessionError(str(error)) from error
    config = zenoh.Config()
    try:
        for key, value in (common | options | _SEND_BUFFERS).items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise SessionError(f"zenoh {', '.join(endpoints)}: {reason(error)}") from error


def open_client(endpoint: str, keys: Path | None, timeout_s: float) -> zenoh.Session:
    """A controller's session: a *client* of a robot or a router. Raises SessionError when nobody
    answers within ``timeout_s``."""
    options = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": round(1000 * timeout_s),
        "connect/exit_on_failure": True,
        "scouting/multicast/enabled": False,
        "transport/link/rx/max_message_size": MAX_MAP_BYTES + _MAX_INBOUND_BYTES,
    }
    return open_session(options, (endpoint,), keys)


def reason(error: zenoh.ZError) -> str:
    """What zenoh says, without the places in its sources and the names of its types."""
    text = " ".join(str(error).split(" at /", maxsplit=1)[0].rpartition('msg: "')[2].split())
    return "nobody answers" if text.startswith("Unable to connect") else text


@contextmanager
def declaring(session: zenoh.Session) -> Iterator[None]:
    """Not left open when a name makes no key."""
    try:
        yield
    except zenoh.ZError as error:
        close_session(session)
        raise SessionError(f"zenoh: {reason(error)}") from error


def close_session(session: zenoh.Session) -> None:
    """Idempotent; waits for a frozen router 2 s at most."""
    if session.is_closed():
        return
    try:
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub leaves the result open
    except zenoh.ZError as error:  # timed out on a frozen router: it is closed all the same
        _log.warning("zenoh: %s", reason(error))
