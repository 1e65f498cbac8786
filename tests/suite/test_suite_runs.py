"""Runs of the suite: stored units, resuming, exact scores, and verification."""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.arrays import U16
from shuttle_marl.base.files import seal
from shuttle_marl.commands.suite import main
from shuttle_marl.exact import best_response, evaluate
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite import results
from shuttle_marl.suite.exploit import Trained
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.results import TASKS, summarise, task_of_run, verify_run
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, summary, unit, verified

GAME = reduced_game()
TASK = "exploit-entrance-v1"


def table(name: str) -> TabulatedPolicy:
    return tabulate(resolve(name, GAME), GAME)


def noisy(setting: Any) -> TabulatedPolicy:
    """A method that depends on the seed."""
    return table(f"bc@{0.3 + 0.1 * setting.seed}")


class Illegal:
    def probabilities(self, states: Any) -> Any:
        return np.eye(states.game.n_strokes)[np.zeros(len(states), int)]


class Torn:
    @property
    def table(self) -> Any:
        raise KeyError("zz")


class First:
    def act(self, observation: Any, mask: Any) -> int:
        return int(mask.argmax())


def played(tmp_path: Path, method: str, task: str = TASK, **options: Any) -> Path:
    return run(task, method, tmp_path / method.replace(":", "-"), **options)


def reasons(folder: Path) -> list[str]:
    return [each.reason for each in verified(folder).refused]


