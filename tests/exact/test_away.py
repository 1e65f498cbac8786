"""Figures at home and away in refits, and the iteration that solves for values."""

import json

import numpy as np
import pytest
from scipy import stats

from shuttle_marl.commands import exact as commands
from shuttle_marl.exact import ExactError, best_response, evaluate, solve
from shuttle_marl.exact.odds import over, spread
from shuttle_marl.exact.profile import moved
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import Scorer
from tests.exact.exact_games import with_probabilities
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()


@pytest.fixture(scope="module")
def refits() -> tuple[Game, ...]:
    """Two games of its layout."""
    return with_probabilities(GAME, 1), with_probabilities(GAME, 2)


@pytest.fixture(autouse=True)
def known_refits(monkeypatch: pytest.MonkeyPatch, refits: tuple[Game, ...]) -> None:
    monkeypatch.setattr(commands, "refits_of", lambda game: refits)


def test_the_interval_is_that_of_one_more_refit() -> None:
    width = stats.t.ppf(0.975, 2) * np.sqrt(4 / 3)
    one = spread([1.0, 2.0, 3.0])
    assert (one.value, one.low, one.high) == pytest.approx((2.0, 2 - width, 2 + width))


def test_a_scorecard_has_figures_away(refits: tuple[Game, ...]) -> None:
    safe, bc = (tabulate(resolve(name, GAME), GAME) for name in ("safe", "bc"))
    card = Scorer(GAME, refits=refits).score(safe, "safe")
    odds = [evaluate(moved(safe, game), moved(bc, game)).odds() for game in refits]
    assert card.away["rally_win_vs_bc"].value == pytest.approx(np.mean([each.rally for each in odds]))
    assert card.away["match_win_vs_bc"].value == pytest.approx(np.mean([each.match() for each in odds]))
    gains = [best_response(moved(safe, game)).value.odds().value for game in refits]
    assert card.away["exploitability"].value == pytest.approx(np.mean(gains))
    told = card.as_json()
    assert told["home"] == {name: told[name] for name in ("rally_win_vs_bc", "match_win_vs_bc", "exploitability")}
    assert set(told["away"]["exploitability"]) == {"value", "low", "high"}
    assert 0 < card.thin_vs_bc < 1
    assert Scorer(GAME).score(safe, "safe").as_json()["away"] is None


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert commands.main((*arguments, "--game", reduced_model())) == 0
    return capsys.readouterr().out


def test_commands_print_home_and_away(capsys: pytest.CaptureFixture[str], refits: tuple[Game, ...]) -> None:
    solved = json.loads(run(capsys, "solve", "--json"))
    policy = solve(GAME).policy[0]
    wins = [evaluate(moved(policy, game), moved(policy, game)).odds().serving for game in refits]
    assert solved["home"] == {"server_win": (1 + solved["value_at_serve"]) / 2, "exploitability": 0.0}
    assert solved["away"]["server_win"]["value"] == pytest.approx(np.mean(wins))
    answer = json.loads(run(capsys, "best-response", "safe", "--json"))
    assert answer["home"] == {"rally_win": answer["rally_win"], "match_win": answer["match_win"]}
    assert answer["away"]["rally_win"]["low"] < answer["away"]["rally_win"]["value"]
    assert "2 refits of the game on resampled matches" in run(capsys, "evaluate", "random")


def test_over_keeps_the_order_of_the_games(refits: tuple[Game, ...]) -> None:
    seen = over([*refits, *refits], lambda game: {"first": float(game is refits[0])})
    assert seen["first"].value == 0.5
    with pytest.raises(ExactError, match="an interval needs at least 2 refits"):
        over(refits[:1], lambda game: {})
