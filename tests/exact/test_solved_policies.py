"""Solved policies by name, tables in files, and families of installed packages."""

import importlib.metadata
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save_file

from shuttle_marl.exact import PairPolicy, best_response, evaluate, solve, solve_robust, solve_soft
from shuttle_marl.game.policy import PolicyError
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.policy import baselines, computed, registry
from shuttle_marl.policy.registry import Family, resolve
from tests.exact.exact_games import hand_made, random_policy, with_probabilities
from tests.reduced import reduced_game

GAME = reduced_game()


def cumulative(name: str) -> np.ndarray:
    return tabulate(resolve(name, GAME), GAME).cumulative


def test_minimax_and_best_responses_have_names() -> None:
    assert {"minimax", "best-response:bc"} <= set(registry.names(GAME))
    assert np.array_equal(cumulative("minimax"), solve(GAME).policy[0].cumulative)
    average = tabulate(resolve("bc", GAME), GAME)
    assert np.array_equal(cumulative("best-response:bc"), best_response(average).policy.cumulative)


def test_human_play_has_names() -> None:
    assert "human:0.05" in registry.names(GAME)
    prior = PairPolicy(game=GAME, probability=baselines.probabilities(None, GAME))
    expected = from_pair_probabilities(GAME, solve_soft(prior, tau=0.1).policy[0].probability)
    assert np.array_equal(cumulative("human:0.1"), expected.cumulative)
    player = baselines.players(GAME)[0]
    own = PairPolicy(game=GAME, probability=baselines.probabilities(player, GAME))
    expected = from_pair_probabilities(GAME, solve_soft(own, prior, tau=0.1).policy[0].probability)
    assert np.array_equal(cumulative(f"human:0.1:{player}"), expected.cumulative)
    assert np.array_equal(cumulative("human:1e9"), cumulative("bc"))


def test_robust_play_needs_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    refits = [with_probabilities(GAME, seed) for seed in (1, 2)]
    computed.robust_policy.cache_clear()
    monkeypatch.setattr(computed, "refits_of", lambda game: ())
    with pytest.raises(PolicyError, match="needs refits of the game on resampled matches"):
        resolve("minimax:robust", GAME)
    monkeypatch.setattr(computed, "refits_of", lambda game: tuple(refits))
    assert np.array_equal(cumulative("minimax:robust"), solve_robust([GAME, *refits]).policy.cumulative)
    computed.robust_policy.cache_clear()


def test_robust_play_is_listed_where_there_are_refits(monkeypatch: pytest.MonkeyPatch) -> None:
    for variants, listed in (([], False), (["men", "women"], False), (["men", "women", "1", "2"], True)):
        monkeypatch.setattr(computed, "variants", lambda _, variants=variants: variants)
        assert ("minimax:robust" in registry.names(GAME)) == listed


def test_the_name_within_a_best_response_is_a_whole_name() -> None:
    sharp = tabulate(resolve("bc@0.5", GAME), GAME)
    assert np.array_equal(cumulative("best-response:bc@0.5"), best_response(sharp).policy.cumulative)
    assert not np.array_equal(cumulative("best-response:bc@0.5"), cumulative("best-response:bc"))
    twice = tabulate(resolve("best-response:best-response:random", GAME), GAME)
    once = tabulate(resolve("best-response:random", GAME), GAME)
    assert evaluate(twice, once).odds().rally > 0.5


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("minimax:3", "expected minimax or minimax:robust"),
        ("human", "expected human:TAU or human:TAU:PLAYER"),
        ("human:-1", "with a number TAU above 0"),
        ("human:nan", "with a number TAU above 0"),
        ("human:0.05:no-one", "no model of the player 'no-one'"),
        ("best-response", "expected the name of a policy behind the colon"),
        ("best-response:rndom", "did you mean random"),
        ("table", "expected a file behind the colon"),
        ("table:nowhere.safetensors", "no readable table"),
    ],
)
def test_names_that_lead_nowhere(name: str, says: str) -> None:
    with pytest.raises(PolicyError, match=says):
        resolve(name, GAME)


