"""Limits of runs and rounds, and aggregates of entries that are written out."""

import dataclasses
import datetime as dt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from shuttle_marl.base import runs
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.suite import results, run, store
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.results import TOLERANCE, difference, summarise, units_of, verify_run
from shuttle_marl.suite.run import Commitment, commit, draw_round, time_of, write
from shuttle_marl.suite.store import Card, Entry, GameOf, RunConfig
from shuttle_marl.suite.task import Case

HASH = "0" * 64


def entry(**fields: Any) -> Entry:
    plain: dict[str, Any] = {
        "case": "a", "seed": 0, "fingerprint": HASH, "policies": {}, "answers": {}, "scores": {"gain": 0.5}, "seconds": 2.0,
    }  # fmt: skip
    return Entry(**{**plain, **fields})


@pytest.mark.parametrize(
    ("fields", "most"),
    [
        ({"strokes": 100}, None),
        ({"strokes": 101}, 101),
        ({"curve": ((5, 0.1), (100, 0.2))}, None),
        ({"curve": ((101, 0.1), (5, 0.2)), "strokes": 7}, 101),
        ({}, None),
    ],
)
def test_units_use_no_more_than_their_budget(fields: dict[str, Any], most: int | None) -> None:
    found = entry(**fields)
    assert store.within_budget(found, Case(name="a")) is found, "a case without a budget"
    if most is None:
        assert store.within_budget(found, Case(name="a", budget=100)) is found
    else:
        with pytest.raises(SuiteError, match=f"used {most} strokes, more than the budget of 100"):
            store.within_budget(found, Case(name="a", budget=100))


def test_units_stand_in_the_file_of_their_case_and_seed(tmp_path: Path) -> None:
    assert store.entry_path(tmp_path, 7, 12) == tmp_path / "entries" / "007-12.json"
    store.write_entry(tmp_path, store.entry_path(tmp_path, 0, 0), entry(strokes=3), {HASH: b"table"})
    store.write_entry(tmp_path, store.entry_path(tmp_path, 0, 1), entry(), {HASH: b"is not written again"})
    assert (tmp_path / "policies" / f"{HASH}.zst").read_bytes() == b"table"
    assert store.read_unit(tmp_path, 0, Case(name="a"), 0).strokes == 3
    for name, seed in (("b", 0), ("a", 1)):
        with pytest.raises(SuiteError, match=f"is of case 'a' and seed 0; expected '{name}' and {seed}"):
            store.read_unit(tmp_path, 0, Case(name=name), seed)
    assert store.read_card(tmp_path) == Card()
    store.write_card(tmp_path, Card(method="one"))
    store.write_card(tmp_path, Card(method="two"))
    assert store.read_card(tmp_path).method == "one"


@pytest.mark.parametrize(
    "fields",
    [
        {"scores": {"gain": float("nan")}}, {"scores": {"gain": 1.1e9}}, {"seconds": -1.0}, {"strokes": -1}, {"case": ""},
        {"scores": {str(i): 0.0 for i in range(17)}}, {"parts": {str(i): 0.0 for i in range(1001)}}, {"case": "x" * 1001},
        {"curve": ((1, 0.0),) * 10_001}, {"seconds": 1.1e9},
    ],
)  # fmt: skip
def test_what_a_method_returns_can_be_stored(fields: dict[str, Any]) -> None:
    with pytest.raises(SuiteError, match="the method returned something that cannot be stored"):
        store.checked(entry(**fields))
    largest = entry(
        scores={str(i): 1e9 for i in range(16)}, parts={str(i): -1e9 for i in range(1000)}, case="x" * 1000, seconds=1e9,
        curve=((1, 0.0),) * 10_000,
    )  # fmt: skip
    assert store.checked(largest).case == largest.case


def test_scores_are_those_that_are_recomputed() -> None:
    results._compare({"gain": 0.5, "best": 1.0}, {"gain": 0.5 + 0.9 * TOLERANCE, "best": 1.0 - 0.9 * TOLERANCE})
    for found, says in (
        ({"gain": 0.5 + 1.1 * TOLERANCE}, "gain is 0.500000110, not 0.5"),
        ({"gain": 0.5 - 1.1 * TOLERANCE}, "gain is 0.499999890, not 0.5"),
        ({"gain": 0.5, "best": 1.0}, "best is 1.000000000, not None"),
        ({}, "the entry has scores that the task does not have: gain"),
        ({"gain": float("nan")}, "gain is nan, not 0.5"),
    ):
        with pytest.raises(SuiteError, match=says):
            results._compare({"gain": 0.5}, found)
    assert TOLERANCE == 1e-7


