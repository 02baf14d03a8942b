"""``scan``, thinned for who asks with ``?points=N``."""

from __future__ import annotations

import zenoh

from amr_slam.serving.asked import NotDone
from amr_slam.wire import MAX_SCAN_POINTS, ScanMessage


def thinned(payload: bytes, parameters: zenoh.Parameters) -> bytes:
    """``payload``: an encoded scan. Raises NotDone when ``points`` is no number of points."""
    text = parameters.get("points")
    if text is None:
        return payload
    # ASCII: isdecimal() alone takes other scripts' digits, and int() a thousand of them.
    most = int(text) if text.isascii() and text.isdecimal() and len(text) <= 4 else 0
    if not 1 <= most <= MAX_SCAN_POINTS:
        raise NotDone(f"points should be a number from 1 to {MAX_SCAN_POINTS}")
    return ScanMessage.decode(payload).thinned(most).encode()
