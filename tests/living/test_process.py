"""The SLAM process watches, keeps what it saw, and takes up newer versions of its map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from labs import cloud_at
from living.places import AFTER, IS, KNOWN, PLACES, WAS, mapped
from test_slam_process import Line, at_once, localizing, serving

from amr_slam.living import (
    AcceptPolicy,
    MapChange,
    MapDiff,
    WatchParams,
    changes_path,
    compare_maps,
    load_changes,
)
from amr_slam.map import load_map, moved, save_map
from amr_slam.params import SlamParams
from amr_slam.reporting import map_changes
from amr_slam.slam_messages import Compare, Compared, Renewed, SlamJob, Stop, Switch, Switched
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.wire import MAX_CHANGES, MAX_MESSAGE_BYTES, MapChanges

__all__ = ["at_once"]


def job(path: Path, policy: AcceptPolicy | None = None, save_period_s: float = 3600.0) -> SlamJob:
    watching = WatchParams(save_period_s=save_period_s)
    return replace(
        localizing(path), params=SlamParams(watching=watching), policy=policy or AcceptPolicy()
    )


def visits(line: Line, count: int) -> tuple[SlamResult, list[Renewed]]:
    rng, stamp_s, renewed = np.random.default_rng(1), 0.0, []
    for _ in range(count):
        for pose in (one for one in PLACES for _ in range(2)):
            cloud = cloud_at(AFTER, pose, rng, sigma_m=0.01, stamp_ns=round(1e9 * stamp_s))
            line.pipe.send(SlamRequest(cloud=cloud, map_from_base=pose, covariance=100.0 * KNOWN))
            stamp_s += 8.0
            answer: Any = line.heard()
            while not isinstance(answer, SlamResult):
                renewed.append(answer)
                answer = line.heard()
        stamp_s += 600.0
    return answer, renewed


def test_changes_are_told_kept_and_survive_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    map_id = save_map(mapped(), path)
    with serving(job(path)) as line:
        line.heard()
        result, _ = visits(line, 2)
        assert result.changes is not None
        line.pipe.send(Stop())
    assert load_map(path)[1] == map_id  # watched, never taken
    known, _ = load_map(path)
    assert len(load_changes(changes_path(path), known, map_id, WatchParams()).diff().changes) == 2
    with serving(job(path)) as line:
        line.heard()
        result, _ = visits(line, 1)
        assert result.changes is not None
        assert (result.changes.new, result.changes.gone) == (1, 1)
        compared = line.ask(Compare())
        assert isinstance(compared, Compared)
        told = map_changes(compared.diff, str(map_id))
        assert MapChanges.decode(told.encode()) == told
        assert told.total == 2
        for change, shape in (("gone", WAS), ("new", IS)):
            (found,) = [one for one in told.changes if one.what == change]
            assert found.box == pytest.approx([*shape.min(axis=0), *shape.max(axis=0)], abs=0.2)
        line.pipe.send(Stop())


def test_the_largest_of_too_many_changes_are_told_and_fit_into_a_message() -> None:
    cell = np.array([[-99_999.123, -99_999.123]])
    sizes = np.random.default_rng(0).permutation(2 * MAX_CHANGES)
    diff = MapDiff(
        against="",
        changes=tuple(
            MapChange(
                number=number,
                kind="gone",
                cells_m=np.concatenate([cell, cell + 0.1 * size]),
                cell_m=0.1,
                since_s=1_700_000_000.123,
                seen_s=1_700_000_000.123,
                passes=99,
            )
            for number, size in enumerate(sizes, start=1)
        ),
    )
    told = map_changes(diff, "6f1d6a44-7f0c-4b2c-9df0-0d5b4b4f3c11")
    assert len(told.encode()) <= MAX_MESSAGE_BYTES
    assert (told.total, len(told.changes)) == (2 * MAX_CHANGES, MAX_CHANGES)
    numbers = [one.number for one in told.changes]
    assert numbers == sorted(numbers)
    assert sizes[np.array(numbers) - 1].min() == MAX_CHANGES


def test_policy_makes_a_new_version_that_is_taken_up(tmp_path: Path) -> None:
    path = tmp_path / "hall.amrmap"
    first = save_map(mapped(), path)
    with serving(job(path, AcceptPolicy(passes=2, age_h=0.0), save_period_s=0.0)) as line:
        line.heard()
        _, renewed = visits(line, 3)
        line.pipe.send(Stop())
    assert renewed
    known, map_id = load_map(path)
    assert renewed[-1].ready.map_id == str(map_id)
    assert not compare_maps(known, mapped(AFTER), "the place as it is").changes
    oldest = sorted(tmp_path.glob("hall.amrmap.[1-9]"))[-1]
    assert load_map(oldest)[1] == first


@pytest.mark.parametrize("same", [True, False])
def test_only_a_version_in_the_same_frame_keeps_the_pose(tmp_path: Path, *, same: bool) -> None:
    known = mapped()
    path, other = tmp_path / "hall.amrmap", tmp_path / "other.amrmap"
    save_map(known, path)
    save_map(known if same else moved(known, PLACES[0]), other)
    with serving(job(path)) as line:
        line.heard()
        switched = line.ask(Switch(job=job(other)))
        assert isinstance(switched, Switched)
        assert switched.same_frame is same
        line.pipe.send(Stop())
