"""The scanner itself: what it measures and sends, and the faults that real ones have."""

from __future__ import annotations

import math
import random
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Final, Literal, Self

import numpy as np
from numpy.typing import NDArray

from amr_drivers.emulators.line import Line
from amr_drivers.emulators.pty_line import PtyLine
from amr_drivers.emulators.s300.answering import Answering
from amr_drivers.emulators.s300.wire import Wire
from amr_drivers.sick_s300.telegrams import (
    Output,
    Telegram,
    encode,
    encode_words,
    standby_words,
    words_from_ranges,
)
from amr_slam.geometry import Array
from amr_slam.simulation import ScannerModel

_HOST: Final = 7
_GUEST: Final = 8
_NUMBERS = 2**32
_HITS = 3
"""Bytes of a damaged telegram that are changed."""
_TOKEN_ANSWER = 4
"""Bytes of an answer that is no scan."""


@dataclass(frozen=True, slots=True, kw_only=True)
class S300Model:
    """Which S300 to be."""

    protocol: Literal["continuous", "request"] = "continuous"
    version: Literal[0x0102, 0x0103] = 0x0103
    length_rule: Literal[4, 8, 14] = 14
    """4 for version 0x0102; 8 or 14 for 0x0103 without and with a measuring field."""
    address: Literal[7, 8] = _HOST
    pair: bool = False
    """An EFI pair on one line: the guest sees what the host sees, from right to left."""
    number_order: Literal["little", "big"] = "little"
    baud_rate: int = 500_000
    sweep_s: float = 0.030
    """From the first beam to the last."""
    beams: int = 541
    field_of_view_deg: float = 270.0
    paced: bool = False
    """Continuous mode: send at the baud rate, not at once. A scan that ends while the last one is
    still on its way is not sent. Answers to requests are always paced."""

    @property
    def addresses(self) -> tuple[int, ...]:
        """Who speaks on this line."""
        return (_HOST, _GUEST) if self.pair else (self.address,)


