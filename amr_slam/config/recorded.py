"""The settings that a recording holds. Not with the rest: the daemon reads no recordings."""

from __future__ import annotations

from amr_drivers.decoding import module_of
from amr_slam.config.checking import checked
from amr_slam.recording import RecordedDevice
from amr_slam.recording.raw import settings_table


def recorded_settings(device: RecordedDevice) -> object:
    """A recorded device's settings, checked as if they stood in a configuration.

    Raises ConfigError with the path from the driver's options down, ValueError for no settings.
    """
    return checked(module_of(device).Settings, settings_table(device))
