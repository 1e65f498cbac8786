"""Parts of tournaments and of their pages from a few figures: curves, names of runs, sentences, places of rallies, ratios."""

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import pytest

from shuttle_marl.base import runs
from shuttle_marl.league import LeagueConfig, LeagueError, entrants
from shuttle_marl.league.curves import Curve, learning_charts, read_curve
from shuttle_marl.league.entrants import PAIRINGS, Entrant
from shuttle_marl.league.page.tournament import _improvements, _labels, _names, _pairings, _stroke, _summary, _words
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.report import _away, _percents, meta_game
from shuttle_marl.league.run import _curves, append_results, check_same, continued, log_name, manifest, read_results
from shuttle_marl.league.tournament import (
    BOUND,
    COUNTS,
    MatchOptions,
    PairResult,
    Tournament,
    _counted,
    decided,
    forfeited,
    log_likelihood_ratio,
    round_robin,
    share_of,
)
from shuttle_marl.pages import Cell, charts

NAN = math.nan


def test_points_and_last_figures_of_a_curve() -> None:
    rows: list[dict[str, Any]] = [
        {"seconds": 1, "strokes": 10, "rally_win": 0.5},
        {"seconds": 2, "rally_win": NAN},
        {"seconds": True, "strokes": 30, "rally_win": 0.75},
        {"seconds": 4, "strokes": 40, "rally_win": "x"},
        {"seconds": 5, "strokes": math.inf, "rally_win": 1},
        {"seconds": 6, "strokes": 60},
    ]
    curve = Curve(name="a", rows=rows)
    assert curve.points("rally_win", "seconds") == [(1.0, 0.5), (5.0, 1.0)]
    assert curve.points("rally_win", "strokes") == [(10.0, 0.5), (30.0, 0.75)]
    assert (curve.last("rally_win"), math.isnan(curve.last("exploitability"))) == (1.0, True)


def test_the_last_line_of_a_curve_may_be_incomplete(tmp_path: Path) -> None:
    path = tmp_path / runs.METRICS
    path.write_text('{"a": 1}\n{"a": 2}\n{"a"')
    assert (read_curve(tmp_path, "run").name, read_curve(tmp_path, "run").rows) == ("run", [{"a": 1}, {"a": 2}])
    for content, says in (
        ("{}\n[]\n", "is not a JSON object"),
        ("{\n", "is damaged"),
        ("[" * 9999 + "\n", "nested too deeply|damaged"),
    ):
        path.write_text(content)
        with pytest.raises(LeagueError, match=says):
            read_curve(tmp_path, "run")
    path.unlink()
    with pytest.raises(LeagueError, match="cannot be read"):
        read_curve(tmp_path, "run")


