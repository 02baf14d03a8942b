"""What the driver says to a device, and when. No socket, no clock of its own.

1. Finding the dialect. A device is silent to the wrong one, and some stay mute after it until the
   connection is made anew, so that each dialect is tried on a connection of its own: CoLa B for
   1 s, then CoLa A for 1 s. Any answer settles it, a refusal as well.
2. Optional questions, for the technician. What is refused or not answered in 0.5 s is left out.
3. Scans: polled, one question in flight; or streamed, subscribed to. A stream that pauses is asked
   for the device's state, which tells a device in standby from one that is gone.
"""

from __future__ import annotations

import enum
from collections import deque

from amr_drivers.errors import LinkLost
from amr_drivers.sick_cola.decoder import ColaDecoder
from amr_drivers.sick_cola.framing import Dialect
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    OUTPUT_RANGE,
    SCAN,
    STATE,
    event_request,
    read_request,
)
from amr_drivers.sick_cola.settings import Settings

_PATIENCE_S = 1.0
"""For the first answer in a dialect."""
_OPTIONAL_S = 0.5
_OPTIONAL = (FIRMWARE, STATE, OUTPUT_RANGE)
_AGAIN_S = 2.0
"""Between two subscriptions of a stream that does not come, and two refused questions."""
_WARM_UP_S = 1.0
"""For so long at most after its first scan a polled device is asked at once again, until a second
one was seen to become ready."""
_STATE_POLLS = 4
"""Of a device that sends no distances every fourth question is for its state."""
_GOLDEN = 0.618034
"""Multiples of it fall evenly between 0 and 1: polls then meet all phases of the mirror, of which
the promptest answers set the clock."""


class Step(enum.Enum):
    """What the driver is to do other than sending."""

    WAIT = enum.auto()
    RECONNECT = enum.auto()


class Dialogue:
    """One dialogue, over several connections while the dialect is being found."""

    def __init__(self, settings: Settings, decoder: ColaDecoder, now_ns: int) -> None:
        self._settings = settings
        self._decoder = decoder
        dialects = [Dialect.B, Dialect.A]
        if settings.dialect != "auto":
            dialects = [Dialect(settings.dialect)]
        self._untried = deque(dialects)
        self._trying = self._untried.popleft()
        self._questions = deque(_OPTIONAL)
        self._asked_ns: int | None = None
        self._since_ns = now_ns
        self._polls = 0
        self._subscribed_ns: int | None = None
        self._due_ns = now_ns

    @property
    def streaming(self) -> bool:
        """The device has been told to send."""
        return self._subscribed_ns is not None

    @property
    def warming_up(self) -> bool:
        """How old a polled scan is cannot be told yet: it must not be given."""
        polled = self._settings.delivery == "polled"
        return polled and not self._decoder.settled

    def connected(self, now_ns: int) -> None:
        """The connection was made anew, as asked for."""
        self._asked_ns, self._since_ns = None, now_ns
        self._decoder.gap()

    def next(self, now_ns: int) -> bytes | Step:
        """What to send now, or what to do instead. Raises LinkLost."""
        if self._decoder.late_s > self._decoder.silence_s:
            raise LinkLost("only old scans come")
        if self._decoder.dialect is None:
            return self._find_dialect(now_ns)
        if self._questions and (question := self._optional(now_ns)) is not None:
            return question
        if self._settings.delivery == "polled":
            return self._poll(now_ns)
        return self._stream(now_ns)

    def stop(self) -> bytes:
        """Ends the subscription."""
        return event_request(SCAN, self._dialect, on=False)

    @property
    def _dialect(self) -> Dialect:
        return self._decoder.dialect or self._trying

    def _ask(self, name: str, now_ns: int) -> bytes:
        self._asked_ns = now_ns
        return read_request(name, self._dialect)

    def _waited_s(self, now_ns: int) -> float | None:
        """For how long the request in flight has been; None: none is."""
        if self._decoder.pending is None or self._asked_ns is None:
            return None
        return 1e-9 * (now_ns - self._asked_ns)

    def _find_dialect(self, now_ns: int) -> bytes | Step:
        waited_s = self._waited_s(now_ns)
        if waited_s is None:
            return self._ask(IDENT, now_ns)
        if waited_s < _PATIENCE_S:
            return Step.WAIT
        if not self._untried:
            tried = (
                "CoLa A and B"
                if self._settings.dialect == "auto"
                else f"CoLa {self._trying.upper()}"
            )
            raise LinkLost(f"no answer in {tried}: another device, another dialect, or starting up")
        self._trying = self._untried.popleft()
        return Step.RECONNECT

    def _optional(self, now_ns: int) -> bytes | Step | None:
        waited_s = self._waited_s(now_ns)
        if waited_s is not None and waited_s < _OPTIONAL_S:
            return Step.WAIT
        question = self._questions.popleft()
        # Time spent with questions is no silence of the stream.
        self._since_ns = self._due_ns = now_ns
        return self._ask(question, now_ns)

    def _poll(self, now_ns: int) -> bytes | Step:
        waited_s = self._waited_s(now_ns)
        if waited_s is not None:
            if waited_s > self._decoder.silence_s:
                raise LinkLost(f"no answer for {waited_s:.1f} s")
            return Step.WAIT
        if now_ns < self._due_ns and not self._hurried(now_ns):
            return Step.WAIT
        self._due_ns = now_ns + round(1e9 * self._pause_s())
        self._polls += 1
        why = self._decoder.idle and self._polls % _STATE_POLLS == 0
        return self._ask(STATE if why else SCAN, now_ns)

    def _hurried(self, now_ns: int) -> bool:
        first_ns = self._decoder.first_scan_ns
        return self.warming_up and first_ns is not None and now_ns - first_ns < 1e9 * _WARM_UP_S

    def _pause_s(self) -> float:
        if self._decoder.scan_ns <= self._since_ns and self._polls > 0:
            return max(_OPTIONAL_S, self._settings.poll_interval_s)  # refused so far
        # Who asks more often than the mirror turns meets all phases anyway.
        interval_s = self._settings.poll_interval_s
        phase = self._polls * _GOLDEN % 1.0
        return interval_s + phase * min(interval_s, self._decoder.period_s)

    def _stream(self, now_ns: int) -> bytes | Step:
        if self._subscribed_ns is None:
            return self._subscribe(now_ns)
        limit_ns = round(1e9 * self._decoder.silence_s)
        if now_ns - max(self._since_ns, self._decoder.heard_ns) > limit_ns:
            raise LinkLost(f"silent for {1e-9 * limit_ns:.1f} s")
        quiet_ns = now_ns - max(self._decoder.scan_ns, self._since_ns)
        if quiet_ns < limit_ns // 2 or self._waited_s(now_ns) is not None:
            return Step.WAIT
        if now_ns - self._subscribed_ns > 1e9 * _AGAIN_S:
            return self._subscribe(now_ns)
        if self._asked_ns is not None and now_ns - self._asked_ns < limit_ns // 2:
            return Step.WAIT
        return self._ask(STATE, now_ns)

    def _subscribe(self, now_ns: int) -> bytes:
        self._since_ns = self._since_ns if self.streaming else now_ns
        self._subscribed_ns = self._asked_ns = now_ns
        return event_request(SCAN, self._dialect, on=True)
