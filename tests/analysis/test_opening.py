"""Openings: the strokes after a line from the serve."""

from collections import Counter

import numpy as np
import pytest

from shuttle_marl.analysis.rally import Players, opening, states_after
from shuttle_marl.exact import evaluate, solve
from shuttle_marl.game.policy import Policy
from shuttle_marl.game.rally.stepper import stepper_of
from shuttle_marl.game.rules import RETURNED_BELOW, IllegalStrokeError
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from tests.reduced import reduced_game


@pytest.fixture(scope="module")
def game() -> Game:
    return reduced_game()


@pytest.fixture(scope="module")
def players(game: Game) -> Players:
    policy: Policy = resolve("random", game)
    table = tabulate(policy, game)
    return Players(tables=(table, table), value=evaluate(table, table))


def line_of(game: Game, length: int) -> list[int]:
    """Legal strokes one after the other, by the lowest state that each reaches."""
    line: list[int] = []
    for _ in range(length):
        line.append(int(game.legal_strokes(min(states_after(game, line)))[0]))
    return line


def test_states_are_those_of_rallies_that_are_played(game: Game) -> None:
    line, stepper, rng = line_of(game, 2), stepper_of(game), np.random.default_rng(0)
    reached: Counter[int] = Counter()
    for _ in range(4000):
        state = ROOT
        for i, stroke in enumerate(line):
            if not stepper.is_legal(state, stroke):
                break
            played, state = stepper.step(state, i % 2, stroke, int(rng.integers(1 << 24)))
            if played.outcome < RETURNED_BELOW:
                break
        else:
            reached[state] += 1
    expected = states_after(game, line)
    assert sum(expected.values()) == pytest.approx(1)
    assert set(reached) <= set(expected)
    for state, probability in expected.items():
        assert reached[state] / reached.total() == pytest.approx(probability, abs=4 * np.sqrt(0.25 / reached.total()))


@pytest.mark.parametrize("length", [0, 1, 2])
def test_values_are_those_of_the_solvers(game: Game, players: Players, length: int) -> None:
    line, solution = line_of(game, length), solve(game)
    found = opening(game, line, players, solution)
    assert found.seat == length % 2
    assert found.share.sum() == pytest.approx(1)
    assert (np.diff(found.share) <= 0).all()
    assert ((found.available > 0) & (found.available <= 1 + 1e-12)).all()
    assert players.value is not None
    before = sum(weight * players.value.striking[found.seat][state] for state, weight in states_after(game, line).items())
    # Every stroke is a share of the value before it, up to the rounding of tables to 1/65535: of a stroke that hurried strikers
    # and others may play, the value is the mean over them, whoever plays it more often.
    assert 2 * float(found.share @ found.win) - 1 == pytest.approx(float(before), abs=1e-6)
    states = states_after(game, line)
    for stroke, win in zip(found.stroke.tolist(), found.win.tolist(), strict=True):
        pairs = {int(game.pair(state, stroke)): weight for state, weight in states.items()}
        legal = {pair: weight for pair, weight in pairs.items() if pair >= 0}
        q = game.stroke_values(players.value.striking[1 - found.seat], np.array(list(legal)))
        mean = np.average(q, weights=list(legal.values()))
        assert 2 * win - 1 == pytest.approx(mean, abs=1e-9)
    best = sum(weight * solution.value[found.seat][state] for state, weight in states_after(game, line).items())
    assert 2 * float(found.share @ found.optimal) - 1 <= float(best) + 1e-6


def test_a_line_must_be_legal(game: Game, players: Players) -> None:
    serves = set(game.legal_strokes(ROOT).tolist())
    other = next(stroke for stroke in range(game.n_strokes) if stroke not in serves)
    for wrong in (other, game.n_strokes, -1):
        with pytest.raises(IllegalStrokeError, match="stroke 1 of the opening"):
            opening(game, [wrong], players, solve(game))