def test_a_policy_that_reads_the_score_has_no_best_response(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_moody.py").write_text("def player(states):\n    return states.mask\nplayer.reads_score = True\n")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError, match="reads the score, so it has no table over states; evaluate it by sampling"):
        resolve("best-response:my_moody:player", GAME)


def test_a_saved_table_can_be_played(tmp_path: Path) -> None:
    path = tmp_path / "mine.safetensors"
    table = tabulate(resolve("safe", GAME), GAME)
    table.save(path)
    assert np.array_equal(cumulative(f"table:{path}"), table.cumulative)
    with pytest.raises(PolicyError, match=r"tabulated for game \w{12}, this is"):
        TabulatedPolicy.load(path, hand_made())


def test_damaged_tables_are_refused(tmp_path: Path) -> None:
    game = hand_made()
    path = tmp_path / "mine.safetensors"
    good = random_policy(hand_made((*game.catalogue.names, "clear:back-centre:above:forehand")), 0)
    for wrong, says in (
        (good.cumulative[:-1], "not a table over the"),
        (good.cumulative.astype(np.int32), "not a table over the"),
        (good.cumulative // 2, "not a table over the"),
    ):
        save_file({"cumulative": wrong}, path, metadata={"game": good.game.hash})
        with pytest.raises(PolicyError, match=says):
            TabulatedPolicy.load(path, good.game)
    wide = random_policy(GAME, 0)
    falls = wide.cumulative.copy()
    state = int(np.flatnonzero(GAME.legal_count(np.arange(GAME.n_states)) >= 3)[0])
    falls[GAME.pair_start[state] : GAME.pair_start[state] + 2] = (9, 7)
    save_file({"cumulative": falls}, path, metadata={"game": GAME.hash})
    with pytest.raises(PolicyError, match="a cumulative probability falls"):
        TabulatedPolicy.load(path, GAME)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(PolicyError, match="no readable table"):
        TabulatedPolicy.load(path, GAME)


@pytest.fixture
def entry_points(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Entry points of packages that could be installed, by key; instead of those that are."""
    points: dict[str, str] = {}

    def found() -> dict[str, importlib.metadata.EntryPoint]:
        return {key: importlib.metadata.EntryPoint(key, value, registry.ENTRY_POINTS) for key, value in points.items()}

    monkeypatch.setattr(registry, "_entry_points", found)
    registry._plugged_in.cache_clear()
    yield points
    registry._plugged_in.cache_clear()


MIRROR = Family(
    load=lambda argument, game: resolve(argument or "random", game), names=lambda _: ("mirror:safe",), of_policies=True
)
MIRROR_OF_BC = Family(load=lambda argument, game: resolve("safe", game), names=lambda _: ("bc",))


def test_an_installed_package_can_add_policies(entry_points: dict[str, str]) -> None:
    entry_points["mirror"] = f"{__name__}:MIRROR"
    assert "mirror:safe" in registry.names(GAME)
    assert np.array_equal(cumulative("mirror:safe@0.5"), cumulative("safe@0.5"))


def test_an_entry_point_hides_nothing_that_is_registered(entry_points: dict[str, str]) -> None:
    entry_points["random"] = f"{__name__}:MIRROR_OF_BC"
    assert registry.names(GAME).count("random") == 1
    assert not np.array_equal(cumulative("random"), cumulative("safe"))


@pytest.mark.parametrize(
    ("value", "says"),
    [("no_such_module:X", "raised ModuleNotFoundError"), (f"{__name__}:GAME", "is a Game, expected a Family")],
)
def test_a_broken_package_hides_no_other(entry_points: dict[str, str], value: str, says: str) -> None:
    entry_points["broken"] = value
    assert "random" in registry.names(GAME)
    with pytest.raises(PolicyError, match=f"policies 'broken': entry point .* {says}"):
        resolve("broken", GAME)
