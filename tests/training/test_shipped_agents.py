"""The trained agents that come with the package: played from tables made of their networks, as good as their cards say."""

import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save

from shuttle_marl.base import cache as base_cache
from shuttle_marl.base.files import seal
from shuttle_marl.game import default_game, model_folder
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.policy import PolicyError, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.league import default_pool
from shuttle_marl.policy import registry
from shuttle_marl.policy.agents import CARD, NETWORK, load_agent, read_card, save_agent, shipped_folder
from shuttle_marl.policy.network import PolicyNetwork, limits
from shuttle_marl.training import Evaluator
from shuttle_marl.training.networks import logit_network, make_actor, weights_of
from tests.exact.exact_games import random_game, tiring_game

GAME, TIRING = default_game(), tiring_game()
SHIPPED = ("a2c", "ppo", "ppo:attacking", "ppo:cautious", "ppo:defensive", "ppo:self-play", "sac")


def test_all_are_listed_and_the_main_ones_play_in_the_default_league() -> None:
    assert set(SHIPPED) <= set(registry.names(GAME))
    assert {"a2c", "ppo", "sac", "ppo:self-play"} <= set(default_pool(GAME))


def test_figures_of_the_cards_are_true() -> None:
    bc = tabulate(registry.resolve("bc", GAME), GAME)
    evaluator = Evaluator(GAME, [bc])
    exploitability = {"bc": evaluator.evaluate(bc).exploitability}
    for name in SHIPPED:
        found = evaluator.evaluate(tabulate(registry.resolve(name, GAME), GAME))
        for figure, value in read_card(shipped_folder(name, model_folder()))["evaluation"].items():
            assert getattr(found, figure) == pytest.approx(value, abs=1e-4), name
        assert found.rally_win > 0.5
        exploitability[name] = found.exploitability
    assert exploitability["ppo:self-play"] < exploitability["bc"] / 3


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that does not exist yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "shuttle_marl" / base_cache.NAME


@pytest.mark.parametrize("hidden", [0, 1, 3])
@pytest.mark.parametrize("game", [random_game(5, 8), tiring_game()], ids=["random", "tiring"])
def test_the_table_is_the_network_of_torch(game: Game, hidden: int) -> None:
    torch.manual_seed(0)
    actor = make_actor(game, width=24, hidden=hidden)
    module = logit_network(actor)
    with torch.no_grad():
        for weights in module.parameters():
            weights.normal_(std=0.4)  # those of duels and efforts too
    table = PolicyNetwork.of_tensors(weights_of(actor), game).table(game)
    states = np.flatnonzero(game.playable)
    with torch.no_grad():
        logits = module(torch.from_numpy(game.observation(states))).double()
    p = torch.softmax(logits.masked_fill(~torch.from_numpy(game.mask(states)), -torch.inf), -1).numpy()
    row, pairs = game.pairs(states)
    strokes = game.pair_stroke[pairs]
    assert np.abs(np.cumsum(p, axis=1)[row, strokes] * 65535 - table.cumulative[pairs]).max() < 1.01
    efforts = table.cumulative.reshape(game.n_blocks, -1)
    assert (efforts != efforts[0]).any()


def test_logits_may_be_as_large_as_float32_allows() -> None:
    game, largest = tiring_game(), float(np.finfo(np.float32).max)
    n, levels = game.n_strokes, game.levels
    sizes = {"own": n + 1, "incoming": n + 1, "contact": 2, "duel": LONGEST_DUEL + 1, "effort": levels, "opponent_effort": levels}
    zeros = {name: np.zeros((size, 1)) for name, size in (sizes | {"hurried": 2, "position": 2}).items()}
    for bias, fits in ((largest, True), (np.nextafter(largest, np.inf), False)):
        policy = PolicyNetwork(**zeros, layers=((np.zeros((n, 1)), np.full(n, bias)),))
        with nullcontext() if fits else pytest.raises(PolicyError, match="the network gives no finite numbers in state"):
            found, uniform = policy.table(game), tabulate(registry.resolve("random", game), game)
            assert np.abs(found.cumulative.astype(int) - uniform.cumulative).max() <= 1


def test_the_table_does_not_depend_on_the_order_of_sums() -> None:
    """The same network with the numbers of its layers in another order: sums of float64 would differ in their last bits."""
    game, rng = tiring_game(), np.random.default_rng(0)
    torch.manual_seed(1)
    tensors = weights_of(make_actor(game, width=64, hidden=1))
    order = rng.permutation(64)
    other = {name: array[..., order] if array.shape[-1] == 64 else array for name, array in tensors.items()}

    # Biases of a hidden layer belong to its rows, which stay where they are.
    other["0.layers.1.bias"] = tensors["0.layers.1.bias"]
    other["0.layers.1.weight"], other["1.weight"] = tensors["0.layers.1.weight"][:, order], tensors["1.weight"]
    one, two = (PolicyNetwork.of_tensors(found, game).table(game) for found in (tensors, other))
    assert one.hash == two.hash


