"""What passes through the daemon, kept in a ring and written to a file, off the loop's thread.

Device threads and the loop only append to a list; one thread encodes it five times a second, into
the ring and, with ``--record``, into a file. Another one saves the ring when that is asked for.
"""

from __future__ import annotations

import json
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, Literal

from amr_drivers import registry
from amr_slam.config import Config
from amr_slam.durable import sync_folder
from amr_slam.recording import About, RecordedDevice, RecordingWriter
from amr_slam.recording import Sample as Decoded
from amr_slam.recording.messages import Entry, encode, encode_decision, encode_published
from amr_slam.recording.ring import Kept, Ring
from amr_slam.rerun import Decision
from amr_slam.samples import WHEELS, Raw, RawBytes, Way, untapped
from amr_slam.service.map_view import MapView
from amr_slam.service.record_file import LEAST_FREE_BYTES, RecordFile, free_bytes, write_map
from amr_slam.service.shelf import Shelf
from amr_slam.serving.asked import Put
from amr_slam.wire import PoseMessage, StatusMessage

_log = logging.getLogger(__name__)

_PERIOD_S: Final = 0.2
_MAX_WAITING: Final = 100_000
"""Things that wait for the thread: a minute and a half of two scanners, while a disk hangs."""
_MAX_FILE_BYTES: Final = 8 << 20
_CLOSE_LIMIT_S: Final = 0.4  # what the other parts leave of the 5 s of a stop

_Published = PoseMessage | StatusMessage
_Item = Raw | Decoded | Decision | tuple[int, _Published]


