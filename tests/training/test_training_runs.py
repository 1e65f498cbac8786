"""Training runs from start to end: the same seed, a kill, several seeds, and logs on which nothing of the learning depends."""

import dataclasses
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import load
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from shuttle_marl.base import runs
from shuttle_marl.base.intervals import interquartile_mean
from shuttle_marl.base.runs import RunError
from shuttle_marl.commands.training import main
from shuttle_marl.game.policy import PolicyError, States, TabulatedPolicy, tabulate
from shuttle_marl.policy.agents import read_card
from shuttle_marl.policy.computed import sharpened
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog, replay
from shuttle_marl.recording.reader import check
from shuttle_marl.training import A2CConfig, Evaluation, Evaluator, PPOConfig, SACConfig, TrainingConfig, TrainingError, train
from shuttle_marl.training.config import SelfPlayVariant
from shuttle_marl.training.learner import STATE
from shuttle_marl.training.networks import tabulated
from shuttle_marl.training.ppo import PPO
from shuttle_marl.training.run import train_seeds
from tests.kernel.episodes import compare_with_rally_v0
from tests.recording.conftest import read_rallies
from tests.reduced import reduced_game, reduced_model
from tests.stops import Killed, stop
from tests.waiting import wait_until

GAME = reduced_game()
SMALL: dict[str, Any] = {
    "game": reduced_model(),
    "batch": 256,
    "growth": 0.0,
    "width": 16,
    "evaluate_every": 4,
    "checkpoint_every": 3,
    "record": "all",
}
VARIANTS: tuple[SelfPlayVariant, ...] = ("best-response", "restarts", "pool", "magnet", "emagnet", "nash")
CONFIGS: dict[str, TrainingConfig] = {
    "ppo": PPOConfig(**SMALL, strokes=256 * 8, minibatches=3),
    "a2c": A2CConfig(**SMALL, strokes=256 * 8),
    "sac": SACConfig(**SMALL, strokes=256 * 8, warm_up=300, minibatch=64, buffer=700),
    "self-play": PPOConfig(**SMALL, strokes=256 * 8, opponent=("self",)),
    "pool": PPOConfig(**SMALL, strokes=256 * 8, opponent=("bc", "random", "safe")),
    **{
        variant: PPOConfig(**SMALL, strokes=256 * 8, opponent=("self",), variant=variant, update_interval=2, pool_size=2)
        for variant in VARIANTS
    },
}


def weights(run: Path) -> bytes:
    return (run / "agent" / "network.safetensors").read_bytes()


def rallies(run: Path) -> bytes:
    return (run / "rallies.mcap").read_bytes()