def test_runs_are_drawn_by_strokes_where_all_count_them(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []

    def chart(lines: dict[str, Any], by: str, caption: str, *, logarithmic: bool) -> str | None:
        drawn.append((by, caption, logarithmic, lines))
        return caption if any(lines.values()) else None

    monkeypatch.setattr("shuttle_marl.pages.charts.curves", chart)
    counted = Curve(name="a", rows=[{"seconds": 1, "strokes": 10, "exploitability": 0.5, "rally_win": 0.25}])
    timed = Curve(name="b", rows=[{"seconds": 2, "rally_win": 0.75}])
    empty = Curve(name="c", rows=[{"strokes": 5}])
    assert learning_charts([counted, empty]) == [("Exploitability", "exploitability"), ("Rallies won", "rallies won")]
    assert [each[:3] for each in drawn] == [
        *(("strokes", "exploitability", True), ("strokes", "normalised score", False), ("strokes", "rallies won", False))
    ]
    assert drawn[2][3] == {"a": [(10.0, 0.25)], "c": []}
    drawn.clear()
    learning_charts([counted, timed])
    assert {each[0] for each in drawn} == {"seconds"}
    assert drawn[2][3] == {"a": [(1.0, 0.25)], "b": [(2.0, 0.75)]}


def test_curves_are_those_of_agents_whose_runs_exist(tmp_path: Path) -> None:
    for name, content in (("run", '{"a": 1}\n'), ("bad", "[]\n")):
        (tmp_path / name).mkdir()
        (tmp_path / name / runs.METRICS).write_text(content)
    at = tmp_path.as_posix()
    pool = [f"agent:{at}/run/agent", f"agent:{at}/run/best@0.5", f"agent:{at}/bad/agent", f"agent:{at}/no/agent"]
    pool += [f"table:{at}/run/agent", "agent:", "bc"]
    assert [curve.name for curve in _curves(pool)] == pool[:2]


def test_names_of_runs_are_those_below_their_common_folder(tmp_path: Path) -> None:
    a, b = tmp_path / "x" / "a", tmp_path / "x" / "y" / "b"
    assert _names([a, b]) == ["a", "y/b"]
    assert _names([a]) == ["a"]
    assert _names([tmp_path / "x", a]) == ["x", "a"]
    for folders, says in (([], "give one run or more"), ([a, tmp_path / "x" / "y" / ".." / "a"], "given twice")):
        with pytest.raises(LeagueError, match=says):
            _names(folders)


def test_methods_are_named_by_the_settings_in_which_they_differ() -> None:
    settings = [
        json.dumps({"algorithm": name, "width": 8, "opponent": of}) for name, of in (("ppo", ["bc"]), ("sac", ["bc", "safe"]))
    ]
    assert _labels(settings) == ["algorithm ppo, opponent bc", "algorithm sac, opponent bc and safe"]
    assert _labels(settings[:1]) == ["algorithm ppo, opponent bc"]
    assert _labels(['{"width": 8}', '{"width": 8, "budget": "5m"}']) == ["budget none", "budget 5m"]
    assert _labels(["{}"]) == ["all runs"]
    assert [_words(value) for value in (None, "", [], 0, False, ["a", None])] == [
        "none",
        "none",
        "none",
        "0",
        "False",
        "a and none",
    ]


def test_which_method_is_better_and_by_what() -> None:
    finals = {
        "rally_win": {"a": [0.5, 0.6, 0.7], "b": [0.1, 0.2, 0.3], "c": []},
        "exploitability": {"a": [0.5] * 3, "b": [0.1] * 3},
    }
    found = _improvements(finals)
    rows = [[cell.text for cell in row] for row in found.rows]
    assert [row[:4] for row in rows] == [
        ["a", "b", "rallies won", "100 %"],
        ["b", "a", "rallies won", "0 %"],
        ["a", "b", "exploitability", "0 %"],
        ["b", "a", "exploitability", "100 %"],
    ]


def standing(player: str, rank_low: int = 0, **figures: float) -> Standing:
    usual: dict[str, Any] = dict.fromkeys(
        ("rating", "rating_low", "rating_high", "share", "share_low", "share_high", "rally_share", "serving", "receiving"), NAN
    )
    return Standing(
        **{"rank": 1, "player": player, "matches": 2, "wins": 1, "forfeits": 0, "rank_low": rank_low, **usual, **figures}
    )


def test_who_is_first_in_a_sentence() -> None:
    assert _summary([standing("a"), standing("b")]) == "No matches were played."
    assert _summary([standing("a", 1), standing("b", 2)]).startswith("a is ranked first: no other")
    assert _summary([standing("a", 1), standing("b", 1), standing("c", 1), standing("d", 2)]).startswith(
        "a, b and c share the first rank"
    )


def test_intervals_of_fractions_stay_between_0_and_100() -> None:
    assert _percents(-0.1, 1.2) == Cell("0.0 % to 100.0 %", 1.0)
    assert _percents(math.nan, math.nan) == Cell()
    assert _percents(0.25, 0.5) == Cell("25.0 % to 50.0 %", 0.25)
    assert _away(standing("a", away_share=0.5, away_low=0.25, away_high=0.75)) == Cell("50.0 % (25.0 % to 75.0 %)", 0.5)
    assert _away(standing("a")).text == ""
    assert _stroke("smash", 0.256, None).text == "smash (26 %)"
    assert _stroke("smash", 0.5, 1234.4).text == "smash (50 %, 1,234 real strokes)"


def test_a_meta_game_shows_who_has_weight_in_a_solution() -> None:
    weights = {
        "nash_average": {"a": 0.0, "b": 0.25, "c": 0.0004, "d": 0.0},
        "maximal_lottery": {"a": 0.0, "b": 0.0, "c": 0.0, "d": 0.0005},
        "alpha_rank": {"a": 0.5, "b": 0.0, "c": 0.0004, "d": 0.0},
    }
    found = meta_game("all entrants", weights)
    assert found.caption == "All entrants"
    assert [[cell.text for cell in row] for row in found.rows] == [
        ["a", "0.0 %", "0.0 %", "50.0 %"], ["b", "25.0 %", "0.0 %", "0.0 %"], ["d", "0.0 %", "0.1 %", "0.0 %"],
    ]  # fmt: skip


def result(number: int, rallies: int, pool: str = "abc") -> PairResult:
    pairing = round_robin(pool)[number]
    half = dict.fromkeys(COUNTS, 0) | {
        "matches": 1,
        "wins": 1,
        "rallies": rallies,
        "points_won": rallies // 2,
        "strokes": 10 * rallies,
    }
    return PairResult(pairing=number, names=pairing.names, seats=(half, dict(half)), cells=(0, 0, 1))


@pytest.mark.parametrize(
    ("logs", "record", "places"),
    [
        ({0: "rallies.mcap"}, "all", ["0", "20"]),
        ({0: "rallies.mcap", 2: "rallies-2.mcap"}, "all", ["0 in rallies.mcap", "0 in rallies-2.mcap"]),
        ({0: "rallies.mcap"}, "sample:2", []),
    ],
)
def test_pairings_tell_their_first_rally_in_the_log(logs: dict[int, str], record: str, places: list[str]) -> None:
    results = [result(0, 10), forfeited(round_robin("abc")[1], ["c"], "ill"), result(2, 6)]
    found = _pairings(cast(Any, SimpleNamespace(config=LeagueConfig(record=record), results=results, logs=logs)))
    cells = [[cell.text for cell in row] for row in found.rows]
    assert [row[:6] for row in cells] == [
        ["a", "b", "2", "100.0 %", "50.0 %", "10.00"],
        ["b", "c", "2", "100.0 %", "50.0 %", "10.00"],
    ]
    assert [text for row in cells for text in row[6:]] == places


def test_names_of_logs() -> None:
    assert [log_name(stage) for stage in (0, 1, 9)] == ["rallies.mcap", "rallies-2.mcap", "rallies-10.mcap"]


def about(**changes: Any) -> dict[str, Any]:
    return {"game": {"hash": "g"}, "policies": {"a": "1", "b": "2"}, "sources": {"c": {}}, **changes}


def test_a_run_is_continued_with_the_same_game_and_policies(tmp_path: Path) -> None:
    check_same(tmp_path, about())
    path = tmp_path / runs.MANIFEST
    for known in (about(), {}, about(policies={"a": "1"}), {"game": {"hash": "g"}}):
        path.write_text(json.dumps(known))
        check_same(tmp_path, about())
    for wrong, what in (
        (about(game={"hash": "h"}), "game"), (about(policies={"a": "2"}), "policies"), (about(policies={"d": "1"}), "policies"),
        (about(sources={"c": {"x": "y"}}), "sources"), (about(policies=["a"]), "policies"), (about(game=None), "game"),
    ):  # fmt: skip
        path.write_text(json.dumps(wrong))
        with pytest.raises(LeagueError, match=f"the {what} changed after the run was started"):
            check_same(tmp_path, about())


def test_a_manifest_has_the_hashes_of_tables_and_the_sources_of_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.league.run.source_hashes", lambda name: {f"{name}.py": "x"})
    entrants: Any = [SimpleNamespace(name="a", hash="1"), SimpleNamespace(name="b", hash="")]
    game: Any = SimpleNamespace(hash="g", catalogue=SimpleNamespace(version="v"))
    found = manifest(LeagueConfig(seed=3), game, entrants)
    assert (found["status"], found["seed"]) == ("running", 3)
    assert found["game"] == {"model": "default", "hash": "g", "catalogue": "v"}
    assert (found["policies"], found["sources"]) == ({"a": "1", "b": ""}, {"b": {"b.py": "x"}})
    assert Entrant(name="a", policy=cast(Any, None)).hash == ""


def written(folder: Path, **changes: Any) -> None:
    config = LeagueConfig(pool=("a", "b"), out=folder)
    (folder / runs.CONFIG).write_text(json.dumps({**config.fixed(), **changes}))


def test_the_entrants_of_a_continued_run(tmp_path: Path) -> None:
    def config(*pool: str, **flags: Any) -> LeagueConfig:
        return LeagueConfig(pool=pool, out=tmp_path, **flags)

    with pytest.raises(LeagueError, match="contains no run to extend"):
        continued(config("c", extend=True))
    assert continued(config("a", "b", resume=True)).grown == ()
    written(tmp_path)
    first = continued(config("b", "c", extend=True))
    assert (first.pool, first.grown, first.resume, first.extend) == (("a", "b", "c"), (2,), True, False)
    with pytest.raises(LeagueError, match="all entrants of --pool are already in this run"):
        continued(config("b", extend=True))
    with pytest.raises(LeagueError, match=r"other flags \(seed: 0 then, 1 now"):
        continued(config("c", extend=True, seed=1))
    written(tmp_path, pool=["a", "b", "c", "d"], grown=[2, 3])
    assert continued(config("a", "b")).pool == ("a", "b"), "a new run"
    resumed = continued(config("a", "d", resume=True))
    assert (resumed.pool, resumed.grown) == (("a", "b", "c", "d"), (2, 3))
    assert continued(config("a", "e", resume=True)).pool == ("a", "e"), "other flags, which are refused later"
    more = continued(config("e", extend=True))
    assert (more.pool, more.grown) == (("a", "b", "c", "d", "e"), (2, 3, 4))
    for grown in ([3, 2], [1], [5], [2, 5]):
        written(tmp_path, pool=["a", "b", "c", "d"], grown=grown)
        with pytest.raises(LeagueError, match="expected ascending numbers of entrants"):
            continued(config("a", "b", resume=True))
    written(tmp_path, pool=["a", "b", "c", "d"], grown=[2, 4])
    assert continued(config("a", "b", resume=True)).grown == (2, 4)


def test_results_are_those_of_the_schedule(tmp_path: Path) -> None:
    def read(finished: bool, pool: str = "abc") -> list[PairResult]:
        return read_results(tmp_path, lambda _: round_robin(pool), finished=finished)

    assert read(False) == []
    append_results(tmp_path, [result(0, 10)])
    append_results(tmp_path, [result(1, 4)])
    assert read(False) == [result(0, 10), result(1, 4)]
    path = tmp_path / PAIRINGS
    whole = path.read_bytes()
    path.write_bytes(whole + b'{"pairing": 2')
    assert len(read(False)) == 2
    assert path.read_bytes() == whole, "the incomplete line is gone"
    with pytest.raises(LeagueError, match="pairings are missing"):
        read(True)
    with pytest.raises(LeagueError, match="of another run"):
        read(False, "acb")
    append_results(tmp_path, [result(2, 4)])
    assert len(read(True)) == 3
    path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[1:]))
    with pytest.raises(LeagueError, match="out of order"):
        read(False)
    path.unlink()
    runs.Journal(path).append([{"pairing": -1}])
    with pytest.raises(LeagueError, match="is damaged"):
        read(False)


