"""What the driver is told about a scanner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Where the scanner is and how to listen. Its safety function is not touched: the only thing
    ever changed is where it sends its measurement data (mode stream)."""

    host: str
    """Address or name on the network."""
    port: Annotated[int, Ge(1), Le(65535)] = 2122
    """TCP port for CoLa 2."""
    mode: Literal["poll", "stream"] = "poll"
    """poll: the newest scan is asked for over TCP; for about 1 Hz and less. The channel must be
    switched on in the scanner's configuration. stream: each scan is sent over UDP."""
    channel: Annotated[int, Ge(0), Le(3)] = 0
    """Which of the scanner's four data outputs to use. One reader each."""
    poll_interval_s: Annotated[float, Ge(0.02), Le(20.0)] = 0.5
    """poll: from one question to the next, and up to one scan period more."""
    udp_port: Annotated[int, Ge(0), Le(65535)] = 0
    """stream: UDP port of this computer, another one for each scanner; 0: the system chooses. Name
    one where a firewall has to let it through."""
    receiver: str = ""
    """stream: address of this computer as the scanner sees it; empty: the one that the TCP
    connection to the scanner has."""
    every_nth: Annotated[int, Ge(1), Le(1000)] = 1
    """stream: send only each n-th scan."""
    serial_number: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    """Of the device (not of its system plug) that must be behind the address; 0: any."""
    range_max_m: Annotated[float, Gt(0.0), Le(655.0)] = 40.0
    """An echo from beyond means: nothing within this range. 64 for the types of 9 m."""
    transfer_delay_s: Annotated[float, Ge(0), Le(1)] = 0.0
    """Time from the last beam until the data are on their way; for what a calibration finds."""
    latency_limit_s: Annotated[float, Gt(0), Le(1)] = 0.1
    """Longest delay in network and scheduler. Later scans are old and are dropped."""
    silence_s: Annotated[float, Gt(0), Le(60)] = 0.5
    """Without an answer for so long (poll), or without data for so long or for 2.5 periods where
    that is more (stream), the device counts as silent; an older scan is not given."""
