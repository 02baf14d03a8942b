"""Zones without landmarks: what a scan sees in them counts for nothing."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
from labs import cloud_at, room, world_of
from localizer_rig import SURE, Rig

from amr_slam.changes import compare
from amr_slam.engine import SlamEngine
from amr_slam.evidence import Verdict
from amr_slam.geometry import Array, Pose2
from amr_slam.localizer import LocalizerParams
from amr_slam.map import LayerKind, Layers, MapParams, PointMap
from amr_slam.params import SlamParams
from amr_slam.samples import State
from amr_slam.slam_request import SlamRequest, SlamResult

LEFT_HALF = np.array([[-1.0, -1.0], [4.1, -1.0], [4.1, 7.0], [-1.0, 7.0]])
EVERYTHING = np.array([[-1.0, -1.0], [9.0, -1.0], [9.0, 7.0], [-1.0, 7.0]])
HERE = Pose2(4.0, 3.0, 0.2)


@functools.cache
def mapped() -> PointMap:
    grown = PointMap(MapParams(), "room")
    for i, x in enumerate((2.0, 4.0, 6.0)):
        pose = Pose2(x, 3.0, 0.3 * i)
        grown.insert(cloud_at(room(), pose, np.random.default_rng(i), sigma_m=0.01), pose)
    return grown


def engine(*zones: Array, mode: str = "localization") -> SlamEngine:
    known = mapped().rebuilt([pose for _, pose in mapped().path])
    told = [(LayerKind.ZONE, f"docks {i}", corners) for i, corners in enumerate(zones)]
    known.edit(Layers().with_drawn(told, "Ada", 1) if told else Layers())
    return SlamEngine(SlamParams(), known, "mapping" if mode == "mapping" else "localization")


def scan_of_a_changed_left_half(seed: int = 0) -> SlamRequest:
    """The left wall has come 0.25 m nearer, and three quarters of the others' left halves too."""
    w, h, off = 8.0, 6.0, 0.25
    changed = world_of(
        np.array(
            [
                [4, 0, w, 0], [w, 0, w, h], [w, h, 4, h],
                [4, h - off, off, h - off], [off, h - off, off, off], [off, off, 4, off],
            ],
            dtype=float,
        )
    )  # fmt: skip
    cloud = cloud_at(changed, HERE, np.random.default_rng(seed), sigma_m=0.01)
    return SlamRequest(cloud=cloud, map_from_base=HERE, covariance=100.0 * SURE)


def off_m(result: SlamResult) -> float:
    assert result.fix is not None
    return result.fix.map_from_base.distance_to(HERE)


def test_what_has_changed_in_a_zone_pulls_no_pose() -> None:
    request = scan_of_a_changed_left_half()
    known, change = engine(LEFT_HALF).update(request), None
    assert off_m(known) < 0.02
    assert known.answer.best is not None
    assert 0.3 < known.answer.best.hidden < 0.8
    change = known.change
    assert change is not None
    assert change.contradicting < 0.05
    assert change.explained > 0.95
    # ... as it does without the zone.
    plain = engine().update(request)
    assert plain.fix is None or off_m(plain) > 0.03


@pytest.mark.parametrize("mode", ["localization", "mapping"])
def test_a_robot_in_a_zone_is_told_so_and_its_scans_join_no_map(mode: str) -> None:
    slam = engine(EVERYTHING, mode=mode)
    scans = len(slam.map.path)
    cloud = cloud_at(room(), Pose2(5.5, 2.0, 0.0), np.random.default_rng(5), sigma_m=0.01)
    result = slam.update(
        SlamRequest(cloud=cloud, map_from_base=Pose2(5.5, 2.0, 0.0), covariance=SURE)
    )
    assert (result.zone, result.fix, result.inserted) == ("docks 0", None, False)
    assert 'no-localize zone "docks 0"' in str(result.answer.reason)
    assert len(slam.map.path) == scans


def test_a_place_gains_nothing_by_hiding_what_contradicts_it() -> None:
    """A robot anywhere, most of whose scan would lie in a zone at some wrong place."""
    beside = np.array([[2.0, -1.0], [9.0, -1.0], [9.0, 7.0], [2.0, 7.0]])
    cloud = cloud_at(room(), HERE, np.random.default_rng(1), sigma_m=0.01)
    result = engine(beside).update(SlamRequest(cloud=cloud, map_from_base=None, covariance=None))
    if result.answer.verdict is Verdict.ACCEPTED:
        assert off_m(result) < 0.1


def test_compare_knows_no_contradiction_where_everything_is_hidden() -> None:
    target = engine(EVERYTHING).map.target()
    assert len(target) == 0
    half = engine(LEFT_HALF).map.target()
    cloud = scan_of_a_changed_left_half().cloud
    change = compare(cloud, half, HERE)
    assert change is not None
    assert change.contradicting < 0.05


def in_zone(rig: Rig) -> None:
    answer = engine(EVERYTHING).update(
        SlamRequest(
            cloud=cloud_at(room(), HERE, np.random.default_rng(0)),
            map_from_base=HERE,
            covariance=SURE,
        )
    )
    rig.localizer.handle(replace(answer, stamp_ns=rig.now_ns))
    rig.collect()


def test_the_localizer_goes_on_by_its_wheels_and_is_not_lost() -> None:
    rig = Rig(start=Pose2.identity())
    rig.drive(1.0)
    rig.scan()
    rig.answer(rig.truth)
    assert rig.state() is State.LOCALIZED
    before = rig.estimate.error95_m
    for _ in range(3 * LocalizerParams().lost_refusals):
        rig.drive(2.0, v_mps=0.1)
        rig.scan()
        in_zone(rig)
        assert rig.state() is State.ODOMETRY_ONLY
        assert 'no-localize zone "docks 0"' in str(rig.estimate.fault)
    assert rig.estimate.since_fix_s > LocalizerParams().lost_s
    assert rig.estimate.error95_m > before
    rig.drive(1.0)
    rig.scan()
    rig.answer(rig.truth)
    assert rig.state() is State.LOCALIZED
    assert "zone" not in str(rig.estimate.fault)


def test_an_error_that_all_fixes_share_is_not_averaged_away() -> None:
    rig = Rig(start=Pose2.identity())
    for _ in range(20):
        rig.drive(0.5)
        rig.scan()
        rig.answer(rig.truth)
    alone = rig.estimate.error95_m
    last = rig.localizer.last_result
    assert last is not None
    rig.drive(0.02)
    rig.scan()
    rig.localizer.handle(replace(last, stamp_ns=rig.now_ns, map_error_m=0.025))
    assert rig.estimate.error95_m > math.hypot(0.9 * alone, 2.4 * 0.025)
