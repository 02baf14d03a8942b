"""A SICK LMS1xx, LMS5xx, TiM5xx or TiM7xx on a TCP port of this machine."""

from amr_drivers.emulators.cola.emulator import EmulatedCola, emulate
from amr_drivers.emulators.cola.models import LMS111, LMS511, MODELS, TIM571, TIM781, ColaModel

__all__ = ["LMS111", "LMS511", "MODELS", "TIM571", "TIM781", "ColaModel", "EmulatedCola", "emulate"]
