"""The SLAM process's loop over a real pipe, in a thread instead of a process."""

from __future__ import annotations

import io
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from labs import cloud_at, lab, mapped_lab, tour_poses

from amr_slam import slam_process
from amr_slam.engine import SlamEngine
from amr_slam.geometry import Pose2
from amr_slam.map import load_map, save_map
from amr_slam.map.export import occupancy_image
from amr_slam.params import SlamParams
from amr_slam.region import Region
from amr_slam.slam_messages import (
    Declined,
    Draw,
    Drawn,
    Grow,
    Joined,
    Ready,
    Saved,
    SlamJob,
    Stop,
    Store,
    Stored,
    Switch,
    Switched,
    Unsaved,
)
from amr_slam.slam_request import SlamRequest, SlamResult
from amr_slam.starting import started

DEADLINE_S = 60.0


@dataclass
class Line:
    """The parent's end."""

    pipe: Connection

    def heard(self) -> Any:
        assert self.pipe.poll(DEADLINE_S)
        return self.pipe.recv()

    def ask(self, task: Any) -> Any:
        self.pipe.send(task)
        return self.heard()


@contextmanager
def serving(job: SlamJob) -> Iterator[Line]:
    ours, theirs = Pipe()
    thread = threading.Thread(target=slam_process.serve, args=(theirs, job))
    thread.start()
    try:
        yield Line(ours)
    finally:
        ours.close()
        thread.join()
        theirs.close()


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread of the tests may not be slowed down, and compiles what it needs when it does."""
    monkeypatch.setattr(os, "nice", lambda _: 0)
    monkeypatch.setattr(slam_process, "warm_up", lambda _: None)


def mapping(folder: Path, name: str = "hall") -> SlamJob:
    return SlamJob(
        mode="mapping",
        params=SlamParams(),
        source=None,
        target=folder / f"{name}.amrmap",
        name=name,
        save_period_s=3600.0,
    )


def localizing(path: Path) -> SlamJob:
    return replace(
        mapping(path.parent), mode="localization", source=path, target=None, name=path.stem
    )


def scan(step: int) -> SlamRequest:
    first, pose = tour_poses(0)[0], tour_poses(0)[step]
    cloud = cloud_at(lab(0), pose, np.random.default_rng(step), sigma_m=0.01, stamp_ns=step)
    return SlamRequest(
        cloud=cloud,
        map_from_base=first.inverse() @ pose,
        covariance=np.diag([0.02**2, 0.02**2, 0.01**2]),
    )


def test_map_save_under_a_name_and_localize_in_it(tmp_path: Path) -> None:
    with serving(mapping(tmp_path)) as line:
        assert line.heard() == Ready(map_id=None, map_name="hall", map_scans=0)
        assert line.ask(Store(target=None)) == Declined(reason="there is nothing in the map yet")
        for step in range(3):
            result = line.ask(scan(step))
            assert isinstance(result, SlamResult)
            assert result.inserted
        other = tmp_path / "other.amrmap"
        stored = line.ask(Store(target=other, name="other"))
        assert isinstance(stored, Stored)
        copied, map_id = load_map(other)
        assert (copied.name, str(map_id), len(copied.path)) == ("other", stored.map_id, 3)
        # A name that is taken is nobody's to overwrite; that of the running map is its own.
        declined = line.ask(Store(target=other, name="other"))
        assert isinstance(declined, Declined)
        assert "other already" in declined.reason
        own = line.ask(Store(target=tmp_path / "hall.amrmap", name="hall"))
        assert own == Stored(path=tmp_path / "hall.amrmap", map_id=stored.map_id, map_scans=3)
        assert line.ask(Store(target=None)) == own

        switched = line.ask(Switch(job=localizing(other)))
        assert isinstance(switched, Switched)
        assert switched.ready == Ready(
            map_id=stored.map_id, map_name="other", map_scans=3, path=other
        )
        found = line.ask(replace(scan(1), map_from_base=None, covariance=None))
        assert not found.inserted
        assert found.map_scans == 3
        line.pipe.send(Stop())


def test_a_new_process_makes_the_same_map_of_what_was_saved_and_what_was_not(
    tmp_path: Path,
) -> None:
    """To the last bit: the UUID is that of the content."""
    job, unsaved = mapping(tmp_path), []
    with serving(job) as line:
        line.heard()
        for step in range(5):
            request = scan(step)
            result = line.ask(request)
            assert result.joined_at is not None
            if step == 1:
                line.ask(Store(target=None))
                saved = (tmp_path / "hall.amrmap").read_bytes()
            elif step > 1:
                pose, covariance = result.joined_at
                unsaved.append(
                    Joined(cloud=request.cloud, map_from_base=pose, covariance=covariance)
                )
        whole = line.ask(Store(target=None))
        line.pipe.send(Stop())
    (tmp_path / "hall.amrmap").write_bytes(saved)  # as a kill would have left it
    again = replace(job, source=job.target, saved_before=True)
    with serving(again) as line:
        line.pipe.send(Unsaved(scans=tuple(unsaved)))
        assert line.heard().map_scans == 2
        assert line.ask(Store(target=None)) == whole
        line.pipe.send(Stop())
    assert not (tmp_path / "hall.amrmap.1").exists()


def test_a_map_grows_on_once_it_may(tmp_path: Path) -> None:
    job = mapping(tmp_path)
    with serving(job) as line:
        line.heard()
        line.ask(scan(0))
        line.pipe.send(Stop())
        assert line.heard() == Saved(map_scans=1, error=None)
    assert job.target is not None
    with serving(localizing(job.target)) as line:
        line.heard()
        assert line.ask(scan(1)).joined_at is None
        switched = line.ask(Grow(job=replace(job, saved_before=True)))
        assert isinstance(switched, Switched)
        assert switched.job.mode == "mapping"
        grown = line.ask(scan(2))
        assert grown.inserted
        assert grown.map_scans == 2
        line.pipe.send(Stop())
        assert line.heard() == Saved(map_scans=2, error=None)
    assert len(load_map(job.target)[0].path) == 2
    assert not (tmp_path / "hall.amrmap.1").exists()


def test_a_closed_loop_hurries_the_next_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server = slam_process._Server(mapping(tmp_path))
    assert server.due_s() is None
    server.answer(scan(0))
    due_s = server.due_s()
    assert due_s is not None
    assert due_s > 3000.0
    update = SlamEngine.update
    monkeypatch.setattr(
        SlamEngine, "update", lambda *a: replace(update(*a), moved=Pose2(0.1, 0.0, 0.0))
    )
    server.answer(scan(1))
    soon_s = server.due_s()
    assert soon_s is not None
    assert 0.0 < soon_s <= 360.0  # a tenth of the period: loops come in flocks
    server.answer(scan(2))
    again_s = server.due_s()
    assert again_s is not None
    assert again_s <= soon_s
    # The next one is a whole period away again.
    assert server.save() == Saved(map_scans=3, error=None)
    monkeypatch.setattr(SlamEngine, "update", update)
    server.answer(scan(3))
    due_s = server.due_s()
    assert due_s is not None
    assert due_s > 3000.0


def test_what_was_mapped_is_saved_before_another_job_begins(tmp_path: Path) -> None:
    with serving(mapping(tmp_path)) as line:
        line.heard()
        line.ask(scan(0))
        taken = line.ask(Switch(job=mapping(tmp_path, "hall")))
        assert isinstance(taken, Switched)  # nothing has been saved under that name yet
        assert len(load_map(tmp_path / "hall.amrmap")[0].path) == 1
        assert isinstance(line.ask(Switch(job=mapping(tmp_path, "hall"))), Declined)
        assert isinstance(line.ask(Switch(job=mapping(tmp_path, "second"))), Switched)
        assert line.ask(scan(0)).map_scans == 1
        line.pipe.send(Stop())
        assert line.heard() == Saved(map_scans=1, error=None)
    assert load_map(tmp_path / "second.amrmap")[0].name == "second"


def test_a_map_that_cannot_be_used_changes_nothing(tmp_path: Path) -> None:
    (tmp_path / "bad.amrmap").write_bytes(b"AMRMAP\r\n" + bytes(100))
    with serving(mapping(tmp_path)) as line:
        line.heard()
        line.ask(scan(0))
        for name in ("bad", "missing"):
            declined = line.ask(Switch(job=localizing(tmp_path / f"{name}.amrmap")))
            assert isinstance(declined, Declined)
            assert name in declined.reason
        result = line.ask(scan(1))
        assert (result.inserted, result.map_scans) == (True, 2)
        line.pipe.send(Stop())


def test_a_map_that_cannot_be_saved_is_not_given_up(tmp_path: Path) -> None:
    save_map(mapped_lab(0), tmp_path / "old.amrmap")
    folder = tmp_path / "file"
    folder.write_text("no folder")
    with serving(mapping(folder)) as line:
        line.heard()
        line.ask(scan(0))
        declined = line.ask(Switch(job=localizing(tmp_path / "old.amrmap")))
        assert isinstance(declined, Declined)
        assert "cannot write the map" in declined.reason
        assert line.ask(scan(1)).map_scans == 2


def test_the_picture_is_the_map_pixel_by_pixel(tmp_path: Path) -> None:
    path = tmp_path / "lab.amrmap"
    save_map(mapped_lab(0), path)
    with serving(localizing(path)) as line:
        line.heard()
        drawn = line.ask(Draw(resolution_m=0.1))
        assert isinstance(drawn, Drawn)
        assert drawn.resolution_m == 0.1
        pixels = matplotlib.image.imread(io.BytesIO(drawn.png), format="png")
        expected = occupancy_image(load_map(path)[0], 0.1)
        assert pixels.shape == (drawn.rows, drawn.columns)
        np.testing.assert_array_equal(np.round(255.0 * pixels), expected.pixels)
        assert (drawn.x_min_m, drawn.y_min_m) == (expected.x_min_m, expected.y_min_m)
        # However fine it is asked for, it has a bounded number of pixels.
        fine = line.ask(Draw(resolution_m=0.001))
        assert fine.rows * fine.columns < 8_000_000
        assert fine.resolution_m > 0.001


def test_poses_are_sought_in_the_map_that_is_active(tmp_path: Path) -> None:
    truth = tour_poses(0)[0].inverse() @ tour_poses(0)[2]
    with serving(mapping(tmp_path)) as line:
        line.heard()
        for step in range(4):
            line.ask(scan(step))
        stored = line.ask(Store(target=tmp_path / "new.amrmap", name="new"))
        line.ask(Switch(job=localizing(stored.path)))
        result = line.ask(
            replace(
                scan(2),
                map_from_base=Pose2(50.0, 0.0, 0.0),
                region=Region(
                    map_from_base=truth @ Pose2(0.5, 0.3, 0.4), radius_m=1.0, heading_rad=1.0
                ),
            )
        )
        assert result.sought
        assert result.fix is not None, result.answer.reason
        assert result.fix.map_from_base.distance_to(truth) < 0.1


def test_a_process_that_nobody_takes_ends_with_its_starter() -> None:
    with started() as waiting:
        assert waiting.slam is not None
        process, pipe = waiting.slam.process, waiting.slam.pipe
        assert process.is_alive()
    assert process.exitcode == -signal.SIGKILL
    assert pipe.closed


def test_a_process_whose_starter_is_gone_ends_by_itself() -> None:
    with started() as waiting:
        slam = waiting.take()
    slam.pipe.close()
    slam.process.join(60.0)
    assert slam.process.exitcode == 0
