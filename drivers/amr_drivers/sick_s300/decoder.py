"""From the bytes of continuous mode to scans. Pure: no port, no clock."""

from __future__ import annotations

from math import radians

from amr_drivers.errors import BadTelegram
from amr_drivers.sick_s300.scan_counter import ScanCounter
from amr_drivers.sick_s300.settings import ADDRESSES, Settings
from amr_drivers.sick_s300.telegrams import (
    RANGE_MAX_M,
    Output,
    Telegram,
    TelegramReader,
    is_standby,
    measured_words,
    ranges_from_words,
)
from amr_drivers.timing import ArrivalClock, Arrivals
from amr_slam.samples import Scan


class ContinuousDecoder:
    """An :class:`amr_drivers.background.ScanDecoder`. The scanner sends by itself."""

    def __init__(self, name: str, settings: Settings, start_ns: int) -> None:
        """``start_ns``: since when the scanner is listened to."""
        self._name = name
        self._settings = settings
        self._reader = TelegramReader(settings.beams)
        self._counter = ScanCounter()
        self._clock = ArrivalClock(round(1e9 * settings.latency_limit_s))
        self._arrivals = Arrivals()
        self._hindrance: str | None = None
        self._heard_ns = start_ns
        self._heard: Telegram | None = None
        self._other: tuple[str, int] | None = None
        self._refused = 0
        self._late = 0

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        scans: list[Scan] = []
        self._arrivals.add(self._reader.position, stamp_ns)
        for telegram in self._reader.feed(data):
            if telegram.address != ADDRESSES[self._settings.device_address]:
                self._other = f"telegrams of device address {telegram.address:02d}", stamp_ns
            elif telegram.output is not Output.MEASURED:
                self._other = f"telegrams of {telegram.output.name.lower()}", stamp_ns
            else:
                self._heard, self._heard_ns = telegram, stamp_ns
                scan = self._hear(telegram, self._arrivals.at(telegram.offset))
                if scan is not None:
                    scans.append(scan)
        self._arrivals.at(self._reader.pending)
        return scans

    def sent(self, data: bytes, stamp_ns: int) -> None:
        """Nothing is ever sent to a scanner in continuous mode."""

    def gap(self) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        self._reader.reset()

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        errors = self._reader.damaged + self._refused + self._late
        limit_s, other = self.silence_s, self._other
        silent_s = 1e-9 * (now_ns - self._heard_ns)
        if silent_s <= limit_s:
            return errors, self._hindrance
        recent = other is not None and now_ns - other[1] < 1e9 * limit_s
        only = f"; only {other[0]} come" if other and recent else ""
        return errors, f"no measured values for {silent_s:.1f} s{only}"

    @property
    def silence_s(self) -> float:
        """From when on a scanner counts as silent: the setting and twice the wire time of a
        telegram, or more from a slower scanner."""
        bits = 10 * (2 * self._settings.beams + 26)
        set_s = self._settings.silence_s + 2.0 * bits / self._settings.baud_rate
        return max(set_s, 2.5 * (self._clock.period_s or 0.0))

    @property
    def max_age_s(self) -> float:
        """How old the first beam of the newest scan of a scanner that is not silent may be."""
        return self._settings.sweep_s + self.silence_s

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the telegrams say of the scanner, as (name, value)."""
        heard, period_s = self._heard, self._clock.period_s
        facts: list[tuple[str, str]] = []
        if heard is not None:
            facts.append(("protocol version", f"{heard.version >> 8}.{heard.version & 0xFF:02d}"))
        if period_s is not None:
            facts.append(("scan period", f"{1e3 * period_s:.1f} ms"))
        return tuple(facts)

    def _hear(self, telegram: Telegram, arrival_ns: int) -> Scan | None:
        try:
            return self._scan(telegram, arrival_ns)
        except BadTelegram as reason:
            self._refused += 1
            self._hindrance = str(reason)
            return None

    def _scan(self, telegram: Telegram, arrival_ns: int) -> Scan | None:
        """The scan in a telegram, or None when it holds none that is new and true."""
        settings = self._settings
        words = measured_words(telegram, settings.beams)
        repeated = self._counter.repeats(telegram.scan_number)
        number = self._counter.read(telegram.scan_number)
        self._hindrance = (
            _status_text(telegram.status)
            or ("standby" if is_standby(words) else None)
            or ("frozen: the scan number stands still" if repeated else None)
        )
        if self._hindrance is not None:
            return None
        first_byte_ns = arrival_ns
        if number is not None:
            refined_ns = self._clock.refine(number, arrival_ns)
            if refined_ns is None:
                self._late += 1
                return None
            first_byte_ns = refined_ns
        before_s = settings.sweep_s + settings.transfer_delay_s
        return Scan(
            scanner=self._name,
            stamp_ns=first_byte_ns - round(1e9 * before_s),
            ranges_m=ranges_from_words(words),
            angle_min_rad=-0.5 * radians(settings.field_of_view_deg),
            angle_step_rad=radians(settings.field_of_view_deg) / (settings.beams - 1),
            sweep_s=settings.sweep_s,
            range_max_m=RANGE_MAX_M,
            seq=number,
        )


def _status_text(status: int) -> str | None:
    if status == 0:
        return None
    return "lock-out: reset the scanner" if status == 1 else f"unknown status {status:#06x}"
