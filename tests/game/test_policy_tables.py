"""Policies as tables over legal pairs and positions: what they mean, how they are stored, and which ones are refused."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard

from shuttle_marl.base.tensor_files import read_tensors, tensor_bytes
from shuttle_marl.game.draws import CHOICE_ONE
from shuttle_marl.game.policy import (
    PolicyError,
    States,
    TabulatedPolicy,
    UniformPolicy,
    cumulative_positions,
    from_pair_probabilities,
    tabulate,
)
from tests.exact.exact_games import random_policy, tiring_game
from tests.recovery import Prefers, with_recovery

GAME = tiring_game()
POLICY = random_policy(GAME, 1)
HIDDEN = with_recovery(GAME, 3, 3)
STATES = np.arange(GAME.n_states)


def waiting(seed: int) -> TabulatedPolicy:
    """Random strokes, and random positions among the feasible ones."""
    mask = HIDDEN.waiting.mask(HIDDEN.base(STATES))
    p = mask * np.random.default_rng(seed).uniform(0.1, 1, mask.shape)
    return dataclasses.replace(random_policy(HIDDEN, seed), waits=cumulative_positions(p / p.sum(axis=1, keepdims=True)))


WAITING = waiting(2)


def shares_of(table: TabulatedPolicy, state: int) -> list[int]:
    """How many of the 65,535 draws choose each legal stroke of a state."""
    game = table.game
    entries = table.cumulative[game.pair_start[state] : game.pair_start[state + 1]].tolist()
    return [upper - lower for lower, upper in zip([0, *entries], entries, strict=False)]


def test_a_table_is_what_it_plays() -> None:
    units = [units for state in STATES.tolist() for units in shares_of(POLICY, state)]
    assert min(units) >= 0
    assert np.array_equal(POLICY.pair_probabilities() * CHOICE_ONE, units)
    pairs = np.array([[0, 1, GAME.n_base_pairs], [GAME.n_pairs - 1, 57, 58]])
    assert (POLICY.probability_of(pairs) * CHOICE_ONE).tolist() == np.array(units)[pairs].tolist()
    for block in (0, 4, GAME.n_blocks - 1):
        part = units[block * GAME.n_base_pairs : (block + 1) * GAME.n_base_pairs]
        assert POLICY.block_units(block).tolist() == part
        assert np.array_equal(POLICY.block_probabilities(block) * CHOICE_ONE, part)
    width = max(int(GAME.legal_count(state)) for state in STATES.tolist())
    padded = POLICY.padded
    assert padded.shape == (GAME.n_states, width)
    for state in (0, 5, 2, GAME.n_states - 1):
        count = int(GAME.legal_count(state))
        assert padded[state, :count].tolist() == np.cumsum(shares_of(POLICY, state)).tolist()
        assert (padded[state, count:] == CHOICE_ONE).all()
        p = POLICY.probabilities(States(game=GAME, state=np.array([state, state])))
        assert (p[1] * CHOICE_ONE)[GAME.legal_strokes(state)] == pytest.approx(shares_of(POLICY, state))
        assert p.sum(axis=1) == pytest.approx([1, 1])
    with pytest.raises(ValueError, match="read-only"):
        padded[0, 0] = 0


def test_positions_of_a_table_are_its_own_or_those_of_people() -> None:
    assert WAITING.waits is not None
    steps = np.diff(WAITING.waits.astype(int), axis=1, prepend=0)
    found = WAITING.position_probabilities()
    assert found is not None
    assert found * CHOICE_ONE == pytest.approx(steps)
    states = States(game=HIDDEN, state=STATES[5:8].astype(np.int32))
    assert WAITING.positions(states) * CHOICE_ONE == pytest.approx(steps[5:8])
    people = dataclasses.replace(WAITING, waits=None)
    assert np.array_equal(people.position_probabilities(), HIDDEN.people_positions(STATES))
    assert np.array_equal(people.positions(states), HIDDEN.people_positions(states.state))
    assert np.array_equal(people.waiting_table, cumulative_positions(HIDDEN.people_positions(STATES)))
    assert WAITING.waiting_table is WAITING.waits
    # The first position whose cumulative number is above the draw.
    for table in (WAITING, people):
        row = table.waiting_table[7].tolist()
        for draw in (0, row[4], CHOICE_ONE - 1):
            expected = next(i for i, upper in enumerate(row) if upper > draw)
            assert table.choose_position(np.array([7]), np.array([draw])).tolist() == [expected]


@pytest.mark.parametrize("table", [POLICY, WAITING], ids=["strokes", "positions"])
def test_tables_survive_saving_and_packing(table: TabulatedPolicy, tmp_path: Path) -> None:
    path = tmp_path / "policy.safetensors"
    table.save(path, {"note": "mine"})
    header, arrays = read_tensors(path)
    assert header == {"game": table.game.hash, "hash": table.hash, "note": "mine"}
    assert set(arrays) == ({"cumulative"} if table.waits is None else {"cumulative", "waits"})
    for again in (TabulatedPolicy.load(path, table.game), TabulatedPolicy.unpacked(table.packed(), table.game, "here")):
        assert again.hash == table.hash
        assert again.game is table.game
        assert (again.waits is None) == (table.waits is None)
        assert np.array_equal(again.cumulative, table.cumulative)


def test_tables_of_other_sizes_are_not_unpacked() -> None:
    packed, says = POLICY.packed(), f"it is of another game; expected the {GAME.n_pairs:,} legal pairs of game {GAME.hash[:12]}"
    for other in (
        dataclasses.replace(GAME, fault_odds=GAME.fault_odds[:2]),
        dataclasses.replace(GAME, fault_odds=GAME.fault_odds[:1]),
    ):
        with pytest.raises(ValueError, match=f"expected the {other.n_pairs:,} legal pairs"):
            TabulatedPolicy.unpacked(packed, other, "here")
    with pytest.raises(ValueError, match=says):
        TabulatedPolicy.unpacked(zstandard.compress(bytes(2 * GAME.n_pairs + 2)), GAME, "here")
    damaged = bytearray(packed)
    damaged[-1] ^= 1
    with pytest.raises(zstandard.ZstdError):
        TabulatedPolicy.unpacked(bytes(damaged), GAME, "here")
    with pytest.raises(PolicyError, match="here: not a table over the"):
        TabulatedPolicy.unpacked(zstandard.compress(bytes(2 * GAME.n_pairs)), GAME, "here")


def write(path: Path, arrays: dict[str, Any], **header: str) -> None:
    path.write_bytes(tensor_bytes(arrays, {"game": GAME.hash, "hash": POLICY.hash, **header}))


def test_files_that_are_no_table_of_a_game_are_refused(tmp_path: Path) -> None:
    path, right = tmp_path / "policy.safetensors", {"cumulative": POLICY.cumulative}
    with pytest.raises(PolicyError, match=r"policy\.safetensors: no readable table of a policy"):
        TabulatedPolicy.load(path, GAME)
    write(path, right)
    assert TabulatedPolicy.load(path, GAME).hash == POLICY.hash
    write(path, {"other": POLICY.cumulative})
    with pytest.raises(PolicyError, match="no readable table of a policy"):
        TabulatedPolicy.load(path, GAME)
    write(path, right, game="f" * 64)
    with pytest.raises(PolicyError, match=f"tabulated for game {'f' * 12}, this is {GAME.hash[:12]}; tabulate it again"):
        TabulatedPolicy.load(path, GAME)
    write(path, right, hash="f" * 64)
    with pytest.raises(PolicyError, match="the table does not match its hash"):
        TabulatedPolicy.load(path, GAME)
    write(path, right | {"waits": WAITING.waits})
    with pytest.raises(PolicyError, match="a position that is not feasible"):
        TabulatedPolicy.load(path, GAME)


def with_entry(table: np.ndarray, at: Any, value: Any) -> np.ndarray:
    changed = table.copy()
    changed[at] = value
    return changed


STATE = int(np.flatnonzero(GAME.legal_count(STATES) >= 3)[-1])
LAST = int(GAME.pair_start[STATE + 1]) - 1


@pytest.mark.parametrize(
    ("cumulative", "says"),
    [
        (POLICY.cumulative[:-1], "not a table over the"),
        (POLICY.cumulative[None], "not a table over the"),
        (POLICY.cumulative.astype(np.int32), "not a table over the"),
        (with_entry(POLICY.cumulative, LAST, CHOICE_ONE - 1), "not a table over the"),
        (with_entry(POLICY.cumulative, int(GAME.last_pairs[0]), 0), "not a table over the"),
        (with_entry(POLICY.cumulative, LAST - 2, int(POLICY.cumulative[LAST - 1]) + 1), "a cumulative probability falls"),
    ],
)
def test_numbers_that_are_no_distributions_of_strokes_are_refused(cumulative: np.ndarray, says: str) -> None:
    with pytest.raises(PolicyError, match=f"here: {says}"):
        TabulatedPolicy.checked(cumulative, GAME, "here")


FEASIBLE = np.flatnonzero(HIDDEN.waiting.mask(np.array([5]))[0]).tolist()
"""The three feasible positions in state 5."""
INFEASIBLE = next(place for place in range(9) if place not in FEASIBLE)


def with_shares(shares: dict[int, int]) -> np.ndarray:
    """Positions with so many of the 65,535 draws in state 5."""
    row = np.cumsum([shares.get(place, 0) for place in range(9)])
    return with_entry(WAITING.waiting_table, 5, row.astype(np.uint16))


A, B, C = FEASIBLE
HALF = CHOICE_ONE // 2


@pytest.mark.parametrize(
    ("waits", "says"),
    [
        (with_shares({A: HALF, C: HALF + 1}), ""),
        (with_shares({B: CHOICE_ONE}), ""),
        (WAITING.waiting_table[:-1], "no table of nine positions in the 2,412 states of this game"),
        (WAITING.waiting_table[:, :-1], "no table of nine positions"),
        (WAITING.waiting_table.astype(np.int32), "no table of nine positions"),
        (with_shares({A: HALF, B: HALF}), "no table of nine positions"),
        (with_shares({A: HALF, INFEASIBLE: HALF + 1}), "a position that is not feasible, or a cumulative probability that falls"),
        (with_shares({A: HALF, B: -1, C: HALF + 2}), "a position that is not feasible, or a cumulative probability that falls"),
    ],
)
def test_positions_are_distributions_over_the_feasible_ones(waits: np.ndarray, says: str) -> None:
    if says:
        with pytest.raises(PolicyError, match=f"here: {says}"):
            TabulatedPolicy.checked(WAITING.cumulative, HIDDEN, "here", waits=waits)
    else:
        assert TabulatedPolicy.checked(WAITING.cumulative, HIDDEN, "here", waits=waits).waits is waits


def test_policies_are_tabulated_for_their_game_and_their_positions() -> None:
    table = tabulate(UniformPolicy(), GAME)
    assert shares_of(table, STATE) == np.diff(np.rint(np.linspace(0, CHOICE_ONE, int(GAME.legal_count(STATE)) + 1))).tolist()
    assert table.waits is None
    assert tabulate(table, GAME) is table
    other = dataclasses.replace(GAME, fault_odds=GAME.fault_odds + np.array([0, 1, 0], np.int32))
    with pytest.raises(PolicyError, match="tabulated for another game"):
        tabulate(table, other)
    with pytest.raises(PolicyError, match="this policy was tabulated for another game"):
        table.probabilities(States(game=other, state=np.zeros(1, np.int32)))
    # Equal weights are not where people wait; people's own positions are not stored.
    even = tabulate(Prefers((1.0,) * 9), HIDDEN)
    assert even.waits is not None
    assert even.waits[5].tolist() == [round(CHOICE_ONE * sum(place <= i for place in FEASIBLE) / 3) for i in range(9)]
    assert tabulate(Prefers((1.0,) * 9), GAME).waits is None
    assert tabulate(dataclasses.replace(POLICY, game=HIDDEN), dataclasses.replace(HIDDEN)).waits is None


class Moody(UniformPolicy):
    """Says that it reads the score."""

    reads_score = True


def test_a_policy_that_reads_the_score_has_no_table() -> None:
    with pytest.raises(PolicyError, match="policy 'Moody' reads the score, so it has no table over states"):
        tabulate(Moody(), GAME)


@pytest.mark.parametrize(
    ("sum_of_one_state", "fits"), [(1.0, True), (1 + 9e-7, True), (1 - 9e-7, True), (1 + 2e-6, False), (0.9, False)]
)
def test_probabilities_of_a_state_sum_to_one(sum_of_one_state: float, fits: bool) -> None:
    p = POLICY.pair_probabilities()
    p[GAME.pairs_of(STATE)] *= sum_of_one_state
    if fits:
        assert from_pair_probabilities(GAME, p).hash == POLICY.hash
    else:
        with pytest.raises(PolicyError, match="probabilities sum to"):
            from_pair_probabilities(GAME, p)
