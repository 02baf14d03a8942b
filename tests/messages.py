"""Messages of a robot, for the tests of those who send and who show them."""

from __future__ import annotations

from typing import Any

from amr_slam.samples import State
from amr_slam.wire import HealthPart, MapPart, OdomPose, PoseMessage, StatusMessage

MAP_ID = "6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11"
WELL = HealthPart(link="OK", age_s=0.04, rate_hz=25.0, samples=1000, errors=0)


def pose_of(robot: str = "amr7", seq: int = 0, **changes: Any) -> PoseMessage:
    fields: dict[str, Any] = {
        "stamp": 1_790_000_000.0 + 0.02 * seq,
        "age_s": 0.01,
        "map": MAP_ID,
        "epoch": 2,
        "x": 1.5,
        "y": -2.25,
        "theta": 0.5,
        "vx": 0.3,
        "omega": -0.1,
        "covariance": (0.01, 0.0, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.003),
        "error95_m": 0.05,
        "state": State.LOCALIZED,
        "since_fix_s": 1.5,
        "since_fix_m": 0.45,
        "odom": OdomPose(x=4.0, y=5.0, theta=-1.0),
        "fault": None,
    }
    return PoseMessage(robot=robot, seq=seq, **(fields | changes))


def status_of(robot: str = "amr7", seq: int = 0, **changes: Any) -> StatusMessage:
    fields: dict[str, Any] = {
        "stamp": 1_790_000_000.0,
        "state": State.LOCALIZED,
        "mode": "localization",
        "map": MapPart(id=MAP_ID, name="hall", version=3),
        "scanners": {"front": WELL, "rear": WELL},
        "wheels": WELL,
        "slam": WELL,
        "version": "0.1.0",
        "uptime_s": 12.0,
        "cpu_percent": 20.0,
        "memory_mb": 120.0,
    }
    return StatusMessage(robot=robot, seq=seq, **(fields | changes))
