"""Random numbers by counter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from shuttle_marl.game.draws import CHOICE_ONE, choice_draw, draw, mix, outcome_draw, stream

words = st.integers(0, 2**64 - 1)
_GOLDEN = 0x9E3779B97F4A7C15


def test_mix_gives_the_published_sequence_of_splitmix64() -> None:
    # The first outputs of SplitMix64 with seed 0, as printed in many places (e.g. the Rosetta Code entry for 1234567).
    seeds = np.array([k * _GOLDEN % 2**64 for k in (1, 2, 3)], dtype=np.uint64)
    with np.errstate(over="ignore"):
        assert [hex(int(x)) for x in mix(seeds)] == ["0xe220a8397b1dcdaf", "0x6e789e6aa1b965f4", "0x6c45d188009454f"]
        seeds = np.array([(1234567 + k * _GOLDEN) % 2**64 for k in (1, 2)], dtype=np.uint64)
        assert mix(seeds).tolist() == [6457827717110365317, 3203168211198807973]


@given(words)
def test_mix_can_be_undone(x: int) -> None:
    with np.errstate(over="ignore"):
        y = int(mix(np.array([x], dtype=np.uint64))[0])
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, 1)):
        z = y
        for _ in range(3):
            z = y ^ (z >> shift)
        y = z * pow(factor, -1, 2**64) % 2**64
    assert y == x


def bits(count: int, seed: int = 0) -> np.ndarray:
    """Draws as an environment makes them: many rallies of 16 strokes."""
    return draw(stream(seed, 3, np.arange(count // 16))[:, None], np.arange(16)).ravel()


@pytest.mark.parametrize(("part", "top"), [(outcome_draw, 1 << 24), (choice_draw, CHOICE_ONE)])
def test_draws_are_uniform_and_independent_of_their_neighbours(part: object, top: int) -> None:
    u = part(bits(1 << 20)).astype(np.int64)  # type: ignore[operator]
    assert u.min() >= 0
    assert u.max() < top
    assert stats.chisquare(np.bincount(u * 256 // top, minlength=256)).pvalue > 1e-4
    assert stats.chisquare(np.bincount(u % 251, minlength=251)).pvalue > 1e-4
    for step in (1, 16):  # the next stroke, and the same stroke of the next rally
        pairs = (u[:-step] * 32 // top) * 32 + u[step:] * 32 // top
        assert stats.chisquare(np.bincount(pairs, minlength=1024)).pvalue > 1e-4


def test_outcome_and_choice_of_one_draw_are_independent() -> None:
    b = bits(1 << 20, seed=9)
    for part in (outcome_draw(b) >> 19, outcome_draw(b) >> 11 & 31):
        pairs = part * 32 + choice_draw(b) * 32 // CHOICE_ONE
        assert stats.chisquare(np.bincount(pairs, minlength=1024)).pvalue > 1e-4


def test_the_largest_draws_stay_below_their_bounds() -> None:
    ones = np.array([2**64 - 1], dtype=np.uint64)
    assert outcome_draw(ones).tolist() == [(1 << 24) - 1]
    assert choice_draw(ones).tolist() == [CHOICE_ONE - 1]
    assert choice_draw(np.array([0xFFFFFFFF], dtype=np.uint64)).tolist() == [0]


@given(st.integers(-(2**70), 2**70), st.permutations(range(12)))
def test_a_draw_does_not_depend_on_the_others_of_its_batch(seed: int, order: list[int]) -> None:
    rallies, strokes = np.arange(12), np.arange(12) * 7
    together = draw(stream(seed, 1, rallies), strokes)
    shuffled = draw(stream(seed, 1, rallies[order]), strokes[order])
    assert (together[order] == shuffled).all()
    for i in range(12):
        assert draw(stream(seed, 1, i), int(strokes[i]))[0] == together[i]


@given(words, words)
def test_different_seeds_and_numbers_name_different_streams(a: int, b: int) -> None:
    if a != b:
        assert stream(a)[0] != stream(b)[0]
        assert stream(5, np.array([a], dtype=np.uint64))[0] != stream(5, np.array([b], dtype=np.uint64))[0]


def test_numbers_are_not_interchangeable() -> None:
    names = [stream(0, a, b)[0] for a in range(40) for b in range(40)]
    assert len(set(map(int, names))) == 1600


def test_streams_broadcast() -> None:
    table = stream(4, np.arange(3)[:, None], np.arange(5))
    assert table.shape == (3, 5)
    assert table[2, 4] == stream(4, 2, 4)[0]
