"""The restricted Nash objective: its scale, its frontier, and that it punishes what a score alone rewards."""

import json
from pathlib import Path

import pytest

from shuttle_marl.commands.suite import main
from shuttle_marl.exact import best_response, evaluate, restricted_response
from shuttle_marl.exact.fixed_point import TOLERANCE
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.frontier import STEPS, WEIGHT, frontier
from shuttle_marl.suite.options import SuiteRun
from shuttle_marl.suite.results import summarise
from shuttle_marl.suite.run import run_method
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
BC, SAFE = (tabulate(resolve(name, GAME), GAME, name) for name in ("bc", "safe"))


def test_a_frontier_is_monotone_and_exact() -> None:
    points = frontier(SAFE, BC, tolerance=TOLERANCE)
    assert [each["p"] for each in points] == sorted({*STEPS, WEIGHT})
    for name in ("score", "exploitability"):
        column = [float(each[name]) for each in points]
        assert column == sorted(column)
    assert (points[0]["exploitability"], points[-1]["score"]) == (pytest.approx(0, abs=1e-8), pytest.approx(1, abs=1e-8))
    assert max(each["objective"] for each in points) == next(each["objective"] for each in points if each["p"] == WEIGHT) == 1
    # By hand: no response of the family is worth more than what scores 1.
    found = [restricted_response(SAFE, step).policy for step in STEPS]
    worth = [
        WEIGHT * evaluate(each, SAFE).odds().rally + (1 - WEIGHT) * (1 - best_response(each).value.odds().rally) for each in found
    ]
    zero = WEIGHT * evaluate(BC, SAFE).odds().rally + (1 - WEIGHT) * (1 - best_response(BC).value.odds().rally)
    best = best_response(SAFE).policy
    lost = WEIGHT * evaluate(best, SAFE).odds().rally + (1 - WEIGHT) * (1 - best_response(best).value.odds().rally)
    assert points[-1]["objective"] == pytest.approx((lost - zero) / (max(worth) - zero), abs=1e-6)


@pytest.mark.parametrize(("method", "low", "high"), [("bc", 0.0, 0.0), ("best-response", 0.0, 0.999)])
def test_a_best_response_is_not_the_best_player(method: str, low: float, high: float, tmp_path: Path) -> None:
    out = tmp_path / "run"
    row = summarise(
        run_method(SuiteRun(task="exploit-v0", method=method, quick=True, game=reduced_model(), out=out)), game=reduced_model()
    )
    assert row["objective"] == row["score"]
    assert low - 1e-9 <= row["score"] <= high + 1e-9


def test_the_command_prints_a_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(("frontier", "exploit-v0", "--opponent", "safe", "--game", reduced_model(), "--json")) == 0
    assert set(json.loads(capsys.readouterr().out)[0]) == {"p", "score", "exploitability", "objective"}
    assert main(("frontier", "text-v0", "--opponent", "bc", "--game", reduced_model())) == 1
    assert "exploit-v0 has" in capsys.readouterr().err
