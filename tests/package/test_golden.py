"""Results that no change of the code may change: the game, its value, the strokes of a tournament and of training runs.

If a change is meant to change one of them, the models and every number in the documentation have to be made again.
"""

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.exact import solve
from shuttle_marl.game.shipped import default_game
from shuttle_marl.game.tables import Game
from shuttle_marl.league import LeagueConfig
from shuttle_marl.recording import RallyLog
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, TrainingConfig, train
from tests.tournaments import play_league

GAME_HASH = "32b92c52cd31fd90c4fb31d988f32abe5e277a839d42206c1d334f1606a6e6be"
VALUE_AT_SERVE = -0.0052040
TOURNAMENT = "a2024560bb42ef49"
WINS = {"minimax": 20, "ppo": 12, "safe@greedy": 13, "attacking": 10, "bc": 5, "random": 0}
SMALL: dict[str, Any] = {"batch": 512, "strokes": 1536, "width": 16, "threads": 1, "record": "all"}
TRAINING: dict[str, tuple[TrainingConfig, str]] = {
    "ppo": (PPOConfig(**SMALL), "9e741e05f3fec1ce"),
    "a2c": (A2CConfig(**SMALL), "bea8f9b040805027"),
    "sac": (SACConfig(**SMALL, warm_up=600, minibatch=64, buffer=1000), "612cab4b4c9ebfe5"),
    "self-play": (PPOConfig(**SMALL, opponent=("self",)), "ef8e93e0095f1257"),
}
"""Settings of a run, and the digest of its strokes."""


@pytest.fixture(scope="module")
def game() -> Game:
    return default_game()


def digest(log: Path) -> str:
    """Digest of all strokes of a log, their outcomes, and the rallies that they belong to."""
    with RallyLog(log) as opened:
        columns = opened.stroke_table().select(["number", "position", "stroke", "outcome"]).to_pydict().values()
    lines = "\n".join(" ".join(map(str, row)) for row in zip(*columns, strict=True))
    return hashlib.sha256(lines.encode()).hexdigest()[:16]


def test_the_game_and_its_value_at_the_serve(game: Game) -> None:
    assert game.hash == GAME_HASH
    assert f"`{GAME_HASH}`" in Path("docs/environments.md").read_text(encoding="utf-8")
    assert solve(game).value_at_serve == pytest.approx(VALUE_AT_SERVE, abs=1e-7)


def test_a_tournament(tmp_path: Path) -> None:
    pool = ("bc", "attacking", "safe@greedy", "ppo", "random", "minimax")
    run = play_league(LeagueConfig(pool=pool, matches=4, seed=5, out=tmp_path / "run"))
    assert {standing.player: standing.wins for standing in run.standings} == WINS
    assert digest(run.folder / "rallies.mcap") == TOURNAMENT


@pytest.mark.parametrize("name", TRAINING)
def test_a_training_run(name: str, tmp_path: Path) -> None:
    config, expected = TRAINING[name]
    train(dataclasses.replace(config, seed=4, out=tmp_path / "run"))
    assert digest(tmp_path / "run" / "rallies.mcap") == expected
