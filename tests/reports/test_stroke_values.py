"""Values of strokes, their sums over rallies, and what is not known."""

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pytest

from shuttle_marl.data.schema import Outcome
from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import ROOT
from shuttle_marl.policy.registry import resolve
from shuttle_marl.reports import add_values, add_values_of_pairs, rally_table, strokes_of
from shuttle_marl.reports.value import COLUMNS, Value, nearest_strokes
from tests.exact.exact_games import random_game, random_policy
from tests.exact.test_hidden_positions_solved import waiting, with_recovery
from tests.recording.conftest import read_rallies

MATCHES = os.environ.get("SHUTTLESET")


def column(table: pa.Table, name: str) -> npt.NDArray[np.float64]:
    return table[name].to_numpy(zero_copy_only=False)


def test_values_are_those_of_the_exact_solution(tournament: Path, valued: pa.Table, bc: TabulatedPolicy) -> None:
    game = bc.game
    rallies = read_rallies(tournament)
    state, k = rallies.legal(game)
    value = evaluate(bc, bc).striking[0]
    assert np.allclose(column(valued, "win_before"), (1 + value[state]) / 2, atol=1e-12)
    last = rallies.first_stroke[1:] - 1
    after = (1 - np.r_[value[state[1:]], 0]) / 2
    after[last] = rallies.reason
    assert np.allclose(column(valued, "win_after"), after, atol=1e-12)
    quality = game.stroke_values(value)[game.pair_start[state] + k]
    good = column(valued, "outcome") != Outcome.FAULT
    assert np.allclose(column(valued, "decision")[good], ((quality - value[state]) / 2)[good], atol=1e-12)
    assert np.allclose(column(valued, "decision") + column(valued, "execution"), column(valued, "value_added"))


def test_the_decision_of_a_fault_is_a_mean_over_its_possible_targets(tournament: Path, valued: pa.Table, bc) -> None:
    """The mean over the targets of the shot type and technique, weighted by how likely bc aims and faults there."""
    game = bc.game
    rallies = read_rallies(tournament)
    state, _ = rallies.legal(game)
    value = evaluate(bc, bc).striking[0]
    quality, probability = game.stroke_values(value), bc.pair_probabilities()
    fault = 1 - game.stroke_probabilities()[0]
    for row in np.flatnonzero(column(valued, "outcome") == Outcome.FAULT)[:20]:
        pairs = np.arange(game.pair_start[state[row]], game.pair_start[state[row] + 1])
        stroke = game.pair_stroke[pairs]
        kind = (game.catalogue.shot[stroke] == valued["shot"][row].as_py()) & (
            game.catalogue.technique[stroke] == valued["technique"][row].as_py()
        )
        weight = (probability * fault)[pairs[kind]]
        expected = (weight @ quality[pairs[kind]] / weight.sum() - value[state[row]]) / 2
        assert valued["decision"][row].as_py() == pytest.approx(expected, abs=1e-9)


def test_the_values_of_a_rally_add_up_to_its_outcome(valued: pa.Table, bc: TabulatedPolicy) -> None:
    serve = (1 + evaluate(bc, bc).striking[0][ROOT]) / 2
    rallies = rally_table(valued)
    players, added = np.array(valued["player"].to_pylist()), column(valued, "value_added")
    ends = np.r_[rallies["first"].to_numpy()[1:], valued.num_rows]
    for first, end, server, winner in zip(
        rallies["first"].to_numpy(), ends, rallies["server"].to_pylist(), rallies["winner"].to_pylist(), strict=True
    ):
        sign = np.where(players[first:end] == server, 1.0, -1.0)
        assert sign @ added[first:end] == pytest.approx((server == winner) - serve, abs=1e-9)


def test_values_of_two_people_are_those_of_their_game(tournament: Path, valued: pa.Table, bc: TabulatedPolicy) -> None:
    people = {"bc": "viktor-axelsen", "attacking": "chou-tien-chen"}  # of equal hands, so in the states of the log
    played = np.array(
        [{a, b} == set(people) for a, b in zip(*valued.select(["player", "opponent"]).to_pydict().values(), strict=True)]
    )
    table = valued.drop_columns(list(COLUMNS)).filter(pa.array(played))
    for name in ("player", "opponent"):
        renamed = pa.array([people[player] for player in table[name].to_pylist()])
        table = table.set_column(table.schema.get_field_index(name), name, renamed)
    found = add_values_of_pairs(table, "bc", bc.game)
    pair = pair_game(*sorted(people.values()))
    assert set(found["value_game"].to_pylist()) == {pair.hash}
    first, second = (tabulate(resolve("bc", seat), seat) for seat in pair.seats)
    striking = np.stack(evaluate(first, second).striking)
    state, _ = read_rallies(tournament).legal(bc.game)
    seat = (np.array(found["player"].to_pylist()) == pair.people.players[1]).astype(int)
    assert np.allclose(column(found, "win_before"), (1 + striking[seat, state[played]]) / 2, atol=1e-12)
    rallies = rally_table(found)
    name, added = pair.people.players[0], column(found, "value_added")
    sign = np.where(np.array(found["player"].to_pylist()) == name, 1.0, -1.0)
    wins = np.add.reduceat(sign * added, rallies["first"].to_numpy())
    served = np.array(rallies["server"].to_pylist()) == name
    serve = np.where(served, 1 + striking[0, ROOT], 1 - striking[1, ROOT]) / 2
    assert np.allclose(wins, (np.array(rallies["winner"].to_pylist()) == name) - serve, atol=1e-9)
    assert np.abs(column(found, "win_before") - column(valued.filter(pa.array(played)), "win_before")).max() > 0.01


