"""CoLa A and B fields and telegrams that no sound device sends: refused by a line
that says why, or let pass, and what comes after them is understood."""

from __future__ import annotations

import pytest
from cola_telegrams import scan_data, telegram

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.fields import fields
from amr_drivers.sick_cola.framing import AnyReader, ColaAReader, ColaBReader, Dialect
from amr_drivers.sick_cola.messages import output_range
from amr_drivers.sick_cola.scandata import decode_scan, encode_scan


@pytest.mark.parametrize(
    ("read", "data", "why"),
    [
        (lambda f: f.unsigned(16), b"10000", "does not fit into 16 bits"),
        (lambda f: f.unsigned(16), b"-1", "does not fit into 16 bits"),
        (lambda f: f.signed(16), b"12345", "does not fit into 16 bits"),
        (lambda f: f.letters(5), b"DIST", "has not 5 characters"),
        (lambda f: f.text(), b"9 short", "no text of 9 characters"),
        (lambda f: f.text(), b"5 a\x01b\x02c", "is no text"),
        (lambda f: f.values(3, 16), b"1 2", "no 3 values are left"),
        (lambda f: f.values(3, 16), b"1 22222", "cut short: 2 values instead of 3"),
        (lambda f: f.values(2, 8), b"1 100", "bits"),
    ],
)
def test_a_text_field_that_holds_something_else_is_refused(
    read: object, data: bytes, why: str
) -> None:
    assert callable(read)
    with pytest.raises(BadTelegram, match=why):
        read(fields(data, Dialect.A))


@pytest.mark.parametrize("dialect", list(Dialect))
def test_no_values_are_no_bytes(dialect: Dialect) -> None:
    read = fields(b"", dialect)
    assert len(read.values(0, 16)) == 0
    read.end()


def test_an_output_range_of_several_sectors_is_refused() -> None:
    body = b"\0\2" + bytes(24)
    with pytest.raises(BadTelegram, match="2 sectors instead of 1"):
        output_range(body, Dialect.B)


def test_more_encoders_than_any_device_has_are_not_read() -> None:
    """The number is from outside: nothing is made by it before it is checked."""
    body = bytearray(encode_scan(scan_data(encoders=()), Dialect.B))
    at = _encoder_count_at()
    assert body[at : at + 2] == b"\0\0"
    body[at : at + 2] = b"\xff\xff"
    with pytest.raises(BadTelegram, match="65535 encoders"):
        decode_scan(bytes(body), Dialect.B)


def _encoder_count_at() -> int:
    head_bits = (16, 16, 32, 8, 8, 16, 16, 32, 32, 8, 8, 8, 8, 16, 32, 32)
    return sum(head_bits) // 8


@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize("any_dialect", [False, True], ids=["told", "found out"])
def test_a_telegram_that_was_cut_by_a_gap_spoils_no_other(
    dialect: Dialect, any_dialect: bool
) -> None:
    whole = telegram(scan_data(), dialect, "sSN")
    own = ColaAReader() if dialect is Dialect.A else ColaBReader()
    reader = AnyReader() if any_dialect else own
    assert list(reader.feed(whole[: len(whole) // 2])) == []
    reader.reset()
    assert len(list(reader.feed(whole))) == 1
    # ... and one that comes byte by byte is heard with its last one.
    heard = [len(list(reader.feed(whole[n : n + 1]))) for n in range(len(whole))]
    assert sum(heard[:-1]) == 0
    assert heard[-1] == 1
