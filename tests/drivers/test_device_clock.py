from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amr_drivers.device_clock import DeviceClock

S = 1_000_000_000
LATE = 100_000_000
BOOT_NS = 77_000 * S


def arrivals(
    count: int, period_s: float, *, ppm: float = 0.0, start_us: int = 0, seed: int = 1
) -> list[tuple[int, int, int]]:
    """(device's counter in us, our time of it, arrival) of telegrams with usual delays."""
    dice = random.Random(seed)
    found = []
    for n in range(count):
        true_ns = BOOT_NS + round(n * period_s * S)
        device_us = start_us + round(n * period_s * 1e6 * (1.0 - 1e-6 * ppm))
        delay_ns = round(1e6 * min(dice.expovariate(1.0 / 0.5), 40.0))
        found.append((device_us % 2**32, true_ns, true_ns + delay_ns))
    return found


@pytest.mark.parametrize("ppm", [-80.0, 0.0, 80.0])
def test_the_line_follows_the_drift(ppm: float) -> None:
    clock = DeviceClock()
    for n, (count, true_ns, arrival_ns) in enumerate(arrivals(6000, 0.02, ppm=ppm)):
        assert clock.hear(count, arrival_ns, LATE)
        if n > 10:
            assert abs(clock.at(count) - true_ns) < 1_500_000
    assert clock.drift_ppm == pytest.approx(ppm, abs=10.0)
    assert clock.restarts == 0


@pytest.mark.parametrize("ppm", [-50.0, 0.0, 50.0])
def test_polls_at_all_phases_find_the_prompt_ones(ppm: float) -> None:
    clock = DeviceClock()
    dice = random.Random(3)
    errors_ms = []
    for n in range(500):
        ready_ns = BOOT_NS + n * 2 * S
        count = round(n * 2_000_000 * (1.0 - 1e-6 * ppm))
        phase = (n * 0.618034 + 0.02 * dice.random()) % 1.0 if n > 4 else 0.02
        clock.hear(count, ready_ns + round(66e6 * phase), 2 * LATE)
        errors_ms.append(1e-6 * (clock.at(count) - ready_ns))
    assert max(map(abs, errors_ms)) < 10.0
    assert max(map(abs, errors_ms[250:])) < 3.0


def test_the_counter_wraps() -> None:
    clock = DeviceClock()
    for count, true_ns, arrival_ns in arrivals(500, 0.02, start_us=2**32 - 4_000_000):
        assert clock.hear(count, arrival_ns, LATE)
        assert abs(clock.at(count) - true_ns) < 3_000_000
        assert abs(clock.at((count - 15_000) % 2**32) - (true_ns - 15_000_000)) < 3_000_000
    assert clock.restarts == 0


def test_late_telegrams_are_refused_and_teach_nothing() -> None:
    clock = DeviceClock()
    story = arrivals(200, 0.02)
    for count, _, arrival_ns in story[:100]:
        assert clock.hear(count, arrival_ns, LATE)
    for count, _, _ in story[100:150]:  # they all come at once, when whoever held them lets go
        late = story[149][1] - (BOOT_NS + count * 1000) > LATE
        assert clock.hear(count, story[149][1], LATE) is not late
    for count, true_ns, arrival_ns in story[150:]:
        assert clock.hear(count, arrival_ns, LATE)
        assert abs(clock.at(count) - true_ns) < 2_000_000


@pytest.mark.parametrize("up_s", [5, 3000, 4200])
def test_a_device_that_starts_again_is_noticed(up_s: int) -> None:
    clock = DeviceClock()
    for count, _, arrival_ns in arrivals(100, 0.02, start_us=up_s * 1_000_000):
        clock.hear(count, arrival_ns, LATE)
    later_ns = BOOT_NS + 32 * S
    for n in range(50):
        true_ns = later_ns + n * 20_000_000
        assert clock.hear(n * 20_000, true_ns + 300_000, LATE)
        assert clock.at(n * 20_000) == pytest.approx(true_ns + 300_000, abs=100_000)
    assert clock.restarts == 1


def test_a_first_telegram_that_came_late_is_forgotten() -> None:
    clock = DeviceClock()
    clock.hear(0, BOOT_NS + 400_000_000, LATE)
    assert clock.hear(20_000, BOOT_NS + 20_000_000, LATE)
    assert clock.at(20_000) == BOOT_NS + 20_000_000
    assert clock.restarts == 0


def test_overtaken_telegrams_are_no_restart() -> None:
    clock = DeviceClock(tick_ns=1_000_000, modulus=86_400_000)
    story = [(86_399_900, 0), (40, 140), (0, 141), (80, 180)]
    for count, ms in story:
        assert clock.hear(count, BOOT_NS + ms * 1_000_000, LATE)
    assert clock.restarts == 0
    assert clock.at(80) == BOOT_NS + 180_000_000


@settings(max_examples=200, derandomize=True, deadline=None)
@given(
    steps=st.lists(
        st.tuples(st.integers(0, 2**32 - 1), st.integers(-S, 100 * S)), min_size=1, max_size=60
    )
)
def test_no_story_breaks_it(steps: list[tuple[int, int]]) -> None:
    clock = DeviceClock()
    for count, arrival_ns in steps:
        if clock.hear(count, BOOT_NS + arrival_ns, LATE):
            late_ns = BOOT_NS + arrival_ns - clock.at(count)
            assert abs(late_ns) <= LATE + 0.0002 * 2**31 * 1000
