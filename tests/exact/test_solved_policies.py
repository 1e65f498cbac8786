"""Solved policies by name, tables in files, and families of installed packages."""

from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.exact import PairPolicy, best_response, evaluate, solve, solve_robust, solve_soft
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.game.shipped import refits_of
from shuttle_marl.policy import baselines, registry
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import hand_made
from tests.reduced import reduced_game

GAME = reduced_game()


def cumulative(name: str) -> np.ndarray:
    return tabulate(resolve(name, GAME), GAME).cumulative


def test_minimax_and_best_responses_have_names() -> None:
    assert {"minimax", "best-response:bc"} <= set(registry.names(GAME))
    assert np.array_equal(cumulative("minimax"), solve(GAME).policy[0].cumulative)
    average = tabulate(resolve("bc", GAME), GAME)
    assert np.array_equal(cumulative("best-response:bc"), best_response(average).policy.cumulative)


def test_human_play_has_names() -> None:
    assert "human:0.05" in registry.names(GAME)
    prior = PairPolicy(game=GAME, probability=baselines.probabilities(None, GAME))
    expected = from_pair_probabilities(GAME, solve_soft(prior, tau=0.1).policy[0].probability)
    assert np.array_equal(cumulative("human:0.1"), expected.cumulative)
    player = baselines.players(GAME)[0]
    own = PairPolicy(game=GAME, probability=baselines.probabilities(player, GAME))
    expected = from_pair_probabilities(GAME, solve_soft(own, prior, tau=0.1).policy[0].probability)
    assert np.array_equal(cumulative(f"human:0.1:{player}"), expected.cumulative)
    np.testing.assert_allclose(cumulative("human:1e9").astype(int), cumulative("bc").astype(int), rtol=0, atol=1)


def test_robust_play_needs_refits() -> None:
    assert np.array_equal(cumulative("minimax:robust"), solve_robust([GAME, *refits_of(GAME)]).policy[0].cumulative)
    with pytest.raises(PolicyError, match="needs refits of the game on resampled matches"):
        resolve("minimax:robust", hand_made())
    assert ["minimax:robust" in registry.names(game) for game in (GAME, hand_made())] == [True, False]


def test_the_name_within_a_best_response_is_a_whole_name() -> None:
    sharp = tabulate(resolve("bc@0.5", GAME), GAME)
    assert np.array_equal(cumulative("best-response:bc@0.5"), best_response(sharp).policy.cumulative)
    assert not np.array_equal(cumulative("best-response:bc@0.5"), cumulative("best-response:bc"))
    twice = tabulate(resolve("best-response:best-response:random", GAME), GAME)
    once = tabulate(resolve("best-response:random", GAME), GAME)
    assert evaluate(twice, once).odds().rally > 0.5


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("minimax:3", "expected minimax or minimax:robust"),
        ("human", "expected human:TAU or human:TAU:PLAYER"),
        ("human:-1", "with a number TAU above 0"),
        ("human:nan", "with a number TAU above 0"),
        ("human:0.05:no-one", "no model of the player 'no-one'"),
        ("best-response", "expected the name of a policy behind the colon"),
        ("best-response:rndom", "did you mean random"),
        ("table", "expected a file behind the colon"),
        ("table:nowhere.safetensors", "no readable table"),
    ],
)
def test_names_that_lead_nowhere(name: str, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        resolve(name, GAME)


def test_a_policy_that_reads_the_score_has_no_best_response(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_moody.py").write_text("def player(states):\n    return states.mask\nplayer.reads_score = True\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match="reads the score, so it has no table over states; a league plays it"):
        resolve("best-response:my_moody:player", GAME)


def test_a_saved_table_can_be_played(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    table = tabulate(resolve("safe", GAME), GAME)
    table.save(path)
    assert np.array_equal(cumulative(f"table:{path}"), table.cumulative)
    with pytest.raises(PolicyError, match=r"tabulated for game \w{12}, this is"):
        TabulatedPolicy.load(path, hand_made())