def test_limits_are_those_of_a_softmax() -> None:
    rng = np.random.default_rng(0)
    logits = rng.normal(size=(2000, 31)) * np.geomspace(1e-12, 1e38, 2000)[:, None]
    found = np.empty((2000, 31), np.uint16)
    limits(logits, np.arange(len(found)) * found.shape[1], found.ravel())
    total = np.cumsum(np.exp((logits - logits.max(axis=1, keepdims=True)).astype(np.longdouble)), axis=1)
    expected = total / total[:, -1:] * 65535
    assert np.abs(found - expected).max() <= 0.5 + 1e-9
    assert (found[:, -1] == 65535).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.pop("0.duel.weight"),
        lambda t: t.update({"0.effort.weight": t["0.effort.weight"][:-1]}),
        lambda t: t.update({"1.weight": t["1.weight"].astype(np.float64)}),
        lambda t: t["0.own.weight"].__setitem__((0, 0), np.nan),
        lambda t: t.update({"2.weight": t["1.bias"]}),
        lambda t: [t.update({name: np.full_like(t[name], 1e38)}) for name in tuple(t)] * 9,
    ],
)
def test_weights_that_are_no_network_of_the_game_are_refused(tmp_path: Path, cache: Path, change) -> None:
    game = tiring_game()
    tensors = weights_of(make_actor(game, width=8, hidden=9))
    change(tensors)
    save_agent(tmp_path / "agent", game, save(tensors), {})
    with pytest.raises(PolicyError, match=r"no network of a policy for this game|no finite numbers"):
        load_agent(tmp_path / "agent", game)
    assert not cache.exists()


def tables(cache: Path) -> list[bytes]:
    with sqlite3.connect(cache) as database:
        return [content for [content] in database.execute("SELECT content FROM tables")]


def small_agent(folder: Path) -> Path:
    save_agent(folder, TIRING, save(weights_of(make_actor(TIRING, width=8, hidden=1))), {})
    return folder


def test_a_table_is_made_again_where_it_is_damaged(cache: Path, tmp_path: Path) -> None:
    folder = small_agent(tmp_path / "one")
    first = load_agent(folder, TIRING)
    [whole] = tables(cache)
    for damaged in (whole, whole[:-1], whole[:-3] + bytes([whole[-3] ^ 1]) + whole[-2:], b""):
        with sqlite3.connect(cache) as database:
            database.execute("UPDATE tables SET content = ?", (damaged,))
        assert load_agent(folder, TIRING).hash == first.hash
        assert tables(cache) == [whole]
    load_agent(small_agent(tmp_path / "other"), TIRING)
    assert len(tables(cache)) == 2


def test_agents_play_without_a_cache(cache: Path, tmp_path: Path) -> None:
    agent = small_agent(tmp_path / "agent")
    before = load_agent(agent, TIRING).hash
    cache.unlink()
    cache.mkdir()
    assert load_agent(agent, TIRING).hash == before


def test_playing_needs_no_torch() -> None:
    code = (
        "import sys; from shuttle_marl.game import default_game; from shuttle_marl.policy.registry import resolve\n"
        "resolve('ppo', default_game()); assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_agent_that_is_not_there_is_refused_with_those_that_are() -> None:
    with pytest.raises(PolicyError, match="the trained agents of this game are ppo"):
        registry.resolve("ppo:gentle", GAME)


DAMAGE: dict[str, Callable[[Path], object]] = {
    "nested": lambda f: (f / CARD).write_text("[" * 200_000),
    "list": lambda f: (f / CARD).write_text("[]"),
    "changed card": lambda f: (f / CARD).write_text((f / CARD).read_text().replace('"strokes": ', '"strokes": 1')),
    "network": lambda f: (f / NETWORK).write_bytes((f / NETWORK).read_bytes()[:-1]),
    "game": lambda f: (f / CARD).write_bytes(seal({**read_card(f), "game": "0" * 64})),
    "gone": shutil.rmtree,
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_agent_is_refused(damage: str, tmp_path: Path) -> None:
    folder = tmp_path / "agent"
    shutil.copytree(shipped_folder("ppo", model_folder()), folder)
    DAMAGE[damage](folder)
    with pytest.raises(PolicyError, match=r"damaged|no trained agent|trained on game"):
        load_agent(folder, GAME)


def test_a_card_names_no_file(tmp_path: Path, cache: Path) -> None:
    """Files that it names beside the network would have other hashes."""
    folder = tmp_path / "agent"
    shutil.copytree(shipped_folder("ppo", model_folder()), folder)
    card = read_card(folder)
    secret = tmp_path / "secret"
    secret.write_bytes(b"")
    (folder / CARD).write_bytes(seal({**card, "sha256": {**card["sha256"], "../secret": "0" * 64, str(secret): "0" * 64}}))
    load_agent(folder, GAME)
    wrong: tuple[Any, ...] = ([], "x", None, {NETWORK: 1})
    for hashes in wrong:
        (folder / CARD).write_bytes(seal({**card, "sha256": hashes}))
        with pytest.raises(PolicyError, match="does not hold the hash"):
            load_agent(folder, GAME)
