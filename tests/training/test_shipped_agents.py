"""The trained agents that come with the package: played from tables, as good as their cards say."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shuttle_marl.dynamics import default_game, model_folder
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.table import tabulate
from shuttle_marl.league import default_pool
from shuttle_marl.policy import registry
from shuttle_marl.policy.agents import CARD, NETWORK, TABLE, load_agent, read_card, shipped_folder
from shuttle_marl.training import Evaluator

GAME = default_game()
SHIPPED = ("a2c", "ppo", "ppo:attacking", "ppo:cautious", "ppo:defensive", "ppo:self-play", "sac")


def test_all_are_listed_and_the_main_ones_play_in_the_default_league() -> None:
    assert set(SHIPPED) <= set(registry.names())
    assert {"a2c", "ppo", "sac", "ppo:self-play"} <= set(default_pool())


@pytest.mark.parametrize("name", SHIPPED)
def test_figures_of_the_card_are_true(name: str) -> None:
    policy = tabulate(registry.resolve(name, GAME), GAME, name)
    found = Evaluator(GAME, [tabulate(registry.resolve("bc", GAME), GAME)]).evaluate(policy)
    card = read_card(shipped_folder(name, model_folder()))
    for figure, value in card["evaluation"].items():
        assert getattr(found, figure) == pytest.approx(value, abs=1e-4)
    assert found.rally_win > 0.5


def test_self_play_is_hard_to_exploit() -> None:
    exploitability = {}
    for name in ("bc", "ppo:self-play"):
        policy = tabulate(registry.resolve(name, GAME), GAME)
        exploitability[name] = Evaluator(GAME, [policy]).evaluate(policy).exploitability
    assert exploitability["ppo:self-play"] < exploitability["bc"] / 3


def test_playing_needs_no_torch() -> None:
    code = (
        "import sys; from shuttle_marl.dynamics import default_game; from shuttle_marl.policy.registry import resolve\n"
        "resolve('ppo', default_game()); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["ppo:gentle", "ppo:", "sac:attacking"])
def test_an_agent_that_is_not_there_is_refused_with_those_that_are(name: str) -> None:
    key = name.partition(":")[0]
    with pytest.raises(PolicyError, match=rf"the trained agents of this game are {key}"):
        registry.resolve(name, GAME)


@pytest.mark.parametrize("damage", ["table", "card", "game", "gone"])
def test_a_damaged_agent_is_refused(damage: str, tmp_path: Path) -> None:
    folder = tmp_path / "agent"
    shutil.copytree(shipped_folder("ppo", model_folder()), folder)
    assert (folder / NETWORK).is_file()
    if damage == "table":
        content = bytearray((folder / TABLE).read_bytes())
        content[-1000] ^= 1
        (folder / TABLE).write_bytes(bytes(content))
    elif damage == "card":
        (folder / CARD).write_text("{")
    elif damage == "game":
        (folder / CARD).write_text(json.dumps({**read_card(folder), "game": "0" * 64}))
    else:
        shutil.rmtree(folder)
    with pytest.raises(PolicyError, match=r"damaged|no trained agent|trained on game"):
        load_agent(folder, GAME)
