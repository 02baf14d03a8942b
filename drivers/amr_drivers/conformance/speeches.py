"""What strangers say who answer at a scanner's port."""

from __future__ import annotations

import random
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np

from amr_drivers.sick_s300.telegrams import Output, Telegram, encode, encode_words

_HTTP: Final = (
    b"HTTP/1.1 400 Bad Request\r\nServer: lighttpd\r\nContent-Type: text/html\r\n"
    b"Content-Length: 48\r\nConnection: close\r\n\r\n"
    b"<html><body><h1>400 Bad Request</h1></body></html>"
)
_NMEA: Final = (
    b"$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\r\n"
    b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
)
_COLA_A: Final = b"\x02sRA DeviceIdent 9 LMS10x_FieldEval 10 V1.36-21.10.2010\x03"
_COLA_2: Final = bytes.fromhex("02020202 0000000a 0000 89abcdef 0001 4f41")
"""An opened session (fact sheet, C.1)."""
_SCANLESS_VALUES: Final = 7
"""Values of an S300 that has another field of view than any scanner."""


def _s300() -> bytes:
    words = np.arange(100, 100 + _SCANLESS_VALUES, dtype=np.uint16)
    return encode(
        Telegram(
            address=7,
            version=0x0103,
            status=0,
            scan_number=bytes((1, 2, 3, 4)),
            telegram_number=bytes((1, 2)),
            output=Output.MEASURED,
            payload=encode_words(words),
        )
    )


SPEECHES: Final[Mapping[str, bytes]] = MappingProxyType(
    {
        "HTTP server": _HTTP,
        "NMEA talker": _NMEA,
        "random bytes": random.Random(3).randbytes(1024),
        "S300 with 7 values": _s300(),
        "CoLa A": _COLA_A,
        "CoLa 2": _COLA_2,
    }
)
"""None of them is a scan to any driver, not even to the one whose protocol it is."""