def metrics(run: Path) -> list[dict[str, float]]:
    lines = runs.Journal(run / "metrics.jsonl").read()
    return [{k: v for k, v in line.items() if k != "seconds"} for line in lines]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in VARIANTS[1:5] else ()) for name in CONFIGS]
)
def test_a_run_that_is_broken_off_ends_with_the_same_weights(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = CONFIGS[name]
    whole = train(dataclasses.replace(config, out=tmp_path / "whole"))
    assert whole.iterations == 8
    again = dataclasses.replace(config, out=tmp_path / "broken")
    from shuttle_marl.training import run

    learner: Any = run.LEARNERS[config.algorithm]
    collect, count = learner.collect, itertools.count(1)

    def interrupted(self: Any) -> Any:
        if next(count) == 5:
            raise KeyboardInterrupt
        return collect(self)

    with monkeypatch.context() as patch:
        patch.setattr(learner, "collect", interrupted)
        with pytest.raises(KeyboardInterrupt):
            train(again)
    resumed = train(dataclasses.replace(again, resume=True))
    assert weights(resumed.folder) == weights(whole.folder)
    assert rallies(resumed.folder) == rallies(whole.folder)
    assert metrics(resumed.folder) == metrics(whole.folder)
    assert (resumed.policy.cumulative == whole.policy.cumulative).all()
    if name in ("ppo", "a2c", "sac"):
        other = train(dataclasses.replace(config, out=tmp_path / "other", seed=1))
        assert weights(other.folder) != weights(whole.folder)


def test_a_run_that_stops_anywhere_is_resumed_to_the_same_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = Evaluation(rally_win=0.5, match_win=0.5, normalised_score=0.0, exploitability=0.5)
    monkeypatch.setattr(Evaluator, "evaluate", lambda *_, **__: figures)
    config = SACConfig(**{**SMALL, "batch": 64, "width": 4, "checkpoint_every": 2}, strokes=64 * 3, warm_up=100, minibatch=64)
    whole = train(dataclasses.replace(config, out=tmp_path / "whole")).folder
    for when in itertools.count(1):
        folder = tmp_path / f"stopped-{when}"
        with monkeypatch.context() as patch:
            stop(patch, when, "replace")
            try:
                train(dataclasses.replace(config, out=folder))
                break
            except Killed:
                pass
        train(dataclasses.replace(config, out=folder, resume=(folder / "config.json").exists()))
        assert weights(folder) == weights(whole)
        assert rallies(folder) == rallies(whole)
        assert metrics(folder) == metrics(whole)
    assert when > 12


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_a_killed_process_is_resumed_to_the_same_weights(tmp_path: Path) -> None:
    flags = "--strokes 7680 --batch 256 --growth 0 --record all --width 16 --checkpoint-every 3 --evaluate-every 10 --game"
    command = [sys.executable, "-m", "shuttle_marl.training", "ppo", *flags.split(), reduced_model()]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    subprocess.run([*command, "--out", str(tmp_path / "whole")], check=True, timeout=300, env=environment)
    process = subprocess.Popen([*command, "--out", str(tmp_path / "killed")], env=environment)
    saved = tmp_path / "killed" / "checkpoints"
    wait_until(lambda: process.poll() is not None or list(saved.glob("0*/about.json")), 300, "the first checkpoint")
    assert process.poll() is None
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (tmp_path / "killed" / "agent").exists()
    subprocess.run([*command, "--out", str(tmp_path / "killed"), "--resume"], check=True, timeout=300, env=environment)
    assert weights(tmp_path / "killed") == weights(tmp_path / "whole")
    assert rallies(tmp_path / "killed") == rallies(tmp_path / "whole")
    assert check(tmp_path / "killed" / "rallies.mcap", GAME).problems == ()


class Raises:
    """An opponent that fails."""

    def probabilities(self, states: States) -> np.ndarray:
        raise ValueError("no racket")


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"opponent": ("bd",)}, PolicyError, "did you mean"),
        ({"opponent": (f"{__name__}:Raises",)}, PolicyError, "no racket"),
        ({"game": "nowhere"}, Exception, "no model 'nowhere'"),
        ({"resume": True}, RunError, "no run to resume"),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(
    change: dict[str, Any], error: type[Exception], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, __name__, sys.modules[__name__])
    with pytest.raises(error, match=message):
        train(dataclasses.replace(CONFIGS["ppo"], out=tmp_path / "run", **change))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("name", ["ppo", "a2c", "sac"])
def test_no_number_is_taken_that_cannot_be_meant(name: str) -> None:
    config = CONFIGS[name]
    for field in dataclasses.fields(config):
        if type(getattr(config, field.name)) in (int, float):
            for wrong in (-1, math.nan, math.inf if isinstance(getattr(config, field.name), float) else -7):
                change: dict[str, Any] = {field.name: wrong}
                with pytest.raises(TrainingError, match=f"--{field.name.replace('_', '-')} {wrong}: expected"):
                    dataclasses.replace(config, **change)


