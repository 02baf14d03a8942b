"""The computer under the robot: clock, disk, ports, CAN interface, service."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from amr_slam.config import Config
from amr_slam.service.doctor.findings import Finding, advice

_NEARLY_FULL: Final = 0.05
_LEAST_FREE_BYTES: Final = 512 << 20
_COMMAND_S: Final = 5.0
_UP: Final = 1
"""IFF_UP of /sys/class/net/NAME/flags."""
_UNIT: Final = ("LoadState", "ActiveState", "SubState", "Result", "NRestarts", "StatusText")


def look_at_computer(config: Config, config_path: Path) -> Iterator[Finding]:
    """All that can be seen without opening a device."""
    yield from _clock()
    yield from _disks({config.map.directory, config.recording.directory})
    yield from _can(config.odometry.options)
    yield from _unit(config_path.stem)


def _clock() -> Iterator[Finding]:
    """Others compare our stamps with their clock."""
    told = _command("timedatectl", "show", "--property=NTPSynchronized", "--value")
    if told is None:
        return
    if told.strip() == "yes":
        yield Finding(part="clock", what="synchronised")
    else:
        yield Finding(
            part="clock",
            what="not synchronised: stamps of poses may be off by any time",
            do="timedatectl set-ntp true, and name a time server that the robot reaches "
            "(/etc/systemd/timesyncd.conf); or chrony, or PTP",
        )


def _disks(folders: set[Path]) -> Iterator[Finding]:
    for folder in sorted(folders):
        there = next(one for one in (folder.absolute(), *folder.absolute().parents) if one.exists())
        usage = shutil.disk_usage(there)
        free = f"{usage.free / 1e9:.1f} of {usage.total / 1e9:.1f} GB free"
        if usage.free < max(_LEAST_FREE_BYTES, _NEARLY_FULL * usage.total):
            yield Finding(
                part="disk",
                what=f"{folder}: nearly full, {free}: maps and recordings are not saved",
                do="look what fills it (du -xh / | sort -h | tail; journalctl --vacuum-size=200M); "
                "fetch and delete old recordings",
            )
        elif not os.access(there, os.W_OK):
            yield Finding(
                part="disk",
                what=f"{folder}: this user may not write there",
                do=f"run this as the user that runs the robot, or chown {there}",
            )
        else:
            yield Finding(part="disk", what=f"{folder}: {free}")


def _can(settings: Any) -> Iterator[Finding]:
    if getattr(settings, "interface", None) != "socketcan":
        return
    channel = str(settings.channel)
    flags = Path("/sys/class/net") / channel / "flags"
    try:
        is_up = int(flags.read_text(), 16) & _UP
    except (OSError, ValueError):
        reason = f"no such device: {channel}"
        yield Finding(part="wheels", what=reason, do=advice(f"no such device: can {channel}", ""))
        return
    if is_up:
        yield Finding(part="wheels", what=f"CAN interface {channel} is up")
    else:
        reason = f"interface {channel} is down"
        yield Finding(part="wheels", what=reason, do=advice(reason, "").replace("NAME", channel))


def _unit(instance: str) -> Iterator[Finding]:
    unit = f"amr-slam@{instance}.service"
    told = _command("systemctl", "show", unit, *(f"--property={name}" for name in _UNIT))
    if told is None:
        return
    facts = dict(line.split("=", 1) for line in told.splitlines() if "=" in line)
    yield unit_finding(unit, facts)


def unit_finding(unit: str, facts: dict[str, str]) -> Finding:
    """``facts``: what ``systemctl show`` says of the unit."""
    if facts.get("LoadState") != "loaded":
        return Finding(part="service", what=f"{unit} is not installed here")
    state = f"{unit} is {facts.get('ActiveState')} ({facts.get('SubState')})"
    restarts = facts.get("NRestarts", "0")
    match facts.get("ActiveState"), facts.get("Result"):
        case "active", _ if restarts in {"", "0"}:
            return Finding(part="service", what=f"{state}: {facts.get('StatusText') or 'running'}")
        case "active", _:
            do = f"why it was restarted: journalctl -u {unit} -p warning -n 50"
            return Finding(part="service", what=f"{state}, restarted {restarts} times", do=do)
        case "inactive", "success":
            return Finding(part="service", what=f"{state}", do=f"systemctl enable --now {unit}")
        case _, result:
            do = f"journalctl -u {unit} -n 50 names the reason; then systemctl reset-failed {unit}"
            return Finding(part="service", what=f"{state}: {result}", do=f"{do} and start it")


def _command(program: str, *arguments: str) -> str | None:
    """What it prints; None where there is no systemd to ask."""
    path = shutil.which(program)
    if path is None or not Path("/run/systemd/system").exists():
        return None
    try:
        done = subprocess.run(
            [path, *arguments], capture_output=True, text=True, check=False, timeout=_COMMAND_S
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None
