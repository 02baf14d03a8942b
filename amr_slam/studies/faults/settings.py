"""The robot's configuration for the rows: what differs from row to row has a name here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

ROBOT: Final = "amr7"
PREFIX: Final = "amr"
"""Of all keys: the default."""

# Counters of 16 bits: they wrap after each 10 m, in every row.
_TEXT: Final = """
[robot]
name = "{robot}"
[drive]
kind = "differential"
radius_left_m = 0.1
radius_right_m = 0.1
track_m = 0.5
[odometry]
driver = "can"
[odometry.options]
interface = "{interface}"
channel = "{channel}"
dbc = "{dbc}"
sequence_signal = "Sequence"
left = {{ signal = "LeftCount", modulus_counts = 65536 }}
right = {{ signal = "RightCount", modulus_counts = 65536 }}
[[scanners]]
name = "front"
driver = "sick_s300"
poll_period_s = {poll_period_s}
options = {{ port = "{folder}/front" }}
mounting = {{ x_m = 0.24, y_m = 0.2, theta_deg = 45.0 }}
[[scanners]]
name = "rear"
driver = "sick_s300"
poll_period_s = {poll_period_s}
options = {{ port = "{folder}/rear" }}
mounting = {{ x_m = -0.24, y_m = -0.2, theta_deg = -135.0 }}
[map]
{map}
[zenoh]
listen = [{listen}]
connect = [{connect}]
{keys}
[recording]
directory = "{folder}/recordings"
ring_s = 20.0
[service]
save_period_s = {save_period_s}
answer_limit_s = {answer_limit_s}
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How long things take."""

    scan_period_s: float = 2.0
    """From one registered scan to the next: the paper's."""
    calm_s: float = 5.0
    """Driven before the fault and after it, to compare."""

    def deadline_s(self, seconds: float, scans: int) -> float:
        """``seconds`` and so many scans."""
        return seconds + scans * self.scan_period_s


QUICK: Final = Pace(scan_period_s=0.5, calm_s=1.5)
"""For a look in seconds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """Which robot a row needs. Rows of one setting share a daemon, one after another."""

    place: Literal["laboratory", "alike"] = "laboratory"
    mapping: bool = False
    """Makes a new map, saved each 5 s."""
    can: Literal["slcan", "udp_multicast"] = "slcan"
    """Only the second one can tell of errors on the bus by frames."""
    router: Literal["none", "open", "keys"] = "none"
    """Through which router the fleet listens; ``keys``: one with certificates and rights."""
    clocked: bool = False
    """The daemon's wall clock can be set."""


STANDARD: Final = Setting()


def config_text(
    setting: Setting, pace: Pace, *, folder: Path, dbc: Path, map_path: Path, can_port: int,
    listen: str, connect: str, keys: Path | None,
) -> str:  # fmt: skip
    """TOML. ``listen``, ``connect``: endpoints, or nothing."""
    new_map = f'mode = "mapping"\ndirectory = "{folder}"\nname = "new"'
    known_map = f'mode = "localization"\npath = "{map_path}"'
    multicast = f"239.74.163.2@{can_port}"
    return _TEXT.format(
        robot=ROBOT,
        interface=setting.can,
        channel=multicast if setting.can == "udp_multicast" else f"{folder}/can",
        dbc=dbc,
        folder=folder,
        poll_period_s=pace.scan_period_s,
        map=new_map if setting.mapping else known_map,
        listen=f'"{listen}"' if listen else "",
        connect=f'"{connect}"' if connect else "",
        keys=f'keys = "{keys}"' if keys else "",
        save_period_s=5.0 if setting.mapping else 60.0,
        answer_limit_s=12.0,
    )
