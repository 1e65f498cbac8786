"""Scorecards, and the league's exact figures."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from shuttle_marl.exact import crossplay, evaluate, nash_conv, solve
from shuttle_marl.exact.odds import normalised_score
from shuttle_marl.game.policy import PolicyError, States, tabulate
from shuttle_marl.game.tables import ROOT
from shuttle_marl.league import LeagueConfig, run_league
from shuttle_marl.league.entrants import Entrant, enter
from shuttle_marl.league.ranking import exact_odds
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.scorecard import Scorer
from tests.exact.exact_games import hand_made, random_game, random_policy
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
SCORER = Scorer(GAME)


class Moody:
    """Plays like another policy, but says that it reads the score."""

    reads_score = True

    def __init__(self, name: str) -> None:
        self.base = tabulate(resolve(name, GAME), GAME)

    def probabilities(self, states: States) -> np.ndarray:
        assert states.score is not None
        return self.base.probabilities(states)


def test_the_ends_of_the_scale() -> None:
    bc = SCORER.score(resolve("bc", GAME), "bc")
    best = SCORER.score(resolve("best-response:bc", GAME), "best-response:bc")
    perfect = SCORER.score(resolve("minimax", GAME), "minimax")
    assert (bc.normalised_score, bc.rally_win_vs_bc) == (pytest.approx(0, abs=1e-8), pytest.approx(0.5, abs=1e-9))
    assert best.normalised_score == pytest.approx(1, abs=1e-8)
    assert best.rally_win_vs_bc == pytest.approx((1 + bc.exploitability) / 2, abs=1e-8)
    assert (perfect.exploitability, perfect.regret_per_rally) == (pytest.approx(0, abs=1e-8), pytest.approx(0, abs=1e-8))
    assert perfect.gap_at_serve == pytest.approx(0, abs=1e-8)
    assert 0 < perfect.normalised_score < 1
    for card in (bc, best, perfect):
        assert card.error_bound <= 1e-7
        assert card.match_error_bound <= 1e-6
        assert sum(card.endings_vs_bc.values()) == pytest.approx(1, abs=1e-8)
        assert sum(card.shot_mix_vs_bc.values()) == pytest.approx(1, abs=1e-8)


def test_the_figures_of_one_policy() -> None:
    policy = tabulate(resolve("attacking", GAME), GAME)
    card = SCORER.score(policy, "attacking")
    odds = evaluate(policy, SCORER.reference).odds()
    assert (card.rally_win_serving, card.rally_win_receiving) == (odds.serving, odds.receiving)
    assert card.match_win_vs_bc == odds.match()
    assert card.exploitability == pytest.approx(nash_conv(policy).exploitability, abs=1e-12)
    won = card.endings_vs_bc["own winner"] + card.endings_vs_bc["fault of the opponent"]
    assert won == pytest.approx(card.rally_win_vs_bc, abs=1e-8)
    best = SCORER.reference_best.rally
    assert card.normalised_score == pytest.approx((odds.rally - 0.5) / (best - 0.5), abs=1e-12)
    assert card.gap_at_serve >= card.regret_per_rally / 2 - abs(solve(GAME).value[0][ROOT])
    assert set(card.as_json()) >= {"policy", "rally_win_vs_bc", "match_win_vs_bc", "exploitability", "normalised_score"}


def test_a_game_without_clones_has_no_scorer() -> None:
    with pytest.raises(PolicyError, match="was not loaded from one"):
        Scorer(random_game(991))


def test_exact_figures_of_a_pool() -> None:
    pool = [enter("bc", GAME), Entrant(name="moody", policy=Moody("safe")), enter("safe", GAME), enter("minimax", GAME)]
    pool.append(Entrant(name="broken", policy=Moody("safe"), failure="no distribution"))
    found = exact_odds(GAME, pool)
    tables = [pool[i].table for i in (0, 2, 3)]
    assert found.match[np.ix_([0, 2, 3], [0, 2, 3])] == pytest.approx(crossplay(tables).match(), abs=1e-6)
    for missing in (1, 4):
        assert np.isnan(found.match[missing]).all()
        assert np.isnan(found.match[:, missing]).all()
        assert np.isnan([found.exploitability[missing], found.normalised_score[missing]]).all()
    assert found.exploitability[3] == 0
    assert found.normalised_score[0] == 0
    assert found.share("safe", ["bc", "moody", "minimax"]) == pytest.approx((found.match[2, 0] + found.match[2, 3]) / 2)
    assert np.isnan(found.share("moody", ["bc"]))
    assert found.problem == ""


def test_exact_figures_of_a_game_without_clones_and_of_one_without_end() -> None:
    game = hand_made()
    pool = [Entrant(name=name, policy=Moody("safe"), table=random_policy(game, i)) for i, name in enumerate("ab")]
    found = exact_odds(game, pool)
    assert found.match[0, 1] == pytest.approx(0.5, abs=1e-6)
    assert np.isnan(found.normalised_score).all()
    threshold = game.threshold.copy()
    threshold[:, :2] = 0
    endless = dataclasses.replace(game, threshold=threshold)
    pool = [Entrant(name=name, policy=Moody("safe"), table=random_policy(endless, i)) for i, name in enumerate("ab")]
    found = exact_odds(endless, pool)
    assert "ever ends the rally" in found.problem
    assert np.isnan(found.match).all()


def test_a_run_shows_exact_odds_beside_the_sampled_ones(tmp_path: Path) -> None:
    (tmp_path / "my_sulker.py").write_text("def player(states):\n    return states.mask / states.mask.sum(axis=1)[:, None]\n")
    with (tmp_path / "my_sulker.py").open("a") as file:
        file.write("player.reads_score = True\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        run = run_league(
            LeagueConfig(pool=("safe", "random", "my_sulker:player"), matches=60, game=reduced_model(), out=tmp_path / "run")
        )
    safe, random = (tabulate(resolve(name, GAME), GAME) for name in ("safe", "random"))
    exact = evaluate(safe, random).odds().match()
    rows = pyarrow.csv.read_csv(run.folder / "results.csv").to_pylist()
    assert [row["exact_match_win"] for row in rows] == [pytest.approx(exact, abs=1e-6)] * 2 + [None] * 4
    assert pyarrow.parquet.read_table(run.folder / "results.parquet").column("exact_match_win").null_count == 4
    ranking = {row["player"]: row for row in pyarrow.csv.read_csv(run.folder / "ranking.csv").to_pylist()}
    assert ranking["safe"]["exact_share"] == pytest.approx(exact, abs=1e-6)
    assert ranking["random"]["exploitability"] == pytest.approx(nash_conv(random).exploitability, abs=1e-6)
    blank = ranking["my_sulker:player"]
    assert (blank["exact_share"], blank["exploitability"], blank["normalised_score"]) == (None, None, None)
    wins = sum(row["wins"] for row in rows[:2]) / 60
    assert abs(wins - exact) < 0.2
    payoffs = json.loads((run.folder / "report.json").read_text())["payoffs"]
    first, second = map(payoffs["players"].index, ("safe", "random"))
    assert payoffs["match_win"][first][second] == pytest.approx(exact, abs=1e-6)


def test_the_normalised_score_needs_a_scale() -> None:
    assert normalised_score(0.55, 0.5, 0.6) == pytest.approx(0.5)
    assert normalised_score(0.4, 0.5, 0.6) == pytest.approx(-1)
    for best in (0.5, 0.4, 0.5 + 1e-9):
        assert normalised_score(0.55, 0.5, best, error_bound=1e-8) is None
    assert normalised_score(0.5, 0.5, 0.5) is None
