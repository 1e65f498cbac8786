"""Names and models that no policy comes of, without any game that takes time to load."""

import importlib.metadata
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from shuttle_marl.game import shipped
from shuttle_marl.game.policy import GamePolicy, PolicyError, TemperedPolicy
from shuttle_marl.game.tables import Game, GameError
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.policy import agents, baselines, computed, registry
from shuttle_marl.policy.registry import Family, resolve
from shuttle_marl.policy.stored import StoredPolicies, policy_file
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy, with_probabilities

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))


@pytest.mark.parametrize("suffix", ["inf", "0", "-1", "nan", "1e999", "", "cold"])
def test_temperatures_are_finite_numbers_above_0(suffix: str) -> None:
    with pytest.raises(PolicyError, match="expected @greedy or a temperature above 0"):
        resolve(f"random@{suffix}", GAME)


@pytest.mark.parametrize(("suffix", "temperature"), [("greedy", 0.0), ("0.5", 0.5), ("2", 2.0), ("1e-3", 1e-3)])
def test_a_suffix_is_a_temperature(suffix: str, temperature: float) -> None:
    found = resolve(f"safe@{suffix}", GAME)
    assert isinstance(found, GamePolicy)
    assert isinstance(found.policy, TemperedPolicy)
    assert found.policy.temperature == temperature


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("torch", "expected a file behind the colon, as in torch:mine.safetensors"),
        ("sb3:", "expected an archive behind the colon, as in sb3:mine.zip"),
        ("program:", "expected a command behind the colon, as in program:./player"),
        ("agent", "expected the folder of a trained agent behind the colon, as in agent:runs/ppo-0/agent"),
        ("best-response:", "expected the name of a policy behind the colon, as in best-response:bc"),
        ("random:", "'random' takes nothing behind a colon; write random"),
        ("safe:3", "'safe' takes nothing behind a colon; write safe"),
        ("human:inf", "with a number TAU above 0"),
        ("human:0", "with a number TAU above 0"),
        ("human:x", "with a number TAU above 0"),
        ("human:0.05", "belong to a model; this game was not loaded from one"),
        ("minimax:", "expected minimax or minimax:robust"),
        (":x", "no policy ':x'"),
        ("x:", "no policy 'x:'"),
        ("ppo", "the trained agents of this game are none of that algorithm"),
        ("ppo:attacking", "no policy 'ppo:attacking'"),
    ],
)
def test_what_stands_behind_a_colon(name: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped, "_ORIGINS", {})
    with pytest.raises(PolicyError, match=says):
        resolve(name, GAME)


@pytest.mark.parametrize("key", ["", "a b", "a:b", "a@b", ":", "@", " "])
def test_keys_are_words(key: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_FAMILIES", {})
    with pytest.raises(PolicyError, match="expected a word without ':', '@' and spaces"):
        registry.register(key, lambda *_: random_policy(GAME, 0))
    assert not registry._FAMILIES


def test_a_family_is_registered_once_with_what_is_said_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_FAMILIES", {})
    monkeypatch.setattr(registry, "_entry_points", dict)

    def load(argument: str | None, game: Game) -> TabulatedPolicy:
        return random_policy(game, len(argument or ""))

    registry.register("one", load, about="the first")
    registry.register("two", load, lambda _: ["two:a", "two:b"], about=lambda name: f"as {name}", form="two:WHICH")
    with pytest.raises(PolicyError, match="policy key 'one' is registered already"):
        registry.register("one", load)
    assert registry.names(GAME) == ("one", "two:a", "two:b")
    assert registry.described_names(GAME) == {"one": "the first", "two:a": "as two:a", "two:b": "as two:b"}
    assert registry.forms() == {"two:WHICH": "as two:WHICH"}
    assert [resolve(name, GAME).hash for name in ("two:abc", "one")] == [random_policy(GAME, seed).hash for seed in (3, 0)]


def test_names_may_stand_around_a_policy_seven_times() -> None:
    registry._check_depth("best-response:" * 7 + "bc")
    registry._check_depth("table:" * 99)  # names of files, not of policies
    with pytest.raises(PolicyError, match="more than 7 names"):
        registry._check_depth("best-response:" * 8 + "bc")


def test_several_opponents_are_tables_each() -> None:
    policy = random_policy(GAME, 3)
    assert [each.hash for each in registry.tabulated(policy, GAME)] == [policy.hash]
    found = registry.tabulated(["random", policy], GAME)
    assert [each.hash for each in found] == [registry.tabulated("random", GAME)[0].hash, policy.hash]
    assert len(registry.tabulated("random", GAME)) == 1


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (lambda: 3, "entry point plug:in is a int, expected a Family"),
        (lambda: 1 / 0, "entry point plug:in raised ZeroDivisionError"),
    ],
)
def test_packages_whose_entry_points_are_no_families(load: Callable[[], Any], says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """They are named where their policies are resolved, and left out of lists."""
    point: Any = SimpleNamespace(name="plugged", value="plug:in", load=load)
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [point] if group == registry.ENTRY_POINTS else [])
    registry._entry_points.cache_clear()
    registry._plugged_in.cache_clear()
    try:
        with pytest.raises(PolicyError, match=says):
            resolve("plugged", GAME)
        assert "random" in registry.names(GAME)
    finally:
        registry._entry_points.cache_clear()
        registry._plugged_in.cache_clear()


