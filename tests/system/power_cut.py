"""Cutting the power while a map is saved, over and over from one kept instant.

The saver in the guest tells its console of each save that is done. After the cut the disk is read
as a computer would at its next start (the journal is replayed), by the host.
"""

from __future__ import annotations

import random
import re
import shutil
import subprocess
import time
from pathlib import Path
from typing import Final

from system.machine import Machine

from amr_slam.map import MapError, load_map

_FOLDER: Final = "/var/lib/private/amr-slam"
_LONGEST_S: Final = 6.0
"""Of the host, from the kept instant to the cut: some saves."""


def cut_power(image: Path, folder: Path, cuts: int, accelerator: str, seed: int = 0) -> str:
    """What became of the maps: "20 of 20 whole, ...": those of the last save that was told to be
    safe, or newer."""
    with Machine(image, folder, accelerator=accelerator) as machine:
        machine.run(
            f"systemd-run -q --unit=saver --setenv=AMR_SLAM_COMPILED=0 /opt/amr-slam/bin/python"
            f" /opt/system-test/saver.py {_FOLDER}/maps/hall.amrmap {_FOLDER}/cut/hall.amrmap"
        )
        machine.until(f"[ -e {_FOLDER}/cut/hall.amrmap.2 ]", limit_s=120.0)
        machine.keep("saving")
    dice = random.Random(seed)
    whole, newer, unfinished, failures = 0, 0, 0, []
    for number in range(1, cuts + 1):
        with Machine(image, folder, accelerator=accelerator, fresh=False) as machine:
            machine.return_to("saving")
            time.sleep(dice.uniform(0.0, _LONGEST_S))
        told = re.findall(r"saved (\d+)", (folder / "console.log").read_text(errors="replace"))
        saved = max(map(int, told), default=0)
        name, left = _found(folder)
        unfinished += left
        if name is not None and int(name) >= saved:
            whole += 1
            newer += int(name) > saved
        else:
            failures.append(f"cut {number}: {name} on disk, {saved} told")
    told_of = f"{newer} newer than the last that was told, {unfinished} beside an unfinished file"
    return "; ".join([f"{whole} of {cuts} whole, {told_of}", *failures])


def _found(folder: Path) -> tuple[str | None, bool]:
    """The number of the map on the disk, and whether an unfinished file lies there: the kernel
    forgets one that it was not yet told to make safe."""
    disk, copy = folder / "state.raw", folder / "state"
    shutil.rmtree(copy, ignore_errors=True)
    copy.mkdir()
    _run("qemu-img", "convert", "-O", "raw", folder / "state.qcow2", disk)
    # 1: repaired, as after every power cut.
    if _run("e2fsck", "-fy", disk) not in (0, 1):
        return None, False
    _run("debugfs", "-R", f"rdump /cut {copy}", disk)
    unfinished = any((copy / "cut").glob(".*.tmp"))
    try:
        grown, _ = load_map(copy / "cut/hall.amrmap")
    except MapError:
        return None, unfinished
    return grown.name.removeprefix("save "), unfinished


def _run(*command: str | Path) -> int:
    return subprocess.run(command, capture_output=True, check=False).returncode