class EmulatedS300:
    """An :class:`amr_drivers.emulators.scanner.EmulatedScanner`."""

    def __init__(self, line: Line | Path | None = None, model: S300Model | None = None) -> None:
        """``line``: a path makes a pseudo-terminal with a link of that name."""
        self.mode: Literal["measuring", "standby", "lock-out"] = "measuring"
        """Lock-out: the status in continuous mode; request mode has none, and values are standby's
        then."""
        self.silent = False
        self.frozen = False
        self._model = model or S300Model()
        self._line: Line = PtyLine(line) if isinstance(line, Path) or line is None else line
        self._lock = threading.Lock()
        self._number = 0
        self._newest: Array | None = None
        self._cut_at: int | None = None
        self._damage: int | None = None
        self._speech: bytes | None = None
        self._answering = Answering(self._model.addresses, self._newest_words)
        self._wire: Wire | None = None
        if self._model.paced or self._is_asked:
            answers = self._answers if self._is_asked else None
            self._wire = Wire(self._line, self._model.baud_rate, answers)

    @property
    def port(self) -> str:
        """The path or URL that the driver opens."""
        return self._line.port

    @property
    def scan_number(self) -> int:
        """Number of the newest scan."""
        return self._number

    @property
    def answered(self) -> int:
        """Requests answered so far, also with errors."""
        return self._answering.answered

    @property
    def is_sending(self) -> bool:
        """True while a scan is on its way: one that ends meanwhile is not sent."""
        return self._wire is not None and self._wire.is_busy

    @property
    def optics(self) -> ScannerModel:
        """See :class:`amr_drivers.emulators.scanner.StandIn`."""
        view_rad = math.radians(self._model.field_of_view_deg)
        return ScannerModel(
            beams=self._model.beams,
            angle_min_rad=-0.5 * view_rad,
            angle_step_rad=view_rad / (self._model.beams - 1),
            sweep_s=self._model.sweep_s,
        )

    def measure(self, ranges_m: Array) -> int:
        """See :meth:`amr_drivers.emulators.scanner.EmulatedScanner.measure`. Never blocks."""
        first_beam_ns = time.monotonic_ns() - round(1e9 * self._model.sweep_s)
        with self._lock:
            if not self.frozen or self._newest is None:
                self._number = (self._number + 1) % _NUMBERS
                self._newest = ranges_m
            if not self._is_asked and not self.silent:
                self._transmit()
        return first_beam_ns

    def telegram(self, address: int | None = None) -> bytes:
        """The newest scan as continuous mode sends it for a device address."""
        address = self._model.address if address is None else address
        words = self._newest_words(address)
        assert words is not None
        order = self._model.number_order
        return encode(
            Telegram(
                address=address,
                version=self._model.version,
                status=int(self.mode == "lock-out"),
                scan_number=self._number.to_bytes(4, order),
                telegram_number=(self._number % 2**16).to_bytes(2, order),
                output=Output.MEASURED,
                payload=encode_words(words),
            ),
            self._model.length_rule,
        )

    def cut_next(self, at_byte: int) -> None:
        """See :meth:`amr_drivers.emulators.scanner.EmulatedScanner.cut_next`."""
        self._cut_at = at_byte

    def damage_next(self, seed: int) -> None:
        """Bytes of the next scan telegram are changed."""
        self._damage = seed

    def fail_next(self, code: int) -> None:
        """Request mode: the next request is answered with this error code, and so on."""
        self._answering.fail_next(code)

    def take_token(self) -> None:
        """Request mode: somebody else takes the token, or somebody took it and died."""
        for address in self._model.addresses:
            self._answering.take(address)

    @property
    def token_is_taken(self) -> bool:
        """Request mode: whether somebody holds a token."""
        return any(map(self._answering.is_taken, self._model.addresses))

    def send_bytes(self, data: bytes) -> None:
        """Send anything at once: I/O telegrams, a recording, noise."""
        self._line.write(data)

    def unplug(self) -> None:
        """Pull the cable: the port hangs up and disappears."""
        self._line.unplug()

    def replug(self) -> None:
        """Put it back: the port returns under the same name."""
        self._line.plug()

    def power_cycle(self) -> None:
        """Scan numbers begin anew and nobody has the token. The line stays: it is the adapter's."""
        with self._lock:
            self._number = 0
            self._newest = None
            self._answering.restart()

    def be_another_device(self, speech: bytes) -> None:
        """See :meth:`amr_drivers.emulators.scanner.EmulatedScanner.be_another_device`."""
        self._speech = speech

    def close(self) -> None:
        """Idempotent."""
        if self._wire is not None:
            self._wire.close()
        self._line.unplug()

    def _transmit(self) -> None:
        if self._speech is not None:
            data = self._speech
        else:
            data = self._spoilt(b"".join(map(self.telegram, self._model.addresses)))
        if self._wire is not None:
            self._wire.offer(data)
        else:
            self._line.write(data)

    def _answers(self, data: bytes) -> list[bytes]:
        """Called by the wire's thread, also when nothing came."""
        if not data:
            return []
        with self._lock:
            if self._speech is not None:
                return [self._speech]
            answers = self._answering.feed(data)
            if self.silent:
                return []
            return [self._spoilt(one) if len(one) > _TOKEN_ANSWER else one for one in answers]

    def _newest_words(self, address: int) -> NDArray[np.uint16] | None:
        if self._newest is None:
            return None
        if self.mode == "standby" or (self.mode == "lock-out" and self._is_asked):
            return standby_words(len(self._newest))
        words = words_from_ranges(self._newest)
        return words[::-1] if self._model.pair and address == _GUEST else words

    @property
    def _is_asked(self) -> bool:
        return self._model.protocol == "request"

    def _spoilt(self, data: bytes) -> bytes:
        """A scan telegram with the faults that were ordered for it."""
        if self._damage is not None:
            dice = random.Random(self._damage)
            damaged = bytearray(data)
            for at in dice.sample(range(len(data)), _HITS):
                damaged[at] ^= dice.randrange(1, 256)
            data, self._damage = bytes(damaged), None
        if self._cut_at is not None:
            data, self._cut_at = data[: self._cut_at], None
        return data

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
