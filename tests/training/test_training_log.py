"""Rally logs of training runs, on which nothing of the learning depends."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.agents import read_card
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import Rallies, RallyLog, RecordingError, replay
from shuttle_marl.recording.file_writer import NoRoomError, Sink
from shuttle_marl.recording.replay import check
from shuttle_marl.training import PPOConfig, SACConfig, TrainingConfig, train
from tests.kernel.episodes import compare_with_rally_v0
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
SMALL: dict[str, Any] = {
    "game": reduced_model(),
    "batch": 256,
    "growth": 0.0,
    "width": 16,
    "evaluate_every": 100,
    "checkpoint_every": 3,
    "strokes": 256 * 8,
    "record": "all",
}
LOG = "rallies.mcap"


def read(path: Path) -> Rallies:
    with RallyLog(path) as log:
        return Rallies.concatenate([batch for _, batch in log.batches()])


@pytest.mark.parametrize(
    ("config", "names"),
    [
        (PPOConfig(**SMALL), ("bc",)),
        (PPOConfig(**SMALL, opponent=("random", "safe", "bc")), ("random", "safe", "bc")),
        (PPOConfig(**SMALL, opponent=("self",)), ()),
        (SACConfig(**SMALL), ("bc",)),
    ],
)
def test_the_log_plays_again(config: TrainingConfig, names: tuple[str, ...], tmp_path: Path) -> None:
    done = train(dataclasses.replace(config, out=tmp_path / "run"))
    path = done.folder / LOG
    assert check(path, GAME).problems == ()
    opponents = {name: tabulate(resolve(name, GAME), GAME, name) for name in names}
    with RallyLog(path) as log:
        assert replay(log, GAME, opponents).wrong == ()
        assert [player.name for player in log.policies] == [f"{config.algorithm}-0", *names]
        # Three iterations between checkpoints, eight in all.
        pairings = log.pairings
        assert len(pairings) == 3
    found = read(path)
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


def test_the_log_probability_is_that_of_the_weights(tmp_path: Path) -> None:
    """Before the first update the policy is known: that of a run that learned next to nothing."""
    config = PPOConfig(**{**SMALL, "strokes": 256}, learning_rate=1e-12, eval_temperature=1.0, out=tmp_path / "run")
    done = train(config)
    with RallyLog(done.folder / LOG) as log:
        from shuttle_marl.recording import Derived

        table = log.stroke_table(Derived(log, GAME, {"ppo-0": done.policy})).to_pandas()
    own = table[table.policy == "ppo-0"]
    assert len(own) > 50
    assert np.allclose(np.exp(own.log_probability), own.probability, atol=2e-4)


def test_recording_changes_nothing_that_is_learned(tmp_path: Path) -> None:
    weights = []
    for record in ("all", "sample:3", "none"):
        done = train(PPOConfig(**{**SMALL, "record": record}, out=tmp_path / record))
        weights.append((done.folder / "agent" / "network.safetensors").read_bytes())
    assert weights[0] == weights[1] == weights[2]
    assert not (tmp_path / "none" / LOG).exists()
    assert check(tmp_path / "sample:3" / LOG, GAME).problems == ()
    every, some = read(tmp_path / "all" / LOG), read(tmp_path / "sample:3" / LOG)
    assert math.isclose(len(some) / len(every), 1 / 3, rel_tol=0.25)
    assert set(zip(some.pairing, some.match, strict=True)) < set(zip(every.pairing, every.match, strict=True))


def test_a_disk_that_fills_up_stops_the_run_and_it_goes_on_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = PPOConfig(**SMALL, out=tmp_path / "run")
    whole = train(dataclasses.replace(config, out=tmp_path / "whole"))
    reserve, asked = Sink.reserve, []

    def fills(self: Sink, count: int) -> None:
        asked.append(count)
        if len(asked) == 4:
            raise NoRoomError(28, "No space left on device")
        reserve(self, count)

    with monkeypatch.context() as patch:
        patch.setattr(Sink, "reserve", fills)
        with pytest.raises(RecordingError, match="No space left on device"):
            train(config)
    assert not (tmp_path / "run" / "agent").exists()
    resumed = train(dataclasses.replace(config, resume=True))
    assert (resumed.folder / LOG).read_bytes() == (whole.folder / LOG).read_bytes()
