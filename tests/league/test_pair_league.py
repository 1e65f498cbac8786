"""Leagues in the game of a pair, and predictions of real players."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.commands.league import main
from shuttle_marl.data import read_matches, write_parquet
from shuttle_marl.data.own import import_matches
from shuttle_marl.exact import evaluate
from shuttle_marl.game import pairs as pairs_module
from shuttle_marl.game.pairs import Skill, load_skill, pair_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.scoring import RULES, RulesName
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.pairs import Prediction, players_of, predict, ranked, with_results
from shuttle_marl.league.run import run_league
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.header import Pair
from shuttle_marl.recording.reader import check
from shuttle_marl.reports import AnalysisError
from tests import golden
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


def test_predictions_are_exact_and_contain_the_uncertainty_of_the_skill(monkeypatch: pytest.MonkeyPatch) -> None:
    pair = pair_game(A, B, game=reduced_model())
    found = predict(pair)
    tables = [tabulate(resolve(f"bc:{name}", game), game) for name, game in zip((A, B), pair.seats, strict=True)]
    odds = evaluate(*tables).odds()
    assert found.rally_win == pytest.approx(odds.rally, abs=1e-6)
    assert found.match_win == pytest.approx(odds.match(), abs=1e-5)
    assert predict(pair, rules=RULES["11"]).match_win == pytest.approx(odds.match(RULES["11"]), abs=1e-5)
    skill, rng, drawn = load_skill(model_folder(reduced_model())), np.random.default_rng(7), []
    for _ in range(20):
        moved = skill.offset + (skill.deviation * rng.normal(size=skill.offset.shape)).astype(np.float32)
        monkeypatch.setattr(pairs_module, "load_skill", _constant(dataclasses.replace(skill, offset=moved)))
        pair_game.cache_clear()
        drawn.append(predict(pair_game(A, B, game=reduced_model())).rally_win)
    monkeypatch.undo()
    pair_game.cache_clear()
    deviation = (found.rally_high - found.rally_low) / (2 * 1.96)
    # 20 draws know a deviation to 16 %.
    assert deviation == pytest.approx(np.std(drawn, ddof=1), rel=0.4)
    alone = predict(pair_game("average", A, game=reduced_model()), "bc")
    golden.check("pair", dataclasses.asdict(found) | {"hash": None, "against_average": [*alone.reasons.items()]})


def _constant(skill: Skill) -> Callable[[Path], Skill]:
    return lambda _: skill


def some_predictions() -> list[Prediction]:
    figures: dict[str, Any] = dict.fromkeys(("rally_low", "rally_high", "match_low", "match_high"), 0.5)
    return [
        Prediction(players=players, hash="", rally_win=rally, match_win=match, reasons={}, **figures)
        for players, rally, match in (((A, B), 0.6, 0.9), ((A, "lee-zii-jia"), 0.7, 0.95), ((B, "lee-zii-jia"), 0.5, 0.4))
    ]


def test_players_by_their_results_against_all_others() -> None:
    rows = ranked([B, A, "lee-zii-jia"], some_predictions(), reduced_model(), "2020-01-01")
    assert [row.name for row in rows] == [A, "lee-zii-jia", B]
    assert [row.match_win for row in rows] == pytest.approx([0.925, 0.325, 0.25])
    assert rows[0].rally_win == pytest.approx(0.65)
    assert rows[0].since == "2019-01-01"
    golden.check("pair", {"ranked": [dataclasses.asdict(row) for row in rows]})


def test_real_results(tmp_path: Path) -> None:
    """Three rallies of an unfinished match between the first two, and one of a match with somebody else."""
    lines = ["match,rally,stroke,player,opponent,shot,area,winner"]
    for match, rally, other, winner in (("m", 1, B, A), ("m", 2, B, A), ("m", 3, B, B), ("p", 1, "somebody-else", A)):
        lines.append(f"{match},{rally},1,{A},{other},short serve,front-centre,{winner}")
    (tmp_path / "matches.csv").write_text("\n".join([*lines, ""]))
    (tmp_path / "map.toml").write_text('discipline = "MS"\n[columns]\n' + "".join(f'{k} = "{k}"\n' for k in lines[0].split(",")))
    first, second, _ = with_results(some_predictions(), read_matches(tmp_path / "matches.csv", tmp_path / "map.toml"))
    assert (first.rallies, first.rallies_won, first.matches, first.matches_won) == (3, 2, 0, 0)
    assert (second.rallies, second.matches) == (0, 0)


def test_predictions_follow_the_rules_of_the_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    case, table = Path(__file__).parents[1] / "data/cases/match_to_15", tmp_path / "t.parquet"
    cleaned = import_matches(case / "match.csv", case / "map.toml")
    write_parquet(cleaned.strokes, table, account=cleaned.account, provenance={})
    told: dict[RulesName, tuple[str, ...]] = {
        "15": ("--data", str(table)),
        "11": ("--data", str(table), "--rules", "11"),
        "21": (),
    }
    for rules, flags in told.items():
        assert main(["--pairs", "men", "--players", A, B, "--game", str(reduced_model()), "--json", *flags]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["rules"] == rules
        expected = predict(pair_game(A, B, game=reduced_model()), rules=RULES[rules]).match_win
        assert found["pairs"][0]["match_win"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("some", [(A,), (A, A), (A, "an-se-young")])
def test_players_who_form_no_pair(some: tuple[str, ...]) -> None:
    with pytest.raises(AnalysisError, match="expected two or more, each once, who play men's singles"):
        players_of("men", reduced_model(), some)
