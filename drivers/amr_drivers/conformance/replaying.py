"""Whether recorded bytes give the same scans again."""

from __future__ import annotations

from collections.abc import Sequence

from amr_drivers.background import ScanDecoder
from amr_drivers.conformance.listener import Session
from amr_drivers.conformance.rig import Rig
from amr_slam.samples import RawBytes, Scan, Way


def decoded(decoder: ScanDecoder, raw: Sequence[RawBytes]) -> list[Scan]:
    """The scans of a recording, as a replay gets them."""
    scans: list[Scan] = []
    for piece in raw:
        match piece.way:
            case Way.RECEIVED:
                scans += decoder.received(piece.data, piece.stamp_ns)
            case Way.SENT:
                decoder.sent(piece.data, piece.stamp_ns)
            case Way.GAP:
                decoder.gap()
    return scans


def other_scans(rig: Rig, sessions: Sequence[Session]) -> list[str]:
    """Breaches: scans that were given and do not come out of the recording bit for bit.

    More may come out: a driver gives the newest only.
    """
    breaches = []
    for session in sessions:
        decoder = rig.decoder(session.opened_ns)
        if decoder is None or not session.raw:
            continue
        again = iter([_bits(scan) for scan in decoded(decoder, session.raw)])
        # `in` moves the iterator on to the match: the order must be the same as well.
        missing = sum(_bits(scan) not in again for scan in session.scans)
        if missing:
            breaches.append(f"{missing} scans given are not in the recording's replay")
    return breaches


def _bits(scan: Scan) -> tuple[object, ...]:
    return (
        scan.scanner,
        scan.stamp_ns,
        scan.ranges_m.tobytes(),
        scan.angle_min_rad,
        scan.angle_step_rad,
        scan.sweep_s,
        scan.range_max_m,
        scan.seq,
    )
