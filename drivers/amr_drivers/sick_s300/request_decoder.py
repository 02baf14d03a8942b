"""From the requests and answers of request mode to scans. Pure: no port, no clock."""

from __future__ import annotations

from collections import deque
from math import radians

import numpy as np
from numpy.typing import NDArray

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.dialogue import Dialogue
from amr_drivers.sick_s300.requests import (
    TOKEN_TAKEN,
    Answer,
    AnswerReader,
    Request,
    decode_request,
    encode_request,
    error_text,
    fetch_scan,
    scan_words,
)
from amr_drivers.sick_s300.settings import ADDRESSES, Settings
from amr_drivers.sick_s300.telegrams import (
    HEADER,
    RANGE_MAX_M,
    is_standby,
    ranges_from_words,
)
from amr_slam.samples import Scan

_REACTION_S = 0.25
"""What a scanner may take until it answers: nobody documents it; some scan periods."""
_FROZEN_PERIODS = 2.5
"""One scan may be fetched twice; for longer than this it is a scanner that does not scan anew."""
_REACTIONS = 10
"""Answers remembered: the quickest of them tells what the scanner itself needs."""
_SNIFFED = 21
"""Bytes of a wrong answer that are kept: one less than the beginning of a telegram of continuous
mode, which is looked for in it."""


