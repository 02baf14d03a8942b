from __future__ import annotations

from amr_slam.service.line_quality import LineQuality

MS = 1_000_000


def test_more_than_one_bad_telegram_in_twenty_is_told_and_forgotten_after_ten_seconds() -> None:
    line = LineQuality()
    errors, told = 0, []
    for number in range(600):  # 25 Hz
        now_ns = 40 * MS * number
        if 100 <= number < 200 and number % 10 == 0:
            errors += 1
        else:
            line.sample_came()
        if number % 5 == 0:
            told.append((now_ns, line.complaint(now_ns, errors)))
    first = next(now for now, text in told if text)
    last = max(now for now, text in told if text)
    assert 4000 * MS <= first <= 9000 * MS
    assert last <= 18_000 * MS
    texts = [text for _, text in told if text]
    assert "telegrams damaged in 10 s" in texts[0]


def test_one_bad_telegram_of_few_says_nothing() -> None:
    line = LineQuality()
    for number in range(5):
        line.sample_came()
        assert line.complaint(2000 * MS * number, 1) is None


def test_bytes_without_a_sample_are_a_fault_of_the_link_within_a_second() -> None:
    line = LineQuality()
    for number in range(100):
        line.bytes_came(460, 10 * MS * number)
    assert line.complaint(900 * MS, 0) is None
    text = line.complaint(1000 * MS, 0)
    assert text is not None
    assert "nothing of use in it" in text
    line.sample_came()
    assert line.complaint(1001 * MS, 0) is None


def test_a_flood_is_a_fault_at_once() -> None:
    line = LineQuality()
    line.bytes_came(70_000, 5)
    assert line.complaint(10, 0) is not None
    line.restart()
    assert line.complaint(20, 0) is None


def test_a_slow_line_may_take_more_than_a_second_for_a_telegram() -> None:
    line = LineQuality()
    for number in range(115):  # 9600 Bd
        line.bytes_came(10, 10 * MS * number)
    assert line.complaint(1150 * MS, 0) is None
