"""How boards are divided and ordered."""

from typing import Any

import pytest

from shuttle_marl.suite.board import boards
from shuttle_marl.suite.options import Resources, SuiteError
from shuttle_marl.suite.results import difference, units_of
from shuttle_marl.suite.store import Entry
from shuttle_marl.suite.task import Case


def row(**fields: Any) -> Any:
    bounds = {"value": 1.0, "low": None, "high": None}
    plain = {
        "task": "exploit-entrance-v0", "split": "test", "budget": 10**5, "cases": "c" * 64, "game": "g" * 64, "method": "mine",
        "author": "", "kind": "method", "access": "samples", "score": 0.5, "scores": {"gain": bounds, "best": bounds},
        "seeds": 3, "outputs": "o", "units": {"0": {"a": [0.5]}}, "remarks": [], "commitment": None, "recomputed": True,
    }  # fmt: skip
    return {**plain, **fields}


def test_rows_are_ordered_by_class_access_and_score() -> None:
    rows = [
        row(method="low", score=0.1),
        row(method="reader", score=0.9, access="opponent"),
        row(method="high", score=0.8),
        row(method="tables", score=0.95, access="tables"),
        row(method="reference", score=0.99, kind="reference"),
        row(method="unchecked", score=0.85, recomputed=False),
        row(method="rerun", score=0.2, reran_by=["bob"]),
        row(method="taken as it is", score=0.3, recomputed=None),
    ]
    (found,) = boards(rows)
    order = ["rerun", "reference", "unchecked", "high", "taken as it is", "low", "tables", "reader"]
    assert [each["method"] for each in found["rows"]] == order
    ranks = {each["method"]: each.get("rank") for each in found["rows"]}
    assert ranks == {
        "rerun": 1, "reference": None, "unchecked": None, "high": 1, "taken as it is": 2, "low": 3, "tables": 1, "reader": 1,
    }  # fmt: skip
    assert found["best"] is not None
    assert (found["best"]["method"], found["optimum"], found["gap"]) == ("rerun", 1.0, pytest.approx(0.8))
    assert (found["title"], found["split"], found["budget"]) == ("exploit-entrance-v0, test, 100,000 strokes", "test", 10**5)
    assert found["columns"] == ["best"]


def test_less_is_better_where_the_metric_is_a_loss() -> None:
    bounds = {"value": 1.0, "low": None, "high": None}
    rows = [
        row(task="text-v0", budget=None, score=score, method=str(score), scores={"regret": bounds, "legal": bounds}, split="dev")
        for score in (3.0, 1.0, 2.0)
    ]
    (found,) = boards(rows)
    assert [each["method"] for each in found["rows"]] == ["1.0", "2.0", "3.0"]
    assert (found["title"], found["budget"], found["optimum"], found["gap"]) == ("text-v0, dev", 0, 0.0, 1.0)
    (empty,) = boards([row(task="text-v0", budget=None, kind="reference", split="dev")])
    assert (empty["best"], empty["optimum"], empty["gap"]) == (None, 0.0, None)


def test_boards_stand_by_task_split_budget_and_cases() -> None:
    rows = [
        row(budget=10**6), row(split="dev"), row(game="h" * 64), row(cases="d" * 64), row(), row(split="round"),
        row(task="unknown"), row(task="text-v0", split="round"), row(task="exploit-v0"),
    ]  # fmt: skip
    assert [found["title"] for found in boards(rows)] == [
        "exploit-v0, test, 100,000 strokes",
        "exploit-entrance-v0, dev, 100,000 strokes",
        "exploit-entrance-v0, test, 100,000 strokes, game gggggggg, cases cccccccc",
        "exploit-entrance-v0, test, 100,000 strokes, game gggggggg, cases dddddddd",
        "exploit-entrance-v0, test, 100,000 strokes, game hhhhhhhh, cases cccccccc",
        "exploit-entrance-v0, test, 1,000,000 strokes",
        "exploit-entrance-v0, round, 100,000 strokes",
    ]
    with_more = boards([row(), row(cases="d" * 64)])
    assert [len(found["rows"]) for found in with_more] == [1, 1]


@pytest.mark.parametrize("given", [{"resume": True, "overwrite": True}, {"workers": 0}, {"workers": 513}])
def test_options_of_runs_are_checked(given: dict[str, Any]) -> None:
    with pytest.raises(SuiteError, match=r"--resume continues a run|workers"):
        Resources(**given)


def entry(**fields: Any) -> Entry:
    return Entry(case="a", fingerprint="0" * 64, policies={}, answers={}, seconds=2.0, **fields)


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
