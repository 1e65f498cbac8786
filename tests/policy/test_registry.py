"""Policies by name."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.policy import Policy, PolicyError, States, TemperedPolicy, checked_probabilities, tabulate
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import agents, baselines, registry
from shuttle_marl.policy.computed import StoredPolicies
from shuttle_marl.policy.foreign import FunctionPolicy
from shuttle_marl.policy.registry import Family, resolve, resolve_recorded
from tests import golden
from tests.reduced import reduced_game, reduced_model

GAME = reduced_game()
STATES = States(game=GAME, state=np.flatnonzero(GAME.legal_count(np.arange(GAME.n_states)))[::97].astype(np.int32))

MODULE = """
import pathlib

import numpy as np

pathlib.Path("imported").touch()

class Uniform:
    def probabilities(self, states):
        return states.mask / states.mask.sum(axis=1, keepdims=True)

class FirstLegal:
    def __init__(self, game):
        self.n = game.n_strokes

    def probabilities(self, states):
        return np.eye(self.n)[states.mask.argmax(axis=1)]

class Broken:
    def __init__(self):
        raise RuntimeError("no engine")

instance = Uniform()
number = 7

def function(states):
    return Uniform().probabilities(states)

def by_score(states):
    return function(states)

by_score.reads_score = True
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module in the current folder, under a name that no other test has imported."""
    name = f"my_{tmp_path.name.replace('-', '_')}"
    (tmp_path / f"{name}.py").write_text(MODULE, encoding="utf-8")
    (tmp_path / f"{name}_bad.py").write_text("1 / 0\n", encoding="utf-8")
    (tmp_path / f"{name}_needs.py").write_text("import no_such_package\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.path", [p for p in __import__("sys").path if p != str(tmp_path)])
    return name


@pytest.mark.parametrize("name", ["attacking", "defensive", "safe", "random", "random@greedy", "safe@0.3", "attacking@2"])
def test_every_policy_is_a_distribution_over_legal_strokes(name: str) -> None:
    checked_probabilities(resolve(name, GAME), STATES)


def test_what_policies_play_is_what_was_written_down() -> None:
    shares = {}
    for name in ("bc", "safe@0.3", *baselines.STYLES):
        table, strokes = tabulate(resolve(name, GAME), GAME), GAME.base_pair_stroke
        weight = table.block_probabilities(0) * (1 + GAME.base_pair_state % 7)
        shares[name] = [np.bincount(part[strokes], weight) for part in (GAME.catalogue.shot, GAME.catalogue.area)]
    golden.check("policies", shares)


def test_listed_names_can_be_resolved() -> None:
    of_every_model, shipped = registry.names(GAME), registry.names(default_game())
    assert {"attacking", "defensive", "safe", "random", "minimax:robust", "human:0.05"} <= set(of_every_model) < set(shipped)
    for name in of_every_model:
        assert resolve(name, GAME) is not None
    for name in set(shipped) - set(of_every_model):
        assert resolve(name, default_game()) is not None


@pytest.mark.parametrize("attribute", ["instance", "Uniform", "function"])
def test_own_policies_in_the_current_folder(module: str, attribute: str) -> None:
    p = checked_probabilities(resolve(f"{module}:{attribute}", GAME), STATES)
    assert np.array_equal(p, resolve("random", GAME).probabilities(STATES))


def test_a_class_may_take_the_game_and_a_function_may_read_the_score(module: str) -> None:
    p = resolve(f"{module}:FirstLegal", GAME).probabilities(STATES)
    assert np.array_equal(p.argmax(axis=1), STATES.mask.argmax(axis=1))
    with pytest.raises(PolicyError, match="reads the score"):
        tabulate(resolve(f"{module}:by_score", GAME), GAME)
    with pytest.raises(PolicyError, match="reads the score"):
        tabulate(resolve(f"{module}:by_score@0.5", GAME), GAME)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("atacking", "did you mean attacking"),
        ("randm@greedy", "did you mean random"),
        ("bv:viktor-axelsen", "no module 'bv'"),
        ("", "known: .*random"),
        *(
            (f"random@{suffix}", "expected @greedy or a temperature above 0")
            for suffix in ("hot", "inf", "0", "-1", "nan", "1e999", "")
        ),
        ("torch", "expected a file behind the colon, as in torch:mine.safetensors"),
        ("program:", "expected a command behind the colon, as in program:./player"),
        ("agent", "expected the folder of a trained agent behind the colon, as in agent:runs/ppo-0/agent"),
        ("best-response:", "expected the name of a policy behind the colon, as in best-response:bc"),
        ("random:3", "'random' takes nothing behind a colon; write random"),
        ("human:inf", "with a number TAU above 0"),
        ("human:0", "with a number TAU above 0"),
        ("minimax:", "expected minimax or minimax:robust"),
        (":x", "no policy ':x'"),
        ("ppo", "the trained agents of this game are none of that algorithm"),
        ("MODULE:instanc", "did you mean instance"),
        ("MODULE:number", "is a int; expected"),
        ("MODULE:Broken", "making it raised RuntimeError: no engine"),
        ("MODULE_bad:x", "importing its module raised ZeroDivisionError"),
        ("MODULE_needs:x", "needs 'no_such_package'"),
        ("MODULE.inner:x", "no module"),
    ],
)
def test_names_that_lead_nowhere(module: str, name: str, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        resolve(name.replace("MODULE", module), GAME)


@pytest.fixture
def more_families(monkeypatch: pytest.MonkeyPatch) -> None:
    """Families that a test registers are forgotten after it."""
    monkeypatch.setattr(registry, "_FAMILIES", dict(registry._FAMILIES))


def test_a_new_family_is_one_call(more_families: None) -> None:
    asked = []

    def load(argument: str | None, game: Game) -> Policy:
        asked.append(argument)
        return resolve("random", GAME)

    registry.register("mirror", Family(load=load, names=lambda _: ["mirror:left", "mirror:right"]))
    assert set(registry.names(GAME)) >= {"mirror:left", "mirror:right"}
    resolve("mirror:left", GAME)
    resolve("mirror@0.5", GAME)
    assert asked == ["left", None]
    with pytest.raises(PolicyError, match="did you mean mirror:left"):
        resolve("mirorleft", GAME)
    with pytest.raises(PolicyError, match="registered already"):
        registry.register("mirror", Family(load=load))
    for key in ("", "a b", "a:b", "a@b"):
        with pytest.raises(PolicyError, match="expected a word"):
            registry.register(key, Family(load=load))


def test_a_file_may_name_only_families_that_say_so(more_families: None) -> None:
    for key, from_data in (("open", True), ("closed", False)):
        registry.register(key, Family(load=lambda _, game: resolve("safe", game), from_data=from_data))
    assert type(resolve_recorded("open:x", GAME)) is type(resolve("closed:x", GAME))
    for name in ("closed:x", "best-response:closed:x"):
        with pytest.raises(PolicyError, match="not resolved because a file named it"):
            resolve_recorded(name, GAME)


@pytest.mark.parametrize("name", ["safe@0.5", "minimax", "best-response:best-response:safe", "ppo@greedy"])
def test_names_from_a_file_mean_the_same_as_typed_ones(name: str) -> None:
    game = default_game() if name.startswith("ppo") else GAME  # agents play the shipped game alone
    expected = tabulate(resolve(name, game), game)
    assert np.array_equal(tabulate(resolve_recorded(name, game), game).cumulative, expected.cumulative)


@pytest.mark.parametrize(
    "name",
    [
        "MODULE:function@0.5",
        "MODULE.inner:x",
        "best-response:best-response:MODULE:instance",
        "os.path:join",
        "table:mine.safetensors",
        "best-response:agent:../../x@greedy",
    ],
)
def test_a_name_from_a_file_runs_no_code_and_opens_no_file(module: str, name: str) -> None:
    tabulate(resolve("safe", GAME), GAME).save(Path("mine.safetensors"))
    with pytest.raises(PolicyError, match="not resolved because a file named it"):
        resolve_recorded(name.replace("MODULE", module), GAME)
    assert not Path("imported").exists()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("bc:../../evil", "no model of the player"),
        ("ppo:../../evil", "no policy 'ppo:../../evil'"),
        ("ppo:\0", "no policy"),
        ("random@hot", "expected @greedy or a temperature"),
    ],
)
def test_names_from_a_file_that_lead_nowhere(name: str, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        resolve_recorded(name, GAME)


@pytest.mark.parametrize("find", [resolve, resolve_recorded])
def test_names_that_are_too_deep(find: Callable[[str, Game], Policy]) -> None:
    with pytest.raises(PolicyError, match="more than 7 names around a policy"):
        find("best-response:" * 100_000 + "bc", GAME)


SHIPPED = default_game()
EVERY_211TH = States(game=SHIPPED, state=np.flatnonzero(SHIPPED.legal_count(np.arange(SHIPPED.n_states)))[::211].astype(np.int32))


@given(st.floats(0.01, 100))
def test_probabilities_are_powers(temperature: float) -> None:
    base = resolve("attacking", SHIPPED).probabilities(EVERY_211TH)
    p = checked_probabilities(TemperedPolicy(resolve("attacking", SHIPPED), temperature), EVERY_211TH)
    a, b = np.argsort(base, axis=1)[:, -1], np.argsort(base, axis=1)[:, -2]
    rows = np.flatnonzero(base[np.arange(len(base)), b] > 0)
    ratio = np.log(base[rows, a[rows]] / base[rows, b[rows]]) / temperature
    assert np.allclose(p[rows, b[rows]] / p[rows, a[rows]], np.exp(-ratio), rtol=1e-9, atol=1e-300)


def test_temperature_one_changes_nothing_and_zero_takes_the_likeliest() -> None:
    base = resolve("defensive", SHIPPED).probabilities(EVERY_211TH)
    assert np.allclose(resolve("defensive@1", SHIPPED).probabilities(EVERY_211TH), base, atol=1e-15)
    greedy = resolve("defensive@greedy", SHIPPED).probabilities(EVERY_211TH)
    assert np.array_equal(greedy.argmax(axis=1), base.argmax(axis=1))
    assert np.array_equal(greedy.max(axis=1), np.ones(len(EVERY_211TH)))
    cold = resolve("defensive@0.0001", SHIPPED).probabilities(EVERY_211TH)
    assert np.array_equal(cold > 0, np.isclose(base, base.max(axis=1, keepdims=True), rtol=0.05) & (cold > 0))


def test_faults_of_the_base_are_not_hidden() -> None:
    def twice(states: States) -> np.ndarray:
        return 2 * resolve("random", SHIPPED).probabilities(states)

    with pytest.raises(PolicyError, match="no distribution"):
        TemperedPolicy(FunctionPolicy(twice), 0.5).probabilities(EVERY_211TH)


@pytest.mark.parametrize("temperature", [-1.0, float("nan"), float("inf")])
def test_impossible_temperatures(temperature: float) -> None:
    with pytest.raises(PolicyError, match="expected a finite number"):
        TemperedPolicy(resolve("random", SHIPPED), temperature)


def test_a_damaged_agent_is_listed_and_says_so_when_it_is_played(tmp_path: Path) -> None:
    shutil.copytree(reduced_model(), tmp_path / "model")
    card = agents.shipped_folder("ppo", tmp_path / "model") / agents.CARD
    card.parent.mkdir(parents=True)
    card.write_text("{}\n", encoding="utf-8")
    game = load_game(str(tmp_path / "model"))
    assert agents.installed("ppo", game) == ["ppo"]
    with pytest.raises(PolicyError, match="no trained agent"):
        resolve("ppo", game)


def test_pruning_leaves_what_is_retained(tmp_path: Path) -> None:
    for name in ("a.zst", "b.zst", "other.json"):
        (tmp_path / name).touch()
    StoredPolicies(tmp_path, default_game()).prune({"a"})
    assert {path.name for path in tmp_path.iterdir()} == {"a.zst", "other.json"}
