"""The robot in the machine: its service, what a fleet controller hears of it, and the truth."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from system.drive import truth
from system.machine import SCANNERS, Machine

UNIT: Final = "amr-slam@robot"
LOCALIZED: Final = r'pose .*"state": *"localized"'
_HEARD: Final = "/run/heard"
_SLACK_M: Final = 0.05
"""Between the instant of a pose and its reception, at 0.3 m/s on a slow computer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Heard:
    """One message as it arrived, on the guest's CLOCK_MONOTONIC."""

    at_s: float
    kind: str
    message: dict[str, Any]


class Robot:
    """Drives as drive.py has recorded it, in the map of that laboratory."""

    def __init__(self, machine: Machine, drive: Path) -> None:
        self.machine = machine
        self._truth = truth(drive)
        self._started_s = 0.0

    def configure(self) -> None:
        """What a technician does after tools/install.py: serial numbers, and the map to use."""
        serials = "; ".join(f"s/SERIAL-{n}/A9-{n}/" for n in map(str.upper, SCANNERS))
        self.machine.run(
            f"""set -e
            sed -i '{serials}' /etc/udev/rules.d/70-amr-slam.rules
            udevadm control --reload
            cd /etc/amr-slam
            sed -i 's/mode = "mapping"/mode = "localization"/; s/^name = "hall"//
                    s|directory = "maps".*|path = "maps/hall.amrmap"|' robot.toml
            ip link set can1 up type can bitrate 500000"""
        )

    def power_on(self) -> None:
        """Scanners come to their sockets, the robot drives off, a controller listens."""
        for name in SCANNERS:
            self.machine.plug_scanner(name)
        python, folder = "/opt/amr-slam/bin/python", "/opt/system-test"
        said = self.machine.run(
            f"""set -e
            systemd-run -q --unit=listener {python} {folder}/listener.py {_HEARD}
            systemd-run -q --unit=player python3 {folder}/player.py {folder}/drive.bin /run/started
            until [ -s /run/started ]; do sleep 0.1; done
            cat /run/started"""
        )
        self._started_s = float(said.output)

    def mark(self) -> int:
        """A place in what is heard: the present end."""
        return int(self.machine.run(f"stat -c %s {_HEARD} 2>/dev/null || echo 0").output)

    def heard(self, mark: int) -> list[Heard]:
        """All since then."""
        told = []
        for line in self.machine.run(f"tail -c +{mark + 1} {_HEARD}").output.splitlines():
            at_s, kind, message = line.split(" ", 2)
            told.append(Heard(at_s=float(at_s), kind=kind, message=json.loads(message)))
        return told

    def hears(self, pattern: str, mark: int, limit_s: float) -> float | None:
        """When a line since ``mark`` matches (grep); None: none did in ``limit_s``."""
        waiting = f"tail -f -c +{mark + 1} {_HEARD} | grep -q -m1 '{pattern}'"
        answer = self.machine.run(waiting, limit_s=limit_s, check=False)
        return answer.ended_s if answer.status == 0 else None

    def property(self, name: str, unit: str = UNIT) -> str:
        """Of the unit, as systemd has it."""
        return self.machine.run(f"systemctl show -P {name} {unit}").output.strip()

    def ready_s(self) -> float:
        """From the start of the program to READY, for the newest start."""
        names = "ExecMainStartTimestampMonotonic,ActiveEnterTimestampMonotonic"
        said = self.machine.run(f"systemctl show -p {names} {UNIT}").output
        stamps = dict(line.split("=") for line in said.split())
        began, active = (1e-6 * int(stamps[name]) for name in names.split(","))
        return active - began

    def until_active(self, limit_s: float) -> float:
        """When the unit is active again, on the guest's clock."""
        waiting = f'[ "$(systemctl show -P ActiveState {UNIT})" = active ]'
        return self.machine.until(waiting, limit_s=limit_s).ended_s

    def worst_excess_m(self, heard: list[Heard]) -> float:
        """By how much a pose that claimed to be localized was farther off than it said; below 0:
        none was."""
        worst = -math.inf
        for pose in heard:
            message = pose.message
            if pose.kind != "pose" or message["state"] != "localized":
                continue
            since_s = pose.at_s - self._started_s - message["age_s"]
            x_m, y_m = (np.interp(since_s, self._truth[:, 0], self._truth[:, k]) for k in (1, 2))
            error_m = math.hypot(message["x"] - x_m, message["y"] - y_m)
            worst = max(worst, error_m - message["error95_m"] - _SLACK_M)
        return worst