def test_the_agent_of_sac_is_the_mean_of_its_weights_which_changes_nothing_in_learning(tmp_path: Path) -> None:
    sac = dataclasses.replace(CONFIGS["sac"], strokes=256 * 4)
    assert isinstance(sac, SACConfig)

    def kept(name: str, **changes: Any) -> list[list[bytes]]:
        """Weights that collect, and weights that are shown."""
        saved = runs.Run(train(dataclasses.replace(sac, **changes, out=tmp_path / name)).folder).saved(STATE)
        assert saved is not None
        floats = {name: part for name, part in load(*saved[1]).items() if part.dtype.kind == "f"}
        prefixes = "loss.actor", "averaged."
        return [sorted(part.tobytes() for name, part in floats.items() if name.startswith(p)) for p in prefixes]

    learned, shown = kept("plain", averaging=0.0)
    assert learned == shown
    same, mean = kept("mean", averaging=0.9)
    assert same == learned != mean


def test_the_target_stops_the_run_and_it_stays_stopped(tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIGS["ppo"], out=tmp_path / "run", opponent=("random",), target=0.01)
    done = train(config)
    assert done.iterations == 4
    resumed = train(dataclasses.replace(config, resume=True))
    assert resumed.iterations == 4
    assert weights(resumed.folder) == weights(done.folder)
    board = EventAccumulator(str(done.folder / "tensorboard")).Reload()
    assert [event.step for event in board.Scalars("rally_win")] == [line["strokes"] for line in metrics(done.folder)]


@pytest.mark.slow
def test_ppo_learns_to_beat_bc(tmp_path: Path) -> None:
    done = train(PPOConfig(out=tmp_path / "run", strokes=2_000_000, target=0.98, evaluate_every=5))
    assert done.evaluation.match_win >= 0.98


def test_an_agent_plays_at_its_temperature_and_learns_at_1(tmp_path: Path) -> None:
    found = {}
    for temperature in (1.0, 0.25):
        done = train(dataclasses.replace(CONFIGS["ppo"], eval_temperature=temperature, out=tmp_path / str(temperature)))
        found[temperature] = done.policy, load(weights(done.folder)), rallies(done.folder)
        policy = resolve(f"agent:{done.folder / 'agent'}", GAME)
        assert isinstance(policy, TabulatedPolicy)
        assert (policy.cumulative == done.policy.cumulative).all()
        assert read_card(done.folder / "agent")["evaluation"] == dataclasses.asdict(done.evaluation)
    (plain, weights_1, log_1), (sharp, weights_4, log_4) = found.values()
    assert log_1 == log_4
    assert set(weights_1) == set(weights_4)
    for name, weight in weights_1.items():
        assert (weights_4[name] == weight * (4 if name.startswith("1.") else 1)).all()
    expected = sharpened(plain, 0.25)
    assert np.abs(sharp.pair_probabilities() - expected.pair_probabilities()).max() < 1e-3


def test_ppo_collects_more_and_more_sharply() -> None:
    config = dataclasses.replace(PPOConfig(**SMALL), strokes=256, anneal_after=0.5, final_temperature=0.25)
    seen = torch.tensor(GAME.observation(np.array([5, 6, 7])))
    learner = PPO(config, GAME)
    soft, _ = learner.predict(seen)
    for remaining, temperature in ((1.0, 1.0), (0.5, 1.0), (0.25, 0.5), (0.0, 0.25)):
        learner.anneal(remaining)
        torch.testing.assert_close(learner.predict(seen)[0], soft / temperature)
    played = tabulated(learner.actor, GAME, config.final_temperature)
    states = np.array([5, 6, 7], np.int32)
    logits = torch.where(torch.from_numpy(GAME.mask(states)), learner.predict(seen)[0], -torch.inf)
    wanted = logits.softmax(-1).detach().numpy()
    np.testing.assert_allclose(played.probabilities(States(game=GAME, state=states)), wanted, atol=2e-5)
    never = PPO(dataclasses.replace(config, anneal_after=1.0), GAME)
    before, _ = never.predict(seen)
    never.anneal(0.0)
    torch.testing.assert_close(never.predict(seen)[0], before)


STUDY = PPOConfig(
    game=reduced_model(), strokes=512, batch=256, growth=0.0, width=8, evaluate_every=2, checkpoint_every=1, record="none", seed=3
)


