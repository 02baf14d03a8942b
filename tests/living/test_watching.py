"""What is new, what is gone, since when, by how many passes; and who is never told of."""

from __future__ import annotations

import uuid
from pathlib import Path

import numpy as np
import pytest
from living.places import AFTER, BEFORE, IS, STAYS, WAS, Day, hall, mapped, watching

from amr_slam.geometry import Array, Pose2
from amr_slam.living import (
    AcceptPolicy,
    ChangesError,
    MapChange,
    OtherFrameError,
    Watcher,
    WatchParams,
    accept,
    compare_maps,
    eligible,
    load_changes,
    resume_watching,
    save_changes,
)
from amr_slam.living.evidence import Evidence
from amr_slam.living.file import MAGIC, decode, encode
from amr_slam.map import moved

MAP_ID = uuid.UUID(int=7)


@pytest.fixture(scope="module")
def seen() -> Day:
    """Three visits after the box has moved; people walk about."""
    day = watching(mapped())
    for _ in range(3):
        day.visit(AFTER, people=True)
    return day


def lies_on(change: MapChange, corners: Array) -> bool:
    low, high = corners.min(axis=0), corners.max(axis=0)
    x_min, y_min, x_max, y_max = change.box_m
    return bool(np.all(np.abs([*(low - [x_min, y_min]), *(high - [x_max, y_max])]) < 0.25))


def test_moved_box_is_told_once_new_and_once_gone(seen: Day) -> None:
    changes = seen.watcher.diff().changes
    assert [change.kind for change in changes] == ["gone", "new"]
    assert lies_on(changes[0], WAS)
    assert lies_on(changes[1], IS)
    for number, change in enumerate(changes, start=1):
        assert change.number == number
        assert change.passes == 3
        assert change.since_s is not None
        assert change.seen_s is not None
        assert 1e9 <= change.since_s < 1e9 + 200.0
        assert change.seen_s - change.since_s > 1000.0
    counts = seen.watcher.counts()
    assert (counts.new, counts.gone) == (1, 1)


def test_one_pass_is_not_enough_however_long_it_lasts() -> None:
    day = watching(mapped())
    day.visit(AFTER, away_s=0.0)
    day.visit(AFTER, away_s=0.0)
    assert not day.watcher.diff().changes


def test_people_who_walk_are_no_change() -> None:
    day = watching(mapped())
    for _ in range(4):
        day.visit(BEFORE, people=True)
    assert not day.watcher.diff().changes


def test_pass_to_the_contrary_ends_a_change() -> None:
    day = watching(mapped())
    for _ in range(2):
        day.visit(AFTER)
    assert len(day.watcher.diff().changes) == 2
    day.visit(BEFORE)
    assert not day.watcher.diff().changes
    day.visit(AFTER)
    assert not day.watcher.diff().changes


def test_scan_of_a_vague_pose_says_nothing() -> None:
    day = watching(mapped())
    day.watcher.see = lambda cloud, pose, _, now: Watcher.see(  # type: ignore[method-assign, assignment]
        day.watcher, cloud, pose, np.diag([0.1**2, 1e-4, 1e-5]), now
    )
    for _ in range(2):
        day.visit(AFTER)
    assert not len(day.watcher.new)
    assert not len(day.watcher.gone)


def test_memory_is_bounded() -> None:
    known = mapped()
    day = Day(Watcher(known, WatchParams(most_cells=100)))
    for step in range(3):
        day.visit(hall(IS + np.array([0.0, -0.7 * step]), STAYS))
        assert len(day.watcher.new) <= 100
    day.watcher.tidy(round(1e9 * day.utc_s))
    assert sum(len(one.rays) for one in day.watcher.sightings) <= 12 * 100


def test_accepted_changes_make_the_map_of_the_place_as_it_is(seen: Day) -> None:
    known = mapped()
    before = known.walls.sums.copy()
    done = accept(known, seen.watcher, seen.watcher.diff().changes)
    assert len(done.taken) == 2
    assert not done.left
    assert not compare_maps(done.map, mapped(AFTER), "the truth").changes
    # The map that it was made from is as it was; a map made of the new one's rays is the new one.
    assert np.array_equal(known.walls.sums, before)
    assert not compare_maps(moved(done.map, Pose2.identity()), done.map, "itself").changes