class RequestDecoder:
    """An :class:`amr_drivers.background.ScanDecoder` that also knows what to ask next.

    One request is under way at a time. What comes without one, or after :attr:`deadline_ns`, is
    nobody's answer: the driver throws it away before the next request.
    """

    def __init__(self, name: str, settings: Settings, start_ns: int) -> None:
        """``start_ns``: since when the scanner could have been asked."""
        self._name = name
        self._settings = settings
        address = ADDRESSES[settings.device_address]
        self.dialogue = Dialogue(address, settings.beams)
        fetch = fetch_scan(address, settings.beams)
        self._answer_wire_s = 10.0 * fetch.answer_bytes / settings.baud_rate
        request_wire_s = 10.0 * len(encode_request(fetch)) / settings.baud_rate
        limit_s = request_wire_s + self._answer_wire_s + _REACTION_S + settings.latency_limit_s
        self.answer_limit_s = limit_s
        """From a request to its whole answer at the latest: both on the wire at 10 bits a byte, the
        scanner's reaction, the line's delay."""
        self._request: Request | None = None
        self._reader: AnswerReader | None = None
        self._sent_ns = start_ns
        self._first_byte_ns: int | None = None
        self._reactions_ns: deque[int] = deque(maxlen=_REACTIONS)
        self._answered_ns: int | None = None
        """When the newest answer with a scan began."""
        self._unanswered_since_ns: int | None = start_ns
        self._refusal: str | None = None
        self._refused = False
        self._takes_over = False
        self._hindrance: str | None = None
        self._stray: str | None = None
        self._sniffed = b""
        self._errors = 0
        self._words: NDArray[np.uint16] | None = None
        self._words_since_ns = 0

    @property
    def waits(self) -> bool:
        """True while a request is under way that may still be answered."""
        return self._request is not None

    @property
    def refused(self) -> bool:
        """True when the newest answer was an error that asking again at once will not cure."""
        return self._refused

    @property
    def deadline_ns(self) -> int:
        """Until when the answer must be complete."""
        return self._sent_ns + round(1e9 * self.answer_limit_s)

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        if self._reader is not None and self._request is not None:
            self._errors += 1
        request = decode_request(data)
        self.dialogue.sent(request)
        self._request, self._reader = request, AnswerReader(request)
        self._sent_ns, self._first_byte_ns = stamp_ns, None
        self._sniffed = b""
        if self._unanswered_since_ns is None:
            self._unanswered_since_ns = stamp_ns

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        request, reader = self._request, self._reader
        if request is None or stamp_ns > self.deadline_ns:
            return []
        if reader is None:
            self._sniff(data)
            return []
        if self._first_byte_ns is None:
            self._first_byte_ns = stamp_ns
        try:
            answer = reader.feed(data)
            if answer is None:
                return []
            self._request = None
            return self._hear(request, answer, stamp_ns)
        except BadTelegram as reason:
            # The rest of it may still come: nothing is asked before the deadline.
            self._reader = None
            self._errors += 1
            self._stray = f"bytes come that are no answer ({reason})"
            self._sniff(reader.held + data)
            return []

    def gap(self) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`. What was thrown away was the answer."""
        if self._reader is not None and self._request is not None:
            self._errors += 1
        self._reader = None

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        since_ns = self._unanswered_since_ns
        silent_s = 0.0 if since_ns is None else 1e-9 * (now_ns - since_ns)
        if silent_s <= self.answer_limit_s:
            return self._errors, self._refusal or self._hindrance
        stray = f"; {self._stray}" if self._stray else ""
        return self._errors, f"no answer for {silent_s:.1f} s{stray}"

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the answers say of the scanner, as (name, value): nothing."""
        return ()

    @property
    def silence_s(self) -> float:
        """How long a good line may be without a new scan."""
        settings = self._settings
        return max(settings.silence_s, settings.poll_interval_s) + 2.0 * self.answer_limit_s

    @property
    def max_age_s(self) -> float:
        """How old the first beam of the newest scan of such a line may be."""
        return self._settings.sweep_s + self._settings.scan_period_s + self.silence_s

    def _sniff(self, data: bytes) -> None:
        """What is it that comes instead of an answer?"""
        window = self._sniffed + data
        self._sniffed = window[-_SNIFFED:]
        if HEADER.search(window):
            self._stray = "the scanner sends by itself: it is in continuous mode"

    def _hear(self, request: Request, answer: Answer, stamp_ns: int) -> list[Scan]:
        self.dialogue.answered(request, answer)
        self._unanswered_since_ns = self._stray = None
        # A token that is still taken after it was released is somebody else's.
        takes_over = request.takes_token and answer.code == TOKEN_TAKEN and not self._takes_over
        self._refused = answer.code != 0 and not takes_over
        if request.takes_token:
            self._takes_over = answer.code == TOKEN_TAKEN
        if self._refused:
            self._errors += 1
            self._refusal = f"the scanner refuses: {error_text(answer.code)}"
        if answer.block is None:
            return []
        self._refusal = None
        words = scan_words(answer.block, self._settings.beams)
        answered_ns = self._answered_ns
        self._answered_ns = self._begun_ns(stamp_ns)
        repeated = self._repeats(words, stamp_ns)
        frozen_ns = 1e9 * _FROZEN_PERIODS * self._settings.scan_period_s
        is_frozen = repeated and stamp_ns - self._words_since_ns > frozen_ns
        self._hindrance = (
            "standby"
            if is_standby(words)
            else "frozen: the same scan is answered again and again"
            if is_frozen
            else None
        )
        if self._hindrance is not None or repeated:
            return []
        scan_period_ns = round(1e9 * self._settings.scan_period_s)
        delay_ns = self._delay_ns(self._answered_ns, scan_period_ns)
        if delay_ns > 1e9 * self._settings.latency_limit_s:
            self._errors += 1
            self._hindrance = f"an answer came {1e-9 * delay_ns:.2f} s late: how old is its scan?"
            return []
        # Its sweep had not ended when the answer before this one began.
        since_ns = scan_period_ns if answered_ns is None else self._answered_ns - answered_ns
        ready_ns = self._answered_ns - min(scan_period_ns, since_ns) // 2 - delay_ns
        return [self._scan(words, ready_ns)]

    def _repeats(self, words: NDArray[np.uint16], stamp_ns: int) -> bool:
        """True when these are the values of the answer before: the same scan, not a new one."""
        if self._words is not None and np.array_equal(words, self._words):
            return True
        self._words, self._words_since_ns = words, stamp_ns
        return False

    def _begun_ns(self, last_byte_ns: int) -> int:
        """When the first byte of the answer came."""
        assert self._first_byte_ns is not None
        # The last one cannot have come earlier than one wire time after it.
        return min(self._first_byte_ns, last_byte_ns - round(1e9 * self._answer_wire_s))

    def _delay_ns(self, begun_ns: int, scan_period_ns: int) -> int:
        """How long an answer that began then was held up between scanner and driver. A scanner may
        finish a sweep before it answers; what takes longer than that is the line's doing."""
        self._reactions_ns.append(begun_ns - self._sent_ns)
        late_ns = self._reactions_ns[-1] - min(self._reactions_ns)
        return max(0, late_ns - scan_period_ns)

    def _scan(self, words: NDArray[np.uint16], ready_ns: int) -> Scan:
        """``ready_ns``: when the scanner had the scan ready to be sent."""
        settings = self._settings
        before_s = settings.sweep_s + settings.transfer_delay_s
        return Scan(
            scanner=self._name,
            stamp_ns=ready_ns - round(1e9 * before_s),
            ranges_m=ranges_from_words(words),
            angle_min_rad=-0.5 * radians(settings.field_of_view_deg),
            angle_step_rad=radians(settings.field_of_view_deg) / (settings.beams - 1),
            sweep_s=settings.sweep_s,
            range_max_m=RANGE_MAX_M,
        )