def test_packages_add_families(monkeypatch: pytest.MonkeyPatch) -> None:
    family = Family(load=lambda *_: random_policy(GAME, 5), names=lambda _: ["plugged", "plugged:x"], about=str.upper)
    points: Any = [SimpleNamespace(name=name, value="plug:in", load=lambda: family) for name in ("plugged", "random")]
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: points)
    registry._entry_points.cache_clear()
    registry._plugged_in.cache_clear()
    try:
        assert registry.names(GAME)[-2:] == ("plugged", "plugged:x")
        assert registry.names(GAME).count("plugged") == 1, "the name of the other one is taken"
        assert registry.described_names(GAME)["plugged:x"] == "PLUGGED:X"
        assert resolve("plugged:x", GAME).hash == random_policy(GAME, 5).hash
    finally:
        registry._entry_points.cache_clear()
        registry._plugged_in.cache_clear()


@pytest.mark.parametrize("players", [3, "abc", ["a", 3], {"a": 1}, None])
def test_players_of_a_model_are_a_list_of_names(players: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(baselines, "read_model", lambda *_: ({"players": json.dumps(players)}, {}))
    with pytest.raises(PolicyError, match="the players are not a list of names"):
        baselines.clones(tmp_path)


def test_models_whose_card_is_damaged_have_no_players(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(*_: Any) -> Any:
        raise GameError("no card")

    monkeypatch.setattr(baselines, "read_model", read)
    with pytest.raises(PolicyError, match=r"^no card$"):
        baselines.clones(tmp_path)


def test_players_are_those_of_the_game_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    ask = Mock(return_value="shares")
    known = SimpleNamespace(players=("ann", "bob"), log_choice=np.zeros(GAME.n_base_pairs), opposite=None, pair_probabilities=ask)
    origin = SimpleNamespace(folder=Path("model"), variant=None)
    monkeypatch.setattr(baselines, "clones", lambda _: known)
    monkeypatch.setattr(baselines, "origin_of", lambda _: origin)
    monkeypatch.setattr(baselines, "folder_of", lambda _: origin.folder)
    assert [baselines.probabilities(player, GAME) for player in ("bob", None)] == ["shares", "shares"]
    assert [each.args for each in ask.call_args_list] == [(GAME, "bob", None), (GAME, None, None)]
    with pytest.raises(PolicyError, match="no model of the player 'eve'; there are: ann, bob"):
        baselines.probabilities("eve", GAME)
    assert [baselines.imitation(player, GAME) for player in ("ann", "eve")] == ["bc:ann", "bc"]
    known.log_choice = np.zeros(GAME.n_base_pairs + 1)
    with pytest.raises(PolicyError, match="its players are not of the game beside it"):
        baselines.probabilities(None, GAME)


def test_stored_policies_are_read_by_their_hash(tmp_path: Path) -> None:
    stored, policy, other = StoredPolicies(tmp_path, GAME), random_policy(GAME, 0), random_policy(GAME, 1)
    assert stored.save(policy) == policy.hash
    assert stored.read(policy.hash).hash == policy.hash
    policy_file(tmp_path, policy.hash).write_bytes(other.packed())
    with pytest.raises(PolicyError, match=f"the table was changed: its hash is {other.hash[:12]}"):
        stored.read(policy.hash)
    assert stored.save(policy) == policy.hash, "what is there is not written again"
    with pytest.raises(PolicyError, match="the table was changed"):
        stored.read(policy.hash)
    with pytest.raises(PolicyError, match=r"the policy cannot be read \(No such file"):
        stored.read(other.hash)
    policy_file(tmp_path, other.hash).write_bytes(b"no table")
    with pytest.raises(PolicyError, match=f"{other.hash}.zst: the policy cannot be read"):
        stored.read(other.hash)


def test_tables_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[str, bytes] = {}
    computations: list[int] = []

    def compute() -> TabulatedPolicy:
        computations.append(1)
        return random_policy(GAME, 4)

    cache = SimpleNamespace(read=lambda names: {name: kept[name] for name in names if name in kept}, store=kept.update)
    monkeypatch.setattr(computed, "_CACHE", cache)
    found = [computed.cached_table(GAME, key, compute).hash for key in ("a", "a", "b")]
    assert found == [random_policy(GAME, 4).hash] * 3
    assert (len(computations), len(kept)) == (2, 2)
    kept.update(dict.fromkeys(kept, b"written by another version"))
    assert computed.cached_table(GAME, "a", compute).hash == found[0]
    assert len(computations) == 3
    assert computed.cached_table(GAME, "a", compute).hash == found[0]
    assert len(computations) == 3


def test_agents_are_described_and_found_by_their_names(tmp_path: Path) -> None:
    assert agents.about("ppo") == "agent trained with PPO"
    assert agents.about("sac:self-play") == "agent trained with SAC, self play"
    assert agents.shipped_folder("ppo:attacking", tmp_path) == tmp_path / "agents" / "ppo-attacking"
    with pytest.raises(PolicyError, match="no trained agent"):
        agents.load_agent(tmp_path, GAME)
    agents.save_agent(tmp_path, GAME, b"no network", {"steps": 3})
    card = agents.read_card(tmp_path)
    assert (card["game"], card["catalogue"], card["steps"]) == (GAME.hash, GAME.catalogue.version, 3)
    with pytest.raises(PolicyError, match=r"network\.safetensors: cannot be used"):
        agents.load_agent(tmp_path, GAME)
    other = with_probabilities(GAME, 1)
    with pytest.raises(PolicyError, match=f"trained on game {GAME.hash[:12]}; this is {other.hash[:12]}"):
        agents.load_agent(tmp_path, other)
    with pytest.raises(PolicyError, match=f"trained on game {GAME.hash[:12]}, whose strokes are not these; this is"):
        agents.load_agent(tmp_path, hand_made())
