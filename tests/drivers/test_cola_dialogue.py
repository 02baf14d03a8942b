"""What is said when, on a logical clock."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest
from cola_telegrams import scan_data, telegram

from amr_drivers.errors import LinkLost
from amr_drivers.sick_cola.decoder import ColaDecoder
from amr_drivers.sick_cola.dialogue import Dialogue, Step
from amr_drivers.sick_cola.framing import AnyReader, Dialect
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    OUTPUT_RANGE,
    SCAN,
    STATE,
    Message,
    message,
    number_body,
    parse_message,
    refusal,
)
from amr_drivers.sick_cola.settings import Settings

START_NS = 9_000_000_000_000
STEP_NS = 10_000_000


class Story:
    """A device that answers as told, and a clock that moves in steps of 10 ms."""

    def __init__(self, speech: Dialect = Dialect.B, **settings: Any) -> None:
        self.settings = Settings(host="laser", **settings)
        self.now_ns = START_NS
        self.decoder = ColaDecoder("front", self.settings, START_NS)
        self.dialogue = Dialogue(self.settings, self.decoder, START_NS)
        self.dialect = speech
        self.silent = False
        self.refused: set[str] = set()
        self.log: list[tuple[float, str]] = []
        self.scans = 0
        self.idle = False
        self.streaming = False

    @property
    def t(self) -> float:
        return round(1e-9 * (self.now_ns - START_NS), 3)

    def run(self, seconds: float) -> None:
        end_ns = self.now_ns + round(1e9 * seconds)
        while self.now_ns < end_ns:
            self.now_ns += STEP_NS
            if self.streaming and not self.silent and not self.idle:
                self.say(self.scan("sSN"))
            step = self.dialogue.next(self.now_ns)
            if step is Step.RECONNECT:
                self.log.append((self.t, "reconnect"))
                self.dialogue.connected(self.now_ns)
            elif isinstance(step, bytes):
                self.decoder.sent(step, self.now_ns)
                self.answer(step)

    def say(self, data: bytes) -> None:
        self.decoder.received(data, self.now_ns)

    def scan(self, word: str) -> bytes:
        # 50 Hz: a new one every second step.
        n = (self.now_ns - START_NS) // (2 * STEP_NS)
        changes: dict[str, Any] = {"channels": ()} if self.idle else {}
        up_us = 20_000 * n
        scan = scan_data(scan_counter=n, start_up_us=up_us, transmission_us=up_us + 10, **changes)
        return telegram(scan, self.dialect, word)

    def answer(self, data: bytes) -> None:
        (frame,) = AnyReader().feed(data)
        request = parse_message(frame.payload, frame.dialect)
        assert isinstance(request, Message)
        assert request.word in ("sRN", "sEN"), "the driver must never write or log in"
        self.log.append((self.t, f"{frame.dialect} {request.word} {request.name}"))
        if self.silent or frame.dialect is not self.dialect:
            return
        if request.name in self.refused:
            self.say(refusal(3, self.dialect))
        elif request.word == "sEN":
            self.streaming = True
            self.say(message("sEA", SCAN, number_body(1, 8, self.dialect), self.dialect))
        elif request.name == SCAN:
            self.scans += 1
            self.say(self.scan("sRA"))
        else:
            self.say(message("sRA", request.name, number_body(1, 8, self.dialect), self.dialect))

    def said(self, text: str) -> list[float]:
        return [t for t, what in self.log if text in what]


def test_cola_b_is_tried_first_and_cola_a_on_a_new_connection() -> None:
    story = Story(Dialect.A)
    story.run(1.5)
    words = [what for _, what in story.log]
    assert words[:3] == ["b sRN DeviceIdent", "reconnect", "a sRN DeviceIdent"]
    assert story.said("reconnect") == [pytest.approx(1.01, abs=0.011)]
    assert words[3:6] == [f"a sRN {name}" for name in (FIRMWARE, STATE, OUTPUT_RANGE)]
    assert words[6] == "a sEN LMDscandata"


@pytest.mark.parametrize(
    ("dialect", "text"), [("auto", "CoLa A and B"), ("a", "CoLa A:"), ("b", "CoLa B:")]
)
def test_nobody_who_speaks_cola_is_a_lost_link(dialect: str, text: str) -> None:
    story = Story(dialect=dialect)
    story.silent = True
    with pytest.raises(LinkLost, match=text):
        story.run(5.0)
    assert story.t == pytest.approx(2.0 if dialect == "auto" else 1.0, abs=0.1)


def test_refused_questions_stop_nothing() -> None:
    story = Story(delivery="polled")
    story.refused = {IDENT, FIRMWARE, STATE, OUTPUT_RANGE}
    story.run(1.0)
    assert story.scans > 1


def test_polls_come_at_once_until_a_new_scan_was_seen_then_at_all_phases() -> None:
    story = Story(delivery="polled", poll_interval_s=0.2)
    story.run(5.0)
    polls = story.said(SCAN)
    pauses = [b - a for a, b in pairwise(polls)]
    assert polls[1] - polls[0] < 0.05
    assert min(pauses[4:]) >= 0.2 - 1e-9
    assert max(pauses[4:]) <= 0.2 + 0.02 + 0.011
    assert not story.dialogue.warming_up


def test_the_hurry_begins_with_the_first_scan_however_late_it_comes() -> None:
    story = Story(delivery="polled", poll_interval_s=1.0)
    story.idle = True
    story.run(6.0)
    assert len(story.said(SCAN)) < 8
    story.idle = False
    story.run(1.1)
    polls = story.said(SCAN)
    assert min(b - a for a, b in pairwise(polls[-3:])) < 0.05
    assert not story.dialogue.warming_up


def test_a_frozen_device_is_not_asked_for_ever_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    story = Story(delivery="polled", poll_interval_s=0.5)
    frozen = story.scan("sRA")
    monkeypatch.setattr(story, "scan", lambda _word: frozen)
    story.run(4.0)
    late = [t for t in story.said(SCAN) if t > 1.5]
    assert 4 <= len(late) <= 6


def test_an_unanswered_poll_is_a_lost_link() -> None:
    story = Story(delivery="polled", poll_interval_s=0.1)
    story.run(1.0)
    story.silent = True
    silent_t = story.t
    with pytest.raises(LinkLost, match="no answer for"):
        story.run(3.0)
    assert story.t - silent_t < 0.1 + 0.02 + 0.5 + 0.03


def test_a_refused_poll_is_repeated_slowly() -> None:
    story = Story(delivery="polled", poll_interval_s=0.0)
    story.refused = {SCAN}
    story.run(5.0)
    assert 8 <= len(story.said(SCAN)) <= 12
    said = story.decoder.status(story.now_ns)[1]
    assert said is not None
    assert "sFA 3 (unknown variable)" in said
    story.refused = set()
    story.run(2.0)
    assert story.scans > 2


def test_a_polled_device_without_distances_is_asked_why() -> None:
    story = Story(delivery="polled", poll_interval_s=0.05)
    story.idle = True
    story.run(3.0)
    assert len(story.said(STATE)) > 2


def test_a_silent_stream_is_lost_within_half_a_second() -> None:
    story = Story()
    story.run(1.0)
    story.silent = True
    silent_t = story.t
    with pytest.raises(LinkLost, match="silent for"):
        story.run(3.0)
    assert story.t - silent_t < 0.53


def test_a_device_in_standby_is_asked_for_its_state_and_kept() -> None:
    story = Story()
    story.run(1.0)
    story.idle = True
    story.run(10.0)
    assert len(story.said(STATE)) > 10
    # It may have forgotten whom to send to: it is told again now and then.
    assert 3 <= len(story.said("sEN")) <= 6
    story.idle = False
    story.run(0.1)
    assert story.decoder.status(story.now_ns) == (0, None)


def test_old_scans_for_long_are_a_lost_link(monkeypatch: pytest.MonkeyPatch) -> None:
    story = Story()
    story.run(2.0)
    made = [(story.now_ns, story.scan("sSN"))]

    def delayed(word: str) -> bytes:
        made.append((story.now_ns, Story.scan(story, word)))
        return max((m for m in made if m[0] <= story.now_ns - 400_000_000), default=made[0])[1]

    monkeypatch.setattr(story, "scan", delayed)
    with pytest.raises(LinkLost, match="old scans"):
        story.run(3.0)
