"""Targets can be reached by who knows what is hidden, the rating ranks, and hidden splits follow from the beacon."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, restricted_response
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.suite.adapt import CHANGES
from shuttle_marl.suite.board import boards, rating
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.offline import OPPONENT, targets
from shuttle_marl.suite.options import Split, SuiteError
from shuttle_marl.suite.population import opponent
from shuttle_marl.suite.registry import TASKS, arena_of
from shuttle_marl.suite.robust import refits
from shuttle_marl.suite.task import Arena, Case, Outcome
from shuttle_marl.suite.text import chosen_states, regrets
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, verified


def exploit(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": restricted_response(opponent_of(arena, case), WEIGHT).policy})


def equilibrium(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": arena.policy("minimax")})


def adapt(arena: Arena, case: Case) -> Outcome:
    against = opponent(arena, case.options["family"], case.options["number"])
    answers = {start: restricted_response(against.at(start), WEIGHT).policy for start in CHANGES}
    return Outcome(policies={str(start): answers[start] for start in CHANGES})


def offline(arena: Arena, case: Case) -> Outcome:
    return Outcome(policies={"player": best_response(arena.policy(OPPONENT)).policy})


def valued(arena: Arena, case: Case) -> Outcome:
    values = [evaluate(each, arena.policy(OPPONENT)).odds().rally for each in targets(arena, case, 0).values()]
    return Outcome(answers={"estimates": values})


def text(arena: Arena, case: Case) -> Outcome:
    game, regret = arena.game, regrets(arena.game)
    best = [game.pairs_of(state).start + regret[game.pairs_of(state)].argmin() for state in chosen_states(arena).tolist()]
    return Outcome(answers={"strokes": [game.catalogue.names[game.pair_stroke[pair]] for pair in best]})


OMNISCIENT: dict[str, Any] = {
    "exploit-v0": exploit,
    "equilibrium-v0": equilibrium,
    "adapt-v0": adapt,
    "offline-v0": offline,
    "evaluate-v0": valued,
    "text-v0": text,
}


@pytest.mark.parametrize("name", OMNISCIENT)
def test_who_knows_what_is_hidden_reaches_the_target(name: str) -> None:
    task = TASKS[name]
    arena = arena_of(task, reduced_model(), "test", quick=True)
    case = task.cases(arena)[0]
    found = task.score(arena, case, 0, OMNISCIENT[name](arena, case))[task.metric]
    assert task.hard is not None
    assert (found >= task.hard) if task.higher_is_better else (found <= task.hard)
    assert f"{task.hard:g}".lstrip("0") in task.target
    assert not task.entrance


def test_the_rating_ranks_by_paired_units(tmp_path: Path) -> None:
    rows = [
        summary(run(task, name, tmp_path / task / name, split="test"))
        for task in ("exploit-v0", "equilibrium-v0")
        for name in ("minimax", "bc", "random")
    ]
    found = rating(boards(rows))
    assert list(found) == ["minimax", "bc", "random"]
    # Two wins and a draw against a player of 1500 points on each board: the equation of the maximum.
    strength = {name: 10 ** ((points - 1500) / 400) for name, points in found.items()}
    won = {"minimax": 4, "bc": 2, "random": 0}
    for name, mine in strength.items():
        expected = sum(2 * mine / (mine + other) for each, other in strength.items() if each != name) + mine / (mine + 1)
        assert expected == pytest.approx(won[name] + 0.5, abs=1e-6)
    assert np.isfinite(list(found.values())).all()


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
