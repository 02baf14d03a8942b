"""What can happen to a scan on its way. No socket."""

from __future__ import annotations

import random
from dataclasses import replace

from amr_drivers.sick_safety.cola2 import Frame, encode_frame

_HEAD = 24
_OFFSETS = (32, 36, 40)
"""Of status, derived values and measurement, in an instance's header."""


def cut(datagrams: list[bytes], at_byte: int) -> list[bytes]:
    """The first so many bytes of them."""
    left, kept = at_byte, []
    for datagram in datagrams:
        if left <= 0:
            break
        kept.append(datagram[:left])
        left -= len(datagram)
    return kept


def spoilt_datagrams(datagrams: list[bytes], seed: int) -> list[bytes]:
    """Fragments lost, doubled, in another order, shortened, or with a header that is not true."""
    dice = random.Random(seed)
    spoilt = list(datagrams)
    n = dice.randrange(len(spoilt))
    kind = dice.randrange(6)
    is_last = n == len(spoilt) - 1
    if kind == 0 or (kind == 5 and is_last):
        del spoilt[n]
    elif kind == 1:
        spoilt.insert(dice.randrange(len(spoilt) + 1), spoilt[n])
    elif kind == 2:
        dice.shuffle(spoilt)
    elif kind == 3:
        spoilt[n] = spoilt[n][: dice.randrange(len(spoilt[n]))]
    elif kind == 4:
        # Mark, version, total length or offset; identifications are the devices' own.
        at = dice.choice((*range(12), *range(16, 20)))
        head = bytearray(spoilt[n])
        head[at] ^= 1 << dice.randrange(8)
        spoilt[n] = bytes(head)
    else:
        wrong = bytearray(spoilt[n])
        wrong[dice.randrange(_HEAD, len(wrong))] ^= 1 << dice.randrange(8)
        # The same fragment twice, with one bit of difference. (A last one would complete the
        # instance before its twin comes: UDP's checksum alone guards against that.)
        spoilt.insert(n, bytes(wrong))
    return spoilt


def spoilt_answer(frame: Frame, seed: int) -> bytes:
    """An answer whose structure is broken; its values have no checksum."""
    dice = random.Random(seed)
    kind = dice.randrange(6)
    if kind == 0:
        return encode_frame(replace(frame, session=frame.session ^ 1 << dice.randrange(32)))
    if kind == 1:
        return encode_frame(replace(frame, request=frame.request ^ 1 << dice.randrange(16)))
    if kind == 2:
        whole = bytearray(encode_frame(frame))
        whole[4:8] = (len(whole) + dice.randrange(1, 4000)).to_bytes(4, "big")
        return bytes(whole)
    if kind == 3:
        return encode_frame(replace(frame, payload=frame.payload[: -dice.randrange(5, 200)]))
    payload = bytearray(frame.payload)
    if kind == 4:
        payload[2] ^= 0x80  # the version's letter
    else:
        at = 2 + dice.choice(_OFFSETS)
        payload[at : at + 2] = (dice.randrange(50_000, 60_000)).to_bytes(2, "little")
    return encode_frame(replace(frame, payload=bytes(payload)))
