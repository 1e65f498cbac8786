"""Settings of training: what is accepted and refused, sizes of a run, and what is written of them."""

import json
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.training import A2CConfig, PPOConfig, TrainingError
from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError


@pytest.mark.parametrize(
    ("strokes", "batch", "growth", "iterations"),
    [
        # 100, 200, 300, ... strokes
        (1, 100, 1.0, 1), (100, 100, 1.0, 1), (101, 100, 1.0, 2), (300, 100, 1.0, 2), (301, 100, 1.0, 3), (600, 100, 1.0, 3),
        # 100, 150, 200, ...
        (250, 100, 0.5, 2), (251, 100, 0.5, 3), (450, 100, 0.5, 3), (451, 100, 0.5, 4),
        (100, 100, 0.0, 1), (101, 100, 0.0, 2), (1000, 100, 0.0, 10), (1, 100, 0.0, 1),
    ],
)  # fmt: skip
def test_iterations_of_a_run_whose_batches_grow(strokes: int, batch: int, growth: float, iterations: int) -> None:
    config = A2CConfig(strokes=strokes, batch=batch, growth=growth, checkpoint_every=3)
    assert config.iterations == iterations
    sizes = [config.batch_of(k) for k in range(iterations)]
    assert sizes == [round(batch * (1 + growth * k)) for k in range(iterations)]
    assert sum(sizes[:-1]) < strokes <= sum(sizes)
    assert config.segments == len(range(0, iterations, 3))


def test_what_cannot_be_meant_together() -> None:
    own: dict[str, Any] = {"opponent": ("self",)}
    refused: list[tuple[dict[str, Any], str]] = [
        ({"opponent": ()}, "expected one or more policies"),
        ({"opponent": ("self", "self")}, "self cannot be combined"),
        ({"opponent": ("seIf",)}, "no such policy; did you mean self"),
        ({**own, "fault_cost": 0.5}, "not available in self-play"),
        ({**own, "bonus": ("smash=0.5",)}, "not available in self-play"),
        ({"variant": "nash"}, "--variant nash: requires self-play"),
        ({"record": "half"}, "--record half: invalid enum value"),
        ({"figures": "half"}, "--figures half: invalid enum value"),
    ]
    for flags, says in refused:
        with pytest.raises(Exception, match=says):
            PPOConfig(**flags)


def test_a_league_has_someone_to_meet() -> None:
    with pytest.raises(LeagueTrainingError, match="expected one or more policies"):
        LeagueTrainingConfig(pool=())


def test_settings_that_change_nothing_are_not_written() -> None:
    fixed = PPOConfig(out=Path("run"), resume=True, opponent=("bc", "safe")).fixed()
    assert not {"out", "resume", "overwrite"} & set(fixed)
    assert (fixed["algorithm"], fixed["opponent"], fixed["seed"]) == ("ppo", ["bc", "safe"], 0)
    written = LeagueTrainingConfig(out=Path("run"), workers=3, ray="local", overwrite=True, pool=("bc",)).fixed()
    assert not {"out", "resume", "overwrite", "workers", "ray"} & set(written)
    assert (written["pool"], written["variant"]) == (["bc"], "prioritised")


GOOD: list[dict[str, Any]] = [
    {},
    {"algorithm": "ppo", "seed": 3},
    {"fault_cost": 1},
    {"fault_cost": 0.5},
    {"opponent": ["bc", "safe"]},
    {"exploitability": False},
    {"target": 0.5},
    {"target": None},
]
BAD: list[tuple[object, str]] = [
    ([], "no settings"),
    ({"algorithm": "a2c"}, "settings of a2c, expected those of ppo"),
    ({"sede": 3}, "no setting 'sede'; did you mean seed"),
    ({"seed": 3.5}, r"Expected `int`, got `float` - at `\$.seed`"),
    ({"seed": True}, r"Expected `int`, got `bool` - at `\$.seed`"),
    ({"fault_cost": "1"}, r"Expected `float`, got `str` - at `\$.fault_cost`"),
    ({"exploitability": 1}, r"Expected `bool`, got `int`"),
    ({"opponent": "bc"}, r"Expected `array`, got `str`"),
    ({"opponent": ["bc", 1]}, r"Expected `str`, got `int`"),
    ({"variant": "pools"}, "Invalid enum value 'pools'"),
    ({"record": None}, "Expected `str`, got `null`"),
]


def test_settings_of_a_file_have_the_types_of_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "config.json"
    for settings in GOOD:
        path.write_text(json.dumps(settings))
        config = PPOConfig.load(path, width=9)
        assert config.width == 9
        for name, value in settings.items():
            assert getattr(config, name) == (tuple(value) if isinstance(value, list) else value)
    for wrong, says in BAD:
        path.write_text(json.dumps(wrong))
        with pytest.raises(TrainingError, match=f"config.json: {says}"):
            PPOConfig.load(path)
    with pytest.raises(TrainingError, match="no settings"):
        PPOConfig.load(tmp_path / "nothing.json")