def test_one_change_is_accepted_without_the_other(seen: Day) -> None:
    gone, new = seen.watcher.diff().changes
    done = accept(mapped(), seen.watcher, [gone])
    left = compare_maps(mapped(AFTER), done.map, "half").changes
    assert [change.kind for change in left] == ["new"]
    assert lies_on(left[0], IS)
    seen_again = decode(encode(seen.watcher, mapped(), MAP_ID), mapped(), MAP_ID, WatchParams())
    seen_again.rebase(done.map)
    assert [change.kind for change in seen_again.diff().changes] == [new.kind]


@pytest.mark.parametrize(
    ("policy", "taken"),
    [
        (AcceptPolicy(), 0),
        (AcceptPolicy(passes=3, age_h=0.0), 2),
        (AcceptPolicy(passes=4, age_h=0.0), 0),
        (AcceptPolicy(passes=3, age_h=24.0), 0),
        (AcceptPolicy(passes=3, age_h=0.0, area_m2=0.5), 0),
    ],
)
def test_policy_is_off_and_bounded(seen: Day, policy: AcceptPolicy, taken: int) -> None:
    assert len(eligible(seen.watcher.diff(), policy)) == taken


def test_file_gives_back_what_was_watched(seen: Day, tmp_path: Path) -> None:
    known, path = mapped(), tmp_path / "hall.amrmap.changes"
    save_changes(seen.watcher, known, MAP_ID, path)
    again = load_changes(path, known, MAP_ID, WatchParams())
    assert encode(again, known, MAP_ID) == path.read_bytes()
    # A newer version of the map has the changes in it: nothing is left of them.
    newer = accept(known, again, again.diff().changes).map
    assert not load_changes(path, newer, uuid.UUID(int=8), WatchParams()).diff().changes
    with pytest.raises(ChangesError, match="another map"):
        load_changes(path, moved(known, Pose2(1.0, 0.0, 0.0)), uuid.UUID(int=8), WatchParams())


def test_damaged_file_is_refused_and_watching_begins_anew(seen: Day, tmp_path: Path) -> None:
    known, path = mapped(), tmp_path / "hall.amrmap.changes"
    data = encode(seen.watcher, known, MAP_ID)
    cuts = (b"", MAGIC, data[:100], data[:-1], data[:400] + b"x" + data[401:], b"PK" + data[2:])
    for wrong in cuts:
        path.write_bytes(wrong)
        with pytest.raises(ChangesError, match=r"hall\.amrmap\.changes"):
            load_changes(path, known, MAP_ID, WatchParams())
    assert not len(resume_watching(path, known, MAP_ID, WatchParams()).new)


def test_other_frame_is_refused() -> None:
    known = mapped()
    with pytest.raises(OtherFrameError, match="different frames"):
        compare_maps(known, moved(known, Pose2(3.0, 1.0, 0.7)), "other")


def test_where_cells_are_too_many_the_least_certain_go_first() -> None:
    params = WatchParams(most_cells=100)
    evidence, minute_ns = Evidence(params), 60_000_000_000
    certain, none = np.arange(0, 160, 2), np.empty(0, dtype=np.int64)
    for number in range(4):  # two passes, of two scans each
        now_ns = minute_ns * (1 + 10 * (number // 2) + number % 2)
        evidence.note(certain, none, now_ns)
    assert set(evidence.shown()["passes"]) == {2}
    later_ns = 40 * minute_ns
    evidence.note(np.arange(1, 31, 2), none, later_ns)
    assert len(evidence) == 95
    evidence.note(np.arange(31, 61, 2), none, later_ns + minute_ns)
    # Ten of the hundred are made free. All that is certain is there, and the newest of the rest.
    keys = evidence.rows["key"]
    assert len(keys) == 90
    assert np.all(np.diff(keys) > 0)
    assert set(certain) <= set(keys)
    assert np.all(keys[keys % 2 == 1] > 30)
    # What was seen once goes by itself once its pass is over.
    evidence.tidy(later_ns + 10 * minute_ns)
    np.testing.assert_array_equal(evidence.rows["key"], certain)
