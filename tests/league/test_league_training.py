"""Leagues that learn, on a game of a few hundred states: what they reach, and that a kill changes nothing."""

import contextlib
import dataclasses
import json
import multiprocessing
import os
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load

from shuttle_marl import exact
from shuttle_marl.base.runs import RunError
from shuttle_marl.commands.league import main
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.policy import PolicyError, TabulatedPolicy
from shuttle_marl.game.shipped import CARD, POSITIONS, load_game, model_folder
from shuttle_marl.policy.computed import StoredPolicies
from shuttle_marl.recording import RallyLog
from shuttle_marl.recording.reader import check
from shuttle_marl.training.league.config import VARIANTS, LeagueTrainingConfig, LeagueTrainingError, MetaSolver, Variant
from shuttle_marl.training.league.population import LEAGUE, TABLES, Payoffs
from shuttle_marl.training.league.run import MAIN, train_league
from shuttle_marl.training.league.schedule import FLOOR, prioritised, uniform
from tests.exact.exact_games import random_policy, tiring_game
from tests.exact.test_hidden_positions_solved import waiting, with_recovery
from tests.recording.conftest import read_rallies
from tests.stops import Killed, stop
from tests.waiting import wait_until

SMALL: dict[str, Any] = {
    "strokes": 1500, "rounds": 3, "batch": 256, "width": 8, "update_interval": 2, "patience": 2, "workers": 1,
    "pool": ("attacking", "safe"),
}  # fmt: skip


