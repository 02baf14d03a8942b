"""From a CoLa device's bytes to scans. Pure: no socket, no clock."""

from __future__ import annotations

from math import radians

from amr_drivers.device_clock import DeviceClock
from amr_drivers.errors import BadTelegram
from amr_drivers.sick_cola.facts import Facts
from amr_drivers.sick_cola.framing import AnyReader, Dialect, Frame, FrameReader, reader
from amr_drivers.sick_cola.freshness import Counting, News
from amr_drivers.sick_cola.meaning import ranges_of
from amr_drivers.sick_cola.messages import SCAN, Message, Refusal, parse_message
from amr_drivers.sick_cola.scandata import (
    ScanData,
    decode_scan,
)
from amr_drivers.sick_cola.settings import Settings
from amr_drivers.sick_cola.sweeps import FirstBeam, Sweep, sweep_of
from amr_drivers.timing import Arrivals
from amr_slam.samples import Scan

_ERROR, _DIRTY, _BLIND = 0x01, 0x02, 0x04
"""Bits of the second status byte."""
_STARTING = (1, 0)
"""Status of the first scans after a start, which no document explains; their distances are true."""
_START_NS = 60_000_000_000
"""A start does not last longer."""


class ColaDecoder:
    """An :class:`amr_drivers.background.ScanDecoder`.

    What the driver must know of the dialogue stands in ``pending``, ``heard_ns`` and ``scan_ns``.
    """

    def __init__(self, name: str, settings: Settings, start_ns: int) -> None:
        """``start_ns``: since when the device is listened to."""
        self._name = name
        self._settings = settings
        self._reader: FrameReader = (
            AnyReader() if settings.dialect == "auto" else reader(Dialect(settings.dialect))
        )
        self._arrivals = Arrivals()
        self._clock = DeviceClock()
        self._first_beam = FirstBeam()
        self._counting = Counting()
        self._facts = Facts()
        self._sweep: Sweep | None = None
        self._hindrance: str | None = None
        self._refused = 0
        self._late = 0
        self._late_since_ns: int | None = None
        self._starting_ns: int | None = None
        self._bytes_ns: int | None = None
        self.pending: str | None = None
        """Name of the request that is not answered yet."""
        self.idle = False
        """The scan telegrams hold no distances."""
        self.dialect: Dialect | None = None
        """What the device speaks; None before it has said anything."""
        self.heard_ns = start_ns
        """When it last said something that can be understood."""
        self.scan_ns = start_ns
        """When it last sent a scan telegram, good or bad."""

    def received(self, data: bytes, stamp_ns: int) -> list[Scan]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        scans: list[Scan] = []
        damaged = self._reader.damaged
        self._bytes_ns = stamp_ns
        self._arrivals.add(self._reader.position, stamp_ns)
        for frame in self._reader.feed(data):
            try:
                scan = self._hear(frame, stamp_ns, self._arrivals.at(frame.offset))
            except BadTelegram as reason:
                self._refused += 1
                self._hindrance = str(reason)
            else:
                scans += [] if scan is None else [scan]
        self._arrivals.at(self._reader.pending)
        if self._reader.damaged > damaged:
            self.pending = None  # the answer may have been among it: better asked twice
        return scans

    def sent(self, data: bytes, stamp_ns: int) -> None:  # noqa: ARG002 - the protocol's
        """See :class:`amr_drivers.background.ScanDecoder`."""
        asking = AnyReader()
        for frame in asking.feed(data):
            request = parse_message(frame.payload, frame.dialect)
            if isinstance(request, Message):
                self.pending = request.name

    def gap(self) -> None:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        self._reader.reset()
        self.pending = None

    def status(self, now_ns: int) -> tuple[int, str | None]:
        """See :class:`amr_drivers.background.ScanDecoder`."""
        errors = self._reader.damaged + self._refused + self._late
        silent_s = 1e-9 * (now_ns - self.scan_ns)
        polled_s = self._settings.poll_interval_s if self._settings.delivery == "polled" else 0.0
        if self.dialect is None and silent_s > self._settings.silence_s:
            return errors, f"no answer in CoLa yet{self._stranger(now_ns)}"
        if silent_s <= self.silence_s + polled_s:
            return errors, self._hindrance
        answers = now_ns - self.heard_ns < 1e9 * self.silence_s
        why = self._facts.why_silent() if answers else self._stranger(now_ns)
        return errors, f"no scans for {silent_s:.1f} s{why}"

    @property
    def silence_s(self) -> float:
        """From when on an unanswered request or a pause of the stream is silence."""
        return max(self._settings.silence_s, 2.5 * self._counting.telegram_s)

    @property
    def period_s(self) -> float:
        """One turn of the mirror; 0 before the first scan."""
        return 0.0 if self._sweep is None else self._sweep.period_s

    @property
    def settled(self) -> bool:
        """True once a scan has been seen to become ready, so that its age is known."""
        return self._counting.new >= 2

    @property
    def first_scan_ns(self) -> int | None:
        """When the first scan arrived; None before that."""
        return self._counting.first_ns

    @property
    def late_s(self) -> float:
        """For how long only old telegrams have come."""
        since = self._late_since_ns
        return 0.0 if since is None else 1e-9 * (self.heard_ns - since)

    @property
    def model(self) -> str | None:
        """What the device calls itself; None before it was asked."""
        return self._facts.model

    def facts(self) -> tuple[tuple[str, str], ...]:
        """What the telegrams say of the device, as (name, value). Any thread."""
        facts = list(self._facts.pairs())
        if self.dialect is not None:
            facts.insert(0, ("dialect", f"CoLa {self.dialect.upper()}"))
        if self._sweep is not None:
            sweep, at_end = self._sweep, self._first_beam.told_at_end
            last_deg = sweep.start_deg + (sweep.beams - 1) * sweep.step_deg
            facts += [
                ("beams", f"{sweep.beams} from {sweep.start_deg:g} to {last_deg:g} deg"),
                ("scan period", f"{1e3 * sweep.period_s:.1f} ms"),
                ("time of a scan", f"the {'end' if at_end else 'start'} of its sweep"),
            ]
        if (drift_ppm := self._clock.drift_ppm) is not None:
            facts.append(("clock drift", f"{drift_ppm:.0f} ppm"))
        counts = (
            ("repeated scans", self._counting.repeated),
            ("lost scans", self._counting.lost),
            ("device starts seen", self._clock.restarts),
        )
        return (*facts, *((name, str(count)) for name, count in counts if count))

    def _stranger(self, now_ns: int) -> str:
        """To be appended where nothing that can be understood comes."""
        strange = self._bytes_ns is not None and now_ns - self._bytes_ns < 1e9 * self.silence_s
        return "; what answers does not speak CoLa" if strange else ""

    def _hear(self, frame: Frame, stamp_ns: int, arrival_ns: int) -> Scan | None:
        said = parse_message(frame.payload, frame.dialect)
        if self.dialect is None:
            self.scan_ns = stamp_ns  # nobody could be asked for a scan until now
        self.dialect, self.heard_ns = frame.dialect, stamp_ns
        if isinstance(said, Refusal):
            name, self.pending = self.pending, None
            self._facts.refused(name, said)
            if name == SCAN:
                self._hindrance = f"{SCAN} is refused: {said}"
            return None
        if said.word != "sSN" and said.name == self.pending:
            self.pending = None
        if said.name == SCAN and said.word in ("sRA", "sSN"):
            self.scan_ns = stamp_ns
            return self._scan(
                decode_scan(said.body, frame.dialect), arrival_ns, polled=said.word == "sRA"
            )
        self._facts.answered(said, frame.dialect)
        self._first_beam.identify(self._facts.model or "")
        return None

    def _scan(self, data: ScanData, arrival_ns: int, *, polled: bool) -> Scan | None:
        """The scan in a telegram, or None when it holds none that is new and true."""
        self._facts.scanned(data)
        channel = data.channel("DIST")
        self.idle = channel is None or len(channel.values) == 0
        if (hindrance := self._hinders(data)) is not None or channel is None:
            self._hindrance = hindrance
            return None
        if data.layer_angle != 0:
            # Frames of a horizontal layer come between these; without one, say what comes.
            self._hindrance = self._facts.only_layers(data.layer_angle)
            return None
        sweep = self._sweep = sweep_of(data, channel)
        news = self._counting.hear(data.scan_counter, sweep.period_s, arrival_ns, polled=polled)
        if news is not News.NEW:
            if news is News.FROZEN:
                self._hindrance = "frozen: the scan counter stands still"
            return None
        if not self._in_time(data, sweep, arrival_ns, polled=polled):
            return None
        self._hindrance = self._warning(data, arrival_ns)
        stamp_s = self._first_beam.after_start_up_s(sweep) + self._settings.stamp_shift_s
        return Scan(
            scanner=self._name,
            stamp_ns=self._clock.at(data.start_up_us) + round(1e9 * stamp_s),
            ranges_m=ranges_of(channel, self._settings.range_max_m),
            angle_min_rad=radians(sweep.start_deg - self._settings.straight_ahead_deg),
            angle_step_rad=radians(sweep.step_deg),
            sweep_s=sweep.sweep_s,
            range_max_m=self._settings.range_max_m,
            seq=data.scan_counter,
        )

    def _hinders(self, data: ScanData) -> str | None:
        wanted, second = self._settings.serial_number, data.status[1]
        if wanted not in (0, data.serial_number):
            return (
                f"another device answers at this address: serial number {data.serial_number} "
                f"instead of {wanted}"
            )
        if second & _BLIND:
            return "contaminated: the front screen is too dirty to measure, clean it"
        if second & _ERROR:
            return "device error: see its display or SOPAS"
        if self.idle:
            return f"no distances come{self._facts.why_silent()}"
        return None

    def _in_time(self, data: ScanData, sweep: Sweep, arrival_ns: int, *, polled: bool) -> bool:
        ready_us = self._first_beam.hear(data, sweep)
        limit_s = self._settings.latency_limit_s + (1.5 * sweep.period_s if polled else 0.0)
        restarts = self._clock.restarts
        if not self._clock.hear(ready_us, arrival_ns, round(1e9 * limit_s)):
            self._late += 1
            self._late_since_ns = self._late_since_ns or self.heard_ns
            self._hindrance = "the scans come too late: the network or this computer is overloaded"
            return False
        if self._clock.restarts > restarts:
            self._counting.restarted()
        self._late_since_ns = None
        return True

    def _warning(self, data: ScanData, arrival_ns: int) -> str | None:
        """What a status says that leaves the distances true."""
        first, second = data.status
        if (first, second) != _STARTING:
            self._starting_ns = None
        elif self._starting_ns is None:
            self._starting_ns = arrival_ns
        if second & _DIRTY:
            return "contamination warning: clean the front screen"
        lasting = self._starting_ns is not None and arrival_ns - self._starting_ns > _START_NS
        if lasting or (first, second) not in ((0, 0), _STARTING):
            return f"unknown device status {first:02x} {second:02x}"
        return None
