"""What the scanners' drivers cost: prints a Markdown table and asserts nothing.

Each rig of the conformance suite joins by being one: its emulator sweeps in real time, its driver
listens, and what passed on the line is decoded again as fast as it goes. Processor times, so that
a machine that is busy otherwise changes them little. Example: python benchmarks/scanners.py
"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from amr_drivers.conformance.replaying import decoded
from amr_drivers.conformance.rig import MakeRig, Rig
from amr_drivers.conformance.runner import Runner
from amr_drivers.conformance.table import all_rigs, rigs_named
from amr_slam.samples import RawBytes, Way

SECONDS: Final = 6.0
"""Of each scanner's life: an S300 fills the memory of its clock in 4."""
REPETITIONS: Final = 7


@dataclass(frozen=True, slots=True, kw_only=True)
class Recording:
    """What passed on a scanner's line, and what listening to it cost."""

    raw: list[RawBytes]
    begun_ns: int
    share: float
    """Of one processor, for the driver's thread: waiting, reading, decoding."""


def main() -> int:
    """Measure and print, rig by rig: all, or those named."""
    rigs = rigs_named(sys.argv[1:]) if sys.argv[1:] else all_rigs()
    machine = f"{platform.machine()}, {os.cpu_count()} processors"
    print(f"{machine}, Python {platform.python_version()}, numpy {np.__version__}\n")
    print("| driver | scans/s | bytes a scan | parser MB/s | us a scan | parser | driver |")
    print("|---|---|---|---|---|---|---|")
    for name, make in rigs.items():
        with tempfile.TemporaryDirectory() as folder:
            print(f"| {name} | {' | '.join(measured(make, Path(folder)))} |", flush=True)
    return 0


def measured(make: MakeRig, folder: Path) -> tuple[str, ...]:
    """Rate, size of a scan, speed and time of the parser, its share and the whole driver's."""
    with make(folder) as rig:
        recording = recorded(rig)
        size = sum(len(raw.data) for raw in recording.raw if raw.way is Way.RECEIVED)
        times_s = []
        scans = 0
        for _ in range(REPETITIONS):
            decoder = rig.decoder(recording.begun_ns)
            if decoder is None:
                raise RuntimeError(f"{rig.name} has no decoder")
            begun_s = time.process_time()
            scans = len(decoded(decoder, recording.raw))
            times_s.append(time.process_time() - begun_s)
    taken_s = float(np.median(times_s))
    return (
        f"{1.0 / rig.period_s:.1f}",
        f"{size / scans:.0f}",
        f"{1e-6 * size / taken_s:.1f}",
        f"{1e6 * taken_s / scans:.0f}",
        f"{100.0 * taken_s / scans / rig.period_s:.2f} %",
        f"{100.0 * recording.share:.1f} %",
    )


def recorded(rig: Rig) -> Recording:
    """Some seconds of a scanner at its full rate."""
    raw: list[RawBytes] = []
    with Runner(rig):
        begun_ns = time.monotonic_ns()
        scanner = rig.open(raw.append)
        # By the name that BackgroundScanner gives: the emulator may have threads, too.
        clocks = [
            time.pthread_getcpuclockid(thread.ident)
            for thread in threading.enumerate()
            if thread.ident is not None and thread.name.startswith("scanner-")
        ]
        used_s = -sum(map(time.clock_gettime, clocks))
        while time.monotonic_ns() - begun_ns < 1e9 * SECONDS:
            scanner.read(0.1)
        used_s += sum(map(time.clock_gettime, clocks))
        passed_s = 1e-9 * (time.monotonic_ns() - begun_ns)
        scanner.close()
    return Recording(raw=raw, begun_ns=begun_ns, share=used_s / passed_s)


if __name__ == "__main__":
    sys.exit(main())
