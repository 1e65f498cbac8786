"""Run folders of strangers: every forgery is refused with its reason, and none stops a board."""

import contextlib
import json
import re
import shutil
import sqlite3
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.cache import NAME, cache_folder
from shuttle_marl.base.files import content_hash, seal
from shuttle_marl.commands.suite import main
from shuttle_marl.suite import results
from shuttle_marl.suite.board import render, rows_of, shown
from shuttle_marl.suite.exploit import Trained
from shuttle_marl.suite.results import TASKS, Row, arena_of, verify_run
from tests.reduced import reduced_model
from tests.suite.small import run, summary, verified

TASK = "equilibrium-v1"


def player(setting: Any) -> Trained:
    """A method that depends on the seed and uses most of its budget."""
    return Trained(player=f"bc@{0.3 + 0.1 * setting.seed}", strokes=int(0.97 * setting.budget))


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two seeds by alice."""
    folder = run(TASK, f"{__name__}:player", tmp_path_factory.mktemp("honest") / "run", quick=False, split="test", seeds=2)
    (folder / results.CARD).write_text('{"author": "alice"}')
    return folder


def copied(honest: Path, folder: Path) -> Path:
    """A copy that may be changed; aggregates are not copied, because they would be refused."""
    return Path(shutil.copytree(honest, folder, ignore=shutil.ignore_patterns(results.RESULTS)))


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    return copied(honest, tmp_path / "run")


def entry(folder: Path, number: int = 0, **changes: Any) -> None:
    """Change the entry of a seed and seal it again."""
    path = results.entry_path(folder, 0, number)
    fields = {**json.loads(path.read_text()), **changes}
    path.write_bytes(seal({name: value for name, value in fields.items() if name != "checksum"}))


def scored(folder: Path, **changes: float) -> None:
    entry(folder, scores={**json.loads(results.entry_path(folder, 0, 0).read_text())["scores"], **changes})


def config(folder: Path, **changes: Any) -> None:
    path = folder / runs.CONFIG
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def card(folder: Path, content: str) -> None:
    (folder / results.CARD).write_text(content)


def append_to_a_policy(folder: Path) -> None:
    digest = results.read_entry(results.entry_path(folder, 0, 0)).policies["player"]
    with (folder / results.POLICIES / f"{digest}.zst").open("ab") as file:
        file.write(b"payload")


def without_a_seal(folder: Path) -> None:
    path = results.entry_path(folder, 0, 0)
    path.write_bytes(path.read_bytes().replace(b'"seconds": ', b'"seconds": 1'))


REFUSED: dict[str, tuple[Callable[[Path], None], str]] = {
    "strokes above the budget": (lambda f: entry(f, strokes=90_000_000), "more than the budget of 10,000,000"),
    "negative strokes": (lambda f: entry(f, strokes=-1), "strokes"),
    "half a stroke": (lambda f: entry(f, strokes=0.5), "strokes"),
    "endless seconds": (lambda f: entry(f, seconds=float("inf")), "seconds"),
    "another score": (lambda f: scored(f, exploitability=0.5), "exploitability is"),
    "NaN as a score": (lambda f: scored(f, exploitability=float("nan")), "scores"),
    "5,000 scores": (lambda f: scored(f, **{f"score{i}": 0.5 for i in range(5000)}), "length <= 16"),
    "a score that does not exist": (lambda f: scored(f, score0=0.5), "score0"),
    "no scores": (lambda f: entry(f, scores={}), "exploitability"),
    "another fingerprint": (lambda f: entry(f, fingerprint="0" * 64), "the case has fingerprint 000000000000"),
    "an escape as a fingerprint": (lambda f: entry(f, fingerprint="\x1b]0;x\x07"), "fingerprint"),
    "another case": (lambda f: entry(f, case="100,000,000"), "is of case"),
    "another seed": (lambda f: entry(f, seed=1), "and seed 1"),
    "a huge seed": (lambda f: entry(f, seed=10**400), "seed"),
    "salt": (lambda f: entry(f, answers={"salt\x1b": 1}), r"1 policies or answers that the task does not have, such as salt\x1b"),
    "megabytes of answers": (lambda f: entry(f, answers={"salt": "x" * (1 << 20)}), "larger than 1 MB"),
    "a change without a seal": (without_a_seal, "checksum"),
    "bytes after a policy": (append_to_a_policy, "unused data"),
    "entries of another budget": (lambda f: config(f, budget=10**8), "is of case"),
    "another game": (lambda f: config(f, game="f" * 64), "played on game ffffffffffff"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_forged_unit_is_refused_with_its_reason(name: str, folder: Path) -> None:
    forge, reason = REFUSED[name]
    forge(folder)
    begun = time.monotonic()
    found = verified(folder)
    assert time.monotonic() - begun < 5
    assert found.summary is None
    assert reason in found.refused[0].reason


UNREADABLE: dict[str, Callable[[Path], object]] = {
    "no budget": lambda f: config(f, budget=None),
    "a budget that does not exist": lambda f: config(f, budget=10**5),
    "10,000 seeds": lambda f: config(f, seeds=10_000),
    "no seeds": lambda f: config(f, seeds=0),
    "a method without a name": lambda f: config(f, method=""),
    "a method of 1 MB": lambda f: config(f, method="x" * 10**6),
    "a method that is a list": lambda f: config(f, method=["ppo"]),
    "an unknown task": lambda f: config(f, task="\x1b[31m"),
    "an unknown split": lambda f: config(f, split="training"),
    "a key twice": lambda f: (f / runs.CONFIG).write_text('{"seeds": 5, ' + (f / runs.CONFIG).read_text()[1:]),
    "no object": lambda f: (f / runs.CONFIG).write_text("[]"),
    "a folder as its configuration": lambda f: (f / runs.CONFIG).rename(f / "old").parent.joinpath(runs.CONFIG).symlink_to(f),
    "a card that is a list": lambda f: card(f, "[1]"),
    "a card of an unknown access": lambda f: card(f, '{"access": "none"}'),
    "a card with endless tuning": lambda f: card(f, '{"tuning_strokes": 1e999}'),
    "a card without an author": lambda f: card(f, "{}"),
    "an author without letters": lambda f: card(f, '{"author": " 1"}'),
    "an author and a method": lambda f: card(f, '{"author": "bob/best"}'),
}


def rows(*folders: Path, **options: Any) -> tuple[list[Row], list[str]]:
    left: list[str] = []
    return rows_of(folders, game=reduced_model(), failed=left.append, **options), left


def test_no_folder_stops_a_board(honest: Path, tmp_path: Path) -> None:
    folders = []
    for number, forge in enumerate([*UNREADABLE.values(), *(forge for forge, _ in REFUSED.values())]):
        folders.append(copied(honest, tmp_path / str(number)))
        forge(folders[-1])
    folders += [tmp_path / "missing", copied(honest, tmp_path / "again")]
    (row,), left = rows(*folders[:-1], honest, folders[-1])
    assert row["author"] == "alice"
    assert [line.partition(":")[0] for line in left] == list(map(str, folders))
    assert left[-1].endswith(f"left out, because it holds the units of {honest}")
    # A change that the board did not expect is an error with its type, not the end.
    assert not [line for line in left if "Error:" in line]


def test_a_run_in_two_folders_counts_once(honest: Path, tmp_path: Path) -> None:
    again = copied(honest, tmp_path / "again")
    (row,), left = rows(honest, again)
    assert row["author"] == "alice"
    assert left == [f"{again}: left out, because it holds the units of {honest}"]


def test_values_that_a_method_wrote_into_the_cache_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = run(TASK, "random", tmp_path / "run")
    score, cache = summary(folder)["score"], cache_folder()
    assert cache is not None
    with contextlib.closing(
        sqlite3.connect(cache / NAME, isolation_level=None)
    ) as database:  # all play is even, so every player is perfect
        even = struct.pack("<3d", 0.5, 0.5, 0)
        for (key,) in database.execute("SELECT key FROM odds").fetchall():
            database.execute("UPDATE odds SET content = ? WHERE key = ?", (content_hash(key, even).encode() + even, key))
    assert summary(run(TASK, "random", tmp_path / "again"))["score"] == 0
    assert verified(folder).summary["score"] == score > 15
    assert "exploitability is" in verified(tmp_path / "again").refused[0].reason


def test_seeds_and_strokes_that_are_missing_are_marked(folder: Path) -> None:
    assert verified(folder).summary["remarks"] == ["2 of 5 seeds"]
    # A stranger's row is a method, whatever the card says.
    config(folder, method="random")
    card(folder, '{"author": "mallory", "kind": "reference"}')
    first = json.loads(results.entry_path(folder, 0, 0).read_text())
    for number in (0, 1):
        entry(folder, number, **{**first, "seed": number, "strokes": 0})
    assert verified(folder).summary["remarks"] == ["2 of 5 seeds", "1 of 2 seeds differ", "fits the budget of 0 strokes"]
    assert verified(folder).summary["kind"] == "method"


def test_what_changes_after_it_was_verified_is_not_shown(folder: Path) -> None:
    passes: list[list[Any]] = []

    def changing(units: list[Any]) -> Any:
        yield from units
        passes.append(units)
        scored(folder, exploitability=0.1 * len(passes))
        card(folder, '{"author": "mallory"}')

    summary = verify_run(folder, reduced_model(), progress=changing).summary
    assert len(passes) == 2
    assert summary is not None
    assert (summary["author"], summary["score"] > 15) == ("alice", True)
    assert "exploitability is" in verified(folder).refused[0].reason


def test_entries_that_were_moved_to_another_budget_are_marked(folder: Path, honest: Path) -> None:
    """A stranger can change the labels of units, but not their policies."""
    config(folder, budget=10**8, method="mine:faster")
    task = TASKS[TASK]
    arena = arena_of(task, reduced_model(), "test", budget=10**8)
    (case,) = task.cases(arena)
    for seed in (0, 1):
        entry(folder, seed, case=case.name, fingerprint=task.fingerprint(arena, case, seed))
    (first, second), left = rows(honest, folder)
    assert left == []
    assert {first["budget"], second["budget"]} == {10**7, 10**8}
    assert "fits the budget of 10,000,000 strokes" in second["remarks"]


@pytest.mark.parametrize("name", ["ppo", "\u0440po", "ppo (ours)"])
def test_a_stranger_has_no_name_of_the_package(name: str, folder: Path) -> None:
    """A method of others has its author before it, and no letters that look like others."""
    card(folder, json.dumps({"author": "mallory"}))
    config(folder, method=name)
    ((row,), _) = rows(folder)
    assert f"`mallory/{shown(name)}`" in render([row])
    assert shown(name).isascii()
    assert row["access"] == "opponent"


def test_nothing_of_a_stranger_is_an_address_or_a_mention_on_a_board(folder: Path, honest: Path) -> None:
    config(folder, method="@all www.example.org <b>")
    card(folder, json.dumps({"author": "x", "tuning_strokes": "https://example.org @all | x"}))
    found, _ = rows(folder, honest)
    for line in render(found).splitlines():
        assert not re.search("@|www|http", re.sub("`[^`]*`", "", line))
        assert not line.startswith("| opponent") or line.count("|") == 11


def test_reasons_are_printed_without_escapes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entry(folder, case="\x1b[31m")
    assert main(("verify", str(folder), "--game", reduced_model())) == 1
    printed = capsys.readouterr()
    assert "\x1b" not in printed.out + printed.err
    config(folder, method="\x1b]0;x\x07 @all")
    assert main(("board", str(folder), "--game", reduced_model())) == 1
    assert "\x1b" not in "".join(capsys.readouterr())
