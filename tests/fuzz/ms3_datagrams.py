"""Datagrams of a safety scanner, their reassembly, and the instance.

An input is cut into datagrams by lengths of two bytes before each; what is left over, and the
whole input, are read as an instance.
"""

from __future__ import annotations

import numpy as np

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.blocks import Beams, DerivedValues, Header, Instance, Status, ranges_m
from amr_drivers.sick_safety.datagrams import (
    MAX_INSTANCE,
    MAX_OPEN,
    Reassembler,
    fragments,
)
from amr_drivers.sick_safety.instance import (
    HEADER,
    MAX_BEAMS,
    decode_instance,
    decode_parts,
    encode_instance,
)

_KEPT = 4


def target(data: bytes) -> None:
    """Reassemble the datagrams of an input; read all that may be an instance."""
    reassembler = Reassembler()
    at, stamp_ns = 0, 0
    while at + 2 <= len(data):
        length = int.from_bytes(data[at : at + 2], "little")
        datagram = data[at + 2 : at + 2 + length]
        at += 2 + length
        stamp_ns += 1_000_000
        try:
            done = reassembler.feed(datagram, stamp_ns)
        except BadTelegram:
            continue
        assert reassembler.held_bytes <= (2 * MAX_OPEN + _KEPT) * MAX_INSTANCE
        if done is not None:
            assert len(done.data) <= MAX_INSTANCE
            _read(done.data)
    _read(data)


def _read(data: bytes) -> None:
    try:
        parts = decode_parts(data)
    except BadTelegram:
        return
    instance = _decoded(data)
    # Either the whole is sound, or what can be read of it comes with a complaint.
    assert (instance is None) == (parts.complaint is not None)
    if instance is None:
        return
    if instance.derived is None or instance.beams is None:
        return
    assert len(instance.beams) == instance.derived.beams <= MAX_BEAMS
    ranges = ranges_m(instance.derived, instance.beams)
    assert len(ranges) == len(instance.beams)
    assert not (ranges < 0.0).any()
    again = decode_instance(encode_instance(instance, header_bytes=max(HEADER, 76)))
    assert again.derived == instance.derived
    assert again.status == instance.status
    assert again.beams is not None
    assert again.beams.distance.tobytes() == instance.beams.distance.tobytes()


def seeds() -> list[bytes]:
    """Instances with each kind of header and with blocks absent; their datagrams in two orders."""
    whole = [encode_instance(_instance(), header_bytes=length) for length in (52, 56, 76)]
    bare = [
        encode_instance(Instance(header=_instance().header, status=Status(standby=True))),
        bytes(52),
    ]
    parts = fragments(whole[2], 7, 60)
    orders = [parts, parts[::-1], [*parts[:2], *parts]]
    return [*whole, *bare, *(b"".join(map(_framed, order)) for order in orders)]


def _decoded(data: bytes) -> Instance | None:
    try:
        return decode_instance(data)
    except BadTelegram:
        return None


def _framed(datagram: bytes) -> bytes:
    return len(datagram).to_bytes(2, "little") + datagram


def _instance() -> Instance:
    beams = 6
    return Instance(
        header=Header(
            version=("R", 2, 0, 0),
            serial_number=17_479_021,
            plug_number=17_469_324,
            channel=0,
            sequence=609,
            scan_number=636,
            date=0,
            time_ms=22_740,
        ),
        status=Status(safe_off=0x55, monitoring_cases=(1, 0, 0, 0)),
        derived=DerivedValues(
            factor=1, beams=beams, scan_time_ms=30, start_deg=-10.5, step_deg=0.5, interbeam_us=43
        ),
        beams=Beams(
            distance=np.arange(1000, 1000 + beams, dtype=np.uint16),
            rssi=np.full(beams, 26, dtype=np.uint8),
            status=np.array((1, 1, 2, 0, 5, 17), dtype=np.uint8),
        ),
    )
