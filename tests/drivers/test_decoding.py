"""What the device threads recorded, decoded again: the very same samples."""

from __future__ import annotations

import json
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from paths import REPO
from test_recording import same

from amr_drivers.can_odometry import driver as can_driver
from amr_drivers.decoding import with_decoded
from amr_drivers.emulators.s300 import EmulatedS300
from amr_drivers.emulators.slcan import EmulatedSlcan
from amr_drivers.emulators.wheels import EmulatedWheels
from amr_drivers.sick_s300 import driver as s300_driver
from amr_slam.cli.wiring import _settings
from amr_slam.config import MountingSettings, OdometrySettings, ScannerSettings
from amr_slam.config.recorded import recorded_settings
from amr_slam.recording import Log, RecordedDevice, RecordingError, RecordingWriter, read_log
from amr_slam.recording.values import About, Sample
from amr_slam.samples import (
    CanFrame,
    OdometrySample,
    Raw,
    RawBytes,
    RawFrame,
    Scan,
    Way,
    WheelSample,
)
from amr_slam.service.devices import DeviceEnded, ScannerThread, WheelsThread

DEADLINE_S = 60.0
DBC = REPO / "config/wheels.dbc"
RANGES = np.linspace(1.0, 9.0, 541)
ABOUT = About(robot="amr7", version="1", monotonic_ns=1, utc_ns=2, config="[robot]\n")


class Recorded:
    """Two device threads in front of their emulators, and all that they say, in its order."""

    def __init__(self, folder: Path) -> None:
        self.scanner = EmulatedS300(folder / "front")
        self.can = EmulatedSlcan(folder / "can")
        self.wheels = EmulatedWheels(can_driver.Settings(dbc=str(DBC), sequence_signal="Sequence"))
        self.raw: list[Raw] = []
        self.decoded: list[Sample] = []
        self._lock = threading.Lock()
        self._turned = 0
        scanner = s300_driver.Settings(port=str(folder / "front"), latency_limit_s=1.0)
        odometry = can_driver.Settings(
            interface="slcan", channel=str(folder / "can"), dbc=str(DBC), sequence_signal="Sequence"
        )
        mounting = MountingSettings(x_m=0.0, y_m=0.0, theta_deg=0.0)
        self.threads: tuple[ScannerThread | WheelsThread, ...] = (
            ScannerThread(
                ScannerSettings(
                    name="front",
                    driver="sick_s300",
                    poll_period_s=0.0,
                    mounting=mounting,
                    options=scanner,
                ),
                self._sink,
                0.5,
                self._tap,
            ),
            WheelsThread(
                OdometrySettings(driver="can", options=odometry), self._sink, 0.5, 1.0, self._tap
            ),
        )
        self.devices = (
            RecordedDevice(
                name="front",
                kind="scanner",
                driver="sick_s300",
                settings=json.dumps(asdict(scanner)),
            ),
            RecordedDevice(
                name="wheels",
                kind="odometry",
                driver="can",
                settings=json.dumps(asdict(odometry)),
                files={"dbc": DBC.read_bytes()},
            ),
        )

    def _tap(self, raw: Raw) -> None:
        with self._lock:
            self.raw.append(raw)

    def _sink(self, sample: Sample | DeviceEnded) -> None:
        assert not isinstance(sample, DeviceEnded)
        with self._lock:
            self.decoded.append(sample)

    def count(self, kind: type[Scan | WheelSample]) -> int:
        with self._lock:
            return sum(isinstance(sample, kind) for sample in self.decoded)

    def ways(self, device: str) -> list[Way]:
        with self._lock:
            return [r.way for r in self.raw if isinstance(r, RawBytes) and r.device == device]

    def drive(self, turns: int) -> None:
        """So many scans and wheel samples come through, each before the next one is sent."""
        for _ in range(turns):
            self._until_more(Scan, lambda: self.scanner.measure(RANGES + 0.01 * self._turned))
            self._until_more(WheelSample, self._turn_wheels)

    def _turn_wheels(self) -> None:
        self._turned += 1
        for frame in self.wheels.frames(0.1 * self._turned, -0.05 * self._turned):
            self.can.send(frame)

    def _until_more(self, kind: type[Scan | WheelSample], send: Callable[[], object]) -> None:
        before = self.count(kind)
        deadline_s = time.monotonic() + DEADLINE_S
        while self.count(kind) == before:
            assert time.monotonic() < deadline_s, [thread.health(0) for thread in self.threads]
            send()
            sent_s = time.monotonic()
            while self.count(kind) == before and time.monotonic() < sent_s + 0.3:
                self.can.answer()
                time.sleep(0.002)

    def write(self, path: Path) -> None:
        with RecordingWriter(path) as writer:
            writer.describe(ABOUT, self.devices)
            for raw in self.raw:
                writer.write_raw(raw)
            for sample in self.decoded:
                writer.write(sample)


