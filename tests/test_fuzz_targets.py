"""Every fuzz target on its corpus and on changes of it, as `make fuzz` does for longer."""

from __future__ import annotations

from itertools import islice

import fuzzing
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

RANDOM_CHANGES = 1500


@pytest.mark.parametrize("name", fuzzing.names())
def test_no_known_input_breaks_a_parser(name: str) -> None:
    target = fuzzing.load(name)
    assert target.seeds()
    for data in (*target.seeds(), *fuzzing.corpus(name), b""):
        target.target(data)


@pytest.mark.parametrize("name", fuzzing.names())
def test_no_change_of_them_breaks_a_parser(name: str) -> None:
    target = fuzzing.load(name)
    inputs = [*target.seeds(), *fuzzing.corpus(name)]
    for data in islice(fuzzing.mutations(inputs, seed=1), RANDOM_CHANGES):
        target.target(data)


@pytest.mark.parametrize("name", fuzzing.names())
def test_no_pieces_of_them_break_a_parser(name: str) -> None:
    target = fuzzing.load(name)
    inputs = [*target.seeds(), *fuzzing.corpus(name)]
    pieces = st.one_of(st.sampled_from(inputs), st.binary(max_size=40)).flatmap(
        lambda data: st.slices(len(data)).map(lambda part: data[part])
    )

    @settings(max_examples=200, deadline=None, derandomize=True)
    @given(st.lists(pieces, max_size=6))
    def whatever_comes(parts: list[bytes]) -> None:
        target.target(b"".join(parts))

    whatever_comes()


def test_changes_are_the_same_for_the_same_seed() -> None:
    some = list(islice(fuzzing.mutations([b"abc", b"defghi"], seed=3), 50))
    assert some == list(islice(fuzzing.mutations([b"abc", b"defghi"], seed=3), 50))
    assert len(set(some)) > 30
