"""The scan number, whose byte order the sources disagree about (fact sheet, A.2). Pure."""

from __future__ import annotations

from typing import Literal

_MAX_STEP = 1000


class ScanCounter:
    """Reads the scan number, whose byte order the sources disagree about (A.2).

    In consecutive telegrams the number grows by little: the order in which it does is the right
    one. A number that later grows by little in the other order only changes the verdict.
    """

    def __init__(self) -> None:
        self._last: bytes | None = None
        self._order: _Order | None = None

    def repeats(self, raw: bytes) -> bool:
        """True when these bytes are the last telegram's: a scanner that does not scan anew."""
        return raw == self._last

    def read(self, raw: bytes) -> int | None:
        """The number in four bytes as sent; None while the order is not known."""
        if self._last is not None:
            little, big = (0 < _step(self._last, raw, order) <= _MAX_STEP for order in _ORDERS)
            if little != big:
                self._order = "little" if little else "big"
        self._last = raw
        return None if self._order is None else int.from_bytes(raw, self._order)


_Order = Literal["little", "big"]
_ORDERS: tuple[_Order, _Order] = ("little", "big")


def _step(last: bytes, raw: bytes, order: _Order) -> int:
    return (int.from_bytes(raw, order) - int.from_bytes(last, order)) % 2**32
