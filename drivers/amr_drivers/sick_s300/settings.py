"""What the driver is told about a scanner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Final, Literal

from annotated_types import Ge, Gt, Le

ADDRESSES: Final[Mapping[str, int]] = MappingProxyType({"host": 7, "guest": 8})
"""What ``device_address`` is on the line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """How the scanner is wired and what its own configuration (CDS) says. No setting of the
    scanner is changed."""

    port: str
    """Serial port, best as /dev/serial/by-id/..., or a converter on the network:
    socket://host:port (raw TCP) or rfc2217://host:port."""
    mode: Literal["continuous", "request"] = "continuous"
    """As set in CDS: the scanner sends by itself, and is only listened to; or it is asked for each
    scan, and nobody else may ask it meanwhile."""
    baud_rate: Annotated[int, Ge(9600), Le(4_000_000)] = 500_000
    """As set in CDS. Below 280 000 the scanner cannot send every scan."""
    device_address: Literal["host", "guest"] = "host"
    """Which of the two scanners of an EFI pair is meant; a single scanner is the host."""
    beams: Annotated[int, Ge(2), Le(2000)] = 541
    """Values in a telegram: 541 for an S300; 761 or 381 for an S3000. Others are refused."""
    field_of_view_deg: Annotated[float, Gt(0), Le(360)] = 270.0
    """Angle from the first beam to the last, straight ahead in the middle. S3000: 190."""
    sweep_s: Annotated[float, Ge(0), Le(1)] = 0.030
    """Time from the first beam to the last: 270/360 of the S300's 40 ms."""
    scan_period_s: Annotated[float, Gt(0), Le(1)] = 0.040
    """Time between two sweeps. For request mode alone: an answer does not tell how long ago its
    sweep ended. The middle of what is possible is taken: stamps are off by half of this at most."""
    transfer_delay_s: Annotated[float, Ge(0), Le(1)] = 0.0
    """Time from the last beam to the telegram's first byte; for what a calibration finds."""
    poll_interval_s: Annotated[float, Ge(0), Le(60)] = 0.0
    """Request mode: time from one request to the next; 0 asks as fast as the line allows."""
    latency_limit_s: Annotated[float, Gt(0), Le(1)] = 0.1
    """Longest delay of a telegram in adapter and scheduler. Later ones are old and are dropped."""
    silence_s: Annotated[float, Gt(0)] = 0.5
    """Without a telegram for so long and twice its time on the wire, or for 2.5 of its periods
    where that is more, the scanner counts as silent; an older scan is not given."""
