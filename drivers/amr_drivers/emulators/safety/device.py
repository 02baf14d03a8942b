"""The scanner itself: what it measures and answers. No socket."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from amr_drivers.emulators.safety.models import SafetyModel
from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety import variables
from amr_drivers.sick_safety.blocks import INFINITE, VALID, Beams, Header, Instance, Status
from amr_drivers.sick_safety.cola2 import NO_SESSION_LEFT, UNKNOWN_SESSION, Command, Frame
from amr_drivers.sick_safety.instance import encode_instance
from amr_slam.geometry import Array

Mode = Literal["measuring", "standby", "contaminated", "dirty", "error"]

_UNKNOWN_METHOD: Final = 0x02
_UNKNOWN_VARIABLE: Final = 0x03
_INVALID_DATA: Final = 0x05
_UNKNOWN_COMMAND: Final = 0x0C
_LARGEST_MM: Final = 65_534
_OFF: Final = bytes(52)
"""Latest telegram of a channel that is not switched on."""
_STATES: Final = {
    "measuring": Status(),
    "standby": Status(run_mode=False, standby=True),
    "contaminated": Status(contamination_error=True),
    "dirty": Status(contamination_warning=True),
    "error": Status(run_mode=False, device_error=True),
}
_CONFIRM: Final = 1


@dataclass(slots=True)
class _Session:
    idle_s: int
    used_s: float


class SafetyDevice:
    """Counters, sessions, channels and newest scan of one scanner."""

    def __init__(self, model: SafetyModel, enabled: frozenset[int]) -> None:
        """``enabled``: channels that the device's stored configuration switches on."""
        self.model = model
        self.mode: Mode = "measuring"
        self.frozen = False
        self.big_endian_errors = False
        """Codes of errors are sent as SICK's drivers read them, not as SICK writes."""
        self.enabled = enabled
        self.first_number = 0
        """Of scans after a start."""
        self._ids = 0x7361_0000
        self._ranges_m: Array | None = None
        self._sequence = 0
        self._number = 0
        self._identification = 0
        self._start()

    def power_cycle(self) -> None:
        """Counters, sessions and streams start anew."""
        self._start()

    def measure(self, ranges_m: Array) -> int:
        """A sweep has just ended; its first beam in monotonic ns."""
        first_ns = time.monotonic_ns() - round(1e9 * self.model.derived.sweep_s)
        if not (self.frozen and self._ranges_m is not None):
            self._ranges_m = ranges_m
            self._sequence += 1
            if self.mode in {"measuring", "dirty"}:
                self._number = (self._number + 1) % 2**32
        self._identification += 1
        return first_ns

    def instance(self, channel: int) -> bytes:
        """The newest scan."""
        if self._ranges_m is None or channel not in self.enabled | set(self.streams):
            return _OFF
        model, ranges = self.model, self._ranges_m
        header = Header(
            version=("R", 2, 0, 0),
            serial_number=model.serial_number,
            plug_number=model.plug_number,
            channel=channel,
            sequence=self._sequence,
            scan_number=self._number,
            date=0,
            time_ms=(time.monotonic_ns() - self._booted_ns) // 1_000_000 % 86_400_000,
        )
        return encode_instance(
            Instance(
                header=header,
                status=_STATES[self.mode],
                derived=model.derived,
                beams=self._beams(ranges),
            ),
            header_bytes=model.header_bytes,
        )

    def due(self) -> list[tuple[variables.Stream, int]]:
        """Streams that get the newest scan, with its identification."""
        if self._ranges_m is None:
            return []
        streams = list(self.streams.values())
        return [(s, self._identification) for s in streams if self._sequence % s.every_nth == 0]

    def answer(self, question: Frame) -> Frame:
        """What the scanner says to a telegram."""
        self.expire()
        if question.command == Command.OPEN:
            return self._open(question)
        session = self.sessions.get(question.session)
        if session is None:
            return self._refuse(question, UNKNOWN_SESSION)
        session.used_s = time.monotonic()
        if question.command == Command.CLOSE:
            del self.sessions[question.session]
            return _reply(question, Command.CLOSED)
        if question.command == Command.READ:
            return self._read(question)
        if question.command == Command.CALL:
            return self._call(question)
        return self._refuse(question, _UNKNOWN_COMMAND)

    def expire(self) -> None:
        """Sessions that have been idle for too long end."""
        now_s = time.monotonic()
        idle = [n for n, s in self.sessions.items() if now_s - s.used_s > s.idle_s]
        for number in idle:
            del self.sessions[number]

    def _start(self) -> None:
        self._booted_ns = time.monotonic_ns()
        self._sequence = 0
        self._number = self.first_number
        self._identification = 0
        self._ranges_m = None
        self.sessions: dict[int, _Session] = {}
        self.streams: dict[int, variables.Stream] = {}

    def _beams(self, ranges_m: Array) -> Beams:
        seen = np.isfinite(ranges_m)
        millimetres = np.clip(np.rint(1e3 * np.nan_to_num(ranges_m, posinf=0.0)), 1, _LARGEST_MM)
        return Beams(
            distance=np.where(seen, millimetres, 0).astype(np.uint16),
            rssi=np.where(seen, 100, 0).astype(np.uint8),
            status=np.where(seen, VALID, np.where(np.isposinf(ranges_m), INFINITE, 0)).astype(
                np.uint8
            ),
        )

    def _open(self, question: Frame) -> Frame:
        if len(question.payload) < 3 or question.payload[0] == 0:
            return self._refuse(question, _INVALID_DATA)
        if len(self.sessions) >= self.model.sessions:
            return self._refuse(question, NO_SESSION_LEFT)
        self._ids += 1
        self.sessions[self._ids] = _Session(question.payload[0], time.monotonic())
        return Frame(session=self._ids, request=question.request, command=Command.OPENED)

    def _read(self, question: Frame) -> Frame:
        value = None if question.index is None else self._variable(question.index)
        if value is None:
            return self._refuse(question, _UNKNOWN_VARIABLE)
        return _reply(question, Command.VALUE, question.payload[:2] + value)

    def _variable(self, index: int) -> bytes | None:
        model = self.model
        channel = index - variables.LATEST_TELEGRAM
        if 0 <= channel < variables.CHANNELS:
            return self.instance(channel)
        texts = {
            variables.TYPE_CODE: model.type_code,
            variables.SERIAL_NUMBER: str(model.serial_number),
            variables.FIRMWARE: model.firmware,
        }
        if index in texts:
            return variables.encode_text(texts[index])
        if index == variables.DEVICE_STATUS:
            return b"\x03"
        if index == variables.REQUIRED_ACTION:
            return variables.encode_actions(0 if self.mode == "measuring" else _CONFIRM)
        if index == variables.STATUS_OVERVIEW:
            return self._overview()
        return None

    def _overview(self) -> bytes:
        return variables.encode_overview(
            variables.StatusOverview(
                version="R.1.0.0",
                device_state=3,
                configuration_state=1,
                application_state=1,
                power_on_count=17,
                time_ms=(time.monotonic_ns() - self._booted_ns) // 1_000_000 % 86_400_000,
                date=0,
                error_code=0,
            )
        )

    def _call(self, question: Frame) -> Frame:
        if question.index != variables.CHANGE_STREAM:
            return self._refuse(question, _UNKNOWN_METHOD)
        try:
            stream = variables.decode_stream(question.data)
        except BadTelegram:
            return self._refuse(question, _INVALID_DATA)
        self.streams.pop(stream.channel, None)
        if stream.enabled:
            self.streams[stream.channel] = stream
        return _reply(question, Command.RESULT, question.payload[:2])

    def _refuse(self, question: Frame, code: int) -> Frame:
        order: Literal["little", "big"] = "big" if self.big_endian_errors else "little"
        return _reply(question, Command.FAILED, code.to_bytes(2, order))


def _reply(question: Frame, command: Command, payload: bytes = b"") -> Frame:
    return Frame(
        session=question.session, request=question.request, command=command, payload=payload
    )