def test_matches_of_others_have_values_of_the_average_game(valued: pa.Table, bc: TabulatedPolicy) -> None:
    found = add_values_of_pairs(valued.drop_columns(list(COLUMNS)).slice(0, 500), "bc", bc.game)
    assert set(found["value_game"].to_pylist()) == {bc.game.hash}
    assert np.array_equal(column(found, "win_before")[:480], column(valued, "win_before")[:480])


def test_minimax_values_may_be_the_reference_too(tournament: Path, bc: TabulatedPolicy) -> None:
    minimax = tabulate(resolve("minimax", bc.game), bc.game)
    decision = column(add_values(strokes_of(tournament), minimax), "decision")
    # Against perfect play no choice is better than the reference's; the table of minimax has a resolution.
    assert np.nanmax(decision) < 1e-4
    assert np.nanmean(decision) < -0.01


def test_only_unknown_values_are_null(valued: pa.Table, bc: TabulatedPolicy) -> None:
    lengths = rally_table(valued)["length"].to_numpy()
    first = int(rally_table(valued)["first"][int(np.flatnonzero(lengths >= 6)[0])].as_py())
    plain = valued.drop_columns(list(COLUMNS))
    gap = pa.concat_tables([plain.slice(0, first + 2), plain.slice(first + 3)])  # the third stroke of a rally is missing
    found = add_values(gap, bc)
    kept = pa.concat_tables([valued.slice(0, first + 2), valued.slice(first + 3)])
    before, expected = column(found, "win_before"), column(kept, "win_before")
    # The stroke after the gap has lost what came in; the one after that, its own last stroke.
    assert np.flatnonzero(np.isnan(before)).tolist() == [first + 2]
    # From there on it is not known either how often a player attacked in the rally.
    rest = np.arange(first + 3, first + lengths[np.flatnonzero(lengths >= 6)[0]] - 1)
    same = np.delete(np.arange(len(before)), [first + 2, *rest])
    assert np.array_equal(before[same], expected[same])
    assert np.abs(before[rest] - expected[rest]).max() < 0.1
    after = column(found, "win_after")
    assert np.flatnonzero(np.isnan(after)).tolist() == [first + 1]


def test_the_nearest_stroke_of_the_catalogue(bc: TabulatedPolicy) -> None:
    catalogue = bc.game.catalogue
    nearest = nearest_strokes(catalogue)
    there = catalogue.by_parts >= 0
    assert (nearest[there] == catalogue.by_parts[there]).all()
    shot, area, height, technique = np.nonzero(nearest >= 0)
    found = nearest[shot, area, height, technique]
    assert (catalogue.shot[found] == shot).all()
    assert (catalogue.height[found] == height).all()
    little = Catalogue.from_names(
        ["smash:back-left:above:forehand", "smash:front-right:above:forehand", "smash:middle-centre:above:backhand"]
    )
    near = nearest_strokes(little)
    smash = 5
    assert near[smash, 5, 1, 0] == 0, "middle-left: back-left is nearer than front-right"
    assert near[smash, 1, 1, 0] == 1
    assert near[smash, 4, 1, 0] in (0, 1), "the technique counts before the area"
    assert near[smash, 8, 1, 1] == 2
    assert near[smash, 8, 1, 2] == 0
    assert (near[smash, :, 0] == -1).all()
    assert (near[0] == -1).all()
    alone = nearest_strokes(Catalogue.from_names(["smash:front-left:above:forehand"]))
    assert (alone[smash, :, 1] == 0).all(), "also at the largest distance: the opposite corner with another technique"


@pytest.mark.skipif(not MATCHES, reason="SHUTTLESET names no folder with the annotated matches")
def test_annotated_matches(bc: TabulatedPolicy) -> None:
    found = add_values(strokes_of(Path(str(MATCHES))), bc)
    assert found["value_added"].null_count < 0.05 * found.num_rows
    # 4.5 % of real strokes are of a shot type that fewer than 5 % choose there: they are illegal, as is what follows from them.
    assert found["decision"].null_count < 0.17 * found.num_rows
    # The average player is the average of these matches.
    assert abs(np.nanmean(column(found, "value_added"))) < 0.003
    assert abs(np.nanmean(column(found, "decision"))) < 0.002


@pytest.mark.parametrize("hidden", [False, True])
def test_the_mean_advantage_of_what_a_policy_plays_is_zero(hidden: bool) -> None:
    game = with_recovery(random_game(2), 2) if hidden else random_game(2)
    first, second = random_policy(game, 1), random_policy(game, 2)
    if hidden:
        first, second = waiting(first, 1), waiting(second, 2)
    value = evaluate(first, second)
    for seat, (own, other) in enumerate(((first, second), (second, first))):
        worth = Value(game, value.striking, seat, other)
        pairs = np.arange(game.n_pairs)
        advantage = worth.advantage(pairs, game.pair_state)
        assert np.allclose(worth.win() - worth.before(game.pair_state), advantage, atol=1e-12)
        mean = game.sum_by_state(own.pair_probabilities() * advantage)[game.playable]
        assert np.abs(mean).max() < 1e-7
        assert np.abs(advantage).max() > 0.01
