"""What is saved by itself: when, by which name, and how much of the disk it may take."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from daemon_rig import Daemon, Robot, until, write_config

from amr_slam.config import RecordingSettings, load
from amr_slam.recording import read_log
from amr_slam.samples import Link, RawBytes, State, Way
from amr_slam.service import recorder as module
from amr_slam.service.incidents import Incidents
from amr_slam.service.record_file import LEAST_FREE_BYTES
from amr_slam.service.recorder import Recorder

S = 1_000_000_000
OK = {"front": Link.OK, "rear": Link.OK, "wheels": Link.OK}


class Watch:
    """Ten looks a second."""

    def __init__(self) -> None:
        self.saved: list[tuple[float, str]] = []
        self.refusals = 0
        self.now_ns = 0
        self._incidents = Incidents(self._save)

    def look(
        self,
        seconds: float,
        state: State = State.LOCALIZED,
        crashes: int = 0,
        *,
        links: Mapping[str, Link] | None = None,
    ) -> None:
        for _ in range(round(10 * seconds)):
            self.now_ns += S // 10
            self._incidents.look(self.now_ns, state, OK | dict(links or {}), crashes)

    def _save(self, reason: str) -> Path | None:
        if self.refusals:
            self.refusals -= 1
            return None
        self.saved.append((self.now_ns / S, reason))
        return Path(reason)

    @property
    def reasons(self) -> list[str]:
        return [reason for _, reason in self.saved]


@pytest.mark.parametrize("state", [State.LOST, State.AMBIGUOUS, State.ODOMETRY_ONLY])
@pytest.mark.parametrize("good", [State.LOCALIZED, State.MAPPING])
def test_a_state_that_stays_worse_is_saved_with_what_came_of_it(good: State, state: State) -> None:
    watch = Watch()
    watch.look(10, State.STARTING)
    watch.look(20, good)
    watch.look(1.5, state)
    watch.look(20, good)
    assert watch.saved == []
    watch.look(60, state)
    ((at_s, reason),) = watch.saved
    assert reason == state.value.replace("_", "-")
    assert at_s == pytest.approx(51.5 + 2 + 5, abs=0.3)


def test_who_has_never_known_its_place_loses_nothing() -> None:
    watch = Watch()
    watch.look(100, State.STARTING, links={"front": Link.LOST})
    watch.look(100, State.LOST, links={"front": Link.LOST})
    assert watch.saved == []


def test_lost_devices_and_processes_are_saved_by_their_names() -> None:
    watch = Watch()
    watch.look(5)
    watch.look(0.5, links={"front": Link.LOST})
    watch.look(600)
    watch.look(2, links={"wheels": Link.STALE})
    watch.look(600)
    assert watch.saved == []
    watch.look(600, links={"wheels": Link.LOST})
    watch.look(600)
    watch.look(600, crashes=1)
    watch.look(600, crashes=1, links={"rear.left": Link.OK})
    watch.look(600, crashes=1, links={"rear.left": Link.LOST})
    assert watch.reasons == ["wheels-lost", "slam-restarted", "rear-left-lost"]


def test_what_flaps_is_saved_twice_in_ten_minutes_and_nothing_falls_between() -> None:
    watch = Watch()
    watch.look(5)
    for _ in range(600):
        watch.look(3, State.LOST, links={"front": Link.LOST})
        watch.look(3)
    assert len(watch.saved) == 12
    times = [at_s for at_s, _ in watch.saved]
    # The ring holds 600 s.
    assert max(b - a for a, b in itertools.pairwise(times)) < 310
    assert min(b - a for a, b in itertools.pairwise(times)) > 299


def test_a_saving_that_cannot_be_yet_is_tried_again() -> None:
    watch = Watch()
    watch.look(5)
    watch.refusals = 2
    watch.look(30, crashes=1)
    assert watch.reasons == ["slam-restarted"]


# -- on disk ---------------------------------------------------------------------------------


class Recording:
    """A recorder with something in its ring."""

    def __init__(self, folder: Path, **settings: Any) -> None:
        path = write_config(folder)
        self.folder = folder / "recordings"
        config = replace(load(path), recording=RecordingSettings(directory=self.folder, **settings))
        self.recorder = Recorder(config, path)
        noise = bytes(range(256)) * 40
        for number in range(1, 20):
            data = noise[number:] + noise[:number]
            self.recorder.tap(
                RawBytes(device="front", stamp_ns=number, way=Way.RECEIVED, data=data)
            )

    def save(self, reason: str, *, automatic: bool) -> Path:
        saved: list[Path] = []

        def wanted() -> bool:
            path = self.recorder.save(reason, automatic=automatic)
            saved.extend([] if path is None else [path])
            return path is not None

        until(wanted, "the saving before it")
        until(lambda: saved[0].exists() or self.recorder.trouble is not None, "the saving")
        return saved[0]

    def kept(self) -> list[str]:
        return [path.name.rsplit("-", 1)[1] for path in sorted(self.folder.rglob("*.mcap"))]

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.recorder.close()


def test_the_oldest_automatic_recordings_go_and_nobody_elses(tmp_path: Path) -> None:
    with Recording(tmp_path, automatic_count=2) as recording:
        asked = recording.save("asked", automatic=False)
        for number in range(4):
            path = recording.save(f"n{number}", automatic=True)
            # As if they were a second apart, which is what their names tell.
            path.rename(path.with_name(f"amr7-2026112{number}T000000Z-n{number}.mcap"))
        assert asked.exists()
        assert sorted(recording.kept()) == ["asked.mcap", "n2.mcap", "n3.mcap"]
        log = read_log(asked)
        assert log.about is not None
        assert log.about.reason == "asked"


def test_the_bytes_of_automatic_recordings_are_bounded(tmp_path: Path) -> None:
    with Recording(tmp_path) as recording:
        size = recording.save("first", automatic=True).stat().st_size
    with Recording(tmp_path, automatic_mb=2.5 * size / 1e6) as recording:
        for number in range(3):
            recording.save(f"n{number}", automatic=True)
        until(lambda: len(recording.kept()) == 2, "what was too much has gone")
    with Recording(tmp_path, automatic_mb=0.001) as recording:
        path = recording.save("large", automatic=True)
        assert not path.exists()
        assert "automatic_mb" in (recording.recorder.trouble or "")
        assert recording.recorder.saves_by_itself
    with Recording(tmp_path, automatic_mb=0.0) as recording:
        assert not recording.recorder.saves_by_itself


def test_on_a_full_disk_automatic_recordings_give_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Recording(tmp_path) as recording:
        first = recording.save("first", automatic=True)
        free = iter([0, LEAST_FREE_BYTES + (1 << 30)])
        monkeypatch.setattr(module, "free_bytes", lambda _: next(free))
        asked = recording.save("asked", automatic=False)
        assert asked.exists()
        assert not first.exists()
        monkeypatch.setattr(module, "free_bytes", lambda _: 0)
        refused = recording.save("refused", automatic=False)
        assert not refused.exists()
        assert asked.exists()
        assert "the disk is nearly full" in (recording.recorder.trouble or "")
        monkeypatch.undo()
        recording.save("again", automatic=False)
        until(lambda: recording.recorder.trouble is None, "the trouble's end")


def test_a_daemon_saves_what_led_to_a_lost_scanner(tmp_path: Path) -> None:
    with Robot(tmp_path) as robot, Daemon(tmp_path) as daemon:
        daemon.listen()
        daemon.status_when(
            lambda s: all(part.link == "OK" for part in s.health().values()), "all is well"
        )
        robot.front.unplug()
        folder = tmp_path / "recordings" / "automatic"
        until(lambda: any(folder.glob("*-front-lost.mcap")), f"the recording, {daemon.log()}")
        (saved,) = folder.iterdir()
        assert "incident (front-lost" in daemon.log()
        assert daemon.stop() == 0
    log = read_log(saved)
    assert log.about is not None
    assert log.about.reason == "front-lost"
    opened = [r for r in log.raw if isinstance(r, RawBytes) and r.way is Way.OPENED]
    assert {one.device for one in opened} == {"front", "rear", "wheels"}
