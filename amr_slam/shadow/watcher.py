"""The thread of shadow mode: hears both systems, pairs what they say, counts."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from typing import Final

from amr_slam.geometry import wrap_angle
from amr_slam.shadow.clock import ClockDifference
from amr_slam.shadow.comparison import Comparison
from amr_slam.shadow.file import PairFile
from amr_slam.shadow.history import History, Known
from amr_slam.shadow.messages import CameraPose, CameraPoseError, parse
from amr_slam.shadow.settings import ShadowSettings
from amr_slam.states import State
from amr_slam.wire import PoseMessage, ShadowPart

_log = logging.getLogger(__name__)

_QUEUE: Final = 512
_WAITING: Final = 512
_SAID: Final = 2048
"""Poses of the robot that are not taken in yet: ten seconds at the highest rate."""
_PERIOD_S: Final = 0.05
_MOST_HZ: Final = 200
"""Messages a second that are looked at; the rest is counted as dropped."""
_PATIENCE_S: Final = 2.0
"""So long a pose that is ahead of the robot's waits for these."""
_COMPLAINT_S: Final = 60.0
_STILL_TOLD_S: Final = 10.0
_COMPARED: Final = frozenset({State.LOCALIZED, State.MAPPING, State.ODOMETRY_ONLY})
_SLACK_S: Final = 1e-3
_PART_S: Final = 0.25
_CLOSE_S: Final = 1.0


