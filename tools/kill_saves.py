"""Kill a process at random moments while it saves maps, and load what it leaves behind.

python tools/kill_saves.py --count 500
"""

from __future__ import annotations

import argparse
import itertools
import os
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from amr_slam.clouds import CloudParams, cloud_from_scan
from amr_slam.durable import write_durably
from amr_slam.geometry import Pose2
from amr_slam.map import MapParams, PointMap, load_map, save_map
from amr_slam.map.file import encode
from amr_slam.samples import Scan


def grown(scans: int, seed: int) -> PointMap:
    """A round room seen from around its middle."""
    rng = np.random.default_rng(seed)
    made = PointMap(MapParams(), f"map-{scans}")
    for number in range(scans):
        scan = Scan(
            scanner="front",
            stamp_ns=number,
            ranges_m=rng.normal(5.0, 0.01, 541),
            angle_min_rad=-2.35,
            angle_step_rad=4.7 / 540,
        )
        made.insert(
            cloud_from_scan(scan, Pose2.identity(), CloudParams()), Pose2(0.01 * number, 0.0, 0.0)
        )
    return made


def save_for_ever(contents: list[bytes], path: Path) -> None:
    """What ``save_map`` does once the map is encoded, until the kill."""
    for content in itertools.cycle(contents):
        write_durably(path, content, keep=2)


def main() -> int:
    """Fork, wait a random moment, kill, look; 1 when a map was not whole."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=500, help="kills (default 500)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    moments, maps = random.Random(arguments.seed), [grown(2, 1), grown(3, 2)]
    whole = cut_short = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hall.amrmap"
        known = {save_map(one, path) for one in maps}
        contents = [encode(one)[0] for one in maps]
        begun_s = time.monotonic()
        for _ in range(10):
            write_durably(path, contents[0], keep=2)
        save_s = (time.monotonic() - begun_s) / 10.0
        for number in range(arguments.count):
            child = os.fork()
            if child == 0:
                save_for_ever(contents, path)
            time.sleep(moments.uniform(0.0, 3.0 * save_s))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            cut_short += any(Path(folder).glob(".*.tmp"))
            whole += load_map(path)[1] in known
            for older in Path(folder).glob("*.amrmap.?"):
                assert load_map(older)[1] in known, older
            if sys.stderr.isatty():
                sys.stderr.write(f"\r{number + 1} of {arguments.count}")
        save_map(maps[0], path)
        left = len(list(Path(folder).glob(".*.tmp")))
    print(
        f"{whole} of {arguments.count} kills left a whole map; {cut_short} cut a save short "
        f"(one takes {1e3 * save_s:.1f} ms); {left} files left behind"
    )
    return 0 if whole == arguments.count and left == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
