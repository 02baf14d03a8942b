from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from math import pi, radians
from typing import Any

import numpy as np
import pytest
from cola_telegrams import channel, scan_data, telegram
from paths import SHARED

from amr_drivers.sick_cola.decoder import ColaDecoder
from amr_drivers.sick_cola.driver import Settings, scan_decoder
from amr_drivers.sick_cola.framing import Dialect
from amr_drivers.sick_cola.messages import (
    FIRMWARE,
    IDENT,
    SCAN,
    STATE,
    event_request,
    message,
    number_body,
    read_request,
    refusal,
    texts_body,
)
from amr_drivers.sick_cola.scandata import ScanData
from amr_slam.samples import Scan

START_NS = 5_000_000_000_000
MS = 1_000_000
BEAMS = 541


def decoder(**settings: Any) -> ColaDecoder:
    return scan_decoder("front", Settings(host="laser", **settings), START_NS)


def full(n: int = 0, **changes: Any) -> ScanData:
    """Scan ``n`` of an LMS111: 20 ms apart, sent 3.1 ms after its end."""
    values = np.full(BEAMS, 1000 + n, dtype=np.uint16)
    return scan_data(
        scan_counter=n,
        telegram_counter=n,
        start_up_us=1_000_000 + 20_000 * n,
        transmission_us=1_003_100 + 20_000 * n,
        **({"channels": (channel(values=values),)} | changes),
    )


def arrival_ns(n: int) -> int:
    return START_NS + n * 20 * MS + MS


def hear(
    decoding: ColaDecoder, *scans: ScanData, word: str = "sSN", dialect: Dialect = Dialect.B
) -> list[Scan]:
    found = []
    for n, scan in enumerate(scans):
        found += decoding.received(telegram(scan, dialect, word), arrival_ns(n))
    return found


# ---------------------------------------------------------------- scans


@pytest.mark.parametrize("dialect", list(Dialect))
@pytest.mark.parametrize("word", ["sRA", "sSN"])
def test_a_telegram_is_a_scan(dialect: Dialect, word: str) -> None:
    decoding = decoder()
    (scan,) = hear(decoding, full(), word=word, dialect=dialect)
    assert scan.scanner == "front"
    assert scan.seq == 0
    assert len(scan.ranges_m) == BEAMS
    assert scan.ranges_m[0] == 1.0
    assert scan.angle_min_rad == pytest.approx(-0.75 * pi)
    assert scan.angle_step_rad == pytest.approx(radians(0.5))
    assert scan.sweep_s == pytest.approx(0.015)
    # 3.1 ms from the sweep's end to the transmission, 15 ms from its start to its end.
    assert scan.stamp_ns == arrival_ns(0) - round(18.1 * MS)
    assert decoding.dialect is dialect
    assert decoding.status(arrival_ns(0)) == (0, None)
    assert dict(decoding.facts())["time of a scan"] == "the end of its sweep"


def test_a_device_that_tells_the_start_of_its_sweep() -> None:
    # An LMS511: 40.8 ms from one to the other, while the sweep takes 21.1 ms.
    decoding = decoder()
    scan = full(
        scan_frequency=2500,
        channels=(channel(start_angle=-50_000, angle_step=1667, values=np.full(1141, 900)),),
    )
    scan = replace(scan, transmission_us=scan.start_up_us + 40_800)
    (found,) = hear(decoding, scan)
    assert found.stamp_ns == arrival_ns(0) - round(40.8 * MS)
    assert found.angle_min_rad == pytest.approx(radians(-95.0))
    assert found.angles_rad[-1] == pytest.approx(radians(95.0), abs=1e-9)
    assert dict(decoding.facts())["time of a scan"] == "the start of its sweep"


