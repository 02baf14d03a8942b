"""What was looked at, what it is like, and what to do: lines for a technician."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    part: str
    """What: ``front``, ``map``, ``disk``, ..."""
    what: str
    """What it is like, in one line."""
    do: str | None = None
    """What to do next; None: it is well."""

    @property
    def is_well(self) -> bool:
        return self.do is None

    def lines(self) -> str:
        """To print."""
        mark = "ok   " if self.is_well else "WRONG"
        line = f"{mark} {self.part}: {self.what}\n"
        return line if self.do is None else f"{line}      -> {self.do}\n"


_ADVICE: Final[tuple[tuple[str, str], ...]] = (
    (
        r"permission denied|errno 13",
        (
            "this user may not open the port: sudo usermod -aG dialout $USER, then log "
            "in anew (the service has its own group: SupplementaryGroups in its unit)"
        ),
    ),
    (
        r"errno 16|resource busy|already in use|could not exclusively",
        "another program holds it: end it (is the service running? systemctl status 'amr-slam@*')",
    ),
    (r"token already taken|no session resources", "close CDS, Safety Designer and other readers"),
    (
        r"no such device: (can|vcan|slcan)|errno 19\b",
        "there is no such CAN interface: adapter plugged in, and its driver loaded? ip link",
    ),
    (
        r"network is down|errno 100\b|interface .* is down",
        "the CAN interface is down: ip link set NAME up type can bitrate 500000 restart-ms 100",
    ),
    (
        r"no such file or directory|could not open port|errno 2\b",
        (
            "the port is not there: adapter plugged in and powered? Compare with ls -l "
            "/dev/serial/by-id/ and correct the port in the configuration"
        ),
    ),
    (
        r"baud rate|noise",
        (
            "set options.baudrate to what the scanner's own software shows; then cable, shield and "
            "termination"
        ),
    ),
    (r"standby", "end standby: release the scanner's control input, or end it in its software"),
    (r"lock-?out", "the scanner has locked itself out: read its display, clear the cause, reset"),
    (
        r"contaminat",
        "clean the window with a soft cloth and the maker's cleaner; scratched: replace it",
    ),
    (
        r"another (scanner|device) (is|answers) at this address|serial number",
        "the cables of two scanners are exchanged, or one was replaced: host or serial_number",
    ),
    (r"mirrored|swapped|turned by|scanner configuration", "docs/scanner-faults.md: mounting"),
    (r"frozen", "power-cycle the scanner"),
    (
        r"connection refused|no route|timed out|unreachable|errno 11[0-3]",
        "nobody answers there: power, network cable, address (ping it); a converter's port number",
    ),
    (
        r"not switched on|does not send|no distances|no scans|no measured values|no answer",
        (
            "power and cable of the scanner; in its own software: data output switched on, format, "
            "address"
        ),
    ),
    (r"values instead of|field of view", "make beams and field_of_view_deg those of the scanner"),
    (
        r"bus-off|error-passive|errors on the bus|no acknowledgement",
        "CAN: bit rate, termination (60 ohm between CAN-H and CAN-L with power off), wiring",
    ),
    (
        r"wheel counts for|no heartbeat|sends no counts",
        "power of the drive or encoder node, CAN wiring, bit rate; a drive may wait for NMT start",
    ),
    (r"wheel stuck|wheel slips|counts nothing", "turn the wheels by hand: encoder and coupling"),
    (r"telegrams damaged", "shield and termination of the line; a cable beside a motor's"),
    (r"out of date|too late", "the computer or the network is too slow: load (top), cables"),
)


def advice(text: str, otherwise: str) -> str:
    """What to do about a fault in a driver's or the system's words."""
    for pattern, do in _ADVICE:
        if re.search(pattern, text, re.IGNORECASE):
            return do
    return otherwise
