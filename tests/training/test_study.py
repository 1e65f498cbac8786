"""The same training with several seeds, side by side."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.base.intervals import interquartile_mean
from shuttle_marl.base.runs import RunError
from shuttle_marl.commands.training import main
from shuttle_marl.training import PPOConfig, TrainingError, train
from shuttle_marl.training.study import train_seeds
from tests.reduced import reduced_model

SMALL = PPOConfig(
    game=reduced_model(), strokes=512, batch=256, growth=0.0, width=8, evaluate_every=2, checkpoint_every=1, record="none", seed=3
)


def test_every_seed_ends_as_it_would_alone_and_the_command_says_the_spread(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "study"
    flags = ["--strokes", "512", "--batch", "256", "--growth", "0", "--width", "8", "--evaluate-every", "2"]
    flags += ["--checkpoint-every", "1", "--record", "none", "--seed", "3", "--game", SMALL.game, "--out", str(out)]
    assert main(["ppo", *flags, "--seeds", "3", "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert "normalised score" in said
    assert f"agent:{out}/seed-3/agent" in said.replace("\n", "")
    alone = train(dataclasses.replace(SMALL, seed=4, out=tmp_path / "alone"))
    name = Path("agent") / "network.safetensors"
    assert (out / "seed-4" / name).read_bytes() == (alone.folder / name).read_bytes()
    found = json.loads((out / "results.json").read_text())
    assert list(found["seeds"]) == ["3", "4", "5"]
    won = [evaluation["rally_win"] for evaluation in found["seeds"].values()]
    assert won[1] == alone.evaluation.rally_win
    middle = interquartile_mean([won])
    assert found["figures"]["rally_win"] == pytest.approx({**middle._asdict(), "lowest": min(won), "highest": max(won)})
    assert np.ptp(won) > 0

    again = train_seeds(dataclasses.replace(SMALL, out=out, resume=True), 3, 1)
    assert again.figures == found["figures"]
    with pytest.raises(RunError, match="other flags"):
        train_seeds(dataclasses.replace(SMALL, out=out, resume=True), 2, 1)
    with pytest.raises(RunError, match="--overwrite"):
        train_seeds(dataclasses.replace(SMALL, out=out), 3, 1)


@pytest.mark.parametrize(("seeds", "jobs"), [(1, 1), (2, 0)])
def test_too_few_seeds_or_jobs_are_named(seeds: int, jobs: int, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=f"--seeds {seeds} --jobs {jobs}: expected"):
        train_seeds(dataclasses.replace(SMALL, out=tmp_path / "run"), seeds, jobs)
    assert not (tmp_path / "run").exists()
