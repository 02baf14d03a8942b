"""What a view shows, and to whom."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from amr_slam.wire import DEFAULT_ENDPOINT


class ViewError(Exception):
    """The view cannot be opened as asked for: one line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewSettings:
    """Which robots, on which address, and who may do what."""

    endpoint: str = DEFAULT_ENDPOINT
    """Of a robot or a router on Zenoh."""
    robots: tuple[str, ...] = ()
    """Their names; none for all."""
    prefix: str = "amr"
    keys: Path | None = None
    """What ``amr-slam keys fleet`` wrote; with ``--commands`` where the view is to command."""
    full_rate: bool = False
    """Listen to each pose, not to every n-th."""
    host: str = "127.0.0.1"
    """Address on which pages are served. Loopback unless there are tokens and a certificate."""
    port: int = 8080
    """0 takes a free one."""
    allow_commands: bool = False
    """Pages with a token for it may command robots."""
    tokens: Path | None = None
    """File of tokens (:func:`amr_slam.viewing.access.read_tokens`)."""
    certificate: Path | None = None
    """PEM; the names in it are those under which the view is reached."""
    key: Path | None = None
    """The certificate's private key, PEM."""