CASES = [
    Case(name="a", budget=100),
    Case(name="b1", stratum="b", budget=100),
    Case(name="b2", stratum="b", budget=100),
    Case(name="control", counts=False, budget=100),
]
GAINS = {"a": (1.0, 2.0, 6.0), "b1": (4.0, 4.0, 4.0), "b2": (8.0, 8.0, 11.0), "control": (90.0, 91.0, 92.0)}


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """A run of three seeds in four cases, of which one is a control, and a task of three seeds and two budgets."""
    found = SimpleNamespace(
        task=SimpleNamespace(
            name="exploit-v0", metric="gain", seeds=3, budgets=(50, 100), higher_is_better=True, roles=("player",), answers=()
        ),
        arena=SimpleNamespace(base="b" * 64, game=SimpleNamespace(hash=HASH)),
        cases=CASES,
        config=RunConfig(
            task="exploit-v0", method="mine:train", split="test", quick=False, budget=100, seeds=3,
            game=GameOf(model="m", hash=HASH),
        ),
        card=Card(),
        entries={
            (case, seed): entry(
                case=case, seed=seed, scores={"gain": gain, "exploitability": 10.0 - gain}, strokes=40 + 20 * seed,
                policies={"player": f"{hash(case) % 7}{seed}".zfill(64)}, fingerprint=f"{index}".zfill(64),
            )
            for index, (case, gains) in enumerate(GAINS.items())
            for seed, gain in enumerate(gains)
        },
    )  # fmt: skip

    def read_unit(folder: Path, number: int, case: Case, seed: int) -> Entry:
        assert case is found.cases[number]
        return found.entries[case.name, seed]

    monkeypatch.setattr(results, "task_of_run", lambda *_: (found.task, found.arena, found.cases))
    monkeypatch.setattr(store, "read_config", lambda _: found.config)
    monkeypatch.setattr(store, "read_card", lambda _: found.card)
    monkeypatch.setattr(store, "read_unit", read_unit)
    there = lambda number, seed: (found.cases[number].name, seed) in found.entries  # noqa: E731
    monkeypatch.setattr(store, "entry_path", lambda _, number, seed: SimpleNamespace(exists=lambda: there(number, seed)))
    return found


def test_aggregates_of_a_run_by_hand(fake: Any) -> None:
    """A quarter of three seeds is less than one, so none is left out: 3, 4 and 9, and the mean over three cases."""
    row = summarise(Path("run"))
    assert row["score"] == pytest.approx(16 / 3)
    assert row["scores"]["exploitability"]["value"] == pytest.approx(10 - row["score"])
    assert row["worst"] == 3
    assert row["strata"] == {
        "a": {"gain": 3.0, "exploitability": 7.0}, "b": {"gain": 6.5, "exploitability": 3.5},
        "control": {"gain": 91.0, "exploitability": -81.0},
    }  # fmt: skip
    assert row["units"] == {"a": {"a": [1.0, 2.0, 6.0]}, "b": {"b1": [4.0, 4.0, 4.0], "b2": [8.0, 8.0, 11.0]}}
    assert (row["seconds"], row["strokes"], row["seeds"], row["budget"]) == (24.0, 4 * 180, 3, 100)
    assert (row["author"], row["method"], row["access"], row["kind"]) == ("anonymous", "mine:train", "opponent", "method")
    assert (row["low"], row["high"]) == (None, None), "the scores of b1 are copies"
    assert row["remarks"] == ["3 seeds, of which 1 differ"]
    assert (row["commitment"], row["game"]) == (None, "b" * 64)
    fake.task.higher_is_better = False
    assert summarise(Path("run"))["worst"] == 9


