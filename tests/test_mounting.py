from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_slam import config
from amr_slam.geometry import Pose2
from amr_slam.mounting import Mask, Mounting
from amr_slam.samples import Scan
from amr_slam.service.body import own_body

HERE = Pose2(0.3, 0.2, math.radians(45.0))


def scan(ranges_m: np.ndarray) -> Scan:
    """270 degrees at half a degree."""
    return Scan(
        scanner="front",
        stamp_ns=0,
        ranges_m=ranges_m,
        angle_min_rad=math.radians(-135.0),
        angle_step_rad=math.radians(0.5),
    )


def dropped_deg(mounting: Mounting, ranges_m: np.ndarray) -> np.ndarray:
    """Bearings, seen from above, of the beams that a mounting's masks drop."""
    one = scan(ranges_m)
    gone = np.isnan(mounting.masked(one).ranges_m)
    return np.degrees(mounting.bearings_rad(one)[gone])


@pytest.mark.parametrize("upside_down", [False, True])
def test_a_mask_drops_its_sector_as_seen_from_above(*, upside_down: bool) -> None:
    mask = Mask(from_deg=-135.0, to_deg=-120.0)
    mounting = Mounting(base_from_lidar=HERE, upside_down=upside_down, masks=(mask,))
    gone = dropped_deg(mounting, np.full(541, 5.0))
    assert len(gone) == 31
    assert gone.min() == pytest.approx(-135.0)
    assert gone.max() == pytest.approx(-120.0)


def test_a_near_mask_keeps_what_is_behind_it() -> None:
    mask = Mask(from_deg=60.0, to_deg=75.0, closer_than_m=0.4)
    mounting = Mounting(base_from_lidar=HERE, masks=(mask,))
    ranges = np.where(np.arange(541) % 2, 0.3, 5.0)
    gone = dropped_deg(mounting, ranges)
    assert 15 <= len(gone) <= 16
    assert 60.0 - 1e-6 <= gone.min() <= gone.max() <= 75.0 + 1e-6


@settings(derandomize=True)
@given(
    first=st.floats(-360.0, 350.0),
    width=st.floats(0.1, 359.0),
    bearing=st.floats(-180.0, 180.0),
)
def test_a_sector_may_lie_across_the_back(first: float, width: float, bearing: float) -> None:
    last = first + width
    if last > 360.0:
        return
    covered = Mask(from_deg=first, to_deg=last).covers(
        np.array([math.radians(bearing)]), np.array([1.0])
    )[0]
    turns = [bearing + 360.0 * turn for turn in (-1, 0, 1)]
    inside = [first + 1e-6 <= angle <= last - 1e-6 for angle in turns]
    outside = [angle < first - 1e-6 or angle > last + 1e-6 for angle in turns]
    assert covered or not any(inside)
    assert not (covered and all(outside))


@pytest.mark.parametrize(
    ("mask", "reason"),
    [
        ("{ from_deg = 10.0, to_deg = -10.0 }", "from_deg 10 should be below to_deg -10"),
        ("{ from_deg = -180.0, to_deg = 180.0 }", "masks every beam"),
        ("{ from_deg = 0.0, to_deg = 9.0, closer_than_m = 0.0 }", "greater than 0"),
        ("{ from_deg = 0.0 }", "to_deg: is missing"),
    ],
)
def test_masks_without_sense_are_refused(mask: str, reason: str, tmp_path: object) -> None:
    with pytest.raises(config.ConfigError, match=reason):
        config.parse(_table(mask))


def test_masks_reach_the_mounting() -> None:
    loaded = config.parse(_table("{ from_deg = 60.0, to_deg = 75.0, closer_than_m = 0.4 }"))
    assert loaded.scanners[0].mounting.mounting.masks == (
        Mask(from_deg=60.0, to_deg=75.0, closer_than_m=0.4),
    )


def _table(mask: str) -> dict[str, object]:
    return tomllib.loads(
        f"""
        [robot]
        name = "amr7"
        [drive]
        kind = "differential"
        radius_left_m = 0.1
        radius_right_m = 0.1
        track_m = 0.5
        [odometry]
        driver = "mock"
        [[scanners]]
        name = "front"
        driver = "mock"
        mounting = {{ x_m = 0.2, y_m = 0.1, theta_deg = 45.0, masks = [{mask}] }}
        [map]
        mode = "mapping"
        """
    )


def test_the_robots_own_body_is_proposed_as_a_mask() -> None:
    """A post at 0.22 m that never moves, among walls; a person's leg that comes near is none."""
    rng = np.random.default_rng(0)
    scans = []
    for number in range(8):
        ranges = 4.0 + rng.normal(0.0, 0.01, 541)
        ranges[20:30] = 0.22 + rng.normal(0.0, 0.004, 10)
        ranges[300 + 8 * number : 310 + 8 * number] = 0.35
        scans.append(scan(ranges))
    (line,) = own_body(scans, Mounting(base_from_lidar=HERE))
    assert "at -125.0 to -120.5 deg" in line
    assert "masks = [{ from_deg = -127.0, to_deg = -119.0, closer_than_m = 0.4 }]" in line
    masked = Mounting(
        base_from_lidar=HERE,
        masks=(Mask(from_deg=-127.0, to_deg=-119.0, closer_than_m=0.4),),
    )
    assert not list(own_body(scans, masked))
    assert not list(own_body(scans[:3], Mounting(base_from_lidar=HERE)))