def test_a_model_folder_that_a_run_names_is_not_opened(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    with pytest.raises(SuiteError, match=r"not shipped; name it with --game"):
        verify_run(folder)
    with pytest.raises(SuiteError, match=r"not shipped; name it with --game"):
        summarise(folder)


def test_the_game_of_a_run_is_the_one_that_its_reader_names() -> None:
    about: dict[str, Any] = {"task": "exploit-v1", "method": "ppo", "split": "dev", "quick": False, "budget": 10**6, "seeds": 1}
    config = results.RunConfig(**about, model="default", game="0" * 64)
    for model, found in ((None, "default"), (reduced_model(), reduced_model())):
        task, arena, cases = task_of_run(config, model)
        assert (task.name, arena.split, arena.quick, arena.budget) == ("exploit-v1", "dev", False, 10**6)
        assert arena.model == f"{found}:recovery"
        assert {case.budget for case in cases} == {10**6}
    with pytest.raises(SuiteError, match="names no budget; budgets are never pooled"):
        task_of_run(dataclasses.replace(config, budget=None))


@pytest.fixture(scope="module")
def noisy_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seeds of a stranger's method; look, do not touch."""
    return played(tmp_path_factory.mktemp("noisy"), f"{__name__}:noisy", seeds=2)


def test_scores_are_exact_and_verified(noisy_run: Path) -> None:
    result, opponent = summary(noisy_run), table("bc@0.5")
    wins = [evaluate(table(f"bc@{temperature}"), opponent).odds().rally for temperature in (0.3, 0.4)]
    perfect = evaluate(table("minimax"), opponent).odds().rally
    assert result["scores"]["score"]["value"] == pytest.approx(100 * (np.mean(wins) - perfect), abs=1e-6)
    assert result["low"] < result["score"] < result["high"]
    assert reasons(noisy_run) == []


def fails(setting: Any) -> Any:
    return dict[str, Any]()["zz"]


def test_errors_of_methods_say_where_and_it_can_be_run_again(tmp_path: Path) -> None:
    for _ in range(2):
        with pytest.raises(SuiteError, match=rf"{__name__}:fails, case bc@0.5/20,000, seed 0: .*KeyError: 'zz' \(.*, line \d+\)"):
            played(tmp_path, f"{__name__}:fails")
    assert not runs.has_results(tmp_path / f"{__name__}-fails")
    folder = played(tmp_path, "bc")
    with pytest.raises(runs.RunError, match="a finished run"):
        played(tmp_path, "bc")
    assert runs.has_results(folder)
    assert json.loads((folder / runs.MANIFEST).read_text())["status"] == "finished"


@dataclasses.dataclass(frozen=True)
class Declared:
    strokes: Any

    def __call__(self, setting: Any) -> Any:
        return Trained(player="bc", strokes=self.strokes)


counted, halves, negative, many = map(Declared, (np.int64(100), 0.5, -5, 10**9))


def test_declared_strokes_are_checked(tmp_path: Path) -> None:
    assert unit(TASK, f"{__name__}:counted", tmp_path)[1].strokes == 100
    for name, told in (("halves", "no whole number"), ("negative", "cannot be stored"), ("many", "more than the budget")):
        with pytest.raises(SuiteError, match=told):
            unit(TASK, f"{__name__}:{name}", tmp_path)


def test_a_method_whose_library_is_missing_says_how_to_install_it(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['torch'] = None\n"
        "from shuttle_marl.commands.suite import main\n"
        f"arguments = ['run', 'exploit-v1', '--method', 'ppo', '--quick', '--game', {reduced_model()!r}, '--out', 'o']\n"
        "main(arguments), main(arguments)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert done.stderr.count("this needs torch, which is not installed; `make install`") == 2


def test_a_wrong_option_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="--budget -1"):
        played(tmp_path, "bc", budget=-1)
    assert not list(tmp_path.iterdir())


def test_references_bound_the_scale(tmp_path: Path) -> None:
    best = summary(played(tmp_path, "restricted"))["scores"]
    assert best["gain"]["value"] == pytest.approx(best["best"]["value"], abs=1e-5)
    assert 0 < summary(played(tmp_path, "restricted-bc"))["score"] < best["gain"]["value"]
    response = best_response(table("bc@0.5")).value.odds().rally - evaluate(table("minimax"), table("bc@0.5")).odds().rally
    assert summary(played(tmp_path, "best-response"))["scores"]["score"]["value"] == pytest.approx(100 * response, abs=1e-6)
    assert summary(played(tmp_path, "minimax"))["score"] == pytest.approx(0, abs=1e-6)
    one, some = (summary(played(tmp_path, name))["scores"]["score"]["value"] for name in ("constant", "constant-by-incoming"))
    assert one < some < 100 * response
    golden.check("player_methods", {"constant": one, "constant-by-incoming": some})


def test_perfect_play_has_to_mix_where_positions_are_hidden(tmp_path: Path) -> None:
    assert summary(played(tmp_path, "minimax-deterministic", "equilibrium-v1"))["score"] > 0.5
    assert summary(played(tmp_path, "minimax", "equilibrium-v1"))["score"] < 0.01


def test_estimates_of_the_opponent_are_answered(tmp_path: Path) -> None:
    found = summary(played(tmp_path, "restricted-counts"))
    assert 0.25 * found["scores"]["best"]["value"] < found["score"] <= found["scores"]["best"]["value"] + 1e-6
    assert 0 < found["strokes"] <= 20_000
    golden.check("player_methods", {"restricted-counts": {**found["scores"], "strokes": found["strokes"]}})


def test_players_that_act_are_tabulated(tmp_path: Path) -> None:
    _, entry, policies = unit(TASK, f"{__name__}:First", tmp_path)
    player = TabulatedPolicy.unpacked(policies[entry.policies["player"]], GAME, "")
    first = np.zeros(GAME.n_pairs)
    first[GAME.pair_start[:-1][GAME.playable]] = 1
    assert np.array_equal(player.pair_probabilities(), first)


@pytest.mark.parametrize(
    ("method", "told"), [("Illegal", "plays the illegal stroke"), ("Torn", "table of its player raised KeyE")]
)
def test_an_illegal_player_is_refused(method: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match=told):
        unit(TASK, f"{__name__}:{method}", tmp_path)


def test_a_run_is_resumed(noisy_run: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(noisy_run, tmp_path / noisy_run.name))
    whole = summary(folder)
    kept = results.entry_path(folder, 0, 0).read_bytes()
    results.entry_path(folder, 0, 1).unlink()
    with pytest.raises(SuiteError, match=r"000-1.json: No such file.*--resume"):
        summary(folder)
    played(tmp_path, f"{__name__}:noisy", seeds=2, resume=True)
    assert results.entry_path(folder, 0, 0).read_bytes() == kept
    again = summary(folder)
    assert {**again, "seconds": 0} == {**whole, "seconds": 0}
    with pytest.raises(runs.RunError, match="other flags"):
        played(tmp_path, f"{__name__}:noisy", seeds=3, resume=True)


LEFT: list[int] = []  # what an earlier unit left in memory


def hoarding(setting: Any) -> TabulatedPolicy:
    """A method that would carry something to the next unit."""
    LEFT.append(setting.seed)
    return table("minimax" if len(LEFT) > 1 else "bc")


@pytest.mark.parametrize("ray", [None, pytest.param("local", marks=pytest.mark.slow)])
def test_nothing_of_a_unit_reaches_the_next_one(ray: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if ray is not None:
        pytest.importorskip("ray")
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, sys.path)))
    folder = played(tmp_path, f"{__name__}:hoarding", seeds=2, ray=ray)
    entries = [results.read_entry(results.entry_path(folder, 0, seed)) for seed in (0, 1)]
    assert [entry.policies["player"] for entry in entries] == [table("bc").hash] * 2
    assert LEFT == []


