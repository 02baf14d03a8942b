"""Recorded bytes and frames through the drivers' own decoders, once more.

A driver's decoder is pure, so the samples are those that the driver gave, to the bit. Live, a new
one is made whenever the device is opened, and so it is here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from amr_drivers import registry
from amr_drivers.background import ScanDecoder
from amr_slam.recording import Log, RecordedDevice, RecordingError
from amr_slam.samples import CanFrame, DriveSample, Raw, RawBytes, RawFrame, Scan, Way

_log = logging.getLogger(__name__)


class WheelDecoder(Protocol):
    """Frames of one bus to wheel samples. Pure: the same calls give the same samples."""

    def received(self, frame: CanFrame) -> Sequence[DriveSample]:
        """Take in the next frame, whatever it is; the samples that it completes."""


def module_of(device: RecordedDevice) -> registry.ScannerModule | registry.OdometryModule:
    """The driver's module. Raises ValueError: unknown here."""
    if device.kind == "scanner":
        return registry.scanner_module(device.driver)
    return registry.odometry_module(device.driver)


def with_decoded(log: Log, settings_of: Callable[[RecordedDevice], Any]) -> Log:
    """The log with the samples that its raw channels give, in place of those recorded beside them.

    ``settings_of`` checks a recorded device's settings and gives the driver's ``Settings``; it
    raises ValueError, or RecordingError that names the channel. Devices without a decoder, or of
    which nothing came, keep the recorded samples. Raises RecordingError, naming the channel, for a
    driver that is not known here or cannot decode with these settings.
    """
    samples = list(log.samples)
    for device in log.devices:
        passed = [raw for raw in log.raw if raw.device == device.name]
        if not any(isinstance(raw, RawFrame) or raw.data for raw in passed):
            continue
        with _naming(device):
            module = module_of(device)
            kind = "scan_decoder" if device.kind == "scanner" else "wheel_decoder"
            make = getattr(module, kind, None)
            if make is None:
                _log.warning(
                    "/raw/%s: driver %s decodes no recordings: the samples recorded with it are "
                    "used",
                    device.name,
                    device.driver,
                )
                continue
            settings = settings_of(device)
            with _files_in_place(device, registry.file_fields(module), settings) as placed:
                decoded = _decoded(device, passed, make, placed)
        samples = [one for one in samples if not _is_of(one, device)]
        samples += decoded
    return replace(log, samples=tuple(samples))


@contextmanager
def _naming(device: RecordedDevice) -> Iterator[None]:
    try:
        yield
    except RecordingError:
        raise
    except ValueError as error:
        raise RecordingError(f"/raw/{device.name}: {error}") from error


def _is_of(sample: object, device: RecordedDevice) -> bool:
    if isinstance(sample, Scan):
        return device.kind == "scanner" and sample.scanner == device.name
    return device.kind == "odometry"


@contextmanager
def _files_in_place(device: RecordedDevice, fields: Iterable[str], settings: Any) -> Iterator[Any]:
    """The settings with the recorded contents of their files; no path of a recording is opened."""
    with TemporaryDirectory(prefix="amr-slam-") as folder:
        paths = {}
        for index, field in enumerate(fields):
            if not getattr(settings, field):
                continue
            if field not in device.files:
                raise ValueError(f"the recording lacks the file that {field} names")
            path = Path(folder) / str(index)
            path.write_bytes(device.files[field])
            paths[field] = str(path)
        yield replace(settings, **paths) if paths else settings


def _decoded(
    device: RecordedDevice, passed: Iterable[Raw], make: Callable[..., Any], settings: Any
) -> list[Scan] | list[DriveSample]:
    if device.kind == "scanner":
        return _scans(passed, lambda start_ns: make(device.name, settings, start_ns))
    return _wheels(passed, lambda start_ns: make(settings, start_ns))


def _scans(passed: Iterable[Raw], make: Callable[[int], ScanDecoder]) -> list[Scan]:
    scans: list[Scan] = []
    decoder: ScanDecoder | None = None
    for raw in passed:
        if not isinstance(raw, RawBytes):
            continue
        if decoder is None or raw.way is Way.OPENED:
            decoder = make(raw.stamp_ns)
        if raw.way is Way.RECEIVED:
            scans += decoder.received(raw.data, raw.stamp_ns)
        elif raw.way is Way.SENT:
            decoder.sent(raw.data, raw.stamp_ns)
        elif raw.way is Way.GAP:
            decoder.gap()
    return scans


def _wheels(passed: Iterable[Raw], make: Callable[[int], WheelDecoder]) -> list[DriveSample]:
    """Segments go on over a reopening, as the service counts them."""
    samples: list[DriveSample] = []
    decoder: WheelDecoder | None = None
    first_segment, segment = 0, -1
    for raw in passed:
        if isinstance(raw, RawBytes):
            # After a gap in the recording nothing is integrated, either.
            decoder = None if raw.way in {Way.OPENED, Way.GAP} else decoder
            continue
        if decoder is None:
            decoder, first_segment = make(raw.stamp_ns), segment + 1
        for sample in decoder.received(raw):
            segment = first_segment + sample.segment
            samples.append(replace(sample, segment=segment))
    return samples