@pytest.fixture(scope="session")
def model(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Name of a model: long rallies of smashes and net shots at two levels of effort."""
    folder = tmp_path_factory.mktemp("model")
    game = dataclasses.replace(tiring_game(), fault_odds=np.array([ONE, 2 * ONE], np.int32))
    game.save(folder / "game.safetensors")
    return str(folder)


def final(folder: Path) -> tuple[dict[str, Any], bytes]:
    """All results of a run but the time that it took."""
    figures = json.loads((folder / "results.json").read_text())
    del figures["seconds"]
    for line in figures["curve"]:
        del line["seconds"]
    return figures, load((folder / MAIN).read_bytes())["cumulative"].tobytes()


@pytest.mark.parametrize(
    "variant", [pytest.param(variant, marks=pytest.mark.slow if variant in VARIANTS[:2] else ()) for variant in VARIANTS]
)
def test_every_variant_learns(variant: Variant, model: str, tmp_path: Path) -> None:
    config = LeagueTrainingConfig(**{**SMALL, "strokes": 9_000}, variant=variant, oracle="ppo", game=model, out=tmp_path / "run")
    done = train_league(config)
    game = load_game(model)
    first, *_, last = done.figures["curve"]
    assert done.figures["exploitability"] <= last["exploitability"] <= first["exploitability"]
    assert variant == "psro" or last["exploitability"] < first["exploitability"]
    answer = exact.best_response(done.policy)
    assert answer.value.odds().value == pytest.approx(done.figures["exploitability"], abs=2e-5)
    roles = {each["role"] for each in done.figures["policies"]}
    with_exploiters = {"given", "main", "best-response", "main-exploiter", "league-exploiter"}
    assert roles == {"plain": {"given", "main"}, "psro": {"given", "oracle"}}.get(variant, with_exploiters)
    # Policies are stored once, under their hashes, and those of the past are never changed.
    hashes = [each["hash"] for each in done.figures["policies"]]
    assert len(set(hashes)) == len(hashes)
    tables = StoredPolicies(done.folder / TABLES, game)
    assert [tables.read(name).hash for name in hashes] == hashes
    with pytest.raises(RunError, match="finished run"):
        train_league(config)
    again = train_league(dataclasses.replace(config, resume=True))
    assert again.figures["curve"] == done.figures["curve"]


@pytest.mark.parametrize(
    ("variant", "learner"), [("prioritised", "ppo"), ("plain", "a2c"), ("fictitious", "sac"), ("psro", "ppo")]
)
def test_leagues_learn_where_to_wait(variant: Variant, learner: Any, model: str, tmp_path: Path) -> None:
    shutil.copytree(model, tmp_path / "model")
    for file in (CARD, POSITIONS):
        shutil.copy(model_folder() / file, tmp_path / "model")
    name = f"{tmp_path / 'model'}:recovery"
    config = LeagueTrainingConfig(**SMALL, variant=variant, learner=learner, game=name, out=tmp_path / "run")
    done = train_league(config)
    assert done.policy.waits is not None, "positions of its own, not those of people"
    assert exact.best_response(done.policy).value.odds().value == pytest.approx(done.figures["exploitability"], abs=2e-5)
    assert TabulatedPolicy.load(tmp_path / "run" / MAIN, load_game(name)).hash == done.policy.hash


@pytest.mark.parametrize("meta_solver", ["nash", "linear"])
def test_exact_oracles_find_the_equilibrium(meta_solver: MetaSolver, model: str, tmp_path: Path) -> None:
    config = LeagueTrainingConfig(
        variant="psro", meta_solver=meta_solver, rounds=12, game=model, pool=("attacking",), out=tmp_path / "run"
    )
    done = train_league(config)
    # Only with Nash equilibria is it sure to end there; the linear average draws nearer.
    assert done.figures["exploitability"] < {"nash": 1e-4, "linear": 0.03}[meta_solver]
    assert done.figures["exhausted"] == (meta_solver != "linear")
    solved = exact.solve(load_game(model))
    value = exact.evaluate(done.policy, solved.policy[1]).odds().value
    assert value == pytest.approx(0, abs=done.figures["exploitability"] + 1e-5)


def test_best_responses_are_averaged_where_equilibria_mix(model: str, tmp_path: Path) -> None:
    shutil.copytree(model, tmp_path / "model")
    for file in (CARD, POSITIONS):
        shutil.copy(model_folder() / file, tmp_path / "model")
    config = LeagueTrainingConfig(
        variant="psro", rounds=20, game=f"{tmp_path / 'model'}:recovery", pool=("attacking",), out=tmp_path / "run"
    )
    curve = [line["exploitability"] for line in train_league(config).figures["curve"]]
    assert curve[-1] < 0.02 < curve[4]
    assert json.loads((tmp_path / "run" / "config.json").read_text())["meta_solver"] == "linear"


def test_sac_plays_in_a_league(model: str, tmp_path: Path) -> None:
    config = LeagueTrainingConfig(**{**SMALL, "rounds": 4}, learner="sac", game=model, out=tmp_path / "run")
    done = train_league(config)
    assert len(done.figures["curve"]) == 4
    # Exploiters began again with new weights on the way.
    assert {"main-exploiter", "league-exploiter"} <= {each["role"] for each in done.figures["policies"]}
    assert done.figures["strokes"] >= 1500


@pytest.mark.parametrize("recovery", [False, True])
def test_payoffs_are_those_of_cross_play_and_solved_once(recovery: bool, model: str, tmp_path: Path) -> None:
    game = with_recovery(load_game(model), 0) if recovery else load_game(model)
    tables, policies = StoredPolicies(tmp_path / TABLES, game), [random_policy(game, seed, 2.0) for seed in range(4)]
    policies = [waiting(policy, seed) if recovery else policy for seed, policy in enumerate(policies)]
    hashes = [tables.save(policy) for policy in policies]
    assert len(list((tmp_path / TABLES).iterdir())) == 4
    payoffs = Payoffs(tables)
    assert np.allclose(payoffs.values(hashes[:3]), 2 * exact.crossplay(policies[:3]).rally - 1, atol=2e-5)
    assert payoffs.solved == 3
    restored = Payoffs(tables, payoffs.as_json(hashes))
    assert np.allclose(restored.values(hashes), 2 * exact.crossplay(policies).rally - 1, atol=2e-5)
    assert restored.solved == 3
    assert restored.match_wins(hashes[0], hashes[:1]) == pytest.approx(0.5)
    assert np.allclose(restored.match_wins(hashes[3], hashes[:3]), exact.crossplay(policies).match()[3, :3], atol=1e-3)


@pytest.fixture(scope="module")
def whole(model: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A league that was not broken off."""
    return train_league(LeagueTrainingConfig(**SMALL, game=model, out=tmp_path_factory.mktemp("whole") / "run")).folder


@pytest.mark.parametrize("when", [4, 26, pytest.param(46, marks=pytest.mark.slow)])
def test_a_league_that_stops_anywhere_is_resumed_to_the_same_results(
    when: int, whole: Path, model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = LeagueTrainingConfig(**SMALL, game=model, out=tmp_path / "run")
    with monkeypatch.context() as patch, contextlib.suppress(Killed):
        stop(patch, when, "replace")
        train_league(config)
    train_league(dataclasses.replace(config, resume=(tmp_path / "run" / "config.json").exists()))
    assert final(tmp_path / "run") == final(whole)


def test_every_rally_of_a_league_is_recorded(whole: Path, model: str) -> None:
    logs = sorted((whole / "rallies").glob("*.mcap"))
    assert len(logs) == len(list((whole / "learners").glob("*.json"))) >= 9
    names = set()
    for path in logs:
        assert check(path, load_game(model)).problems == ()
        played = read_rallies(path)
        own = played.policy[played.row_of_stroke, played.striker] == 0
        turn = json.loads((whole / "learners" / path.with_suffix(".json").name).read_text())["result"]
        assert own.sum() == turn["strokes"]
        with RallyLog(path) as log:
            names |= {player.name.partition("-")[0] for player in log.policies}
    assert names == {"main", "league", "frozen", "best"}


def _with_worker(config: LeagueTrainingConfig) -> tuple[Any, int]:
    """A league in a process of its own, and one of its workers."""
    process = multiprocessing.get_context("forkserver").Process(target=train_league, args=(config,))
    process.start()
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")

    def workers() -> list[int]:
        assert process.is_alive(), "the league ended without a worker"
        with contextlib.suppress(OSError):
            return [pid for pid in map(int, children.read_text().split()) if _is_worker(pid)]
        return []

    return process, wait_until(workers, 300, "a worker of the league")[-1]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_change_nothing_and_one_that_dies_costs_nothing(whole: Path, model: str, tmp_path: Path) -> None:
    process, worker = _with_worker(LeagueTrainingConfig(**{**SMALL, "workers": 2}, game=model, out=tmp_path / "run"))
    os.kill(worker, signal.SIGKILL)
    process.join()
    assert process.exitcode == 0
    assert final(tmp_path / "run") == final(whole)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
def test_workers_end_with_the_league(model: str, tmp_path: Path) -> None:
    process, worker = _with_worker(LeagueTrainingConfig(**{**SMALL, "workers": 2}, game=model, out=tmp_path / "run"))
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    wait_until(lambda: not _is_worker(worker), 300, "the end of the worker")


def _is_worker(pid: int) -> bool:
    """Whether a process is one of a pool, and not what keeps count of its semaphores."""
    with contextlib.suppress(OSError):
        return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def test_damage_is_noticed(whole: Path, model: str, tmp_path: Path) -> None:
    import shutil

    config = LeagueTrainingConfig(**SMALL, game=model, out=tmp_path / "run", resume=True)
    shutil.copytree(whole, tmp_path / "run")
    best = json.loads((whole / LEAGUE).read_text())["best"]["hash"]
    (tmp_path / "run" / TABLES / f"{best}.zst").write_bytes(b"rubbish")
    with pytest.raises(PolicyError, match="cannot be read"):
        train_league(config)
    (tmp_path / "run" / LEAGUE).write_text("{}")
    with pytest.raises(LeagueTrainingError, match="cannot be used"):
        train_league(config)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (["--response-fraction", "0.9", "--past-fraction", "0.5"], "fractions that add up to 1 or less"),
        (["--main-agents", "0"], "expected `int` >= 1"),
        (["--pool", "nobody"], "nobody"),
    ],
)
def test_bad_settings_are_refused(flags: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", *flags, "--out", str(tmp_path / "run")]) == 1
    assert message in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("flags", "algorithm", "rounds"),
    [
        ({}, "ppo", 10),
        ({"strokes": 240_000_000}, "ppo", 8),
        ({"strokes": 240_000_000, "rounds": 99}, "ppo", 99),
        ({"strokes": 10**10}, "ppo", 60),
        ({"strokes": 10}, "ppo", 6),
        ({"variant": "psro", "oracle": "a2c"}, "a2c", 10),
        ({"learner": "sac", "strokes": 10**9}, "sac", 33),
        ({"variant": "plain", "oracle": "ppo", "learner": "sac", "strokes": 10**7}, "sac", 6),
        ({"variant": "psro", "oracle": "ppo", "learner": "sac", "strokes": 10**10}, "ppo", 60),
        ({"variant": "psro", "oracle": "exact", "learner": "sac"}, "sac", 60),
        ({"variant": "psro", "oracle": "exact", "rounds": 3}, "ppo", 3),
    ],
)
def test_what_learns_and_for_how_many_rounds(flags: dict[str, Any], algorithm: str, rounds: int) -> None:
    config = LeagueTrainingConfig(**flags)
    assert (config.algorithm, config.n_rounds) == (algorithm, rounds)
    assert config.exact_oracle == (flags.get("variant") == "psro" and flags["oracle"] == "exact")


@pytest.mark.parametrize("win", [[1.0, 1.0, 1.0], [0.0, 0.0], [np.nan, np.nan], [1.0], [1 - 1e-17, 1.0]])
def test_alike_opponents_are_met_alike_however_one_sided(win: list[float]) -> None:
    assert np.allclose(prioritised(win), 1 / len(win))


def test_opponents_that_win_are_met_most() -> None:
    weight = prioritised([1.0, 0.5, 0.0])
    assert np.allclose(weight, (1 - FLOOR) * np.array([0, 0.2, 0.8]) + FLOOR / 3)
    assert len(prioritised([])) == 0
    assert len(uniform(0)) == 0


@given(st.lists(st.floats(0, 1) | st.sampled_from([0.0, 1.0, float("nan")]), min_size=1, max_size=50))
def test_weights_are_always_probabilities(win: list[float]) -> None:
    weight = prioritised(win)
    assert weight.sum() == pytest.approx(1)
    assert weight.min() >= FLOOR / len(win) / 2
