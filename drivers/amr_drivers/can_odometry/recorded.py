"""Recorded frames to wheel samples, as the driver does it. Pure."""

from __future__ import annotations

from amr_drivers.can_odometry.frames import FrameDecoder
from amr_drivers.errors import BadTelegram
from amr_slam.samples import RawFrame, WheelSample


class RecordedWheels:
    """An :class:`amr_drivers.decoding.WheelDecoder`."""

    def __init__(self, decoder: FrameDecoder) -> None:
        self._decoder = decoder

    def received(self, frame: RawFrame) -> WheelSample | None:
        """See :class:`amr_drivers.decoding.WheelDecoder`."""
        if frame.error or frame.remote:
            return None
        try:
            return self._decoder.feed(
                frame.stamp_ns, frame.arbitration_id, frame.data, is_extended=frame.extended
            )
        except BadTelegram:
            return None
