"""The daemon's recordings: on a signal, from the start, and what they do when the disk does not."""

from __future__ import annotations

import base64
import json
import os
import signal
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from daemon_rig import Daemon, Robot, until, write_config
from foxglove_official import check
from mcap.reader import make_reader
from mcap.records import Channel, Message
from messages import MAP_ID, pose_of, status_of

from amr_drivers.decoding import with_decoded
from amr_slam.cli import main
from amr_slam.cli.wiring import _settings
from amr_slam.config import Config, RecordingSettings, load
from amr_slam.map.export import FREE, OCCUPIED, OccupancyImage, png_bytes
from amr_slam.recording import read_log
from amr_slam.recording.mcap_file import records
from amr_slam.samples import RawBytes, RawFrame, Scan, State, Way, WheelSample, untapped
from amr_slam.service import record_file
from amr_slam.service import recorder as module
from amr_slam.service.map_view import MapView
from amr_slam.service.recorder import Recorder
from amr_slam.serving import Asked, Picture
from amr_slam.wire import MapImage


def topics_in(path: Path) -> dict[str, int]:
    """Topics and how many messages each has."""
    names: dict[int, str] = {}
    counts: dict[str, int] = {}
    with path.open("rb") as stream:
        for record in records(stream):
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message):
                topic = names[record.channel_id]
                counts[topic] = counts.get(topic, 0) + 1
    return counts


def test_a_signal_saves_the_last_minutes_and_replay_runs_on_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = tmp_path / "whole.mcap"
    with Robot(tmp_path), Daemon(tmp_path, record=whole) as daemon:
        daemon.listen()
        daemon.status_when(
            lambda s: s.slam.samples >= 3 and all(h.link == "OK" for h in s.health().values()),
            "some scans were registered",
        )
        before = daemon.next_poses(1)[0].seq
        children = daemon.children()
        os.killpg(daemon.process.pid, signal.SIGUSR1)  # as systemctl kill does: to all of them
        until(lambda: ": saved" in daemon.log(), f"the recording, {daemon.log()}")
        # The poses went on meanwhile.
        poses = daemon.next_poses(5)
        assert poses[-1].seq > before
        assert daemon.children() == children
        assert daemon.stop() == 0
    (saved,) = (tmp_path / "recordings").iterdir()
    assert saved.name.startswith("amr7-")
    assert saved.name.endswith("-sigusr1.mcap")
    for path in (saved, whole):
        counts = topics_in(path)
        assert set(counts) - {"/map"} == {
            *("/raw/front", "/raw/rear", "/raw/wheels", "/scan/front", "/scan/rear", "/wheels"),
            *("/pose", "/status", "/decisions", "/tf", "/tf_static", "/scene", "/health"),
        }
        assert counts["/pose"] > 20
        log = read_log(path)
        assert log.about is not None
        assert log.about.robot == "amr7"
        assert log.about.config == daemon.config.read_text()
        assert {device.name for device in log.devices} == {"front", "rear", "wheels"}
        again = with_decoded(log, _settings)
        live = {s.stamp_ns: s for s in log.samples if isinstance(s, WheelSample)}
        wheels = {s.stamp_ns: s for s in again.samples if isinstance(s, WheelSample)}
        assert len(live) > 20
        # What the loop had not yet taken out when the file was closed is in the bytes alone.
        assert live.keys() <= wheels.keys()
        assert all(wheels[stamp] == sample for stamp, sample in live.items())
        scans = sum(isinstance(sample, Scan) for sample in again.samples)
        assert scans > sum(isinstance(sample, Scan) for sample in log.samples)
        report = tmp_path / "report.json"
        arguments = ["replay", path, "--config", daemon.config, "--scan-period", "0.4"]
        assert main(list(map(str, [*arguments, "--report", report]))) == 0
        facts = json.loads(report.read_text())
        assert facts["scans_in_log"] == scans
        assert facts["registrations"] > 1

    capsys.readouterr()
    located = ["localize", "--map", daemon.map_path, saved, "--config", daemon.config]
    assert main(list(map(str, [*located, "--scan-period", "1.0"]))) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(lines) > 2
    assert any(line["accepted"] for line in lines)


