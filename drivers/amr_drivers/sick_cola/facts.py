"""What a device says about itself, for the technician. Pure."""

from __future__ import annotations

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.framing import Dialect
from amr_drivers.sick_cola.meaning import ANGLE_UNITS
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    OUTPUT_RANGE,
    SCAN,
    SERIAL,
    STATE,
    STATES,
    Message,
    Refusal,
    number,
    output_range,
    texts,
)
from amr_drivers.sick_cola.scandata import (
    ScanData,
)

_HORIZONTAL = 0
_MAX_LAYERS = 64


class Facts:
    """Answers of one device, by name. Replaced as a whole, so that any thread may read them."""

    def __init__(self) -> None:
        self._said: dict[str, str] = {}
        self._layers: frozenset[int] = frozenset()
        self._subscription: str | None = None
        self.model: str | None = None

    def answered(self, answer: Message, dialect: Dialect) -> None:
        """An answer that is no scan. Names that nobody asked for are passed over."""
        try:
            self._answered(answer, dialect)
        except BadTelegram:
            # Firmwares differ in what surrounds a text; nothing hangs on these.
            self._say(answer.name, "unreadable")

    def refused(self, name: str | None, refusal: Refusal) -> None:
        """The last request was not done."""
        if name == SCAN:
            self._subscription = f"; the device answers {refusal}"

    def scanned(self, scan: ScanData) -> None:
        """A scan telegram came."""
        self._subscription = None
        if self._said.get(SERIAL) != str(scan.serial_number):
            self._say(SERIAL, str(scan.serial_number))
        if scan.device_name and self._said.get("name") != scan.device_name:
            self._say("name", scan.device_name)
        if scan.layer_angle not in self._layers and len(self._layers) < _MAX_LAYERS:
            self._layers |= {scan.layer_angle}

    def only_layers(self, layer_angle: int) -> str | None:
        """What hinders measuring when a layer comes that is not horizontal; None: nothing."""
        if _HORIZONTAL in self._layers:
            return None
        return f"no horizontal layer comes, but one at {0.01 * layer_angle:g} deg"

    def why_silent(self) -> str:
        """What the device's state says about scans that do not come; to be appended."""
        if self._subscription is not None:
            return self._subscription
        state = self._said.get(STATE)
        said = f" (it says: {state})" if state else ""
        return f": the device answers but does not measure, or is told to send no scans{said}"

    def pairs(self) -> tuple[tuple[str, str], ...]:
        """(name, value) in the technician's words."""
        said = self._said
        words = (
            ("serial number", said.get(SERIAL)),
            ("device name", said.get("name")),
            ("firmware", said.get(FIRMWARE)),
            ("state", said.get(STATE)),
            ("output range", said.get(OUTPUT_RANGE)),
            ("layers", str(len(self._layers)) if len(self._layers) > 1 else None),
        )
        return tuple((name, value) for name, value in words if value is not None)

    def _answered(self, answer: Message, dialect: Dialect) -> None:
        if answer.name == IDENT:
            self.model = " ".join(texts(answer.body, 2, dialect)).strip() or None
        elif answer.name == FIRMWARE:
            self._say(FIRMWARE, texts(answer.body, 1, dialect)[0])
        elif answer.name == STATE:
            state = number(answer.body, 8, dialect)
            self._say(STATE, STATES.get(state, f"unknown state {state}"))
        elif answer.name == OUTPUT_RANGE:
            part = output_range(answer.body, dialect)
            first, last = part.start / ANGLE_UNITS, part.stop / ANGLE_UNITS
            self._say(OUTPUT_RANGE, f"{first:g} to {last:g} deg")
        elif answer.name == SCAN and answer.word == "sEA" and not number(answer.body, 8, dialect):
            self._subscription = "; the device has not begun to send"

    def _say(self, name: str, value: str) -> None:
        self._said = self._said | {name: value}
