"""Reports as pages: what they say, that text from outside stays text, and in a browser that they work without a network."""

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from shuttle_marl import __version__
from shuttle_marl.base import runs
from shuttle_marl.base.intervals import interquartile_mean, probability_of_improvement
from shuttle_marl.commands.league import main
from shuttle_marl.league import LeagueConfig, LeagueError
from shuttle_marl.league.assessment import assess
from shuttle_marl.league.page import Curve, compare, console_table, page
from shuttle_marl.league.ranking import ExactOdds, rank
from shuttle_marl.league.tournament import COUNTS, PairResult, forfeited, round_robin
from shuttle_marl.reports import charts
from tests import golden
from tests.pages import parsed

EVIL = "</script><script>alert(1)</script><img src=http://example.org/x>\x1b[2J"
POOL = ("bc", "minimax", EVIL, "fails")


def tournament() -> dict[str, Any]:
    """A tournament of four, one of whom has a dangerous name and another forfeits."""
    rng = np.random.default_rng(0)
    results = []
    for pairing in round_robin(POOL):
        if "fails" in pairing.names:
            results.append(forfeited(pairing, ["fails"], "it <b>broke</b>"))
            continue
        won = int(rng.integers(10, 40))
        half = dict.fromkeys(COUNTS, 0) | {"matches": 50, "wins": won, "rallies": 4000, "points_won": 2000, "strokes": 36_000}
        results.append(
            PairResult(pairing=pairing.number, names=pairing.names, seats=(half, dict(half)), cells=(50 - won, 0, won))
        )
    match = np.full((4, 4), np.nan)
    match[:2, :2] = [[0.5, 0.1], [0.9, 0.5]]
    exact = ExactOdds(
        names=POOL,
        match=match,
        exploitability=np.array([0.4, 0, math.nan, math.nan]),
        normalised_score=np.array([0, 0.8, math.nan, math.nan]),
    )
    standings = rank(POOL, results, 0, exact)
    return {
        "config": LeagueConfig(pool=POOL),
        "game": "0" * 64,
        "standings": standings,
        "results": results,
        "assessment": assess(standings, results, exact),
    }


def test_text_from_outside_is_text() -> None:
    found = parsed(page(**tournament()))
    names = [tag for tag, _ in found.tags]
    assert names.count("script") == names.count("style") == 1
    assert "img" not in names
    assert "b" in names  # the page's own
    assert "it <b>broke</b>" in found.words
    assert any(EVIL.replace("\x1b", "\\x1b") in word for word in found.words)
    for tag, attributes in found.tags:
        assert not any(key.startswith("on") or key == "style" for key in attributes), (tag, attributes)
        for key in ("href", "src"):
            assert re.match(r"#|data:,|[a-z.]+$", attributes.get(key) or "#"), attributes
    policy = next(a["content"] for t, a in found.tags if a.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy


def test_payoffs_are_shaded() -> None:
    found = parsed(page(**tournament()))
    shaded = {(each["class"], each["data-key"]) for tag, each in found.tags if tag == "td" and each.get("data-key")}
    assert {("shade-9", "0.9"), ("shade-1", "0.1")} <= shaded


def test_text_in_charts_is_text() -> None:
    names = [EVIL, "$x^2$ & y", "_hidden", "\N{SNOWMAN}"]
    points = {name: (i, float(i + 1)) for i, name in enumerate(names)}
    drawing = charts.curves({name: [(0.0, 1.0), point] for name, point in points.items()}, "across", "up", logarithmic=True)
    assert drawing is not None
    found = parsed(drawing.encode())
    assert {tag for tag, _ in found.tags} <= {"svg", "g", "defs", "path", "use", "text", "title", "clippath", "rect", "tspan"}
    assert not any("style" in attributes for _, attributes in found.tags)
    for name in names:
        label = name.replace("\x1b", "\\x1b")
        assert any(label[:25] in word for word in found.words), name
    assert charts.curves({"a": [(1.0, 0.0)], "b": []}, "across", "up", logarithmic=True) is None


def test_charts_are_those_that_somebody_looked_at() -> None:
    points = {"one": [(0.5, 0.2), (2.0, 0.4)], "two": [(1.0, 0.1), (30.0, 0.9)]}
    drawings = {
        "curves": charts.curves(points, "across", "up"),
        "curves, logarithmic": charts.curves(points, "across", "up", logarithmic=True),
    }
    golden.check("charts", {name: golden.drawing(str(drawing)) for name, drawing in drawings.items()}, 0.01)


def test_a_curve_of_one_point_is_a_point() -> None:
    one, two = (charts.curves({"a": [(1.0, 2.0), (2.0, 3.0)][:n]}, "across", "up") for n in (1, 2))
    assert str(one).count("<use") > str(two).count("<use")


def test_the_middle_half_and_the_probability_of_improvement() -> None:
    found = interquartile_mean([[1.0, 2.0, 3.0, 100.0], [2.0, 2.0, 3.0, -50.0]])
    assert found.value == pytest.approx(2.25)
    assert found.low <= found.value <= found.high
    assert interquartile_mean([[2.0, 2.0]]) == (2, 2, 2)
    assert math.isnan(interquartile_mean([[2.0]]).low)
    rng = np.random.default_rng(0)
    ours, theirs = rng.normal(0.5, 1, 9).round(1).tolist(), rng.normal(0, 1, 7).round(1).tolist()
    better = probability_of_improvement(ours, theirs)
    assert better.value == pytest.approx(mannwhitneyu(ours, theirs).statistic / 63)
    assert better.low < better.value < better.high <= 1
    assert probability_of_improvement([1.0, 1.0], [1.0, 1.0]).value == 0.5


def training_run(folder: Path, seed: int, entropy: float, end: float) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps({"algorithm": "ppo", "seed": seed, "entropy": entropy}))
    rows = [{"strokes": 100 * i, "seconds": i, "exploitability": end + 0.5 / i, "rally_win": 0.5} for i in range(1, 6)]
    runs.Journal(folder / "metrics.jsonl").append(rows)
    with (folder / "metrics.jsonl").open("a") as file:
        file.write('{"strokes": 6')  # by a process that was killed
    return folder


