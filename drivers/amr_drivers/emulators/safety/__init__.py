"""A SICK microScan3 or nanoScan3 on a TCP port of this machine, with its UDP stream."""

from amr_drivers.emulators.safety.emulator import EmulatedSafety, emulate
from amr_drivers.emulators.safety.models import MICROSCAN3, MODELS, NANOSCAN3, SafetyModel

__all__ = ["MICROSCAN3", "MODELS", "NANOSCAN3", "EmulatedSafety", "SafetyModel", "emulate"]
