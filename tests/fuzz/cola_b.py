"""CoLa B: framing, messages and LMDscandata, on whatever bytes come."""

from __future__ import annotations

from cola_telegrams import check_reader, seeds_of

from amr_drivers.sick_cola.framing import MAX_PAYLOAD_B, ColaBReader, Dialect

_LONGEST = MAX_PAYLOAD_B + 9


def target(data: bytes) -> None:
    """Raises AssertionError, or what no parser may raise."""
    check_reader(ColaBReader, data, _LONGEST)


def seeds() -> list[bytes]:
    """Valid telegrams, alone and one after another."""
    return seeds_of(Dialect.B)
