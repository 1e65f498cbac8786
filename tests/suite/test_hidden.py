"""Hidden splits, and games that do not ship: nobody can tune on them, and the shipped game does not answer them."""

from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.registry import TASKS, arena_of
from shuttle_marl.suite.robust import refits
from shuttle_marl.suite.task import Arena
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, verified

BEACONS = ("5" * 64, "6" * 64)


def arena(task: str, split: Split, beacon: str | None = None) -> Arena:
    return arena_of(TASKS[task], reduced_model(), split, quick=True, beacon=beacon)


@pytest.mark.parametrize(
    ("task", "method"), [("exploit-v0", "minimax"), ("offline-v0", "clone"), ("robust-v0", "minimax"), ("evaluate-v0", "model")]
)
def test_a_hidden_split_follows_from_the_beacon(task: str, method: str, tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="needs --beacon"):
        arena(task, "hidden")
    folder = run(task, method, tmp_path / "run", split="hidden", beacon=BEACONS[0])
    assert verified(folder, beacon=BEACONS[0]).refused == []
    assert verified(folder, beacon=BEACONS[1]).refused
    row = summary(folder, BEACONS[0])
    assert row["game"] == reduced_game().hash


def test_hidden_opponents_and_games_are_drawn() -> None:
    cases = TASKS["exploit-v0"].all_cases(arena("exploit-v0", "hidden", BEACONS[0]))
    one, other = (opponent_of(arena("exploit-v0", "hidden", beacon), cases[0]) for beacon in BEACONS)
    assert one.hash != other.hash
    given, scored = refits(arena("robust-v0", "hidden", BEACONS[0]))
    assert {game.hash for game in given}.isdisjoint({game.hash for game in scored})


def test_the_shipped_game_does_not_answer_a_drawn_one() -> None:
    test, shipped = arena("offline-v0", "test"), arena("exploit-v0", "test")
    assert test.game.hash != shipped.game.hash == test.base
    assert arena("evaluate-v0", "test").game.hash == test.game.hash
    opponent = test.policy("human:0.05")
    best = best_response(opponent).value.odds().rally
    known = TabulatedPolicy(game=test.game, cumulative=best_response(shipped.policy("human:0.05")).policy.cumulative)
    assert (evaluate(known, opponent).odds().rally - 0.5) / (best - 0.5) < 0.9
    assert np.ptp(test.game.threshold.astype(int) - shipped.game.threshold) > 0
