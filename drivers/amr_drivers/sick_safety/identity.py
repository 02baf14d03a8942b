"""What a scanner says of itself over CoLa 2, beside its scans."""

from __future__ import annotations

from dataclasses import dataclass

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_safety.session import Refused, Session
from amr_drivers.sick_safety.variables import (
    CONFIGURATION,
    DEVICE_NAME,
    DEVICE_STATUS,
    FIRMWARE,
    REQUIRED_ACTION,
    SERIAL_NUMBER,
    STATUS_OVERVIEW,
    TYPE_CODE,
    actions,
    decode_configuration,
    decode_overview,
    decode_text,
    model_of,
)

_TEXTS = {
    "type code": TYPE_CODE,
    "serial number (CoLa 2)": SERIAL_NUMBER,
    "firmware": FIRMWARE,
    "device name": DEVICE_NAME,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Read once when the connection is made."""

    type_code: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    """(name, value); what a model does not have is left out."""

    @property
    def model(self) -> str:
        """Example: ``SICK nanoScan3``."""
        return f"SICK {model_of(self.type_code)}"


def read_identity(session: Session) -> Identity:
    """Ask for all that is documented. Raises DriverError, but not for variables that a model or
    its firmware does not have."""
    facts: dict[str, str] = {}
    for name, index in _TEXTS.items():
        value = _value(session, index)
        if value is not None and (text := _text(value)):
            facts[name] = text
    if state := _value(session, DEVICE_STATUS):
        facts["device status"] = str(state[0])
    if (value := _value(session, STATUS_OVERVIEW)) is not None:
        facts |= _overview(value)
    if (value := _value(session, CONFIGURATION)) is not None:
        facts |= _configuration(value)
    if action := required_action(session):
        facts["required action"] = action
    return Identity(type_code=facts.get("type code", ""), facts=tuple(facts.items()))


def required_action(session: Session) -> str | None:
    """What somebody has to do at the scanner. Raises DriverError."""
    value = _value(session, REQUIRED_ACTION)
    try:
        return None if value is None else ", ".join(actions(value)) or None
    except BadTelegram:
        return None


def _value(session: Session, index: int) -> bytes | None:
    try:
        return session.read(index)
    except Refused:
        return None


def _text(value: bytes) -> str:
    try:
        return decode_text(value)
    except BadTelegram:
        return ""


def _overview(value: bytes) -> dict[str, str]:
    try:
        overview = decode_overview(value)
    except BadTelegram:
        return {}
    facts = {"power-on count": str(overview.power_on_count)}
    if overview.error_code:
        facts["last error"] = f"{overview.error_code:#010x}"
    return facts


def _configuration(value: bytes) -> dict[str, str]:
    try:
        return {"configuration checksum": f"{decode_configuration(value).checksum:08x}"}
    except BadTelegram:
        return {}