def test_remarks_on_a_run(fake: Any) -> None:
    for seed in range(3):
        fake.entries["b1", seed] = dataclasses.replace(
            fake.entries["b1", seed], scores={"gain": 4.0 + seed, "exploitability": 40.0}
        )
    fake.entries["b2", 1] = dataclasses.replace(fake.entries["b2", 1], scores={"gain": 8.5, "exploitability": 0.0})
    row = summarise(Path("run"))
    assert row["remarks"] == []
    assert row["low"] is not None
    assert row["low"] < row["score"] < row["high"]
    risk = row["scores"]["exploitability"]
    assert (risk["low"], risk["high"] is not None) == (0, True), "no player wins more than perfect play"
    for seed in (1, 2):
        for case in CASES:
            fake.entries[case.name, seed] = dataclasses.replace(fake.entries[case.name, seed], strokes=50 - seed)
    assert summarise(Path("run"))["remarks"] == ["fits the budget of 50 strokes"]
    fake.entries["a", 0] = dataclasses.replace(fake.entries["a", 0], strokes=51)
    assert summarise(Path("run"))["remarks"] == []
    fake.entries["a", 0] = dataclasses.replace(fake.entries["a", 0], strokes=None)
    fake.config = dataclasses.replace(fake.config, quick=True)
    assert summarise(Path("run"))["remarks"] == ["a quick run", "strokes not declared"]
    fake.task.seeds = 4
    assert summarise(Path("run"))["remarks"] == ["a quick run", "3 of 4 seeds", "strokes not declared"]
    fake.card = Card(kind="reference", authors=["ann", "bob"], access="tables", tuning_strokes="a few")
    row = summarise(Path("run"))
    assert row["remarks"] == ["a quick run"]
    assert (row["author"], row["access"], row["kind"], row["tuning_strokes"]) == ("ann, bob", "tables", "reference", "a few")
    fake.config = dataclasses.replace(fake.config, commitment="c" * 64)
    assert (summarise(Path("run"))["access"], summarise(Path("run"))["commitment"]) == ("samples", "c" * 64)
    fake.config = dataclasses.replace(fake.config, commitment=None, method="ppo-restricted")
    assert (summarise(Path("run"))["access"], summarise(Path("run"))["author"]) == ("tables", "ann, bob")
    fake.card = Card()
    assert summarise(Path("run"))["author"] == ""


def test_outputs_identify_runs(fake: Any) -> None:
    first = summarise(Path("run"))
    fake.entries["a", 1] = dataclasses.replace(fake.entries["a", 1], seconds=99.0)
    assert summarise(Path("run"))["outputs"] == first["outputs"]
    fake.entries["a", 1] = dataclasses.replace(fake.entries["a", 1], answers={"x": 1})
    second = summarise(Path("run"))
    assert second["outputs"] != first["outputs"]
    assert second["cases"] == first["cases"]
    fake.entries["a", 0] = dataclasses.replace(fake.entries["a", 0], fingerprint="f" * 64)
    assert summarise(Path("run"))["cases"] != first["cases"]


def test_runs_that_are_not_whole(fake: Any) -> None:
    fake.entries["a", 1] = dataclasses.replace(fake.entries["a", 1], scores={"gain": 2.0})
    with pytest.raises(SuiteError, match="run: the units have different scores, or none named gain"):
        summarise(Path("run"))
    fake.entries["a", 1] = dataclasses.replace(
        fake.entries["a", 1], scores={"gain": 2.0, "exploitability": 1.0}, parts={"x": 1.0}
    )
    with pytest.raises(SuiteError, match="the units have different scores"):
        summarise(Path("run"))
    fake.entries = {
        key: dataclasses.replace(each, scores={"exploitability": 1.0}, parts={}) for key, each in fake.entries.items()
    }
    with pytest.raises(SuiteError, match="the units have different scores, or none named gain"):
        summarise(Path("run"))
    del fake.entries["a", 1]
    with pytest.raises(SuiteError, match="run: 1 of 12 units are missing; --resume plays them"):
        summarise(Path("run"))


def test_parts_stand_for_cases_in_the_main_score() -> None:
    entries = {
        ("a", seed): entry(seed=seed, scores={"gain": 1.0, "best": 2.0}, parts={"x": 3.0 + seed, "y": 5.0}) for seed in (0, 1)
    }
    case = [Case(name="a", stratum="s")]
    assert units_of(case, entries, "gain", "gain") == {"a": {"x": [3.0, 4.0], "y": [5.0, 5.0]}}
    assert units_of(case, entries, "best", "gain") == {"s": {"a": [2.0, 2.0]}}
    assert units_of(case, entries, "gain") == {"s": {"a": [1.0, 1.0]}}


