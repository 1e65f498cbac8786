"""What methods may read: ranks apart, and programs that get episodes only."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import shuttle_marl
from shuttle_marl.base.runs import CONFIG
from shuttle_marl.exact import evaluate
from shuttle_marl.game.shipped import resolve_game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.policy.stored import StoredPolicies
from shuttle_marl.suite import store
from shuttle_marl.suite.board import boards
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import TASKS, arena_of
from tests.reduced import reduced_model
from tests.suite import small
from tests.suite.small import summary, verified

METHODS = (Path(__file__).parent / "isolated_methods.py").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder of a stranger, with methods and a card that says they read samples."""
    (tmp_path / "strange.py").write_text(METHODS)
    (tmp_path / "card.json").write_text('{"access": "samples"}')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PACKAGE", str(Path(shuttle_marl.__file__).parent))


def run(task: str, method: str, **options: Any) -> Path:
    return small.run(task, method, Path("run"), **options)


def named(setting: Any) -> str:
    return "minimax"


def named_response(setting: Any) -> str:
    return f"best-response:{setting.opponent}"


class Solver:
    """Solves the shipped game, and values the policies of a log in it."""

    def estimate(self, log: Any, policies: Any) -> list[float]:
        game = resolve_game(reduced_model())
        bc = tabulate(resolve("bc", game), game)
        return [evaluate(TabulatedPolicy(game=game, cumulative=each.cumulative), bc).odds().rally for each in policies]


@pytest.mark.parametrize(
    ("task", "method", "access"),
    [("exploit-v0", "named", "tables"), ("exploit-v0", "named_response", "tables"), ("evaluate-v0", "Solver", "tables")],
)
def test_what_was_not_isolated_is_not_ranked_among_samples(task: str, method: str, access: str) -> None:
    folder = run(task, f"{__name__}:{method}")
    row = summary(folder)
    assert (row["access"], row["isolated"]) == (access, False)
    config = json.loads((folder / CONFIG).read_text())
    del config["isolated"]
    (folder / CONFIG).write_text(json.dumps(config))
    assert summary(folder)["access"] == access, "who says nothing was not isolated"
    (board,) = boards([row])
    assert [(each["access"], each["rank"]) for each in board["rows"]] == [(access, 1)]
    Path("card.json").unlink()
    assert summary(run(task, f"{__name__}:{method}", overwrite=True))["access"] == TASKS[task].offers


@pytest.mark.parametrize(
    ("task", "method"),
    [
        ("exploit-v0", "learner"),
        ("equilibrium-v0", "learner"),
        ("offline-v0", "Offline"),
        ("evaluate-v0", "Estimator"),
        ("text-v0", "Text"),
        ("adapt-v0", "Adapter"),
    ],
)
def test_isolated_methods_get_episodes(task: str, method: str) -> None:
    folder = run(task, f"strange:{method}", isolated=True)
    assert verified(folder).refused == []
    row = summary(folder)
    assert (row["access"], row["isolated"]) == ("samples", True)
    if method == "learner":
        assert row["strokes"] == 64 * (20_000 // 64)


@pytest.mark.parametrize(
    ("method", "reason"),
    [
        ("named", "returns an object with act"),
        ("imports", "cannot import shuttle_marl"),
        ("opens", "cannot open"),
        ("through_a_folder", "cannot open"),
        ("renames", "cannot open"),
        ("reads_the_memory", "cannot open /proc"),
        ("starts", "cannot start programs"),
        ("spawns", "cannot start programs"),
        ("interprets", "InterpreterError|RuntimeError|cannot start"),
        ("prints", "SystemExit: 3"),
        ("missing", "AttributeError"),
    ],
)
def test_isolated_methods_read_no_tables(method: str, reason: str) -> None:
    with pytest.raises(SuiteError, match=reason):
        run("exploit-v0", f"strange:{method}", isolated=True)


def test_no_file_of_an_isolated_method_names_or_shows_its_opponent() -> None:
    hidden = run("exploit-v0", "strange:drawn", isolated=True, split="hidden", beacon="ab" * 32)
    (work,) = (hidden / "work").iterdir()
    assert (work / "found.txt").read_text() == ""
    assert not re.match("[0-9]{3}-", work.name)


def test_what_cannot_be_isolated_is_refused() -> None:
    for task, method in (("exploit-v0", "ppo"), ("exploit-v0", "program:perl player.pl")):
        with pytest.raises(SuiteError, match="of your own"):
            run(task, method, isolated=True)
    with pytest.raises(SuiteError, match="tables of games"):
        run("robust-v0", "strange:learner", isolated=True)


def test_the_table_is_what_the_method_plays() -> None:
    folder = run("offline-v0", "strange:Offline", isolated=True)
    arena = arena_of(TASKS["offline-v0"], reduced_model(), "dev", quick=True)
    entry = store.read_entry(store.entry_path(folder, 0, 0))
    policy = StoredPolicies(folder / store.POLICIES, arena.game).read(entry.policies["player"])
    states = np.flatnonzero(arena.game.playable)
    row, pair = arena.game.pairs(states)
    first = [arena.game.legal_strokes(state).min() for state in states.tolist()]
    assert (policy.probability_of(pair) == (arena.game.pair_stroke[pair] == np.array(first)[row])).all()
