"""The driver ``cia402``: wheels on drives that speak CANopen."""

from __future__ import annotations

import time

from amr_drivers.can_odometry.cia402.decoder import Cia402Decoder
from amr_drivers.can_odometry.cia402.settings import Settings
from amr_drivers.can_odometry.source import CanOdometry
from amr_slam.samples import FrameTap, untapped

__all__ = ["Settings", "open_odometry", "wheel_decoder"]


def open_odometry(settings: Settings, tap: FrameTap = untapped) -> CanOdometry:
    """Open the bus and begin to listen; does not wait for the first frame.

    Raises LinkLost when the bus cannot be opened, ValueError for a mapping that cannot be used.
    """
    return CanOdometry(
        "CiA 402 drives", settings, wheel_decoder(settings, time.monotonic_ns()), tap
    )


def wheel_decoder(settings: Settings, start_ns: int) -> Cia402Decoder:
    """What turns the bus's frames into samples. Raises ValueError as :func:`open_odometry`."""
    return Cia402Decoder(settings, start_ns)
