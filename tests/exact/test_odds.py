"""Odds in the cache: the same as solved ones, and a damaged or unwritable cache changes nothing."""

import importlib.util
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from shuttle_marl import exact
from shuttle_marl.base import cache
from shuttle_marl.exact import odds
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.policy.computed import best_response_policy
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "shuttle_marl" / cache.NAME


@pytest.fixture(scope="module")
def policies() -> list[TabulatedPolicy]:
    game = random_game(seed=3)
    return [random_policy(game, seed) for seed in range(3)]


def test_known_odds_are_the_solved_ones(stored: Path, policies: list[TabulatedPolicy]) -> None:
    with cache.forgotten():
        solved = exact.crossplay(policies)
    for _ in range(2):
        found = exact.crossplay(policies)
        np.testing.assert_allclose(found.serving, solved.serving, atol=1e-12)
        assert found.error_bound <= 1e-9
        assert [each.value for each in odds.best_odds(policies)] == pytest.approx(
            [exact.nash_conv(policy).exploitability for policy in policies], abs=1e-12
        )
    with sqlite3.connect(stored) as database:
        assert database.execute("SELECT count(*) FROM odds").fetchone() == (9,)
    pairs = [(policies[1], policies[0]), (policies[0], policies[1])]
    ahead, behind = odds.pair_odds(pairs)
    assert ahead.serving == pytest.approx(1 - behind.receiving)


def test_damage_is_noticed(stored: Path, policies: list[TabulatedPolicy]) -> None:
    right = exact.crossplay(policies).serving
    with sqlite3.connect(stored) as database:
        for key, numbers in database.execute("SELECT key, content FROM odds").fetchall():
            flipped = bytes([numbers[0], *numbers[1:-1], numbers[-1] ^ 1])
            database.execute("UPDATE odds SET content = ? WHERE key = ?", (flipped, key))
    np.testing.assert_array_equal(exact.crossplay(policies).serving, right)
    rng = np.random.default_rng(0)
    content = stored.read_bytes()
    for position in rng.integers(0, 8 * len(content), 40):
        damaged = bytearray(content)
        damaged[position // 8] ^= 1 << position % 8
        stored.write_bytes(damaged)
        np.testing.assert_array_equal(exact.crossplay(policies).serving, right)
    stored.write_bytes(b"not a database")
    np.testing.assert_array_equal(exact.crossplay(policies).serving, right)
    assert odds.pair_odds([]) == []


def test_a_cache_that_cannot_be_used_only_costs_time(
    tmp_path: Path, policies: list[TabulatedPolicy], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    unwritable = exact.crossplay(policies).serving
    with cache.forgotten():
        np.testing.assert_allclose(unwritable, exact.crossplay(policies).serving, atol=1e-12)


def test_results_of_the_package_are_the_computed_ones(stored: Path) -> None:
    game = default_game()

    def results() -> tuple[npt.NDArray[Any], list[float], str]:
        tables = {name: tabulate(resolve(name, game), game) for name in ("bc", "random", "safe")}
        gains = [each.value for each in odds.best_odds([tables["safe"]])]
        best = best_response_policy(tables["bc"]).hash
        return exact.crossplay([*tables.values()]).serving, gains, best

    shipped = results()
    assert not stored.exists(), "nothing was computed"
    with cache.forgotten():
        computed = results()
    np.testing.assert_allclose(shipped[0], computed[0], atol=1e-9)
    assert shipped[1] == pytest.approx(computed[1], abs=1e-9)
    assert shipped[2:] == computed[2:]


@pytest.mark.parametrize("file", ["exact/sweeps.py", "game/rally.py", "kernel/core.py", "policy/network.py"])
def test_results_of_other_source_code_are_not_used(file: str, tmp_path: Path) -> None:
    def key() -> bytes:
        spec = importlib.util.spec_from_file_location("copy_of_cache", tmp_path / "base" / "cache.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.key_of("result")

    for name in ("base/cache.py", file):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((Path(cache.__file__).parents[1] / name).read_bytes())
    before = key()
    assert key() == before
    (tmp_path / file).write_text("changed = True\n")
    assert key() != before
