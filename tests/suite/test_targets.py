"""Targets can be reached by who knows what is hidden, and the rating ranks."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.exact import best_response, evaluate, restricted_response
from shuttle_marl.suite.adapt import CHANGES
from shuttle_marl.suite.board import boards, rating
from shuttle_marl.suite.exploit import opponent_of
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.offline import OPPONENT, targets
from shuttle_marl.suite.population import opponent
from shuttle_marl.suite.registry import TASKS, arena_of
from shuttle_marl.suite.task import Arena, Case, Outcome
from shuttle_marl.suite.text import chosen_states, regrets
from tests.reduced import reduced_model
from tests.suite.small import run, summary


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
