"""The driver ``can``: wheels in frames that a DBC file describes."""

from __future__ import annotations

import time

from amr_drivers.can_odometry.dbc_decoder import DbcDecoder
from amr_drivers.can_odometry.settings import Settings
from amr_drivers.can_odometry.source import CanOdometry
from amr_slam.samples import FrameTap, untapped

__all__ = ["FILES", "Settings", "open_odometry", "wheel_decoder"]

FILES = ("dbc",)
"""Settings that name files: a recording takes their contents along."""


def open_odometry(settings: Settings, tap: FrameTap = untapped) -> CanOdometry:
    """Open the bus and begin to listen; does not wait for the first frame.

    Raises LinkLost when the bus cannot be opened, ValueError for a DBC file that does not fit.
    """
    return CanOdometry(
        "wheel encoders", settings, wheel_decoder(settings, time.monotonic_ns()), tap
    )


def wheel_decoder(settings: Settings, start_ns: int) -> DbcDecoder:
    """What turns the bus's frames into samples. Raises ValueError as :func:`open_odometry`."""
    return DbcDecoder(settings, start_ns)