class Recorder:
    """Ring and file of one daemon. Everything but :meth:`close` returns at once; any thread."""

    def __init__(self, config: Config, config_path: Path, record: Path | None = None) -> None:
        """``record``: a file for everything from now on. Raises OSError: it cannot be written."""
        settings = config.recording
        self._directory = settings.directory
        self._robot = config.robot.name
        self._config_text = config_path.read_text("utf-8")
        self._devices = _devices(config)
        self._view = MapView()
        self._mountings = {
            scanner.name: scanner.mounting.mounting.base_from_lidar for scanner in config.scanners
        }
        self._ring = Ring(settings.ring_s, round(1e6 * settings.ring_mb))
        self._keeps = settings.ring_s > 0.0
        self._shelf = Shelf(
            settings.directory / "automatic",
            round(1e6 * settings.automatic_mb),
            settings.automatic_count,
        )
        self.saves_by_itself = self._keeps and settings.automatic_mb > 0.0
        """Whether there is a ring to save without being asked, and room for it."""
        self.trouble: str | None = None
        """Why the last saving failed; None when it did not."""
        self._file = None if record is None else RecordFile(record, self._described(record))
        self._lock = threading.Lock()
        self._waiting: list[_Item] = []
        self._overrun = False
        self._wanted: tuple[Path, str] | None = None
        self._saving: threading.Thread | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        if self._keeps or record is not None:
            self._thread.start()

    @property
    def records(self) -> bool:
        """Whether anything is kept of what it is given."""
        return self._thread.is_alive()

    @property
    def tap(self) -> Callable[[Raw], object]:
        """For the drivers."""
        return self._put if self._thread.is_alive() else untapped

    def shows_maps(self, put: Put) -> None:
        """From now on recordings show the active map, which ``put`` has drawn."""
        if self._thread.is_alive():
            self._view.put = put

    def take(self, sample: Decoded) -> None:
        """A sample that the localizer gets."""
        if self._thread.is_alive():
            self._put(sample)

    def published(self, message: _Published) -> None:
        """A message that leaves the robot."""
        if self._thread.is_alive():
            self._put((time.monotonic_ns(), message))

    def decided(self, decision: Decision) -> None:
        """What the loop does with the localizer."""
        if self._thread.is_alive():
            self._put(decision)

    def save(self, reason: str, *, automatic: bool = False) -> Path | None:
        """Have the ring saved; where it will be. None: there is none, or the last saving goes on.

        ``automatic``: nobody has asked for it; it goes when others come.
        Raises ValueError when ``reason`` is not 1 to 40 letters, digits, '_' or '-'.
        """
        if not re.fullmatch(r"[A-Za-z0-9_-]{1,40}", reason):
            raise ValueError(f"{reason!r:.60} should be 1 to 40 letters, digits, '_' or '-'")
        if not self._keeps:
            _log.warning("nothing to save: recording.ring_s is 0")
            return None
        folder = self._shelf.folder if automatic else self._directory
        path = folder / f"{self._robot}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{reason}.mcap"
        with self._lock:
            if self._wanted is not None or (self._saving and self._saving.is_alive()):
                _log.warning("%s: not saved: the last saving still goes on", path)
                return None
            self._wanted = path, reason
        return path

    def close(self) -> None:
        """Complete the file; a saving that goes on is given up. Idempotent."""
        self._stopping.set()
        deadline_s = time.monotonic() + _CLOSE_LIMIT_S
        for thread in (self._thread, self._saving):
            if thread is not None and thread.is_alive():
                thread.join(max(0.0, deadline_s - time.monotonic()))
                if thread.is_alive():
                    _log.warning("%s: the disk does not answer; left behind", thread.name)

    def _put(self, item: _Item) -> None:
        with self._lock:
            if len(self._waiting) < _MAX_WAITING:
                self._waiting.append(item)
            else:
                self._overrun = True

    # -- the thread ------------------------------------------------------------------------

    def _run(self) -> None:
        stopping = False
        while not stopping:
            stopping = self._stopping.wait(_PERIOD_S)
            self._turn()
        if self._file is not None:
            self._file.close()

    def _turn(self) -> None:
        with self._lock:
            items, self._waiting = self._waiting, []
            overrun, self._overrun = self._overrun, False
            wanted = self._wanted
        for item in items:
            if isinstance(item, tuple) and isinstance(item[1], StatusMessage):
                self._view.follow(item[1], 1e-9 * item[0])
        entries = [_entry(item) for item in items]
        now_ns = time.monotonic_ns()
        if overrun:
            _log.warning("recording: the disk was too slow: there is a gap in it")
            entries += [
                encode(RawBytes(device=device.name, stamp_ns=now_ns, way=Way.GAP))
                for device in self._devices
            ]
        if self._file is not None:
            self._file.write(entries, self._view.newest, now_ns)
        if self._keeps:
            self._ring.add(entries, now_ns)
        if wanted is not None:
            saving = threading.Thread(
                target=self._save,
                args=(self._ring.kept(now_ns), *wanted),
                name="recorder-saving",
                daemon=True,
            )
            saving.start()
            with self._lock:
                self._saving, self._wanted = saving, None

    def _save(self, kept: Kept, path: Path, reason: str) -> None:
        """A file that is there is whole: it gets its name when it is complete."""
        part = path.with_name(f".{path.name}.part")
        automatic = path.parent == self._shelf.folder
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._make_room(kept.size_bytes, automatic=automatic)
            try:
                with self._described(part, reason) as writer:
                    picture = self._view.newest
                    for entries in kept.parts():
                        if picture is not None:
                            write_map(writer, picture, entries[0].stamp_ns)
                            picture = None
                        self._write_part(writer, entries)
                with part.open("rb") as written:
                    os.fsync(written.fileno())
                part.replace(path)
                sync_folder(path.parent)
            finally:
                part.unlink(missing_ok=True)
            if automatic:
                self._shelf.trim()
        except OSError as error:
            self._complain(path, error.strerror or str(error))
        except _NoRoomError as error:
            self._complain(path, str(error))
        except _GivenUpError:
            _log.warning("%s: not saved: stopping", path)
        else:
            self.trouble = None
            _log.info("%s: saved", path)

    def _make_room(self, size_bytes: int, *, automatic: bool) -> None:
        """Automatic recordings give way to the others, and to the disk's least free space."""
        if automatic and not self._shelf.make_room(size_bytes):
            raise _NoRoomError(f"{size_bytes >> 20} MiB are more than recording.automatic_mb")
        while free_bytes(self._shelf.folder) < LEAST_FREE_BYTES + size_bytes:
            if not self._shelf.drop_oldest():
                raise _NoRoomError("the disk is nearly full")

    def _complain(self, path: Path, reason: str) -> None:
        self.trouble = f"{path}: not saved: {reason}"
        _log.warning("%s", self.trouble)

    def _write_part(self, writer: RecordingWriter, entries: Sequence[Entry]) -> None:
        begun_s = time.monotonic()
        for entry in entries:
            writer.add(entry)
        # Half of the time is the loop's: no pose waits for a saving.
        if self._stopping.wait(time.monotonic() - begun_s):
            raise _GivenUpError

    def _described(self, path: Path, reason: str = "") -> RecordingWriter:
        writer = RecordingWriter(path, self._mountings)
        about = About(
            robot=self._robot,
            version=version("amr-slam"),
            monotonic_ns=time.monotonic_ns(),
            utc_ns=time.time_ns(),
            config=self._config_text,
            reason=reason,
        )
        writer.describe(about, self._devices)
        return writer


class _NoRoomError(Exception):
    """A recording that the disk must not take."""


class _GivenUpError(Exception):
    """The daemon stops."""


def _entry(item: _Item) -> Entry:
    if isinstance(item, tuple):
        stamp_ns, message = item
        return encode_published(message.kind, stamp_ns, message.encode())
    if isinstance(item, Decision):
        return encode_decision(item.stamp_ns, item.do, item.arguments)
    return encode(item)


def _devices(config: Config) -> tuple[RecordedDevice, ...]:
    odometry = config.odometry
    return (
        _device(WHEELS, "odometry", odometry.driver, odometry.options),
        *(_device(s.name, "scanner", s.driver, s.options) for s in config.scanners),
    )


def _device(
    name: str, kind: Literal["scanner", "odometry"], driver: str, options: Any
) -> RecordedDevice:
    module = registry.scanner_module if kind == "scanner" else registry.odometry_module
    files = {}
    for field in registry.file_fields(module(driver)):
        path = getattr(options, field)
        if not path:
            continue
        try:
            with Path(path).open("rb") as stream:
                files[field] = stream.read(_MAX_FILE_BYTES)
        except OSError as error:  # the driver itself refuses what it cannot do without
            _log.warning("%s: recordings lack %s: %s", name, field, error.strerror)
    settings = json.dumps(asdict(options), allow_nan=False)
    return RecordedDevice(name=name, kind=kind, driver=driver, settings=settings, files=files)
