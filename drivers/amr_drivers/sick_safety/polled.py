"""A scanner that is asked for its newest scan over TCP."""

from __future__ import annotations

import threading
import time
from typing import Final

from amr_drivers.background import BackgroundScanner
from amr_drivers.errors import BadTelegram, LinkLost, LinkTimeout
from amr_drivers.sick_safety.cola2 import UNKNOWN_SESSION
from amr_drivers.sick_safety.decoder import PolledDecoder
from amr_drivers.sick_safety.identity import Identity, read_identity, required_action
from amr_drivers.sick_safety.session import Refused, Session
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.variables import LATEST_TELEGRAM
from amr_drivers.transport import TcpStream
from amr_slam.samples import DeviceInfo, Tap

_IDLE_S: Final = 60
"""The scanner ends a session that asks nothing for so long; three polls at the slowest."""
_SLICE_S: Final = 0.05
_ACTION_S: Final = 5.0
"""A scanner that does not measure is asked this often what has to be done to it."""
_SPREAD_S: Final = 0.05
"""Questions are spread over so long, a scan period at most..."""
_GOLDEN: Final = 0.618034
"""...in steps of this part of it: soon one comes right after a scan was completed, even where the
poll interval is a multiple of the scan period. Such answers tell when all others were measured."""


class Polled(BackgroundScanner):
    """A :class:`amr_slam.samples.Scanner`."""

    def __init__(self, name: str, settings: Settings, tap: Tap) -> None:
        now_ns = time.monotonic_ns()
        self._settings = settings
        self._polling = PolledDecoder(name, settings, now_ns)
        super().__init__(name, self._polling, tap)
        self._address = f"{settings.host}:{settings.port}"
        self._stopping = threading.Event()
        self._stream = TcpStream(settings.host, settings.port)
        self._session = Session(
            self._address,
            self._stream,
            answer_s=settings.silence_s,
            stopping=self._stopping,
            heard=self._take,
            sent=self._note_sent,
        )
        self._identity: Identity | None = None
        self._action: str | None = None
        self._action_ns = now_ns
        self._begun_ns = now_ns
        self._polls = 0
        self._start()

    def info(self) -> DeviceInfo:
        identity = self._identity or Identity()
        facts = (("mode", "poll"), *identity.facts, *self._polling.facts())
        return DeviceInfo(model=identity.model, address=self._address, facts=facts)

    def status(self) -> tuple[int, str | None]:
        """See :class:`amr_slam.samples.Scanner`."""
        errors, hindrance = super().status()
        if hindrance is None or self._action is None or self._fault is not None:
            return errors, hindrance
        return errors, f"{hindrance}; the scanner asks for: {self._action}"

    def close(self) -> None:
        """Idempotent."""
        super().close()
        self._stream.close()

    def _turn(self) -> None:
        try:
            self._work()
        except (LinkTimeout, BadTelegram, Refused):
            # The line stands: a session that is not given back would be missed by the next.
            self._session.close()
            raise

    def _work(self) -> None:
        if self._stopping.is_set():
            self._session.close()
            raise LinkLost(f"{self._address}: closed")
        if self._identity is None:
            self._session.open(_IDLE_S)
            self._identity = read_identity(self._session)
            self._begun_ns = time.monotonic_ns()
        wait_s = self._until_due_s()
        if wait_s > 0.0:
            # Nothing is expected, but a hang-up is noticed.
            if data := self._stream.read(min(wait_s, _SLICE_S)):
                self._take(data, time.monotonic_ns())
            return
        self._polls += 1
        self._poll()
        if self._polling.hindered:
            self._ask_for_action()
        else:
            self._action = None

    def _until_due_s(self) -> float:
        interval_s = self._settings.poll_interval_s
        since_s = 1e-9 * (time.monotonic_ns() - self._begun_ns)
        # Polls that a stall has swallowed are not made up for.
        self._polls = max(self._polls, int(since_s / interval_s))
        spread_s = min(_SPREAD_S, 0.5 * interval_s) * (_GOLDEN * self._polls % 1.0)
        return self._polls * interval_s + spread_s - since_s

    def _poll(self) -> None:
        index = LATEST_TELEGRAM + self._settings.channel
        try:
            self._session.read(index)
        except Refused as reason:
            if reason.code != UNKNOWN_SESSION:
                return  # the decoder has heard it, too, and says so
            self._session.open(_IDLE_S)
            self._session.read(index)

    def _ask_for_action(self) -> None:
        now_ns = time.monotonic_ns()
        if now_ns - self._action_ns > 1e9 * _ACTION_S:
            self._action_ns = now_ns
            self._action = required_action(self._session)

    def _hang_up(self) -> None:
        self._stopping.set()

    def _max_age_s(self) -> float:
        return self._polling.silence_s
