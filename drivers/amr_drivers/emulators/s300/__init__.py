"""A SICK S300 or S3000 in continuous mode or in request mode, on a serial line or a converter."""

from amr_drivers.emulators.s300.device import EmulatedS300, S300Model
from amr_drivers.emulators.s300.standing_in import emulate

__all__ = ["EmulatedS300", "S300Model", "emulate"]