def test_the_test_of_two_entrants_is_symmetric_and_sure_at_19_to_1() -> None:
    assert share_of(0) == 0.5
    assert share_of(400) == pytest.approx(10 / 11)
    assert pytest.approx(math.log(19)) == BOUND
    assert log_likelihood_ratio((3, 4, 3), 50) == pytest.approx(0, abs=1e-9)
    ratio = log_likelihood_ratio((1, 4, 9), 50)
    assert log_likelihood_ratio((9, 4, 1), 50) == pytest.approx(-ratio)
    assert ratio > 0
    # Only wins: the likeliest distributions have all weight on draws of 1 and 0 at the two means, m and 1 - m.
    mean = share_of(100)
    assert log_likelihood_ratio((0, 0, 1000), 100) == pytest.approx(1000 * math.log(mean / (1 - mean)), rel=1e-3)
    sure = next(n for n in range(1, 99) if decided((0, 0, n), 100))
    assert sure == math.ceil(math.log(19) / math.log(mean / (1 - mean)))
    assert decided((sure, 0, 0), 100)
    assert not decided((0, 0, sure - 1), 100)
    assert np.isfinite(log_likelihood_ratio((0, 0, 0), 10))


@pytest.mark.parametrize(("batch", "size"), [(1, 2), (2, 2), (3, 2), (7, 6), (8, 8), (8192, 8192)])
def test_batches_hold_whole_cells(batch: int, size: int) -> None:
    pool: Any = [SimpleNamespace(table=table) for table in (None, "a", None, "b", "c")]
    found = Tournament(cast(Any, None), pool, MatchOptions(matches=4, seed=0, batch=batch), workers=3)
    assert (found._batch, found._workers) == (size, 3)
    assert found._table_of.tolist() == [-1, 0, -1, 1, 2]
    on_a_cluster = Tournament(cast(Any, None), pool, found._options, cluster=cast(Any, SimpleNamespace(slots=7)))
    assert on_a_cluster._workers == 7