def test_a_difference_is_of_paired_units() -> None:
    def row(task: str, gains: dict[str, list[float]]) -> Any:
        return {"task": task, "method": "x", "units": {"s": gains}}

    ours, theirs = {"a": [3.0, 5.0], "b": [4.0, 4.0]}, {"a": [1.0, 2.0], "b": [4.0, 3.0]}
    assert difference(row("exploit-v0", ours), row("exploit-v0", theirs))["value"] == pytest.approx((2.5 + 0.5) / 2)
    assert difference(row("text-v0", ours), row("text-v0", theirs))["value"] == pytest.approx(-1.5)
    for other in (row("text-v0", ours), row("exploit-v0", {"a": [1.0, 2.0]}), row("exploit-v0", {**theirs, "b": [1.0]})):
        with pytest.raises(SuiteError, match="x and x have different cases or seeds; run both with the same ones"):
            difference(row("exploit-v0", ours), other)


def test_units_are_refused_before_anything_is_recomputed(fake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    computed: list[Any] = []
    fake.task.fingerprint = lambda arena, case, seed: fake.entries[case.name, seed].fingerprint

    def score(arena: Any, case: Case, seed: int, outcome: Any) -> dict[str, float]:
        computed.append(case.name)
        return {name: value + wrong.get((case.name, seed), 0.0) for name, value in fake.entries[case.name, seed].scores.items()}

    fake.task.score = score
    fake.task.parts = lambda *_: {}
    monkeypatch.setattr(store, "read_outcome", lambda *_: None)
    wrong: dict[tuple[str, int], float] = {}
    found = verify_run(Path("run"))
    assert (found.units, found.refused, len(computed)) == (12, [], 12)
    assert found.summary is not None
    wrong["a", 1] = 0.25
    found = verify_run(Path("run"))
    assert [(each.case, each.seed) for each in found.refused] == [("a", 1)]
    assert found.summary is None
    wrong.clear()
    computed.clear()
    fake.task.fingerprint = lambda *_: "e" * 64
    assert {each.reason for each in verify_run(Path("run")).refused} >= {
        "the case has fingerprint 000000000000; expected eeeeeeeeeeee"
    }
    for change, says in (
        (
            {"policies": {"player": HASH, "other": HASH}},
            "the entry has 1 policies or answers that the task does not have, such as other",
        ),
        ({"answers": {"x" * 50: 1, "y": 2}}, f"the entry has 2 policies .* such as {'x' * 40}$"),
    ):
        fake.entries["b1", 2] = entry(case="b1", seed=2, **change)
        (refused,) = verify_run(Path("run")).refused
        assert (refused.case, refused.seed) == ("b1", 2)
        with pytest.raises(ShuttleError, match=says):
            raise ShuttleError(refused.reason)
    assert computed == []
    fake.arena.game.hash = "9" * 64
    reasons = {each.reason for each in verify_run(Path("run")).refused}
    assert reasons == {"played on game 000000000000; this is 999999999999"}


BEACON = 1000
DRAWN = time_of(BEACON)


def commitment(**fields: Any) -> Commitment:
    plain: dict[str, Any] = {
        "task": "exploit-v0", "author": "ann", "method": "a:b", "date": DRAWN - dt.timedelta(seconds=1), "hash": HASH,
    }  # fmt: skip
    return Commitment(**{**plain, **fields})


def test_rounds_of_the_beacon_have_times() -> None:
    """The first one was at 15:09:27 UTC on 23 August 2023, and one follows every three seconds."""
    assert time_of(1) == dt.datetime(2023, 8, 23, 15, 9, 27, tzinfo=dt.UTC)
    assert time_of(1001) - time_of(1) == dt.timedelta(seconds=3000)


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ([commitment(), commitment(author="bob")], None),
        ([commitment(), commitment(task="adapt-v0")], None),
        ([commitment(beacon=BEACON)], None),
        ([commitment(date=DRAWN)], "ann: committed at .* not before the beacon"),
        ([commitment(beacon=BEACON + 1)], "ann: committed for round 1001 of the beacon, not 1000"),
        (
            [commitment(), commitment(author="Ann.", date=DRAWN - dt.timedelta(days=1))],
            "ann: has the name of Ann., who committed first",
        ),
        ([commitment(author="rn"), commitment(author="m")], "has the name of"),
        ([commitment(author="vv0"), commitment(author="wo")], "has the name of"),
        ([commitment(task="nothing")], "no task 'nothing'"),
    ],
)
def test_entries_of_a_round(entries: list[Commitment], says: str | None, tmp_path: Path) -> None:
    paths = [tmp_path / f"{number}.json" for number in range(len(entries))]
    for path, each in zip(paths, entries, strict=True):
        write(path, each)
    if says is not None:
        with pytest.raises(SuiteError, match=says):
            draw_round(paths, beacon=BEACON, randomness="ab" * 32, now=DRAWN)
        return
    found = draw_round(paths, beacon=BEACON, randomness="ab" * 32, now=DRAWN)
    assert (found.beacon, found.randomness, list(found.commitments)) == (BEACON, "ab" * 32, entries)
    assert found.entry("exploit-v0", "ann") == entries[0]
    for task, author, there in (("exploit-v0", "eve", "ann"), ("text-v0", "ann", "none")):
        with pytest.raises(SuiteError, match=f"no entry of '{author}' for {task} in this round; there are: {there}"):
            found.entry(task, author)
    with pytest.raises(SuiteError, match="round 1000 of the beacon appears at 2023-08-23 15:59:24 UTC"):
        draw_round(paths, beacon=BEACON, randomness="ab" * 32, now=DRAWN - dt.timedelta(seconds=1))