def test_units_of_two_versions_of_a_method_are_not_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "my_methods").mkdir()
    (tmp_path / "my_methods" / "__init__.py").write_text(
        "def player(setting):\n    from my_methods.helper import NAME\n    return NAME\n"
    )
    helper = tmp_path / "my_methods" / "helper.py"
    helper.write_text("NAME = 'bc'\n")
    folder = played(tmp_path, "my_methods:player", seeds=2)
    assert set(json.loads((folder / runs.MANIFEST).read_text())["sources"]) == {"my_methods"}
    helper.write_text("NAME = 'safe'\n")
    kept = results.entry_path(folder, 0, 1).read_bytes()
    played(tmp_path, "my_methods:player", seeds=2, resume=True)  # nothing is left to play
    results.entry_path(folder, 0, 1).unlink()
    for _ in range(2):
        with pytest.raises(runs.RunError, match="sources changed after the run was started"):
            played(tmp_path, "my_methods:player", seeds=2, resume=True)
    helper.write_text("NAME = 'bc'\n")
    played(tmp_path, "my_methods:player", seeds=2, resume=True)
    assert {**json.loads(kept), "seconds": 0, "checksum": 0} == {
        **json.loads(results.entry_path(folder, 0, 1).read_text()),
        "seconds": 0,
        "checksum": 0,
    }


def test_a_changed_policy_is_refused(tmp_path: Path) -> None:
    folder = played(tmp_path, "bc")
    (folder / results.RESULTS).write_text('{"score": 0.99}')  # which nothing reads
    assert reasons(folder) == []
    (policy,) = (folder / results.POLICIES).iterdir()
    numbers = TabulatedPolicy.unpacked(policy.read_bytes(), GAME, "").cumulative.copy()

    def packed(numbers: U16) -> bytes:
        return TabulatedPolicy(game=GAME, cumulative=numbers).packed()

    numbers[np.flatnonzero((numbers > 0) & (numbers < 65534) & (numbers % 2 == 0))[0]] ^= 1  # one bit
    policy.write_bytes(packed(numbers))
    assert "the table was changed" in str(reasons(folder)[0])
    policy.write_bytes(packed(numbers[1:]))
    assert "expected the" in str(reasons(folder)[0])
    numbers[1] = 65535
    policy.write_bytes(packed(numbers))
    assert "a cumulative probability falls" in str(reasons(folder)[0])
    policy.write_bytes(b"nonsense")
    assert "cannot be read" in str(reasons(folder)[0])


def test_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    game = ("--game", reduced_model())

    def told(*arguments: str) -> Any:
        assert main((*arguments, "--json")) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    tasks = {task["task"]: task for task in told("list")["tasks"]}
    assert list(tasks) == list(TASKS)
    assert all(task["about"] and task["protocol"] and task["baselines"] for task in tasks.values())
    assert tasks["exploit-v1"]["zero"] == "perfect play, which uses no weakness"
    assert [name for name, task in tasks.items() if task["entrance"]] == ["exploit-entrance-v1"]
    hidden = [name for name, task in tasks.items() if "position of the receiver" in task["hidden"]]
    assert hidden == ["exploit-v1", "adapt-v1", "equilibrium-v1"]
    assert len({task["game"] for task in tasks.values()}) > 1

    (tmp_path / results.CARD).write_text('{"author": "alice"}')
    found = told("run", "exploit-entrance-v1", "--method", "bc", "--quick", *game)
    assert found["remarks"] == ["a quick run", "1 of 8 seeds"], "only rows of the package are references"
    assert told("verify", found["folder"], *game)["reproduced"] == 1
    assert main(("board", found["folder"], *game, "--out", "board.md")) == 0
    assert "alice/bc" in (tmp_path / "board.md").read_text()
    # A damaged folder is left out of the board, and one is needed.
    path = results.entry_path(Path(found["folder"]), 0, 0)
    entry = json.loads(path.read_text())
    path.write_text("{}")
    assert main(("board", found["folder"], str(tmp_path / "none"), *game)) == 1
    assert "left out" in capsys.readouterr().err
    assert main(("board",)) == 1
    assert "--results" in capsys.readouterr().err
    path.write_bytes(seal({**{key: entry[key] for key in entry if key != "checksum"}, "fingerprint": "0" * 64}))
    assert main(("verify", found["folder"], *game)) == 1
    assert "refused: bc@0.5" in capsys.readouterr().out
    assert main(("run", "exploit-entrance-v1", "--method", "nothing")) == 1
    assert "no method 'nothing'" in capsys.readouterr().err