def test_a_part_of_a_known_field_begins_later() -> None:
    decoding = decoder()
    ident = texts_body(("LMS10x_FieldEval", "V1.80"), Dialect.B)
    decoding.received(message("sRA", IDENT, ident, Dialect.B), arrival_ns(0))
    part = channel(start_angle=450_000, values=np.full(181, 900))  # 45 to 135 degrees
    (scan,) = hear(decoding, full(channels=(part,)))
    # The sweep's end is at 225 degrees: half a turn, 10 ms, after the first beam of the part.
    assert scan.stamp_ns == arrival_ns(0) - round((3.1 + 10.0) * MS)
    assert scan.sweep_s == pytest.approx(0.005)
    assert scan.angle_min_rad == pytest.approx(-0.25 * pi)


def test_a_small_part_does_not_turn_an_end_into_a_start() -> None:
    # 10 degrees take 0.6 ms, and the transmission comes 3.1 ms after the end of the sweep.
    decoding = decoder()
    hear(decoding, full(channels=(channel(values=np.full(21, 900)),)))
    assert dict(decoding.facts())["time of a scan"] == "the end of its sweep"


def test_straight_ahead_and_the_shift_are_settings() -> None:
    (usual,) = hear(decoder(), full())
    (other,) = hear(decoder(straight_ahead_deg=0.0, stamp_shift_s=0.002), full())
    assert other.angle_min_rad == pytest.approx(usual.angle_min_rad + 0.5 * pi)
    assert other.stamp_ns == usual.stamp_ns + 2 * MS


def test_repeated_scans_are_dropped_and_lost_ones_counted() -> None:
    decoding = decoder()
    numbers = [0, 1, 1, 2, 5, 6]
    found = [decoding.received(telegram(full(n), Dialect.B), arrival_ns(n)) for n in numbers]
    assert [len(scans) for scans in found] == [1, 1, 0, 1, 1, 1]
    facts = dict(decoding.facts())
    assert (facts["repeated scans"], facts["lost scans"]) == ("1", "2")
    assert decoding.status(arrival_ns(6)) == (0, None)


def test_every_nth_scan_is_no_loss() -> None:
    decoding = decoder()
    for n in range(0, 60, 3):
        assert len(decoding.received(telegram(full(n), Dialect.B), arrival_ns(n))) == 1
    assert "lost scans" not in dict(decoding.facts())
    assert decoding.silence_s == 0.5
    slow = decoder(silence_s=0.1)
    for n in range(0, 60, 30):
        slow.received(telegram(full(n), Dialect.B), arrival_ns(n))
    assert slow.silence_s == pytest.approx(2.5 * 30 * 0.02)


@pytest.mark.parametrize("word", ["sRA", "sSN"])
def test_a_counter_that_stands_still_is_frozen(word: str) -> None:
    decoding = decoder()
    texts = []
    for n in range(16):
        decoding.received(telegram(full(0), Dialect.B, word), arrival_ns(n))
        texts.append(decoding.status(arrival_ns(n))[1])
    assert texts[5] is None
    assert texts[-1] == "frozen: the scan counter stands still"
    assert len(decoding.received(telegram(full(16), Dialect.B, word), arrival_ns(16))) == 1
    assert decoding.status(arrival_ns(16)) == (0, None)


def test_old_scans_are_refused() -> None:
    decoding = decoder()
    assert len(hear(decoding, *(full(n) for n in range(20)))) == 20
    # Whoever held the line lets go 2 s later: a hundred scans at once.
    late_ns = arrival_ns(120)
    found = [decoding.received(telegram(full(n), Dialect.B), late_ns) for n in range(20, 121)]
    assert sum(map(len, found[:95])) == 0
    assert len(found[-1]) == 1
    errors, hindrance = decoding.status(late_ns)
    assert errors >= 95
    assert hindrance is None
    assert decoding.late_s == 0.0


def test_a_polled_scan_may_be_a_turn_old_and_no_more() -> None:
    decoding = decoder(delivery="polled")
    hear(decoding, *(full(n) for n in range(20)), word="sRA")
    data = telegram(full(30), Dialect.B, "sRA")
    assert len(decoding.received(data, arrival_ns(30) + 20 * MS)) == 1
    data = telegram(full(40), Dialect.B, "sRA")
    assert decoding.received(data, arrival_ns(40) + 200 * MS) == []


