"""The restricted Nash objective: its scale, its frontier, and that it punishes what a score alone rewards."""

import json
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.commands.suite import main
from shuttle_marl.exact import best_response, evaluate, restricted_response
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.exact.optimal import restricted_value
from shuttle_marl.exact.profile import PairPolicy, StatePolicy
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.frontier import STEPS, WEIGHT, frontier
from shuttle_marl.suite.task import Arena
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary

GAME = reduced_game()
ARENA = Arena(game=GAME)
BC, SAFE = (tabulate(resolve(name, GAME), GAME) for name in ("bc", "safe"))


def worth(player: StatePolicy, p: float = WEIGHT) -> float:
    """Rallies won against SAFE restricted with p: with probability p it is SAFE that strikes, and else the worst enemy."""
    return restricted_value(player, SAFE, p).odds().rally


def test_a_frontier_is_monotone_and_exact() -> None:
    points = frontier(ARENA, SAFE, tolerance=TOLERANCE)
    assert [each["p"] for each in points] == list(STEPS)
    assert (STEPS[0], STEPS[-1]) == (0, 1)
    for name in ("score", "exploitability"):
        column = [float(each[name]) for each in points]
        assert column == sorted(column)
    assert (points[0]["exploitability"], points[-1]["score"]) == (pytest.approx(0, abs=1e-8), pytest.approx(1, abs=1e-8))
    by_p = {each["p"]: each["objective"] for each in points}
    assert by_p[0] == pytest.approx(0, abs=1e-6)
    assert by_p[WEIGHT] == pytest.approx(1, abs=1e-6) == max(by_p.values())
    zero, one, best = (worth(restricted_response(SAFE, p).policy) for p in (0, WEIGHT, 1))
    assert by_p[1] == pytest.approx((best - zero) / (one - zero), abs=1e-5)


def test_the_value_in_the_restricted_game_is_that_of_play() -> None:
    assert worth(BC, 1) == pytest.approx(evaluate(BC, SAFE).odds().rally, abs=1e-8)
    assert worth(BC, 0) == pytest.approx(1 - best_response(BC).value.odds().rally, abs=1e-8)
    # The enemy's answer, as a policy: the mixture of it and the opponent, stroke by stroke, wins at most that much.
    enemy = best_response(BC).policy.pair_probabilities()
    mixed = PairPolicy(game=GAME, probability=WEIGHT * SAFE.pair_probabilities() + (1 - WEIGHT) * enemy)
    assert worth(BC) <= evaluate(BC, mixed).odds().rally + 1e-9


def test_no_mixture_is_better_than_the_restricted_response() -> None:
    tables = [restricted_response(SAFE, p).policy.pair_probabilities() for p in (0, 0.5, WEIGHT, 1)]
    one = worth(restricted_response(SAFE, WEIGHT).policy)
    rng = np.random.default_rng(0)
    for _ in range(20):
        weights = rng.dirichlet(np.full(len(tables), 0.5))
        mixed = PairPolicy(game=GAME, probability=np.tensordot(weights, tables, axes=1))
        assert worth(mixed) <= one + 1e-9


@pytest.mark.parametrize(("method", "low", "high"), [("minimax", 0.0, 0.0), ("best-response", -1.0, 0.9), ("bc", -1e3, -1.0)])
def test_a_best_response_is_not_the_best_player(method: str, low: float, high: float, tmp_path: Path) -> None:
    row = summary(run("exploit-v0", method, tmp_path / "run"))
    assert row["objective"] == row["score"]
    assert low - 1e-6 <= row["score"] <= high + 1e-6


def test_the_command_prints_a_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(("frontier", "exploit-v0", "--opponent", "safe", "--game", reduced_model(), "--json")) == 0
    assert set(json.loads(capsys.readouterr().out)[0]) == {"p", "score", "exploitability", "objective"}
    assert main(("frontier", "text-v0", "--opponent", "bc", "--game", reduced_model())) == 1
    assert "exploit-v0 has" in capsys.readouterr().err
