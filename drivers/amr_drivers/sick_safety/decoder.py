"""From the bytes of a scanner to scans, polled and streamed. Pure: no port, no clock."""

from __future__ import annotations

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.cola2 import (
    Command,
    Frame,
    FrameReader,
    decode_frame,
    error_code,
    error_text,
)
from amr_drivers.sick_safety.datagrams import Reassembler
from amr_drivers.sick_safety.settings import Settings
from amr_drivers.sick_safety.sweeps import Sweeps
from amr_drivers.sick_safety.variables import LATEST_TELEGRAM
from amr_slam.samples import Scan

_SCAN_TIME_S = 0.05
"""The longest scan time of these scanners is 50 ms."""


class PolledDecoder:
    """An :class:`amr_drivers.background.ScanDecoder` of the bytes on the TCP connection.

    A scan is what answers the newest question for the channel's latest telegram, no other frame.
    """

    def __init__(self, name: str, settings: Settings, start_ns: int) -> None:
        """``start_ns``: since when the scanner is listened to."""
        self._settings = settings
        self._index = LATEST_TELEGRAM + settings.channel
        self._reader = FrameReader()
        self._sweeps = Sweeps(name, settings, wait_s=_SCAN_TIME_S)
        self._asked: tuple[Frame, int] | None = None
        self._heard_ns = start_ns
        self._unasked = 0

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        scans = []
        for frame in self._reader.feed(data):
            scan = self._hear(frame, stamp_ns)
            if scan is not None:
                scans.append(scan)
        return scans

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """A question: what has been heard before it is no answer to it."""
        self._reader.reset()
        self._asked = decode_frame(data), stamp_ns

    def gap(self) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        self._reader.reset()
        self._asked = None

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        sweeps = self._sweeps
        errors = self._reader.damaged + self._unasked + sweeps.refused + sweeps.late
        silent_s = 1e-9 * (now_ns - self._heard_ns)
        if silent_s > self.silence_s:
            return errors, f"no answer for {silent_s:.1f} s"
        return errors, sweeps.hindrance or sweeps.remark

    @property
    def silence_s(self) -> float:
        """From when on a scanner counts as silent."""
        return self._settings.poll_interval_s + _SCAN_TIME_S + self._settings.silence_s

    @property
    def hindered(self) -> bool:
        """Whether the newest answer was no scan."""
        return self._sweeps.hindrance is not None

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the telegrams say of the scanner, as (name, value)."""
        return self._sweeps.facts()

    def _hear(self, frame: Frame, stamp_ns: int) -> Scan | None:
        asked, self._asked = self._asked, None
        if asked is None or not answers(frame, asked[0]):
            self._asked = asked
            self._unasked += 1
            return None
        question, asked_ns = asked
        if question.index != self._index or question.command != Command.READ:
            return None
        self._heard_ns = stamp_ns
        if frame.command == Command.FAILED:
            self._sweeps.hindrance = f"channel {self._settings.channel}: {refusal(frame)}"
            return None
        # Younger than the question by nothing that is known: so long it may have been on its way.
        if stamp_ns - asked_ns > 1e9 * self._settings.latency_limit_s:
            self._sweeps.drop_late(f"an answer took {1e-9 * (stamp_ns - asked_ns):.2f} s")
            return None
        return self._sweeps.scan(frame.data, stamp_ns)


class StreamedDecoder:
    """An :class:`amr_drivers.background.ScanDecoder` of the datagrams."""

    def __init__(self, name: str, settings: Settings, start_ns: int) -> None:
        """``start_ns``: since when the scanner is listened to."""
        self._settings = settings
        self._reassembler = Reassembler()
        self._sweeps = Sweeps(name, settings)
        self._heard_ns = start_ns
        self._foreign: tuple[str, int] | None = None

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """See :class:`amr_drivers.background.ScanDecoder`. ``data`` is one datagram."""
        try:
            instance = self._reassembler.feed(data, stamp_ns)
        except BadTelegram as reason:
            self._foreign = str(reason), stamp_ns
            return []
        if instance is None:
            return []
        self._heard_ns = stamp_ns
        scan = self._sweeps.scan(instance.data, instance.stamp_ns)
        return [] if scan is None else [scan]

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """Nothing is sent over UDP."""

    def gap(self) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        self._reassembler.reset()

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        reassembler, sweeps = self._reassembler, self._sweeps
        errors = reassembler.lost + reassembler.refused + sweeps.refused + sweeps.late
        silent_s, limit_s = self.silent_s(now_ns), self.silence_s
        if silent_s <= limit_s:
            return errors, sweeps.hindrance or sweeps.remark
        foreign = self._foreign
        recent = foreign is not None and now_ns - foreign[1] < 1e9 * limit_s
        only = f"; only {foreign[0]}" if foreign is not None and recent else ""
        return errors, f"no measurement data for {silent_s:.1f} s{only}"

    def silent_s(self, now_ns: int) -> float:
        """For how long no whole instance has come."""
        return 1e-9 * (now_ns - self._heard_ns)

    @property
    def silence_s(self) -> float:
        """From when on a scanner counts as silent."""
        longest_s = self._sweeps.period_s or _SCAN_TIME_S * self._settings.every_nth
        return max(self._settings.silence_s, 2.5 * longest_s)

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the telegrams say of the scanner, as (name, value)."""
        return self._sweeps.facts()


def answers(frame: Frame, question: Frame) -> bool:
    """Whether this is what a scanner says to that: of one session, request and subject."""
    if frame.request != question.request:
        return False
    if question.command == Command.OPEN:
        return frame.command in (Command.OPENED, Command.FAILED)
    if frame.command == Command.FAILED:
        # To a session that is gone a device may answer in the name of none.
        return frame.session in (question.session, 0)
    right = {
        Command.READ: Command.VALUE,
        Command.CALL: Command.RESULT,
        Command.CLOSE: Command.CLOSED,
    }
    return (
        frame.session == question.session
        and frame.command == right.get(Command(question.command))
        and frame.index == question.index
    )


def refusal(frame: Frame) -> str:
    """Why a scanner refuses, in words."""
    try:
        return error_text(error_code(frame))
    except BadTelegram as reason:
        return str(reason)