def test_a_device_that_starts_again_is_followed() -> None:
    decoding = decoder()
    hear(decoding, *(full(n) for n in range(50)))
    fresh = [
        replace(full(n), start_up_us=20_000 * n, transmission_us=20_000 * n + 3100)
        for n in (1, 2, 3)
    ]
    for n, scan in enumerate(fresh):
        at_ns = arrival_ns(500 + n)
        (found,) = decoding.received(telegram(scan, Dialect.B), at_ns)
        assert found.stamp_ns == at_ns - round(18.1 * MS)
    facts = dict(decoding.facts())
    assert facts["device starts seen"] == "1"
    assert "lost scans" not in facts


# ---------------------------------------------------------------- what is no scan


@pytest.mark.parametrize(
    ("status", "scans", "text"),
    [
        ((0, 0), 1, None),
        ((1, 0), 1, None),
        ((0, 1), 0, "device error"),
        ((0, 2), 1, "contamination warning"),
        ((0, 4), 0, "contaminated"),
        ((0, 5), 0, "contaminated"),
        ((0, 8), 1, "unknown device status 00 08"),
    ],
)
def test_device_status(status: tuple[int, int], scans: int, text: str | None) -> None:
    decoding = decoder()
    assert len(hear(decoding, full(status=status))) == scans
    said = decoding.status(arrival_ns(0))[1]
    assert said is None if text is None else text in str(said)


def test_a_start_that_does_not_end_is_said() -> None:
    decoding = decoder()
    for n in (0, 1000, 2999, 3001):
        found = decoding.received(telegram(full(n, status=(1, 0)), Dialect.B), arrival_ns(n))
        assert len(found) == 1
        said = decoding.status(arrival_ns(n))[1]
        assert said == ("unknown device status 01 00" if n > 3000 else None)


def test_another_device_gives_no_scan() -> None:
    decoding = decoder(serial_number=17271466)
    assert hear(decoding, full()) == []
    said = decoding.status(arrival_ns(0))[1]
    assert said is not None
    assert "serial number 18090362 instead of 17271466" in said
    assert len(hear(decoder(serial_number=18090362), full())) == 1


def test_the_horizontal_layer_is_taken() -> None:
    decoding = decoder()
    layers = [full(n, layer_angle=(250, 0, -250, -500)[n % 4]) for n in range(8)]
    assert [scan.seq for scan in hear(decoding, *layers)] == [1, 5]
    assert decoding.status(arrival_ns(7)) == (0, None)
    assert dict(decoding.facts())["layers"] == "4"
    tilted = decoder()
    assert hear(tilted, full(layer_angle=250)) == []
    assert tilted.status(arrival_ns(0))[1] == "no horizontal layer comes, but one at 2.5 deg"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"channels": ()}, "no distances"),
        ({"channels": (channel(name="RSSI1"),)}, "no distances"),
        ({"channels": (channel(values=np.full(1, 900)),)}, "no sweep"),
        ({"channels": (channel(values=np.full(2000, 900)),)}, "no sweep"),
        ({"channels": (channel(angle_step=0),)}, "no sweep"),
        ({"channels": (channel(scale=-1.0),)}, "scale"),
        ({"scan_frequency": 0}, "frequency"),
    ],
)
def test_what_is_no_sweep_is_refused_by_name(changes: dict[str, Any], text: str) -> None:
    decoding = decoder()
    assert hear(decoding, full(**changes)) == []
    said = decoding.status(arrival_ns(0))[1]
    assert said is not None
    assert text in said


def test_damage_is_counted() -> None:
    decoding = decoder()
    data = bytearray(telegram(full(1), Dialect.B))
    data[100] ^= 4
    hear(decoding, full(0))
    decoding.sent(read_request(SCAN, Dialect.B), arrival_ns(1))
    assert decoding.received(bytes(data), arrival_ns(1)) == []
    assert decoding.pending is None, "the damaged answer must be asked for again"
    assert len(decoding.received(telegram(full(2), Dialect.B), arrival_ns(2))) == 1
    assert decoding.status(arrival_ns(2)) == (1, None)


# ---------------------------------------------------------------- answers and silence


