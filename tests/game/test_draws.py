"""Random numbers by counter."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game.draws import CHOICE_ONE, choice_draw, draw, mix, outcome_draw, position_draw, stream

_GOLDEN = 0x9E3779B97F4A7C15


def test_mix_gives_the_published_sequence_of_splitmix64() -> None:
    # The first outputs of SplitMix64 with seed 0, as printed in many places (e.g. the Rosetta Code entry for 1234567).
    seeds = np.array([k * _GOLDEN % 2**64 for k in (1, 2, 3)], dtype=np.uint64)
    with np.errstate(over="ignore"):
        assert [hex(int(x)) for x in mix(seeds)] == ["0xe220a8397b1dcdaf", "0x6e789e6aa1b965f4", "0x6c45d188009454f"]
        seeds = np.array([(1234567 + k * _GOLDEN) % 2**64 for k in (1, 2)], dtype=np.uint64)
        assert mix(seeds).tolist() == [6457827717110365317, 3203168211198807973]


def test_the_largest_draws_stay_below_their_bounds() -> None:
    ones = np.array([2**64 - 1], dtype=np.uint64)
    assert outcome_draw(ones).tolist() == [(1 << 24) - 1]
    assert choice_draw(ones).tolist() == [CHOICE_ONE - 1]
    assert choice_draw(np.array([0xFFFFFFFF], dtype=np.uint64)).tolist() == [0]


def test_stroke_position_and_outcome_take_bits_of_their_own() -> None:
    """The upper half chooses the stroke, the 32 bits from the sixteenth the position, the lowest 24 the outcome."""
    numbers = np.array([1 << bit for bit in range(64)], dtype=np.uint64)
    assert np.flatnonzero(choice_draw(numbers)).tolist() == [*range(49, 64)]
    assert np.flatnonzero(position_draw(numbers)).tolist() == [*range(33, 48)]
    assert np.flatnonzero(outcome_draw(numbers)).tolist() == [*range(24)]


@given(st.integers(0, 2**64 - 1), st.permutations(range(12)))
def test_a_draw_does_not_depend_on_the_others_of_its_batch(seed: int, order: list[int]) -> None:
    rallies, strokes = np.arange(12), np.arange(12) * 7
    together = draw(stream(seed, 1, rallies), strokes)
    shuffled = draw(stream(seed, 1, rallies[order]), strokes[order])
    assert (together[order] == shuffled).all()
    for i in range(12):
        assert draw(stream(seed, 1, i), int(strokes[i]))[0] == together[i]


def test_numbers_are_not_interchangeable() -> None:
    names = [stream(0, a, b)[0] for a in range(40) for b in range(40)]
    assert len(set(map(int, names))) == 1600


def test_streams_broadcast() -> None:
    table = stream(4, np.arange(3)[:, None], np.arange(5))
    assert table.shape == (3, 5)
    assert table[2, 4] == stream(4, 2, 4)[0]
