"""The trained agents that come with the package: played from tables, as good as their cards say."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from shuttle_marl.files import seal
from shuttle_marl.game import default_game, model_folder
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.table import tabulate
from shuttle_marl.league import default_pool
from shuttle_marl.policy import agents, registry
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
        "import sys; from shuttle_marl.game import default_game; from shuttle_marl.policy.registry import resolve\n"
        "resolve('ppo', default_game()); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["ppo:gentle", "ppo:", "sac:attacking"])
def test_an_agent_that_is_not_there_is_refused_with_those_that_are(name: str) -> None:
    key = name.partition(":")[0]
    with pytest.raises(PolicyError, match=rf"the trained agents of this game are {key}"):
        registry.resolve(name, GAME)


@pytest.mark.parametrize("damage", ["table", "card", "nested", "list", "changed card", "game", "network", "gone"])
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
    elif damage == "nested":
        (folder / CARD).write_text("[" * 200_000)
    elif damage == "list":
        (folder / CARD).write_text("[]")
    elif damage == "changed card":
        (folder / CARD).write_text((folder / CARD).read_text().replace('"strokes": 4', '"strokes": 5'))
    elif damage == "network":
        (folder / NETWORK).write_bytes((folder / NETWORK).read_bytes()[:-1])
    elif damage == "game":
        (folder / CARD).write_bytes(seal({**read_card(folder), "game": "0" * 64}))
    else:
        shutil.rmtree(folder)
    with pytest.raises(PolicyError, match=r"damaged|no trained agent|trained on game"):
        load_agent(folder, GAME)


def test_a_card_names_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A card from someone else opens nothing outside its folder."""
    folder = tmp_path / "agent"
    shutil.copytree(shipped_folder("ppo", model_folder()), folder)
    card = read_card(folder)
    secret = tmp_path / "secret"
    secret.write_bytes(b"")
    (folder / CARD).write_bytes(seal({**card, "sha256": {**card["sha256"], "../secret": "0" * 64, str(secret): "0" * 64}}))
    opened = []
    open_file = agents.open_file
    monkeypatch.setattr(agents, "open_file", lambda path: opened.append(path) or open_file(path))
    load_agent(folder, GAME)
    assert {path.parent for path in opened} == {folder}
    for hashes in ([], "x", None, {TABLE: 1}):
        (folder / CARD).write_bytes(seal({**card, "sha256": hashes}))
        with pytest.raises(PolicyError, match="does not fit its hash"):
            load_agent(folder, GAME)