def test_runs_side_by_side(tmp_path: Path, small_model: str, capsys: pytest.CaptureFixture[str]) -> None:
    folders = [training_run(tmp_path / f"e{e}-{s}", s, e, e + s / 100) for e in (0.1, 0.2) for s in range(3)]
    for seed in ("1", "2"):
        flags = ["--pool", "random", "safe", "--game", small_model, "--matches", "4", "--record", "none", "--seed", seed]
        assert main([*flags, "--out", str(tmp_path / f"t{seed}")]) == 0
        folders.append(tmp_path / f"t{seed}")
    assert main(["report", *map(str, folders), "--out", str(tmp_path / "all.html")]) == 0
    assert "all.html" in capsys.readouterr().out
    words = parsed((tmp_path / "all.html").read_bytes()).words
    for expected in ("t1: rank", "t2: rank", "safe", "entropy 0.1", "entropy 0.2", "e0.1-0", "0.2100", "100 %", "is better than"):
        assert expected in words, expected
    assert "0.2000 to 0.2200" in words
    golden.check("pages", {"runs side by side": shown(words)})


def shown(words: list[str]) -> list[str]:
    """The words of a page without scripts, styles, and what changes with the version."""
    return [word.strip() for word in words if word.strip() and len(word) < 300 and __version__ not in word]


def test_the_words_of_a_page_are_those_that_somebody_read() -> None:
    golden.check("pages", {"tournament": shown(parsed(page(**tournament())).words)})


def test_one_training_run_has_its_last_evaluation_and_settings(tmp_path: Path) -> None:
    words = parsed(compare([training_run(tmp_path / "run", 0, 0.1, 0.2)])).words
    for expected in ("Last evaluation", "exploitability", "0.3", "Settings", "entropy", "0.1"):
        assert expected in words, expected
    assert "seeds" not in words
    assert "Comparison" not in words
    golden.check("pages", {"a training run": shown(words)})


def test_what_cannot_be_compared(tmp_path: Path) -> None:
    run = training_run(tmp_path / "run", 0, 0.1, 0.1)
    (tmp_path / "empty").mkdir()
    for folders, says in (
        ([], "give one run"),
        ([run, run], "given twice"),
        ([run, training_run(tmp_path / "copy", 0, 0.1, 0.1)], "run and copy are the same run"),
        ([tmp_path / "empty"], "neither a finished tournament"),
        ([tmp_path / "gone"], "neither a finished tournament"),
    ):
        with pytest.raises(LeagueError, match=says):
            compare(folders)
    for content, says in (
        (b"{\n", "damaged"),
        (b"[]\n", "not a JSON object"),
        (b"\xff\n", "damaged"),
        (b"[" * 9999 + b"\n", "damaged"),
    ):
        (run / "metrics.jsonl").write_bytes(content)
        with pytest.raises(runs.RunError, match=says):
            compare([run])
    row = dict.fromkeys(("rank", "rating", "rating_low", "rating_high", "rating_exact", "group"), 1)
    for rows, says in (
        ([{"player": "a"}], "not the report of a tournament"),
        ([row | {"player": "a"}] * 2, "a player is ranked twice"),
        ([row | {"player": str(i)} for i in range(1001)], "more than 1,000 are ranked"),
        ([row | {"player": "a", "rating_low": 2}], "an interval ends before it begins"),
    ):
        (tmp_path / "empty" / "report.json").write_text(json.dumps({"ranking": rows}))
        with pytest.raises(LeagueError, match=says):
            compare([tmp_path / "empty"])


def test_the_console_shows_few_columns_of_the_ranking() -> None:
    shown = console_table(tournament()["standings"]).columns
    brief = ["", "player", "rating", "95 % interval", "matches won", "exact", "rallies won", "exploitability", "normalised"]
    assert [column.header for column in shown] == brief


def test_points_and_last_figures_of_a_curve() -> None:
    rows: list[dict[str, Any]] = [
        {"seconds": 1, "strokes": 10, "rally_win": 0.5},
        {"seconds": 2, "strokes": 20, "rally_win": None, "policy": "main-agent-0@2"},
        {"seconds": 5, "rally_win": 1},
        {"seconds": 6, "strokes": 60},
    ]
    curve = Curve(name="a", rows=rows)
    assert curve.points("rally_win", "seconds") == [(1.0, 0.5), (5.0, 1.0)]
    assert curve.points("rally_win", "strokes") == [(10.0, 0.5)]
    assert (curve.last("rally_win"), math.isnan(curve.last("exploitability"))) == (1.0, True)
    assert math.isnan(curve.last("policy"))
