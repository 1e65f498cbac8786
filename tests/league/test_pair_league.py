"""Leagues in the game of a pair of players."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.exact import evaluate
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.run import run_league
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.header import Pair
from shuttle_marl.recording.reader import check
from tests.reduced import reduced_game, reduced_model

A, B = "viktor-axelsen", "kento-momota"


def test_a_league_in_the_game_of_a_pair(tmp_path: Path) -> None:
    config = LeagueConfig(
        pool=("bc", "minimax", "random"), matches=60, players=(A, B), game=reduced_model(), out=tmp_path / "run"
    )
    run = run_league(config)
    pair = pair_game(A, B, game=reduced_model())
    assert json.loads((tmp_path / "run" / "config.json").read_text())["players"] == [A, B]
    assert "players" not in LeagueConfig().fixed()
    seats = [[tabulate(resolve(name, game), game) for game in pair.seats] for name in config.pool]
    for standing in run.standings:
        place = config.pool.index(standing.player)
        own, others = seats[place], [*seats[:place], *seats[place + 1 :]]
        # Half of the matches as each of the players.
        wins = [(evaluate(own[0], s[1]).odds().match() + 1 - evaluate(s[0], own[1]).odds().match()) / 2 for s in others]
        assert standing.exact_share == pytest.approx(np.mean(wins), abs=1e-5)
        assert standing.share_low - 0.1 < standing.exact_share < standing.share_high + 0.1
    assert {s.player: s.exploitability for s in run.standings}["minimax"] < 1e-6
    log = tmp_path / "run" / "rallies.mcap"
    with RallyLog(log) as opened:
        header = opened.header
    assert (header.pair, header.game) == (Pair(players=(A, B), discipline="men"), pair.hash)
    assert check(log, header.pair.game(reduced_model())).problems == ()
    assert len(check(log, dataclasses.replace(pair, threshold=pair.threshold)).problems) == 0
    with pytest.raises(Exception, match=f"of {A} against {B}, not on"):
        check(log, reduced_game())