@contextmanager
def recording(folder: Path) -> Iterator[Recorded]:
    recorded = Recorded(folder)
    with ExitStack() as stack:
        stack.callback(recorded.can.close)
        stack.callback(recorded.scanner.close)
        for thread in recorded.threads:
            stack.callback(thread.join, 5.0)
            thread.start()
        for thread in recorded.threads:
            stack.callback(thread.ask_to_stop)
        yield recorded


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A robot whose lines are damaged, cut short, and pulled and put back."""
    folder = tmp_path_factory.mktemp("lines")
    with recording(folder) as live:
        live.drive(4)
        live.scanner.send_bytes(random.Random(1).randbytes(300))
        live.drive(2)
        live.scanner.cut_next(500)
        live.scanner.measure(RANGES)
        live.can.send_bytes(b"t1")
        live.can.send(CanFrame(stamp_ns=0, identifier=0x7FF, data=b"foreign"))
        live.drive(3)
        live.scanner.frozen = True  # no scan comes of it
        live.scanner.measure(RANGES)
        live.scanner.frozen = False
        live.can.unplug()
        live.scanner.unplug()
        for thread in live.threads:
            deadline_s = time.monotonic() + DEADLINE_S
            while thread.health(0).link != "lost":
                assert time.monotonic() < deadline_s
                time.sleep(0.01)
        live.can.replug()
        live.scanner.replug()
        live.drive(4)
    return live


@pytest.fixture
def log(recorded: Recorded, tmp_path: Path) -> Log:
    recorded.write(tmp_path / "run.mcap")
    return read_log(tmp_path / "run.mcap")


def of_kind(samples: tuple[Sample, ...] | list[Sample], kind: type[Sample]) -> list[Sample]:
    return [sample for sample in samples if isinstance(sample, kind)]


def test_decoded_again_the_samples_are_those_that_the_daemon_got(
    recorded: Recorded, log: Log
) -> None:
    assert recorded.ways("front").count(Way.OPENED) >= 2
    assert recorded.ways("wheels").count(Way.OPENED) >= 2
    # From the bytes alone: what was decoded live is not in the log that is asked.
    again = with_decoded(replace(log, samples=()), recorded_settings).samples
    wheels, live_wheels = of_kind(again, WheelSample), of_kind(recorded.decoded, WheelSample)
    assert wheels == live_wheels
    assert {s.segment for s in wheels if isinstance(s, WheelSample)} >= {0, 1}
    scans, live_scans = of_kind(again, Scan), of_kind(recorded.decoded, Scan)
    assert len(live_scans) >= 13
    # A thread that the processor kept waiting gets the newest scan only; all were decoded.
    stamps = {scan.stamp_ns: scan for scan in scans}
    assert all(same(stamps[scan.stamp_ns], scan) for scan in live_scans)
    assert len(scans) - len(live_scans) <= 2


def test_no_sample_is_there_twice(log: Log) -> None:
    again = with_decoded(log, recorded_settings)
    alone = with_decoded(replace(log, samples=()), recorded_settings)
    assert len(again.samples) == len(alone.samples)
    assert all(same(a, b) for a, b in zip(again.samples, alone.samples, strict=True))


def test_a_driver_that_decodes_nothing_keeps_what_was_recorded(
    log: Log, caplog: pytest.LogCaptureFixture
) -> None:
    mocks = tuple(replace(device, driver="mock", settings="{}") for device in log.devices)
    assert with_decoded(replace(log, devices=mocks), recorded_settings).samples == log.samples
    assert "/raw/front: driver mock decodes no recordings" in caplog.text
    silent = tuple(raw for raw in log.raw if isinstance(raw, RawBytes) and not raw.data)
    assert with_decoded(replace(log, raw=silent), recorded_settings).samples == log.samples


def test_nothing_is_integrated_across_a_gap_in_the_recording(log: Log) -> None:
    frames = [raw for raw in log.raw if isinstance(raw, RawFrame)]
    gap = RawBytes(device="wheels", stamp_ns=frames[3].stamp_ns, way=Way.GAP)
    cut = replace(log, samples=(), raw=(*frames[:3], gap, *frames[3:6]))
    samples = with_decoded(cut, recorded_settings).samples
    assert [s.segment for s in samples if not isinstance(s, Scan)] == [0, 0, 0, 1, 1, 1]
    assert not any(isinstance(sample, OdometrySample) for sample in samples)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"driver": "sick_s3000"}, "no scanner driver is named 'sick_s3000'"),
        ({"settings": "[]"}, "no JSON object"),
        ({"settings": "{"}, "Expecting property name"),
        ({"settings": "[" * 100_000}, "nested too deeply"),
        ({"settings": '{"port": "x", "beams": 1}'}, "beams"),
        ({"settings": '{"port": "x", "rate": 1}'}, "unknown key"),
    ],
)
def test_settings_from_a_recording_are_not_trusted(
    log: Log, changes: dict[str, str], reason: str
) -> None:
    front = replace(log.devices[0], **changes)  # type: ignore[arg-type]  # texts only
    with pytest.raises(RecordingError, match="/raw/front: ") as caught:
        with_decoded(replace(log, devices=(front,)), _settings)
    assert reason in str(caught.value)


def test_no_file_that_a_recording_names_is_opened(log: Log) -> None:
    wheels = next(device for device in log.devices if device.name == "wheels")
    bare = replace(wheels, files={})
    with pytest.raises(RecordingError, match="/raw/wheels: the recording lacks the file that dbc"):
        with_decoded(replace(log, devices=(bare,)), _settings)
    foreign = replace(wheels, files={"dbc": b"\xff\xfe no DBC"})
    with pytest.raises(RecordingError, match=r"/raw/wheels: .*no DBC file"):
        with_decoded(replace(log, devices=(foreign,)), _settings)