class Shadow:
    """:meth:`heard` is for any thread, :meth:`said` and :meth:`part` for the loop's; none of them
    waits."""

    def __init__(self, settings: ShadowSettings, robot: str) -> None:
        assert settings.key is not None
        self._settings, self._robot, self._key = settings, robot, settings.key
        self._map_from_camera = settings.map_from_camera.pose
        self._base_from_marker = settings.base_from_marker.pose
        self._payloads: deque[tuple[bytes, float]] = deque(maxlen=_QUEUE)
        self._said: deque[PoseMessage] = deque(maxlen=_SAID)
        # From here on the thread's own, but for the part that it puts in place as a whole.
        self._history = History()
        self._clock = ClockDifference(settings.clock_s)
        self._waiting: deque[tuple[CameraPose, float]] = deque(maxlen=_WAITING)
        self._comparison: Comparison | None = None
        self._clock_told = False
        self._counts = {"received": 0, "refused": 0, "unmatched": 0, "unlocalized": 0, "dropped": 0}
        self._second, self._in_second = 0, 0
        self._detail: str | None = None
        self._detail_s = self._logged_s = -math.inf
        self._unlogged = 0
        self._paired_s: float | None = None
        self._written_s = -math.inf
        path = settings.directory / f"{robot}-shadow.csv"
        self._file = PairFile(path, round(1e6 * settings.file_mb))
        self._made_s = time.time()
        self._part = self._made(self._made_s)
        self._stopping = threading.Event()
        # A daemon: a disk that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._run, name="shadow", daemon=True)
        self._thread.start()

    def heard(self, payload: bytes) -> None:
        """Something on the key; the oldest goes where too much comes."""
        self._payloads.append((payload, time.time()))

    def said(self, message: PoseMessage) -> None:
        """The robot has published this pose."""
        self._said.append(message)

    def part(self) -> ShadowPart:
        """For the status, half a second old at most."""
        return self._part

    def close(self) -> None:
        """Idempotent."""
        self._stopping.set()
        self._thread.join(_CLOSE_S)

    # -- the thread ------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stopping.wait(_PERIOD_S):
            self.turn(time.time())
        self._file.close()

    def turn(self, now_s: float) -> None:
        """Take in all that came (``now_s``: UTC). The thread does it; tests may without one."""
        while self._said:
            self._history.add(self._said.popleft())
        while self._payloads:
            self._take(*self._payloads.popleft())
        for _ in range(len(self._waiting)):
            camera, received_s = self._waiting.popleft()
            self._pair(camera, received_s, now_s)
        if abs(now_s - self._made_s) >= _PART_S:
            self._made_s = now_s
            self._part = self._made(now_s)

    def _take(self, payload: bytes, received_s: float) -> None:
        self._counts["received"] += 1
        second = int(received_s)
        self._in_second = self._in_second + 1 if second == self._second else 1
        self._second = second
        if self._in_second > _MOST_HZ:
            self._counts["dropped"] += 1
            self._complain(f"more than {_MOST_HZ} messages a second", received_s)
            return
        try:
            camera = parse(payload, self._settings, self._robot, received_s)
        except CameraPoseError as error:
            self._counts["refused"] += 1
            self._complain(str(error), received_s)
            return
        if camera is None:
            return
        self._clock.arrived(camera.stamp_s, received_s)
        self._waiting.append((camera, received_s))

    def _complain(self, text: str, now_s: float) -> None:
        """In the status at once, in the log once a minute."""
        line = "".join(c if c.isprintable() else "?" for c in text)[:200]
        self._detail, self._detail_s = line, now_s
        self._unlogged += 1
        if time.monotonic() - self._logged_s >= _COMPLAINT_S:
            self._logged_s = time.monotonic()
            _log.warning("shadow, %s: %s (%d such messages)", self._key, line, self._unlogged)
            self._unlogged = 0

    def _pair(self, camera: CameraPose, received_s: float, now_s: float) -> None:
        newest_s = self._history.newest_s
        at_s = camera.stamp_s + self._clock.known.clock_s
        if newest_s is None or at_s > newest_s:
            if now_s - received_s < _PATIENCE_S:
                self._waiting.append((camera, received_s))
            else:
                self._counts["unmatched"] += 1
                self._complain("stamped when no pose of the robot was published", now_s)
            return
        known = self._history.at(at_s)
        if known is None:
            self._counts["unmatched"] += 1
            self._complain("stamped when no pose of the robot was published", now_s)
            return
        if known.said.state not in _COMPARED:
            self._counts["unlocalized"] += 1
            return
        self._paired_s = now_s
        # Without the estimate of the clock, which moves: what is learned from must stay alike.
        plain_s = camera.stamp_s + self._clock.base_s
        plain = self._history.at(plain_s)
        if plain is not None:
            self._note_clock(camera, plain)
            self._record(camera, plain, plain_s)
        if self._clock.known.sigma_s is not None and not self._clock_told:
            self._clock_told = True
            self._comparison = None  # what was compared before was of other instants
        self._compare(camera, known, at_s)

    def _note_clock(self, camera: CameraPose, plain: Known) -> None:
        dx_m, dy_m, dtheta_rad = self._difference(camera, plain)
        if dtheta_rad is not None:
            self._clock.note(plain.said.omega, dtheta_rad)
        elif math.hypot(dx_m, dy_m) < 1.0:
            theta = plain.map_from_base.theta_rad
            self._clock.note(plain.said.vx, math.cos(theta) * dx_m + math.sin(theta) * dy_m)

    def _difference(self, camera: CameraPose, known: Known) -> tuple[float, float, float | None]:
        """Where the cameras have the marker, less where the robot's own pose puts it."""
        seen = self._map_from_camera @ camera.pose
        expected = known.map_from_base @ self._base_from_marker
        turn = wrap_angle(seen.theta_rad - expected.theta_rad)
        told = turn if camera.theta_rad is not None else None
        return seen.x_m - expected.x_m, seen.y_m - expected.y_m, told

    def _compare(self, camera: CameraPose, known: Known, at_s: float) -> None:
        if self._comparison is None or self._comparison.map_id != known.said.map:
            self._comparison = Comparison(known.said.map, at_s, self._settings.zone_m)
        place = known.map_from_base
        self._comparison.add(place.x_m, place.y_m, self._difference(camera, known))

    def _record(self, camera: CameraPose, known: Known, at_s: float) -> None:
        since_s = at_s - self._written_s
        if 0.0 <= since_s < self._settings.file_period_s - _SLACK_S:
            return
        self._written_s = at_s
        pose, said = known.map_from_base, known.said
        theta = "" if camera.theta_rad is None else f"{camera.theta_rad:.6f}"
        self._file.write(
            f"{at_s:.6f},{camera.x_m:.5f},{camera.y_m:.5f},{theta},"
            f"{pose.x_m:.5f},{pose.y_m:.5f},{pose.theta_rad:.6f},"
            f"{said.vx:.4f},{said.omega:.5f},{said.error95_m:.4f},"
            f"{said.state},{said.map or ''},{said.epoch}"
        )

    def _made(self, now_s: float) -> ShadowPart:
        clock, found = self._clock.known, self._comparison
        bias = (0.0, 0.0, 0.0) if found is None else found.bias
        turned = found is not None and found.turn.count > 0
        return ShadowPart(
            key=self._key,
            since=None if found is None else found.since_s,
            count=0 if found is None else found.way.count,
            mean_m=0.0 if found is None else found.way.mean,
            rms_m=0.0 if found is None else found.way.rms,
            p95_m=0.0 if found is None else found.way.percentile(0.95),
            max_m=0.0 if found is None else found.way.most,
            rms_rad=found.turn.rms if found is not None and turned else None,
            p95_rad=found.turn.percentile(0.95) if found is not None and turned else None,
            bias_x_m=bias[0],
            bias_y_m=bias[1],
            bias_rad=bias[2] if turned else None,
            clock_s=clock.clock_s,
            clock_sigma_s=clock.sigma_s,
            zones=() if found is None else found.zones.worst(),
            age_s=None if self._paired_s is None else max(0.0, now_s - self._paired_s),
            detail=self._detail if now_s - self._detail_s < _STILL_TOLD_S else None,
            **self._counts,
        )
