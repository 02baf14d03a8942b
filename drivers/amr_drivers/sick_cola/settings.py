"""What the driver is told about a scanner."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Where the scanner is and how to listen. Nothing is written to it, nobody logs in."""

    host: str
    """Address or name on the network."""
    port: Annotated[int, Ge(1), Le(65535)] = 2112
    """2112 or 2111; the devices offer both."""
    dialect: Literal["auto", "a", "b"] = "auto"
    """CoLa A (text) or CoLa B (binary), as set in SOPAS; auto finds out, CoLa B first, which
    costs a device of CoLa A a second each time it connects."""
    delivery: Literal["streamed", "polled"] = "streamed"
    """streamed: the device sends each scan by itself. polled: it is asked, one scan at a time."""
    poll_interval_s: Annotated[float, Ge(0.0), Le(60.0)] = 0.5
    """polled: from one question to the next, and up to one scan period more."""
    serial_number: Annotated[int, Ge(0), Le(2**32 - 1)] = 0
    """Of the device that must be behind the address, as on its type label; 0: any."""
    straight_ahead_deg: Annotated[float, Ge(-360.0), Le(360.0)] = 90.0
    """What the device calls the direction straight ahead. 0 for TiM240 and LRS4000."""
    range_max_m: Annotated[float, Gt(0.0), Le(1000.0)] = 80.0
    """An echo from beyond means: nothing within this range. By their data sheets LMS1xx 20 to 50,
    LMS5xx 80, TiM5xx and TiM7xx 10 to 25."""
    stamp_shift_s: Annotated[float, Ge(-1.0), Le(1.0)] = 0.0
    """Added to each scan's stamp; for what a calibration finds."""
    latency_limit_s: Annotated[float, Gt(0), Le(1)] = 0.1
    """Longest delay of a telegram in network and scheduler. Later ones are old and are dropped."""
    silence_s: Annotated[float, Gt(0), Le(60)] = 0.5
    """Without an answer for so long, or for 2.5 telegram periods where that is more, the device
    counts as gone; an older scan is not given."""