def test_the_game_of_a_tournament_is_that_of_its_players(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entrants, "resolve_game", lambda *about: about)
    monkeypatch.setattr(entrants, "pair_game", lambda *players, **about: (players, about))
    found: Any = LeagueConfig(game="club", profile="men").load()
    assert found == ("club", "men")
    found = LeagueConfig(game="club", profile="men", players=("a", "b"), date="2021-01-02").load()
    assert found == (("a", "b"), {"date": "2021-01-02", "discipline": "men", "game": "club"})


def test_the_default_pool_has_few_players_and_what_the_game_knows(monkeypatch: pytest.MonkeyPatch) -> None:
    names = ["bc", *(f"bc:{letter}" for letter in "abcdefgh"), "bc:history", "random", "safe", "minimax", "ppo", "human:0.05"]
    monkeypatch.setattr("shuttle_marl.policy.registry.names", lambda _: names)
    found = entrants.default_pool(cast(Any, SimpleNamespace(seats=(None, None))))
    assert found == ("bc", *(f"bc:{letter}" for letter in "abcdef"), "safe", "random", "ppo", "minimax")


def test_strokes_are_counted_and_the_progress_is_shown_once() -> None:
    counted: list[int] = []
    half = dict.fromkeys(COUNTS, 0)
    one = PairResult(pairing=0, names=("a", "b"), seats=({**half, "strokes": 5}, {**half, "strokes": 7}))
    task: Any = SimpleNamespace(result=lambda: [(one, []), (one, [])])
    assert _counted(task, counted.append) == [(one, [])] * 2
    assert counted == [24]
    assert _counted(task, None) == [(one, [])] * 2


