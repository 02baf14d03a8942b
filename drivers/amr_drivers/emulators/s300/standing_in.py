"""An emulated scanner for a driver's settings."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import urlsplit

from amr_drivers.emulators.converter import EmulatedConverter
from amr_drivers.emulators.line import Line
from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.emulators.s300.device import EmulatedS300, S300Model
from amr_drivers.sick_s300.settings import Settings


def emulate(settings: Settings) -> EmulatedS300:
    """The scanner that these settings name, paced as its line: at a link to a pseudo-terminal, or
    behind a converter on this machine.

    Raises OSError when the port cannot be made there, ValueError for a URL that is no converter's.
    """
    model = S300Model(
        protocol=settings.mode,
        address=7 if settings.device_address == "host" else 8,
        baud_rate=settings.baud_rate,
        sweep_s=settings.sweep_s,
        beams=settings.beams,
        field_of_view_deg=settings.field_of_view_deg,
        paced=True,
    )
    return EmulatedS300(_line(settings.port), model)


def _line(port: str) -> Line:
    if "://" not in port:
        Path(port).parent.mkdir(parents=True, exist_ok=True)
        return PtyLine(Path(port))
    url = urlsplit(port)
    if url.scheme not in ("socket", "rfc2217") or url.hostname is None or url.port is None:
        raise ValueError(f"{port}: neither socket://host:port nor rfc2217://host:port")
    is_raw = url.scheme == "socket"
    return EmulatedConverter("socket" if is_raw else "rfc2217", url.hostname, url.port)