def test_what_a_killed_daemon_has_recorded_is_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = tmp_path / "whole.mcap"
    with Robot(tmp_path), Daemon(tmp_path, record=whole) as daemon:
        until(lambda: whole.exists() and whole.stat().st_size > 50_000, f"bytes, {daemon.log()}")
        assert daemon.stop(signal.SIGKILL) == -signal.SIGKILL
    log = read_log(whole)
    assert "cut off" in caplog.text
    assert {device.name for device in log.devices} == {"front", "rear", "wheels"}
    again = with_decoded(log, _settings)
    assert any(isinstance(sample, Scan) for sample in again.samples)
    assert any(isinstance(sample, WheelSample) for sample in again.samples)


@pytest.fixture
def config(tmp_path: Path) -> tuple[Config, Path]:
    path = write_config(tmp_path)
    return load(path), path


def raw(stamp_ns: int, data: bytes = b"bytes") -> RawBytes:
    return RawBytes(device="front", stamp_ns=stamp_ns, way=Way.RECEIVED, data=data)


class Rig:
    """A recorder, closed at the end."""

    def __init__(self, config: tuple[Config, Path], record: Path | None = None, **ring: Any):
        self.directory = config[1].parent / "saved"
        settings = RecordingSettings(directory=self.directory, **ring)
        self.recorder = Recorder(replace(config[0], recording=settings), config[1], record)

    def __enter__(self) -> Recorder:
        return self.recorder

    def __exit__(self, *_: object) -> None:
        self.recorder.close()
        self.recorder.close()
        assert not any("recorder" in thread.name for thread in threading.enumerate())


def test_all_kinds_of_things_are_saved_in_their_order(config: tuple[Config, Path]) -> None:
    rig = Rig(config)
    with rig as recorder:
        frame = RawFrame(device="wheels", stamp_ns=2, identifier=0x181, data=b"\x01")
        opened = RawBytes(device="front", stamp_ns=1, way=Way.OPENED)
        for thing in (opened, raw(2), frame, raw(3)):
            recorder.tap(thing)
        recorder.take(WheelSample(stamp_ns=3, left_rad=0.5, right_rad=0.25))
        recorder.published(pose_of())
        recorder.published(status_of())
        path = recorder.save("odd-pose")
        assert path is not None
        until(path.exists, "the recording")
    assert path.parent == rig.directory
    assert path.name.endswith("-odd-pose.mcap")
    log = read_log(path)
    assert log.raw == (opened, raw(2), frame, raw(3))
    assert log.samples == (WheelSample(stamp_ns=3, left_rad=0.5, right_rad=0.25),)
    assert topics_in(path)["/pose"] == topics_in(path)["/status"] == 1
    wheels = next(device for device in log.devices if device.name == "wheels")
    assert wheels.files["dbc"].startswith(b"VERSION")
    assert [p.name for p in rig.directory.iterdir()] == [path.name]


def test_a_recording_shows_the_map_that_was_drawn_once(
    config: tuple[Config, Path], tmp_path: Path
) -> None:
    pixels = np.full((2, 3), FREE, dtype=np.uint8)
    pixels[0] = OCCUPIED
    png = png_bytes(OccupancyImage(pixels=pixels, resolution_m=0.5, x_min_m=0.0, y_min_m=0.0))
    where = MapImage(
        map=MAP_ID,
        width_px=3,
        height_px=2,
        metres_per_px=0.5,
        column_of_x0_px=0.0,
        row_of_y0_px=2.0,
    )
    asked: list[Asked] = []
    whole = tmp_path / "whole.mcap"
    with Rig(config, record=whole) as recorder:
        recorder.shows_maps(asked.append)
        recorder.published(status_of(state=State.LOST))
        recorder.published(status_of())
        until(lambda: len(asked) == 1, "the question for the picture")
        asked[0].not_done("the SLAM process has ended meanwhile")
        recorder.published(status_of())
        until(lambda: len(asked) == 2, "the question anew")
        asked[1].done(Picture(png=png, georeference=where))
        recorder.published(status_of())
        recorder.tap(raw(7))
        path = recorder.save("shown")
        assert path is not None
        until(path.exists, "the recording")
    assert len(asked) == 2
    for file in (path, whole):
        assert topics_in(file)["/map"] == 1
        with file.open("rb") as stream:
            ((schema, _, message),) = make_reader(stream).iter_messages(topics=["/map"])
        shown = json.loads(message.data)
        assert schema is not None
        assert schema.name == "foxglove.Grid"
        check(schema.name, shown)
        assert shown["column_count"] == 3
        cells = np.frombuffer(base64.b64decode(shown["data"]), np.uint8).reshape(2, 3, 4)
        assert (cells[1] == [0, 0, 0, 255]).all()  # the upper row is the last