def test_every_seed_ends_as_it_would_alone_and_the_command_says_the_spread(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "study"
    flags = ["--strokes", "512", "--batch", "256", "--growth", "0", "--width", "8", "--evaluate-every", "2"]
    flags += ["--checkpoint-every", "1", "--record", "none", "--seed", "3", "--game", STUDY.game, "--out", str(out)]
    assert main(["ppo", *flags, "--seeds", "3", "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert re.search("normalised.score", said)
    assert f"agent:{out}/seed-3/agent" in said.replace("\n", "")
    alone = train(dataclasses.replace(STUDY, seed=4, out=tmp_path / "alone"))
    name = Path("agent") / "network.safetensors"
    assert (out / "seed-4" / name).read_bytes() == (alone.folder / name).read_bytes()
    found = json.loads((out / "results.json").read_text())
    assert list(found["seeds"]) == ["3", "4", "5"]
    won = [evaluation["rally_win"] for evaluation in found["seeds"].values()]
    assert won[1] == alone.evaluation.rally_win
    assert found["seeds"]["4"]["strokes"] == alone.strokes
    middle = interquartile_mean([won])
    assert found["figures"]["rally_win"] == pytest.approx({**middle._asdict(), "lowest": min(won), "highest": max(won)})
    assert np.ptp(won) > 0

    again = train_seeds(dataclasses.replace(STUDY, out=out, resume=True), 3, 1)
    assert again.figures == found["figures"]
    with pytest.raises(RunError, match="other flags"):
        train_seeds(dataclasses.replace(STUDY, out=out, resume=True), 2, 1)
    with pytest.raises(RunError, match="--overwrite"):
        train_seeds(dataclasses.replace(STUDY, out=out), 3, 1)


@pytest.mark.parametrize(("seeds", "jobs"), [(1, 1), (2, 0)])
def test_too_few_seeds_or_jobs_are_named(seeds: int, jobs: int, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=f"--seeds {seeds} --jobs {jobs}: expected"):
        train_seeds(dataclasses.replace(STUDY, out=tmp_path / "run"), seeds, jobs)
    assert not (tmp_path / "run").exists()


LOGGED: dict[str, Any] = {**SMALL, "evaluate_every": 100, "strokes": 256 * 8, "figures": "all"}
LOG = "rallies.mcap"


@pytest.mark.parametrize(
    ("config", "names"),
    [
        (PPOConfig(**LOGGED), ("bc",)),
        (PPOConfig(**LOGGED, opponent=("random", "safe", "bc")), ("random", "safe", "bc")),
        (PPOConfig(**LOGGED, opponent=("self",)), ()),
        (PPOConfig(**LOGGED, opponent=("self",), variant="best-response"), ("best-response-0",)),
        (SACConfig(**LOGGED), ("bc",)),
    ],
)
def test_the_log_plays_again(config: TrainingConfig, names: tuple[str, ...], tmp_path: Path) -> None:
    done = train(dataclasses.replace(config, out=tmp_path / "run"))
    path = done.folder / LOG
    assert check(path, GAME).problems == ()
    known = [name for name in names if name != "best-response-0"]  # that changes during the run
    opponents = {name: tabulate(resolve(name, GAME), GAME) for name in known}
    with RallyLog(path) as log:
        assert replay(log, GAME, opponents).wrong == ()
        assert [player.name for player in log.policies] == [f"{config.algorithm}-0", *names]
        # Three iterations between checkpoints, eight in all.
        pairings = log.pairings
        assert len(pairings) == 3
    found = read_rallies(path)
    # What one process plays between two checkpoints are the first rallies of a seed.
    part = found.select((found.pairing == 1) & (found.match < 300))
    compare_with_rally_v0(pairings[1], part, game=GAME)
    # Every stroke of the learner is in the log.
    own = found.policy[found.row_of_stroke, found.striker] == 0
    assert own.sum() == read_card(done.folder / "agent")["strokes"]
    assert set(np.unique(found.update)) == set(range(8))
    assert (found.update // 3 == found.pairing).all()
    if config.algorithm == "ppo":
        assert np.isfinite(found.log_probability[own]).all()
        assert (found.log_probability[own] <= 0).all()
        assert np.isnan(found.log_probability[~own]).all()
        assert np.isfinite(found.value[own]).all()
        assert found.value[own].std() > 0
    else:
        assert found.optional_columns == ("update",)


def test_self_play_meets_its_pool_in_a_fraction_of_rallies(tmp_path: Path) -> None:
    pool: dict[str, Any] = {"opponent": ("self",), "variant": "pool", "pool_size": 2, "update_interval": 2, "fraction": 0.25}
    found = read_rallies(train(PPOConfig(**LOGGED, **pool, out=tmp_path / "run")).folder / LOG)
    met = (found.policy != 0).any(axis=1)
    assert met.mean() == pytest.approx(0.25, abs=0.05)
    assert len(np.unique(found.policy[met])) == 3


def test_every_rally_is_recorded_by_default(tmp_path: Path) -> None:
    """And of some the learner's probabilities and values."""
    done = train(PPOConfig(**{**LOGGED, "figures": "auto"}, out=tmp_path / "run"))
    assert PPOConfig().record == "all"
    found = read_rallies(done.folder / LOG)
    own = found.policy[found.row_of_stroke, found.striker] == 0
    assert own.sum() == read_card(done.folder / "agent")["strokes"]
    known = np.isfinite(found.value)
    assert (known == np.isfinite(found.log_probability)).all()
    first = found.pairing[found.row_of_stroke] == 0
    assert known[own & first].all()
    assert 0 < known[own & ~first].mean() < 0.2
    # Whole rallies.
    for row in range(len(found)):
        assert len(set(known[(found.row_of_stroke == row) & own])) <= 1


def test_the_log_probability_is_that_of_the_weights(tmp_path: Path) -> None:
    """Before the first update the policy is known: that of a run that learned next to nothing."""
    config = PPOConfig(**{**LOGGED, "strokes": 256}, learning_rate=1e-12, eval_temperature=1.0, out=tmp_path / "run")
    done = train(config)
    found = read_rallies(done.folder / LOG)
    own = found.policy[found.row_of_stroke, found.striker] == 0
    state, k = (column[own] for column in found.legal(GAME))
    assert own.sum() > 50
    assert np.allclose(np.exp(found.log_probability[own]), done.policy.probability_of(GAME.pair_at(state, k)), atol=2e-4)


def test_recording_changes_nothing_that_is_learned(tmp_path: Path) -> None:
    """Nor does the room for recorded strokes, or how it grew."""
    first, *others = (
        weights(train(PPOConfig(**{**LOGGED, "growth": 4.0, "record": record}, out=tmp_path / record)).folder)
        for record in ("all", "none")
    )
    assert all(other == first for other in others)
    assert not (tmp_path / "none" / LOG).exists()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="PyTorch finds no CUDA device on this machine")
@pytest.mark.parametrize("name", ["ppo", "a2c", "sac", "pool"])
def test_a_run_on_a_gpu_mixes_no_devices_and_is_resumed(name: str, tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIGS[name], device="cuda", out=tmp_path / "run")
    assert train(config).iterations == train(dataclasses.replace(config, resume=True)).iterations


def test_settings_of_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = {"strokes": 512, "opponent": ("random", "safe"), "exploitability": False, "bonus": ("smash=0.1",)}
    config = PPOConfig(**SMALL | options)
    train(dataclasses.replace(config, out=tmp_path / "run"))
    file = tmp_path / "run" / "config.json"
    assert PPOConfig.load(file) == dataclasses.replace(config, out=None)
    assert PPOConfig.load(str(file), seed=5).seed == 5
    assert main(["ppo", "--seed", "4", "--config", str(file), "--out", str(tmp_path / "again"), "--strokes", "256"]) == 0
    again = PPOConfig.load(tmp_path / "again" / "config.json")
    assert again == dataclasses.replace(config, seed=4, strokes=256)
    (tmp_path / "other.json").write_text('{"stroke": 1}')
    assert main(["ppo", "--config", str(tmp_path / "other.json")]) == 1
    assert re.search("no setting 'stroke'.*strokes", capsys.readouterr().err)
