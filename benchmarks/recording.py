"""What recording costs: processor time at the full rate of two S300 and wheels, memory, files.

Reads as small as a USB adapter gives them (62 bytes), poses and wheels at 50 Hz, one scan of each
scanner in two seconds for the localizer. Prints a Markdown table and asserts nothing.
Example: python benchmarks/recording.py
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from amr_drivers.sick_s300.telegrams import (
    Output,
    Telegram,
    encode,
    encode_words,
    words_from_ranges,
)
from amr_slam.config import load
from amr_slam.geometry import Pose2
from amr_slam.recording import RecordingWriter, Sample
from amr_slam.recording.messages import encode_published
from amr_slam.reporting import pose_message
from amr_slam.samples import PoseEstimate, Raw, RawBytes, RawFrame, Scan, State, Way, WheelSample
from amr_slam.service.recorder import Recorder
from amr_slam.wire import PoseMessage

MINUTES: Final = 10
READ_BYTES: Final = 62
SCANS_HZ: Final = 25
WHEELS_HZ: Final = 50
_S: Final = 1_000_000_000


def main() -> int:
    """Feed ten minutes of a robot, as fast as they are taken, and save them."""
    with tempfile.TemporaryDirectory() as folder:
        config, path = load(Path("config/demo.toml")), Path("config/demo.toml")
        recording = replace(config.recording, directory=Path(folder))
        recorder = Recorder(replace(config, recording=recording), path)
        taps_s, all_s, count = _feed(recorder)
        seconds = 60.0 * MINUTES
        begun_s, wall_s = time.process_time(), time.perf_counter()
        saved = recorder.save("benchmark")
        while saved is not None and not saved.exists():
            time.sleep(0.05)
        assert saved is not None
        print("| what | cost |\n|---|--:|")
        print(f"| messages a second | {count / seconds:.0f} |")
        print(f"| taps: share of a core | {100 * taps_s / seconds:.2f} % |")
        print(f"| recorder's thread: share of a core | {100 * (all_s - taps_s) / seconds:.2f} % |")
        print(f"| saving {MINUTES} min: processor time | {time.process_time() - begun_s:.1f} s |")
        print(f"| the same: until the file is there | {time.perf_counter() - wall_s:.1f} s |")
        print(f"| file of {MINUTES} min | {saved.stat().st_size / 1e6:.1f} MB |")
        recorder.close()
        with_s, with_bytes = _poses(Path(folder) / "drawn.mcap", "/pose")
        without_s, without_bytes = _poses(Path(folder) / "bare.mcap", "/not-drawn")
        print(
            f"| drawing {MINUTES} min for Foxglove: processor time | {with_s - without_s:.1f} s |"
        )
        print(f"| the same: in the file | {(with_bytes - without_bytes) / 1e6:.1f} MB |")
    return 0


def _poses(path: Path, topic: str) -> tuple[float, int]:
    """(processor time in s, bytes of the file) of writing all poses under a topic."""
    poses = [_pose(second, n) for second in range(60 * MINUTES) for n in range(WHEELS_HZ)]
    entries = [
        encode_published("pose", n * _S // WHEELS_HZ, pose.encode())._replace(topic=topic)
        for n, pose in enumerate(poses)
    ]
    begun_s = time.process_time()
    with RecordingWriter(path) as writer:
        for entry in entries:
            writer.add(entry)
    return time.process_time() - begun_s, path.stat().st_size


def _feed(recorder: Recorder) -> tuple[float, float, int]:
    """(processor time of the calls, of the whole process, number of messages)."""
    dice = np.random.default_rng(7)
    walls_m = 4.0 + 2.0 * np.sin(np.linspace(0.0, 9.0, 541))
    taps_s = all_s = 0.0
    count = 0
    for second in range(60 * MINUTES):
        ranges_m = walls_m + dice.normal(0.0, 0.01, (2 * SCANS_HZ, 541))
        raw = _raw(second, ranges_m)
        decoded = _decoded(second, ranges_m)
        poses = [_pose(second, n) for n in range(WHEELS_HZ)]
        count += len(raw) + len(decoded) + len(poses)
        whole_s, own_s = time.process_time(), time.thread_time()
        for one in raw:
            recorder.tap(one)
        for sample in decoded:
            recorder.take(sample)
        for pose in poses:
            recorder.published(pose)
        taps_s += time.thread_time() - own_s
        time.sleep(0.25)  # the recorder's thread takes them
        all_s += time.process_time() - whole_s
    return taps_s, all_s, count


def _raw(second: int, ranges_m: np.ndarray) -> list[Raw]:
    raw: list[Raw] = []
    for n, row in enumerate(ranges_m):
        telegram = Telegram(
            address=7,
            version=0x0103,
            status=0,
            scan_number=(second * SCANS_HZ + n // 2).to_bytes(4, "little"),
            telegram_number=b"\x00\x00",
            output=Output.MEASURED,
            payload=encode_words(words_from_ranges(row)),
        )
        data, stamp_ns = encode(telegram, 14), second * _S + n * _S // len(ranges_m)
        device = ("front", "rear")[n % 2]
        raw += [
            RawBytes(
                device=device,
                stamp_ns=stamp_ns + 20_000 * at,
                way=Way.RECEIVED,
                data=data[at : at + READ_BYTES],
            )
            for at in range(0, len(data), READ_BYTES)
        ]
    for n in range(WHEELS_HZ):
        stamp_ns = second * _S + n * _S // WHEELS_HZ
        data = (second * 50 + n).to_bytes(8, "little")
        raw.append(RawFrame(device="wheels", stamp_ns=stamp_ns, identifier=0x181, data=data))
    return raw


def _decoded(second: int, ranges_m: np.ndarray) -> list[Sample]:
    samples: list[Sample] = [
        WheelSample(
            stamp_ns=second * _S + n * _S // WHEELS_HZ,
            left_rad=0.0314159 * (second * WHEELS_HZ + n),
            right_rad=0.0271828 * (second * WHEELS_HZ + n),
        )
        for n in range(WHEELS_HZ)
    ]
    if second % 2 == 0:
        samples += [
            Scan(
                scanner=name,
                stamp_ns=second * _S,
                ranges_m=np.round(row, 2),
                angle_min_rad=-2.35,
                angle_step_rad=0.0087,
            )
            for name, row in zip(("front", "rear"), ranges_m, strict=False)
        ]
    return samples


def _pose(second: int, n: int) -> PoseMessage:
    stamp_ns = second * _S + n * _S // WHEELS_HZ
    x_m = 1e-9 * stamp_ns / 3.0
    estimate = PoseEstimate(
        stamp_ns=stamp_ns,
        map_from_base=Pose2(x_m, 0.3, 0.1),
        covariance=np.diag([1e-4, 2e-4, 3e-5]) * (1.0 + x_m),
        odom_from_base=Pose2(x_m, 0.0, 0.1),
        vx_mps=0.3,
        omega_radps=0.01,
        state=State.LOCALIZED,
        epoch=1,
        error95_m=0.02,
        since_fix_s=0.5,
        since_fix_m=0.1,
    )
    return pose_message(estimate, robot="amr7", seq=n, utc_from_monotonic_ns=0, map_id=None)


if __name__ == "__main__":
    sys.exit(main())
