"""From the text of an argument to its value; argparse tells what ArgumentTypeError says."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path


def seconds(text: str) -> float:
    """A finite number that is not negative."""
    return finite(text, least=0.0)


def finite(text: str, least: float = -math.inf) -> float:
    """A finite number, not below ``least``."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number >= least):
        bound = "" if least == -math.inf else f" of at least {least:g}"
        raise argparse.ArgumentTypeError(f"{text!r} is not a number{bound}")
    return number


def cell(text: str) -> float:
    """Side of a cell, a millimetre to 10 m."""
    side_m = finite(text, least=0.001)
    if side_m > 10.0:
        raise argparse.ArgumentTypeError(f"{text!r} is more than 10 m")
    return side_m


def count(text: str) -> int:
    """A number from 0 to 999."""
    if not (text.isdecimal() and len(text) <= 3):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 to 999")
    return int(text)


def poses(text: str) -> int:
    """A number from 10 to 5000."""
    if not (text.isdecimal() and len(text) <= 4 and 10 <= int(text) <= 5000):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of poses from 10 to 5000")
    return int(text)


def numbers(text: str) -> tuple[int, ...]:
    """Numbers from 1 to 9999, as 1,3,4."""
    fields = text.split(",")
    if not all(field.isdecimal() and len(field) <= 4 and int(field) > 0 for field in fields):
        raise argparse.ArgumentTypeError(f"{text!r} is not numbers from 1 on, as 1,3,4")
    return tuple(int(field) for field in fields)


def port(text: str) -> int:
    """A TCP port; 0 for a free one."""
    if not (text.isdecimal() and len(text) <= 5 and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"{text!r} is not a port from 0 to 65535")
    return int(text)


def days(text: str) -> int:
    """A number from 1 to 9999."""
    if not (text.isdecimal() and len(text) <= 4 and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number of days from 1 to 9999")
    return int(text)


def domain(text: str) -> int | None:
    """A ROS_DOMAIN_ID; None for off."""
    if text == "off":
        return None
    if not (text.isdecimal() and len(text) <= 3 and int(text) <= 232):
        raise argparse.ArgumentTypeError(f"{text!r} is not a ROS_DOMAIN_ID from 0 to 232, or off")
    return int(text)


def mounting(text: str) -> tuple[float, float, float]:
    """x m, y m, theta degrees."""
    fields = text.split(",")
    if len(fields) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,THETA_DEG")
    x_m, y_m, theta_deg = (finite(field) for field in fields)
    return x_m, y_m, theta_deg


def point(text: str) -> tuple[float, float]:
    """x m, y m."""
    fields = text.split(",")
    if len(fields) != 2:
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y")
    return finite(fields[0]), finite(fields[1])


def corner(text: str) -> tuple[float, float, float]:
    """x m, y m, and theta in degrees where it is not 0."""
    return mounting(text if text.count(",") == 2 else f"{text},0")


def path_ending(*endings: str) -> Callable[[str], Path]:
    """Makes the check that a path has one of these endings."""

    def path(text: str) -> Path:
        if Path(text).suffix not in endings:
            raise argparse.ArgumentTypeError(f"{text!r} does not end in {' or '.join(endings)}")
        return Path(text)

    return path