def test_a_map_that_grows_is_drawn_again_each_minute() -> None:
    view, asked = MapView(), list[Asked]()
    view.put = asked.append
    for mode, now_s, drawn in (
        ("mapping", 100.0, 1),
        ("mapping", 159.0, 1),
        ("mapping", 161.0, 2),
        ("localization", 300.0, 2),
    ):
        view.follow(status_of(mode=mode, state=State.MAPPING), now_s)
        assert len(asked) == drawn


def test_without_a_ring_nothing_is_tapped_and_nothing_saved(
    config: tuple[Config, Path], caplog: pytest.LogCaptureFixture
) -> None:
    with Rig(config, ring_s=0.0) as recorder:
        assert recorder.tap is untapped
        recorder.published(pose_of())
        assert recorder.save("reason") is None
        assert "ring_s is 0" in caplog.text


@pytest.mark.parametrize("reason", ["", "a/b", "..", "x" * 41, "a b"])
def test_a_reason_that_makes_no_file_name_is_refused(
    config: tuple[Config, Path], reason: str
) -> None:
    with Rig(config) as recorder, pytest.raises(ValueError, match="letters"):
        recorder.save(reason)


def test_a_full_disk_ends_the_recording_and_saves_nothing(
    config: tuple[Config, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    whole = tmp_path / "whole.mcap"
    with Rig(config, record=whole) as recorder:
        recorder.tap(raw(1))
        for one in (module, record_file):
            monkeypatch.setattr(one, "LEAST_FREE_BYTES", 1 << 60)
        until(lambda: "the recording ends here: the disk is nearly full" in caplog.text, "the end")
        recorder.tap(raw(2))
        path = recorder.save("reason")
        until(lambda: "not saved: the disk is nearly full" in caplog.text, "the refusal")
    assert path is not None
    assert not path.exists()
    assert {r.stamp_ns for r in read_log(whole).raw} <= {1}


def test_a_folder_that_cannot_be_made_is_said(
    config: tuple[Config, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "saved").write_text("in the way")
    with Rig(config) as recorder:
        recorder.tap(raw(1))
        recorder.save("reason")
        until(lambda: "not saved" in caplog.text, "the complaint")
    assert "File exists" in caplog.text


def test_what_a_hanging_disk_loses_is_a_gap(
    config: tuple[Config, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(module, "_MAX_WAITING", 2)
    with Rig(config, record=tmp_path / "whole.mcap") as recorder:
        for stamp_ns in range(1, 5):
            recorder.tap(raw(stamp_ns))
    found = read_log(tmp_path / "whole.mcap").raw
    at = next(i for i, one in enumerate(found) if isinstance(one, RawBytes) and one.way is Way.GAP)
    assert [one.stamp_ns for one in found[:at]] == [1, 2]
    gaps = {one.device for one in found[at:] if isinstance(one, RawBytes) and one.way is Way.GAP}
    assert gaps == {"front", "rear", "wheels"}


def test_stopping_gives_up_a_saving(
    config: tuple[Config, Path], caplog: pytest.LogCaptureFixture
) -> None:
    rig = Rig(config)
    with rig as recorder:
        for stamp_ns in range(20_000):
            recorder.tap(raw(stamp_ns, stamp_ns.to_bytes(8, "big") * 16))
        first = recorder.save("first")
        until(lambda: recorder._saving is not None, "the saving's begin")
        assert first is not None
        if not first.exists():
            assert recorder.save("second") is None
        recorder.close()
    if "stopping" in caplog.text:
        assert not list(rig.directory.iterdir())
    else:  # it was quicker
        assert read_log(first).raw
