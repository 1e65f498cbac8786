"""Odds in the cache: the same as solved ones, and a damaged or unwritable cache changes nothing."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl import exact
from shuttle_marl.exact import known
from shuttle_marl.game.tabulated import TabulatedPolicy
from tests.exact.exact_games import random_game, random_policy


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "odds.sqlite"
    monkeypatch.setattr(known, "_path", lambda: path)
    known._warn_once.cache_clear()
    return path


@pytest.fixture(scope="module")
def policies() -> list[TabulatedPolicy]:
    game = random_game(seed=3)
    return [random_policy(game, seed) for seed in range(3)]


def no_solver(*_: object, **__: object) -> None:
    raise AssertionError("solved again")


def test_known_odds_are_the_solved_ones(cache: Path, policies: list[TabulatedPolicy], monkeypatch: pytest.MonkeyPatch) -> None:
    solved = exact.crossplay(policies)
    for _ in range(2):
        found = known.crossplay(policies)
        np.testing.assert_allclose(found.serving, solved.serving, atol=1e-12)
        assert found.error_bound <= 1e-9
        assert [odds.value for odds in known.best_odds(policies)] == pytest.approx(
            [exact.nash_conv(policy).exploitability for policy in policies], abs=1e-12
        )
        monkeypatch.setattr(known, "odds_of_pairs", no_solver)
        monkeypatch.setattr(known, "best_response", no_solver)
    pairs = [(policies[1], policies[0]), (policies[0], policies[1])]
    ahead, behind = known.pair_odds(pairs)
    assert ahead.serving == pytest.approx(1 - behind.receiving)
    other = random_policy(policies[0].game, 9)
    with pytest.raises(AssertionError, match="solved again"):
        known.pair_odds([(policies[0], other)])


def test_damage_is_noticed(cache: Path, policies: list[TabulatedPolicy]) -> None:
    right = known.crossplay(policies).serving
    with sqlite3.connect(cache) as database:
        for key, numbers in database.execute("SELECT key, numbers FROM result").fetchall():
            flipped = bytes([numbers[0], *numbers[1:-1], numbers[-1] ^ 1])
            database.execute("UPDATE result SET numbers = ? WHERE key = ?", (flipped, key))
    np.testing.assert_array_equal(known.crossplay(policies).serving, right)
    rng = np.random.default_rng(0)
    content = cache.read_bytes()
    for position in rng.integers(0, 8 * len(content), 40):
        damaged = bytearray(content)
        damaged[position // 8] ^= 1 << position % 8
        cache.write_bytes(damaged)
        np.testing.assert_array_equal(known.crossplay(policies).serving, right)
    cache.write_bytes(b"not a database")
    np.testing.assert_array_equal(known.crossplay(policies).serving, right)
    assert known.pair_odds([]) == []


def test_a_cache_that_cannot_be_used_only_costs_time_and_is_said_once(
    tmp_path: Path, policies: list[TabulatedPolicy], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    right = exact.crossplay(policies).serving

    def locked(_: Path) -> bool:
        raise PermissionError(13, "Permission denied")

    for path, patch in (
        (tmp_path / "odds.sqlite", locked),
        (None, Path.is_file),
        (tmp_path / "file" / "odds.sqlite", Path.is_file),
    ):
        (tmp_path / "file").write_text("no folder")
        monkeypatch.setattr(known, "_path", lambda path=path: path)
        monkeypatch.setattr(Path, "is_file", patch)
        known._warn_once.cache_clear()
        for _ in range(2):
            np.testing.assert_allclose(known.crossplay(policies).serving, right, atol=1e-12)
        assert caplog.text.count("recomputed") == 1
        caplog.clear()
