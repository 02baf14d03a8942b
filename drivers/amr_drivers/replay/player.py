"""The recording that replayed devices share, moved to the present."""

from __future__ import annotations

import time
from bisect import bisect_left
from dataclasses import replace
from pathlib import Path

from amr_drivers.playing import Hold, Shared, deadline_ns
from amr_slam.recording import Sample, read_log
from amr_slam.samples import Scan


class Player:
    """A log whose first sample is now. Raises RecordingError (a ValueError) as ``read_log``."""

    def __init__(self, path: str) -> None:
        self.samples = read_log(Path(path)).samples
        if not self.samples:
            raise ValueError(f"{path}: the recording is empty")
        self.shift_ns = time.monotonic_ns() - self.samples[0].stamp_ns


_NEVER = 2**63
_GRACE_NS = 1_000_000_000
"""Devices are opened one after the other; none misses the beginning for that."""

PLAYERS: Shared[str, Player] = Shared(Player)
"""By path."""


class Track:
    """One device's samples in a recording: those of scanner ``scanner``, or of the wheels (None).

    Raises ValueError when the recording has none.
    """

    def __init__(self, path: str, scanner: str | None) -> None:
        self._path = path
        self._hold = Hold(PLAYERS, path)
        player = self._hold.value
        self._samples = [
            sample
            for sample in player.samples
            if (sample.scanner if isinstance(sample, Scan) else None) == scanner
        ]
        if not self._samples:
            self._hold.close()
            names = sorted({s.scanner for s in player.samples if isinstance(s, Scan)})
            wanted = "wheels" if scanner is None else f"scanner {scanner!r}"
            raise ValueError(f"{path}: no {wanted}; scanners in it: {', '.join(names) or 'none'}")
        self._stamps_ns = [sample.stamp_ns + player.shift_ns for sample in self._samples]
        # Joined late: what is over is not played.
        self._next = bisect_left(self._stamps_ns, time.monotonic_ns() - _GRACE_NS)

    @property
    def ended(self) -> bool:
        return self._next >= len(self._samples)

    def read(self, timeout_s: float) -> Sample | None:
        """The next sample at its time, stamped in the present. Raises LinkLost once closed."""
        deadline = deadline_ns(timeout_s)
        due_ns = _NEVER if self.ended else self._stamps_ns[self._next]
        if not self._hold.wait_until(due_ns, deadline):
            return None
        self._next += 1
        return replace(self._samples[self._next - 1], stamp_ns=due_ns)

    def status(self) -> tuple[int, str | None]:
        return 0, "the recording has ended" if self.ended else None

    def close(self) -> None:
        self._hold.close()
