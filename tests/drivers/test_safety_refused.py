"""CoLa 2 telegrams and datagrams that no sound device sends: refused by a line
that says why, or let pass, and what comes after them is understood."""

from __future__ import annotations

from dataclasses import replace

import pytest

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.cola2 import (
    Frame as Cola2Frame,
)
from amr_drivers.sick_safety.cola2 import (
    FrameReader,
    begun_frame,
    decode_frame,
    encode_frame,
    read_variable,
)
from amr_drivers.sick_safety.datagrams import Reassembler, fragments

MS = 1_000_000


def test_what_is_no_cola_2_telegram_is_named() -> None:
    whole = encode_frame(read_variable(1, 2, 179))
    assert decode_frame(whole) == read_variable(1, 2, 179)
    with pytest.raises(BadTelegram, match=r"bytes of a CoLa 2 telegram of"):
        decode_frame(whole + b"\0")
    with pytest.raises(BadTelegram, match="no CoLa 2 telegram begins with"):
        begun_frame(b"\2\2\2\3" + whole[4:])
    with pytest.raises(BadTelegram, match="bytes are no CoLa 2 telegram"):
        begun_frame(whole[:12])
    with pytest.raises(BadTelegram, match="no frame has"):
        encode_frame(replace(read_variable(1, 2, 179), address=b"\1"))


@pytest.mark.parametrize(
    ("frame", "index"),
    [
        (read_variable(1, 2, 179), 179),
        (Cola2Frame(session=1, request=2, command="RA", payload=b"\x0f"), None),
        (Cola2Frame(session=1, request=2, command="OA"), None),
    ],
)
def test_a_telegram_names_a_variable_or_none(frame: Cola2Frame, index: int | None) -> None:
    assert frame.index == index


def test_half_a_cola_2_telegram_is_given_up_and_counted() -> None:
    whole = encode_frame(read_variable(1, 2, 179))
    reader = FrameReader()
    reader.reset()
    assert reader.damaged == 0  # nothing had begun
    assert list(reader.feed(whole[:10])) == []
    reader.reset()
    assert reader.damaged == 1
    assert list(reader.feed(whole)) == [read_variable(1, 2, 179)]


def test_a_start_too_short_for_its_hubs_address_is_skipped() -> None:
    """A length that only a telegram without an address can have, and an address announced."""
    whole = encode_frame(read_variable(1, 2, 179))
    least = bytearray(encode_frame(Cola2Frame(session=1, request=2, command="OA")))
    least[9] = 1
    reader = FrameReader()
    assert list(reader.feed(bytes(least) + whole)) == [read_variable(1, 2, 179)]
    assert reader.damaged == 1


def test_only_so_many_instances_are_remembered() -> None:
    """Repeated datagrams are known by those that came last; older ones are forgotten."""
    assembling = Reassembler()
    held = []
    for number in range(40):
        data = bytes((number,)) * 100
        (datagram,) = fragments(data, number)
        whole = assembling.feed(datagram, number * MS)
        assert whole is not None
        assert whole.data == data
        assert assembling.feed(datagram, number * MS) is None
        held.append(assembling.held_bytes)
    assert held[-1] == held[-2] == max(held)
    assert assembling.lost == 0
    # One that lacks a fragment is given up by the next whole one.
    first, _ = fragments(bytes(2000), 100)
    assert assembling.feed(first, 41 * MS) is None
    (datagram,) = fragments(bytes(100), 101)
    assert assembling.feed(datagram, 42 * MS) is not None
    assert assembling.lost == 1