@pytest.mark.parametrize("dialect", list(Dialect))
def test_requests_are_pending_until_they_are_answered(dialect: Dialect) -> None:
    decoding = decoder()
    for name, body in (
        (IDENT, texts_body(("TiM5xx", "V2.60"), dialect)),
        (FIRMWARE, texts_body(("V2.60",), dialect)),
        (STATE, number_body(1, 8, dialect)),
        ("LocationName", b"nonsense"),
        (FIRMWARE, b"nonsense"),
    ):
        decoding.sent(read_request(name, dialect), START_NS)
        assert decoding.pending == name
        decoding.received(message("sRA", name, body, dialect), START_NS + MS)
        assert decoding.pending is None
    decoding.sent(event_request(SCAN, dialect, on=True), START_NS)
    decoding.received(refusal(3, dialect), START_NS + MS)
    assert decoding.pending is None
    facts = dict(decoding.facts())
    assert facts["dialect"] == f"CoLa {dialect.upper()}"
    assert facts["state"] == "ready"
    assert facts["firmware"] == "unreadable"
    assert decoding.model == "TiM5xx V2.60"
    said = decoding.status(START_NS + MS)[1]
    assert said == "LMDscandata is refused: sFA 3 (unknown variable)"


def test_silence_is_named() -> None:
    decoding = decoder()
    later_ns = START_NS + 600 * MS
    assert decoding.status(START_NS + 400 * MS) == (0, None)
    assert decoding.status(later_ns) == (0, "no answer in CoLa yet")
    decoding.received(b"HTTP/1.1 400 Bad Request", later_ns)
    said = decoding.status(later_ns)[1]
    assert said == "no answer in CoLa yet; what answers does not speak CoLa"
    state = number_body(3, 8, Dialect.B)
    decoding.received(message("sRA", STATE, state, Dialect.B), later_ns)
    assert decoding.status(later_ns) == (0, None)
    decoding.received(message("sRA", STATE, state, Dialect.B), later_ns + 600 * MS)
    said = decoding.status(later_ns + 600 * MS)[1]
    assert said is not None
    assert "it says: standby" in said
    assert decoding.status(later_ns + 1200 * MS) == (0, "no scans for 1.2 s")


def pieces(data: bytes, size: int) -> Iterator[bytes]:
    return (data[start : start + size] for start in range(0, len(data), size))


@pytest.mark.parametrize("size", [1, 7, 4096])
def test_the_pieces_do_not_matter(size: int) -> None:
    whole, parts = decoder(), decoder()
    data = b"".join(telegram(full(n), Dialect.B) for n in range(3))
    first = whole.received(data, START_NS)
    again = [scan for piece in pieces(data, size) for scan in parts.received(piece, START_NS)]
    assert [(s.seq, s.stamp_ns, s.ranges_m.tobytes()) for s in first] == [
        (s.seq, s.stamp_ns, s.ranges_m.tobytes()) for s in again
    ]
    assert len(first) == 3


@pytest.mark.parametrize(
    "name",
    [
        "lms111_colab_scan1.bin",
        "lms511_colab_scan1.bin",
        "tim781s_colab_scan.bin",
        "tim571_colaa_sRA.bin",
    ],
)
def test_captured_scans_become_scans(name: str) -> None:
    folder = SHARED / "data/sick"
    if not (folder / "index.json").exists():
        pytest.skip(f"{folder} is absent")
    entries = json.loads((folder / "index.json").read_text())
    (wanted, *_) = next(e for e in entries if e["file"] == name)["expect"]["channels"]
    (scan,) = decoder().received((folder / name).read_bytes(), START_NS)
    assert len(scan.ranges_m) == wanted["n"]
    assert np.rint(1e3 * scan.ranges_m[:3]).tolist() == wanted["first3"]
    first_deg = wanted["start_angle_deg"] - 90.0
    assert scan.angles_rad[0] == pytest.approx(radians(first_deg))
    assert scan.angles_rad[-1] == pytest.approx(radians(-first_deg), abs=1e-9)
    assert not np.any(scan.ranges_m < 0.016)
