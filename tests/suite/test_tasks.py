"""Templates of submissions, logs as files, and budgets of learners."""

import sys
from pathlib import Path
from typing import Final

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.table_files import read_parquet
from shuttle_marl.game.layout import states_of
from shuttle_marl.game.shipped import load_game
from shuttle_marl.suite.exploit import PlayerSetting
from shuttle_marl.suite.method import find
from shuttle_marl.suite.offline import generate
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.results import arena_of, find_task, write_data
from shuttle_marl.suite.run import new_submission
from tests.reduced import reduced_game, reduced_model
from tests.suite.small import run, verified

GAME = reduced_game()


COMMANDS = {
    "exploit-v1": "my_player:train",
    "adapt-v1": "my_adapter:Adapter",
    "offline-v1": "my_offline:Learner",
    "evaluate-v1": "my_estimator:Estimator",
}


@pytest.mark.parametrize("task", COMMANDS)
def test_templates_run_as_they_are(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    line = new_submission(task, tmp_path, "alice")
    assert line.endswith(f"run {task} --method {COMMANDS[task]} --quick")
    (source,) = tmp_path.glob("my_*.py")
    assert len(source.read_text().splitlines()) <= 40
    folder = run(task, COMMANDS[task], tmp_path / "run")
    found = verified(folder).summary
    assert found is not None
    assert np.isfinite(found["score"])
    assert found["author"] == "alice"
    sys.modules.pop(source.stem)


def test_data_are_written_with_their_hashes(tmp_path: Path) -> None:
    found = write_data("offline-v1", tmp_path, "dev", reduced_model(), 2, quick=True)
    assert len(found) == 2
    name, digest = next(iter(found.items()))
    table = read_parquet(tmp_path / name)
    assert {"state", "stroke", "probability", "won"} <= set(table.column_names)
    arena = arena_of(find_task("offline-v1"), reduced_model(), "dev", quick=True)
    given = find_task("offline-v1").given(arena, find_task("offline-v1").cases(arena)[0], 0)
    assert digest in given
    logs = write_data("evaluate-v1", tmp_path, "dev", reduced_model(), 1, quick=True)
    assert len({*logs.values()}) == len(logs) == 2
    with pytest.raises(SuiteError, match="adapt-v1 has no logs"):
        write_data("adapt-v1", tmp_path, "dev", reduced_model(), None)


def test_minari_data_sets_are_the_transitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    (name,) = write_data("offline-v1", tmp_path, "test", reduced_model(), 1, quick=True, minari=True)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    read = list(minari.load_dataset(name).iterate_episodes())
    data = generate(arena_of(find_task("offline-v1"), reduced_model(), "test", quick=True), "bc", 3000, 0).transitions
    assert np.array_equal(np.concatenate([each.actions for each in read]), data.stroke)
    assert np.array_equal(np.concatenate([each.rewards for each in read]), data.reward)
    assert np.array_equal(np.concatenate([each.infos["state"][:-1, 0] for each in read]), data.state)
    assert {each.infos["state"][-1, 0] for each in read} == {-1}
    seen = np.concatenate([each.observations["observation"][:-1] for each in read])
    assert np.array_equal(states_of(GAME, seen), data.state)
    assert all(each.terminations[-1] and not each.terminations[:-1].any() for each in read)
    env = minari.load_dataset(name).recover_environment()
    assert env.observation_space.contains(env.reset(seed=0)[0])
    with pytest.raises(ShuttleError, match="exist"):
        write_data("offline-v1", tmp_path, "test", reduced_model(), 1, quick=True, minari=True)


SLOW: Final = [pytest.param(name, 100_000, marks=pytest.mark.slow) for name in ("ppo", "a2c", "sac", "ppo-self-play")]


@pytest.mark.parametrize(("method", "budget"), [("a2c", 20_000), ("ppo-self-play", 20_000), *SLOW])
def test_learners_fit_their_budgets(method: str, budget: int, tmp_path: Path) -> None:
    # Rallies become longer while a player learns, most of all in self-play.
    model = "default:recovery" if budget > 20_000 else f"{reduced_model()}:recovery"
    setting = PlayerSetting(game=load_game(model), model=model, opponent="bc", budget=budget, seed=0, folder=tmp_path)
    trained = find("exploit-v1", method)(setting)
    assert budget / (2 if budget > 20_000 else 3) < trained.strokes <= budget  # a few batches, of unequal length
