"""Logs and reports of a game with effort and duels: the state of every stroke follows from the strokes before it."""

from pathlib import Path

import pytest

from shuttle_marl.analysis import LogPlayers
from shuttle_marl.analysis.strokes import simulated_rallies
from shuttle_marl.exact import evaluate
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.recording import RallyLog, RallyLogWriter
from shuttle_marl.scene.rally_report import report_rally
from tests.exact.exact_games import random_policy, tiring_game

GAME = tiring_game()
NAMES = ("one", "other")


@pytest.fixture(scope="module")
def tables() -> dict[str, TabulatedPolicy]:
    made = (random_policy(GAME, seed).pair_probabilities() for seed in (1, 2))
    return {name: from_pair_probabilities(GAME, p) for name, p in zip(NAMES, made, strict=True)}


@pytest.fixture(scope="module")
def path(tables: dict[str, TabulatedPolicy], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One match."""
    players = {name: table.pair_probabilities() for name, table in tables.items()}
    header, rallies = simulated_rallies(GAME, players, matches=1, seed=3)
    path = tmp_path_factory.mktemp("effort") / "rallies.mcap"
    with RallyLogWriter(path, header) as log:
        log.append(rallies)
    return path


def test_reports_are_those_of_the_state(path: Path, tables: dict[str, TabulatedPolicy]) -> None:
    """Compared with efforts and duels that are counted here, and probabilities looked up by the whole observation."""
    good, returned, _ = GAME.stroke_probabilities()
    value = evaluate(tables["one"], tables["other"])
    observed = set()
    with RallyLog(path) as log:
        players = LogPlayers(log, GAME, lambda name, _: tables[name])
        for number in range(20):
            report = report_rally(log, number, GAME, players)
            catalogue, played = report.played.catalogue, report.played
            strokes, attacks, duel = [GAME.n_strokes] * 2 + played.stroke.tolist(), [0, 0], 0
            for i, (decision, rank) in enumerate(zip(report.analysis.decisions, report.analysis.rank, strict=True)):
                seat, stroke = int(played.striker[i]), int(played.stroke[i])
                efforts = report.efforts(i)
                assert (efforts, report.duel(i)) == ((min(attacks[seat], 2), min(attacks[1 - seat], 2)), min(duel, 3))
                state = int(
                    GAME.state_of(strokes[i], strokes[i + 1], catalogue.height[stroke], min(duel, 3), *efforts, played.hurried[i])
                )
                pair = int(GAME.pair(state, stroke))
                assert (decision.p_succ[rank], decision.p_ret[rank]) == (good[pair], returned[pair])
                table = tables[report.names[seat]]
                assert decision.probability[rank] == table.pair_probabilities()[pair]
                seats = [NAMES.index(name) for name in report.names]
                assert decision.value == pytest.approx((1 + value.striking[seats[seat]][state]) / 2, abs=1e-6)
                observed.add((*efforts, report.duel(i)))
                attacks[seat] += int(catalogue.is_attack[stroke])
                duel = duel + 1 if catalogue.is_net_shot[stroke] else 0
            assert (report.winner == int(played.striker[-1])) == (played.ending == WINNER)
    assert len(observed) > 15