def test_committed_files_are_few_and_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "code"
    for name in ("a.py", "sub/b.py", ".hidden/c.py", "__pycache__/d.pyc", "sub/.e"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(bytes(10))
    assert list(run._files(folder)) == ["a.py", "sub/b.py"]
    for files, size, refused in ((2, 20, False), (1, 20, True), (2, 19, True)):
        monkeypatch.setattr(run, "_FILES", files)
        monkeypatch.setattr(run, "_BYTES", size)
        if not refused:
            assert len(run._files(folder)) == 2
            continue
        with pytest.raises(SuiteError, match=f"more than {files} files or {size} bytes"):
            run._files(folder)
    monkeypatch.undo()
    made = commit(folder, task="exploit-v0", method="a:b", author="ann", now=dt.datetime(2024, 1, 2, 3, 4, 5, 678, dt.UTC))
    assert made.date == dt.datetime(2024, 1, 2, 3, 4, 5, tzinfo=dt.UTC)
    others = [
        commit(folder, task="adapt-v0", method="a:b", author="ann"),
        commit(folder, task="exploit-v0", method="a:c", author="ann"),
        commit(folder, task="exploit-v0", method="a:b", author="bob"),
        commit(folder, task="exploit-v0", method="a:b", author="ann", beacon=7),
    ]  # fmt: skip
    assert len({made.hash, *(each.hash for each in others)}) == 5
    (folder / "x\ny").touch()
    with pytest.raises(SuiteError, match="commit to names that can be printed"):
        run._files(folder)


def test_versions_of_a_method_are_not_mixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config: Any = SimpleNamespace(task="exploit-v0", method="mine:train")
    monkeypatch.setattr(run, "sources", lambda *_: {"a": "1", "b": "2"})
    monkeypatch.setattr(runs, "has_results", lambda _: False)
    assert run._sources(tmp_path, config, more=True) == {"a": "1", "b": "2"}
    monkeypatch.setattr(runs, "has_results", lambda _: True)
    for before, changed in (
        ({"a": "1", "b": "2"}, None),
        ({"a": "0", "b": "2"}, "a"),
        ({"b": "3"}, "a, b"),
        ({"c": "3"}, "a, b, c"),
    ):
        runs.write_json(tmp_path / runs.MANIFEST, {"sources": before})
        assert run._sources(tmp_path, config, more=False) == before
        if changed is None:
            assert run._sources(tmp_path, config, more=True) == before
        else:
            with pytest.raises(SuiteError, match=f": {changed} changed after the run was started"):
                run._sources(tmp_path, config, more=True)
