"""A drive whose devices' bytes are computed beforehand: playing it costs the test's machine little.

``python drive.py OUT`` lets the emulated scanners and wheels of config/robot.toml go round the
laboratory of seed 7 at 0.3 m/s and writes what they say, each piece with its time.
"""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from amr_drivers.can_odometry.settings import Settings
from amr_drivers.emulators.s300 import EmulatedS300, S300Model
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_slam.samples import Scan
from amr_slam.simulation import (
    PathFollower,
    ScannerModel,
    SimulatedRobot,
    Vehicle,
    laboratory,
    opposite_scanners,
    plan_tour,
)

PIECE: Final = struct.Struct("<IBH")
"""Time in ms since the start, kind, length; that many bytes follow."""
FRONT, REAR, CAN, TRUTH = range(4)
_POSE: Final = struct.Struct("<3d")
_FRAME: Final = struct.Struct("=IB3x8s")
_SEED: Final = 7
REPO = Path(__file__).resolve().parent.parent.parent


def record(out: Path, seconds: float) -> None:
    """Drive and write."""
    tour = plan_tour(laboratory(_SEED))
    robot = SimulatedRobot(
        world=laboratory(_SEED),
        world_from_map=tour.world_from_map,
        scanners=opposite_scanners(ScannerModel(sigma_range_m=0.01)),
        vehicle=Vehicle(counts_per_turn=4096),
        scan_period_s=2.0,
        seed=_SEED,
    )
    follower = PathFollower(tour.path_in_map_m)
    dbc = str(REPO / "config/wheels.dbc")
    wheels = EmulatedWheels(Settings(dbc=dbc, sequence_signal="Sequence"))
    lines = {"front": _Line(), "rear": _Line()}
    scanners = {name: EmulatedS300(line, S300Model()) for name, line in lines.items()}
    pieces: list[tuple[int, int, bytes]] = []
    while robot.stamp_ns < 1e9 * seconds:
        for sample in robot.advance(*follower.steer(robot.map_from_base)):
            ms = sample.stamp_ns // 1_000_000
            if isinstance(sample, Scan):
                scanners[sample.scanner].measure(sample.ranges_m)
                kind = FRONT if sample.scanner == "front" else REAR
                pieces.append((ms + round(1e3 * sample.sweep_s), kind, lines[sample.scanner].said))
            else:
                for frame in wheels.frames(sample.left_rad, sample.right_rad):
                    packed = _FRAME.pack(frame.identifier, len(frame.data), frame.data)
                    pieces.append((ms, CAN, packed))
        pose = robot.map_from_base
        packed = _POSE.pack(pose.x_m, pose.y_m, pose.theta_rad)
        pieces.append((robot.stamp_ns // 1_000_000, TRUTH, packed))
    pieces.sort(key=lambda piece: piece[:2])
    out.write_bytes(b"".join(PIECE.pack(t, k, len(data)) + data for t, k, data in pieces))


def truth(file: Path) -> NDArray[np.float64]:
    """Rows of time in s since the start, x m, y m, theta rad."""
    content, at, rows = file.read_bytes(), 0, []
    while at < len(content):
        ms, kind, length = PIECE.unpack_from(content, at)
        at += PIECE.size
        if kind == TRUTH:
            rows.append((1e-3 * ms, *_POSE.unpack_from(content, at)))
        at += length
    return np.array(rows)


class _Line:
    """Keeps what the scanner said last."""

    port = "none"

    def __init__(self) -> None:
        self.said = b""

    def write(self, data: bytes) -> int:
        self.said = bytes(data)
        return len(data)

    def read(self) -> bytes:
        return b""

    def plug(self) -> None:
        """Always in its place."""

    def unplug(self) -> None:
        """Nothing to do."""


if __name__ == "__main__":
    record(Path(sys.argv[1]), 600.0)
