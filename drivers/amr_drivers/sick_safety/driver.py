"""SICK microScan3, nanoScan3 and outdoorScan3."""

from __future__ import annotations

import ipaddress

from amr_drivers.background import ScanDecoder
from amr_drivers.sick_safety.decoder import PolledDecoder, StreamedDecoder
from amr_drivers.sick_safety.polled import Polled
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.streamed import Streamed
from amr_slam.samples import Tap, untapped

__all__ = ["Polled", "Settings", "Streamed", "open_scanner", "scan_decoder"]


def open_scanner(name: str, settings: Settings, tap: Tap = untapped) -> Polled | Streamed:
    """Connect and begin to poll or to listen; does not wait for the first scan.

    Raises LinkLost or LinkTimeout when nobody answers at the address, LinkLost when the UDP port
    is taken, ValueError for a receiver that is no IPv4 address.
    """
    if settings.mode == "poll":
        return Polled(name, settings, tap)
    if settings.receiver:
        ipaddress.IPv4Address(settings.receiver)
    return Streamed(name, settings, tap)


def scan_decoder(name: str, settings: Settings, start_ns: int) -> ScanDecoder:
    """What turns recorded bytes of this scanner into scans."""
    if settings.mode == "poll":
        return PolledDecoder(name, settings, start_ns)
    return StreamedDecoder(name, settings, start_ns)
