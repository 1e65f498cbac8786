"""How boards are divided and ordered, what they show, and differences of paired units."""

from typing import Any

import pytest

from shuttle_marl.suite.board import boards, render
from shuttle_marl.suite.options import SuiteError, SuiteRun
from shuttle_marl.suite.results import Row, difference


def row(score: float = 0.5, **fields: Any) -> Any:
    def bounds(value: float) -> dict[str, float | None]:
        return {"value": value, "low": None, "high": None}

    plain = {
        "task": "exploit-entrance-v1", "split": "test", "budget": 10**5, "cases": "c" * 64, "game": "g" * 64, "method": "mine",
        "author": "alice", "kind": "method", "access": "samples", "score": score, "worst": score, "tuning_strokes": 0,
        "scores": {"gain": bounds(score), "best": bounds(1.0)}, "seeds": 2, "units": {"0": {"a": [score - 0.1, score + 0.1]}},
        "remarks": [],
    }  # fmt: skip
    return {**plain, **fields}


def test_rows_are_ordered_by_access_and_score() -> None:
    rows = [
        row(0.1, method="low"),
        row(0.9, method="reader", access="opponent"),
        row(0.8, method="high"),
        row(0.95, method="tables", access="tables"),
        row(0.99, method="reference", kind="reference", seeds=1),
    ]
    (found,) = boards(rows)
    assert [(each["method"], each.get("rank")) for each in found["rows"]] == [
        ("reference", None), ("high", 1), ("low", 2), ("tables", 1), ("reader", 1),
    ]  # fmt: skip
    assert found["best"] is not None
    assert (found["best"]["method"], found["optimum"], found["gap"]) == ("high", 1.0, pytest.approx(0.2))
    assert found["title"] == "exploit-entrance-v1, test, 100,000 strokes"
    assert found["columns"] == ["best"]
    behind = {each["method"]: each["behind"]["value"] for each in found["rows"] if "behind" in each}
    assert behind == {"low": pytest.approx(0.7), "tables": pytest.approx(-0.15), "reader": pytest.approx(-0.1)}


def test_ties_share_a_rank() -> None:
    rows = [row(method="b"), row(0.4, method="c"), row(0.5 + 1e-8, method="a")]
    (found,) = boards(rows)
    assert [(each["method"], each["rank"]) for each in found["rows"]] == [("a", 1), ("b", 1), ("c", 3)]


def test_equal_scores_are_found_whoever_sent_them_and_under_how_many_seeds() -> None:
    again = row(author="Mallory", seeds=4, units={"0": {"a": [0.6, 0.4, 0.4 + 1e-9, 0.6]}})
    (found,) = boards([again, row(author="", method="ppo"), row(0.4, method="other")])
    assert [(each["method"], each["remarks"]) for each in found["rows"]] == [
        ("ppo", ["the same scores as Mallory/mine"]),
        ("mine", ["the same scores as ppo"]),
        ("other", []),
    ]


def test_less_is_better_where_the_metric_is_a_loss() -> None:
    bounds = {"value": 1.0, "low": None, "high": None}
    loss: dict[str, Any] = {"task": "equilibrium-v1", "scores": {"exploitability": bounds, "won": bounds}, "split": "dev"}
    (found,) = boards([row(score, method=str(score), **loss) for score in (3.0, 1.0, 2.0)])
    assert [each["method"] for each in found["rows"]] == ["1.0", "2.0", "3.0"]
    assert (found["title"], found["optimum"], found["gap"]) == ("equilibrium-v1, dev, 100,000 strokes", 0.0, 1.0)
    (empty,) = boards([row(kind="reference", **loss)])
    assert (empty["best"], empty["optimum"], empty["gap"]) == (None, 0.0, None)


def test_boards_stand_by_task_split_budget_and_cases() -> None:
    rows = [
        row(budget=10**6), row(split="dev"), row(game="h" * 64), row(cases="d" * 64), row(), row(split="round"),
        row(task="unknown"), row(task="exploit-v1"),
    ]  # fmt: skip
    assert [found["title"] for found in boards(rows)] == [
        "exploit-v1, test, 100,000 strokes",
        "exploit-entrance-v1, dev, 100,000 strokes",
        "exploit-entrance-v1, test, 100,000 strokes, game gggggggg, cases cccccccc",
        "exploit-entrance-v1, test, 100,000 strokes, game gggggggg, cases dddddddd",
        "exploit-entrance-v1, test, 100,000 strokes, game hhhhhhhh, cases cccccccc",
        "exploit-entrance-v1, test, 1,000,000 strokes",
        "exploit-entrance-v1, round, 100,000 strokes",
    ]


def test_names_of_strangers_are_escaped_and_short() -> None:
    rows: list[Row] = [row(0.4, method="<b>x</b>|y `z` @all"), row(0.6, method="other", author="")]
    markdown = render(rows)
    assert markdown.index("| 1 | `other` |") < markdown.index("| 2 | `alice/<b>x</b>\\x7cy \\x60z\\x60 @all` |")
    shown = render([row(method=name, author="") for name in ("\u0440po", "\uff50po", "x" * 10**6, "\u200b ")])
    assert all(text in shown for text in ("`\\u0440po`", "`\\uff50po`", f"`{'x' * 60}...`", "`\\u200b`"))
    # What stands before a method never hides it.
    assert f"`ppo{'-' * 21}.../mine`" in render([row(author="ppo" + "-" * 57)])


@pytest.mark.parametrize("given", [{"resume": True, "overwrite": True}, {"workers": 0}, {"workers": 513}])
def test_options_of_runs_are_checked(given: dict[str, Any]) -> None:
    with pytest.raises(SuiteError, match=r"--resume continues a run|workers"):
        SuiteRun(task="exploit-v1", method="ppo", **given)


def test_a_difference_is_of_paired_units() -> None:
    def row(task: str, gains: dict[str, list[float]]) -> Any:
        return {"task": task, "method": "x", "units": {"s": gains}}

    ours, theirs = {"a": [3.0, 5.0], "b": [4.0, 4.0]}, {"a": [1.0, 2.0], "b": [4.0, 3.0]}
    assert difference(row("exploit-v1", ours), row("exploit-v1", theirs))["value"] == pytest.approx((2.5 + 0.5) / 2)
    assert difference(row("equilibrium-v1", ours), row("equilibrium-v1", theirs))["value"] == pytest.approx(-1.5)
    for other in (row("equilibrium-v1", ours), row("exploit-v1", {"a": [1.0, 2.0]}), row("exploit-v1", {**theirs, "b": [1.0]})):
        with pytest.raises(SuiteError, match="x and x have different cases or seeds; run both with the same ones"):
            difference(row("exploit-v1", ours), other)
