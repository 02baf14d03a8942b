"""What is done to a driver, by name; each on a rig of its own."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from amr_drivers.conformance.scenarios import damage, faults, measuring, stopping
from amr_drivers.conformance.scenarios.scenario import Scenario

__all__ = ["SCENARIOS", "Scenario"]

SCENARIOS: Final[Mapping[str, Scenario]] = MappingProxyType(
    {
        "measuring": measuring.measuring,
        "slow reader": measuring.slow_reader,
        "telegram cut": damage.cut,
        "telegram damaged": damage.damaged,
        "noise on the line": damage.noise,
        "50 MB of noise": damage.flood,
        "device silent": faults.silence,
        "unplugged": faults.unplugged,
        "power cycle": faults.power_cycle,
        "frozen": faults.frozen,
        "standby": faults.standby,
        "wrong device": faults.wrong_device,
        "stop": stopping.stop,
        "open and close": stopping.open_and_close,
    }
)
