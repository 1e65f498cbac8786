"""Run folders of strangers: every forgery is refused or marked with its reason, and none stops a board."""

import json
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.files import seal
from shuttle_marl.commands.suite import main
from shuttle_marl.suite import store
from shuttle_marl.suite.board import called, render, rows_of, shown
from shuttle_marl.suite.exploit import Trained
from shuttle_marl.suite.options import SuiteError, VerifyOptions
from shuttle_marl.suite.registry import TASKS, arena_of
from shuttle_marl.suite.results import Row
from tests.reduced import reduced_model
from tests.suite.small import run, summary, verified

Fields = dict[str, Any]


def player(setting: Any) -> Trained:
    """A method that depends on the seed and uses most of its budget."""
    return Trained(player=f"bc@{0.3 + 0.1 * setting.seed}", strokes=int(0.97 * setting.budget))


METHOD = f"{__name__}:player"


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two seeds."""
    out = tmp_path_factory.mktemp("honest") / "run"
    return run("equilibrium-entrance-v0", METHOD, out, quick=False, split="test", seeds=2)


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    """A copy that may be changed; aggregates are not copied, because they would be refused."""
    shutil.copytree(honest, tmp_path / "run", ignore=shutil.ignore_patterns(store.RESULTS))
    return tmp_path / "run"


def entry(folder: Path, number: int = 0, **changes: Any) -> None:
    """Change the entry of a seed and seal it again."""
    path = store.entry_path(folder, 0, number)
    fields = {**json.loads(path.read_text()), **changes}
    path.write_bytes(seal({name: value for name, value in fields.items() if name != "checksum"}))


def config(folder: Path, **changes: Any) -> None:
    path = folder / runs.CONFIG
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def scores(number: int) -> Fields:
    return {f"score{i}": 0.5 for i in range(number)}


def append_to_a_policy(folder: Path) -> None:
    with (folder / store.POLICIES / f"{store.read_entry(store.entry_path(folder, 0, 0)).policies['player']}.zst").open(
        "ab"
    ) as file:
        file.write(b"payload")


REFUSED: dict[str, tuple[Callable[[Path], None], str]] = {
    "strokes above the budget": (lambda f: entry(f, strokes=9_000_000), "more than the budget of 1,000,000"),
    "negative strokes": (lambda f: entry(f, strokes=-1), "strokes"),
    "strokes of a fraction": (lambda f: entry(f, strokes=0.5), "strokes"),
    "negative seconds": (lambda f: entry(f, seconds=-1.0), "seconds"),
    "endless seconds": (lambda f: entry(f, seconds=float("inf")), "seconds"),
    "NaN in a curve": (lambda f: entry(f, curve=[[1000, float("nan")]]), "curve"),
    "a curve beyond the budget": (lambda f: entry(f, curve=[[9_000_000, 0.1]]), "more than the budget"),
    "a huge number in a curve": (lambda f: entry(f, curve=[[1000, 10**400]]), "out of range"),
    "NaN as a score": (lambda f: entry(f, scores={"exploitability": float("nan"), "won": 0.5}), "scores"),
    "5,000 scores": (lambda f: entry(f, scores=scores(5000)), "length <= 16"),
    "a score that does not exist": (lambda f: entry(f, scores=scores(3)), "score0"),
    "no scores": (lambda f: entry(f, scores={}), "exploitability"),
    "an escape as a fingerprint": (lambda f: entry(f, fingerprint="\x1b]0;x\x07"), "fingerprint"),
    "an empty case": (lambda f: entry(f, case=""), "case"),
    "another case": (lambda f: entry(f, case="10,000,000"), "is of case"),
    "a huge seed": (lambda f: entry(f, seed=10**400), "seed"),
    "salt": (lambda f: entry(f, answers={"salt": 1}), "1 policies or answers that the task does not have, such as salt"),
    "megabytes of answers": (lambda f: entry(f, answers={"salt": "x" * (1 << 20)}), "larger than 1 MB"),
    "bytes after a policy": (append_to_a_policy, "unused data"),
    "entries of another budget": (lambda f: config(f, budget=10**7), "is of case"),
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
    "an endless budget": lambda f: config(f, budget=float("inf")),
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
    "a card that is a list": lambda f: (f / store.CARD).write_text("[1]"),
    "a card of an unknown kind": lambda f: (f / store.CARD).write_text('{"kind": "best"}'),
    "a card with endless tuning": lambda f: (f / store.CARD).write_text('{"tuning_strokes": 1e999}'),
}


def test_no_folder_stops_a_board(honest: Path, tmp_path: Path) -> None:
    folders = []
    for number, forge in enumerate([*UNREADABLE.values(), *(forge for forge, _ in REFUSED.values())]):
        folders.append(tmp_path / str(number))
        shutil.copytree(honest, folders[-1], ignore=shutil.ignore_patterns(store.RESULTS))
        forge(folders[-1])
    left: list[str] = []
    (row,) = rows_of([*folders, honest, tmp_path / "missing"], given=VerifyOptions(game=reduced_model()), failed=left.append)
    assert row["recomputed"] is True
    assert [line.partition(":")[0] for line in left] == [str(path) for path in [*folders, tmp_path / "missing"]]
    # A change that the board did not expect is an error with its type, not the end.
    assert not [line for line in left if "Error:" in line]


def rows(*folders: Path) -> tuple[list[Row], list[str]]:
    left: list[str] = []
    return rows_of(folders, given=VerifyOptions(game=reduced_model()), failed=left.append), left


def remarks(folder: Path) -> str:
    return "; ".join(verified(folder).summary["remarks"])


def test_one_seed_as_two_is_marked(folder: Path) -> None:
    first = json.loads(store.entry_path(folder, 0, 0).read_text())
    again = json.loads(store.entry_path(folder, 0, 1).read_text())
    entry(folder, 1, **{**first, "seed": 1, "fingerprint": again["fingerprint"]})
    assert "2 seeds, of which 1 differ" in remarks(folder)
    assert summary(folder)["low"] is None


def test_fewer_seeds_than_due_are_marked(folder: Path) -> None:
    assert "2 of 3 seeds" in remarks(folder)
    config(folder, seeds=1)
    assert "1 of 3 seeds" in remarks(folder)


def test_entries_that_were_moved_to_another_budget_are_marked(folder: Path, honest: Path) -> None:
    """A stranger can change the labels of units, but not their policies."""
    config(folder, budget=10**7, method="mine:faster")
    task = TASKS["equilibrium-entrance-v0"]
    arena = arena_of(task, reduced_model(), "test", budget=10**7)
    (case,) = task.cases(arena)
    for seed in (0, 1):
        entry(folder, seed, case=case.name, fingerprint=task.fingerprint(arena, case, seed))
    assert "fits the budget of 1,000,000 strokes" in remarks(folder)
    for seed in (0, 1):
        entry(folder, seed, strokes=9_700_000)
    (first, second), left = rows(honest, folder)
    assert left == []
    assert {first["budget"], second["budget"]} == {10**6, 10**7}


@pytest.mark.parametrize("name", ["ppo", "\u0440po", "ppo (ours)"])
def test_a_stranger_has_no_name_of_the_package(name: str, folder: Path) -> None:
    """A method of others has its author before it, and no letters that look like others."""
    (folder / store.CARD).write_text(json.dumps({"authors": "mallory"}))
    config(folder, method=name)
    ((row,), _) = rows(folder)
    assert called(row) == f"mallory/{name}"
    assert f"`mallory/{shown(name)}`" in render([row], "md")
    assert shown(name).isascii()
    (folder / store.CARD).unlink()
    ((row,), _) = rows(folder)
    assert called(row) == (name if name == "ppo" else f"anonymous/{name}")
    assert row["reran_by"] == []


def test_nothing_of_a_stranger_is_an_address_or_a_mention_on_a_board(folder: Path, honest: Path) -> None:
    config(folder, method="@all www.example.org <b>")
    (folder / store.CARD).write_text(json.dumps({"tuning_strokes": "https://example.org @all | x"}))
    found, _ = rows(folder, honest)
    assert "the same policies as anonymous/@all" in found[1]["remarks"][-1]
    for line in render(found, "md").splitlines():
        assert not re.search("@|www|http", re.sub("`[^`]*`", "", line))
        assert not line.startswith("| `") or len(re.findall(r"(?<!\\)\|", line)) == 11
    assert "<b>" not in render(found, "html")


def test_a_run_stands_on_a_board_once(folder: Path, honest: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(folder)
    found, left = rows(folder, folder, honest, tmp_path / "link")
    assert len(found) == 1
    assert all("the same run as another one of the board" in line for line in left)
    assert len(left) == 3


def test_reasons_are_printed_without_escapes(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    entry(folder, case="\x1b[31m")
    assert main(("verify", str(folder), "--game", reduced_model())) == 1
    printed = capsys.readouterr()
    assert "\x1b" not in printed.out + printed.err
    config(folder, method="\x1b]0;x\x07 @all")
    assert main(("board", str(folder), "--game", reduced_model(), "--no-check")) == 1
    assert "\x1b" not in "".join(capsys.readouterr())


def test_what_cannot_be_read_again_is_not_stored(tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="cannot be stored"):
        run("exploit-entrance-v0", f"{__name__}:absurd", tmp_path / "run")


def absurd(setting: Any) -> Trained:
    return Trained(player="bc", strokes=10, curve=((10, float("nan")),))