def texts(drawing: str) -> list[tuple[str, str]]:
    """Texts of a chart with their colours."""
    root = ElementTree.fromstring(drawing)
    return [(each.text or "", each.get("fill") or "") for each in root.iter("{http://www.w3.org/2000/svg}text")]


def titles(drawing: str) -> list[str]:
    root = ElementTree.fromstring(drawing)
    return [each.text or "" for each in root.iter("{http://www.w3.org/2000/svg}title")]


@pytest.mark.parametrize(("n", "shown"), [(3, True), (26, True), (27, False)])
def test_cells_of_payoffs_show_their_number_where_there_is_room(n: int, shown: bool) -> None:
    win = np.full((n, n), NAN)
    win[0, 1], win[1, 0], win[0, 2], win[2, 0] = 0.9, 0.1, 0.77, 0.23
    drawing = str(charts.heat_map([f"p{i}" for i in range(n)], win))
    numbers = {text: colour for text, colour in texts(drawing) if text.isdigit()}
    assert numbers == ({"90": "#ffffff", "10": "#ffffff", "77": "#16191c", "23": "#16191c"} if shown else {})
    assert titles(drawing)[:2] == ["p0 beats p1 in 90.0 % of matches", "p0 beats p2 in 77.0 % of matches"]
    assert len(titles(drawing)) == 4
    root = ElementTree.fromstring(drawing)
    assert float(str(root.get("width"))) == pytest.approx(n * (36 if n == 3 else 800 / n) + 240, abs=1)


def test_ratings_that_are_unknown_are_not_drawn() -> None:
    rows = [("a", 10.0, 5.0, 15.0, 12.0), ("b", NAN, NAN, NAN, 7.0), ("c", 3.0, 1.0, 4.0, NAN), ("d", NAN, NAN, NAN, NAN)]
    drawing = str(charts.forest(rows, "Elo"))
    assert titles(drawing) == [
        *["a: +10 Elo, 95 % +5 to +15"] * 2, "a: exactly +12 Elo", "b: exactly +7 Elo", *["c: +3 Elo, 95 % +1 to +4"] * 2,
    ]  # fmt: skip
    assert {"a", "b", "c", "d"} <= {text for text, _ in texts(drawing)}


def test_curves_keep_their_colours_and_names_do_not_overlap() -> None:
    lines: dict[str, list[tuple[float, float]]] = {
        "a": [(1.0, 1.0), (2.0, 2.0)],
        "b": [],
        "c": [(1.0, 0.0), (2.0, -1.0)],
        "d": [(1.0, 3.0)],
    }
    drawing = str(charts.curves(lines, "strokes", "won"))
    assert [colour in drawing for colour in ("#0b8f66", "#d0553c", "#3f6fd8", "#b8860b")] == [True, False, True, True]
    assert list(dict.fromkeys(titles(drawing))) == ["a", "c", "d"]
    logarithmic = str(charts.curves(lines, "strokes", "won", logarithmic=True))
    assert "#3f6fd8" not in logarithmic, "no point of c is above 0"
    assert charts.curves({"b": [], "c": []}, "strokes", "won") is None
    close = str(charts.scatter({name: (0.5, 1.0 + k / 1000) for k, name in enumerate("wxyz")}, "across", "up"))
    root = ElementTree.fromstring(close)
    placed = [each for each in root.iter("{http://www.w3.org/2000/svg}text") if each.text in set("wxyz")]
    heights = sorted(float(str(each.get("y") or each.get("transform", "").split()[1].strip(")"))) for each in placed)
    assert len(heights) == 4
    assert np.diff(heights).min() > 12
