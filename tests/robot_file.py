"""A robot's configuration that is right, to be edited by tests until it is not."""

from __future__ import annotations

ROBOT = """
[robot]
name = "amr7"
[drive]
kind = "differential"
radius_left_m = 0.1
radius_right_m = 0.11
track_m = 0.5
[odometry]
driver = "can"
[odometry.options]
dbc = "config/wheels.dbc"
left = { signal = "LeftCount" }
right = { signal = "RightCount", sign = -1 }
[[scanners]]
name = "front"
driver = "sick_s300"
options = { port = "/dev/ttyS0" }
mounting = { x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }
[[scanners]]
name = "rear"
driver = "sick_s300"
options = { port = "/dev/ttyS1" }
mounting = { x_m = -0.24, y_m = -0.2, theta_deg = -135.0, upside_down = true }
[map]
mode = "mapping"
[slam]
preset = "default"
[service]
publish_hz = 20
[zenoh]
"""


def edited(old: str, new: str) -> str:
    """With one place of it changed."""
    assert ROBOT.count(old) == 1
    return ROBOT.replace(old, new)
