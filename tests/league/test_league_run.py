"""A tournament as a user sees it: the run folder, and that nothing but the flags decides what is in it."""

import functools
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import seal
from shuttle_marl.base.runs import LOCK, MANIFEST, RunError
from shuttle_marl.base.table_files import csv_bytes
from shuttle_marl.commands.cli import console
from shuttle_marl.commands.league import main
from shuttle_marl.game import default_game, load_game, scoring
from shuttle_marl.game.policy import TabulatedPolicy, tabulate
from shuttle_marl.game.rules import FAULT
from shuttle_marl.game.scoring import RULES
from shuttle_marl.league import LeagueConfig, LeagueError, default_pool, run_league
from shuttle_marl.league.entrants import ANCHORS, enter
from shuttle_marl.league.page import console_table
from shuttle_marl.league.ranking import exact_odds, rank, ranking_table, ratings
from shuttle_marl.league.tournament import forfeited, round_robin
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording import RallyLog, RecordingError
from shuttle_marl.recording.reader import check
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.stops import Killed, stop

POOL = ("random", "safe", "attacking")
SAME = (
    "config.json",
    "pairings.jsonl",
    "results.csv",
    "results.parquet",
    "ranking.csv",
    "report.json",
    "report.html",
    "rallies.mcap",
)
"""Files that the flags alone decide; the manifest also says when."""


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run; look, do not touch."""
    out = tmp_path_factory.mktemp("league") / "run"
    run_league(LeagueConfig(pool=POOL, game=reduced_model(), matches=20, seed=5, out=out))
    return out


@pytest.fixture
def small(small_model: str) -> dict[str, Any]:
    """Settings of a run that takes a fraction of a second."""
    return {"pool": ("random", "safe"), "matches": 2, "game": small_model, "exact": False}


def files(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


def test_the_run_folder_is_complete(finished: Path) -> None:
    assert {path.name for path in finished.iterdir()} == {*SAME, "manifest.json", LOCK}
    manifest = json.loads((finished / "manifest.json").read_text())
    assert manifest["status"] == "finished"
    assert manifest["game"]["hash"] == reduced_game().hash
    assert manifest["seed"] == 5
    assert set(manifest["policies"]) == set(POOL)
    assert {"numpy", "pyarrow", "mcap"} <= set(manifest["packages"])
    csv = pyarrow.csv.read_csv(finished / "results.csv")
    parquet = pyarrow.parquet.read_table(finished / "results.parquet")
    assert csv.num_rows == parquet.num_rows == 6
    assert csv.column_names == parquet.column_names
    for name in ("matches", "wins", "rallies", "strokes", "mean_rally_length"):
        assert csv.column(name).to_pylist() == parquet.column(name).to_pylist()
    ratings = {row["player"]: row["rating"] for row in json.loads((finished / "report.json").read_text())["ranking"]}
    ranking = {row["player"]: row["rating"] for row in pyarrow.csv.read_csv(finished / "ranking.csv").to_pylist()}
    assert ([*ranking], ranking) == ([*ratings], pytest.approx(ratings, abs=1e-6))


def test_the_figures_are_the_written_ones(finished: Path) -> None:
    rows = (finished / "results.csv").read_text().splitlines()
    page = (finished / "report.html").read_text()
    heads, cells = re.findall("<th[^>]*>", page), re.findall("<td[^>]*>([^<]*)", page)
    report = json.loads((finished / "report.json").read_text())
    golden.check("league", report | {"made_by": None, "report.html": heads, "cells": cells, "results.csv": rows})


def test_the_log_reproduces_the_results_exactly(finished: Path) -> None:
    expected: Counter[tuple[int, int, str]] = Counter()
    with RallyLog(finished / "rallies.mcap") as log:
        names = [player.name for player in log.header.policies]
        pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        score: scoring.Score | None = None
        for _, batch in log.batches():
            outcome = batch.outcome(log.catalogue)
            for i in range(len(batch)):
                pairing = int(batch.pairing[i])
                seat = names.index(pairs[pairing][0]) == batch.policy[i, 1]
                first, last = batch.first_stroke[i : i + 2]
                if score is None:
                    assert batch.rally[i] == 0
                    score = scoring.Score(server=int(batch.match[i] >> 1) & 1)
                striker = (score.server + last - first - 1) % 2
                winner = 1 - striker if outcome[last - 1] == FAULT else striker
                served = score.server == seat
                games = score.games
                score = score.after(int(winner))
                counts = {
                    "rallies": 1,
                    "strokes": int(last - first),
                    "points_won": winner == seat,
                    "points_lost": winner != seat,
                    "served": served,
                    "served_won": served and winner == seat,
                    "games_won": score.games[int(seat)] - games[int(seat)],
                    "games_lost": score.games[1 - int(seat)] - games[1 - int(seat)],
                    "matches": score.over,
                    "wins": score.winner == seat,
                }
                for name, count in counts.items():
                    expected[pairing, int(seat), name] += int(count)
                if score.over:
                    score = None
    rows = pyarrow.parquet.read_table(finished / "results.parquet").to_pylist()
    names_of_counts = {name for _, _, name in expected}
    found = {(row["pairing"], row["seat"], name): row[name] for row in rows for name in names_of_counts}
    assert found == dict(expected)
    assert check(finished / "rallies.mcap", reduced_game()).problems == ()


def test_the_same_flags_give_the_same_bytes(finished: Path, tmp_path: Path) -> None:
    again = LeagueConfig(pool=POOL, game=reduced_model(), matches=20, seed=5, out=tmp_path / "again", batch=6)
    run_league(again)
    assert files(again.out) == files(finished)
    run_league(LeagueConfig(pool=POOL, game=reduced_model(), matches=20, seed=6, exact=False, out=tmp_path / "other"))
    assert files(tmp_path / "other")["results.csv"] != files(finished)["results.csv"]


def test_without_a_log_the_results_are_the_same(finished: Path, tmp_path: Path) -> None:
    run_league(LeagueConfig(pool=POOL, game=reduced_model(), matches=20, seed=5, out=tmp_path / "run", record="none"))
    assert not (tmp_path / "run" / "rallies.mcap").exists()
    for name in ("results.csv", "results.parquet", "ranking.csv"):
        assert (tmp_path / "run" / name).read_bytes() == (finished / name).read_bytes()


def test_every_place_at_which_a_run_can_stop(tmp_path: Path, small_model: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # What takes time, and is not about files.
    monkeypatch.setattr("shuttle_marl.league.ranking.ratings", functools.partial(ratings, replicates=2))
    monkeypatch.setattr("shuttle_marl.base.runs.describe", lambda packages: {})
    config: dict[str, Any] = {"pool": POOL, "matches": 2, "batch": 2, "game": small_model, "exact": False}
    run_league(LeagueConfig(**config, out=tmp_path / "whole"))
    expected = files(tmp_path / "whole")
    for when in range(1, 60):
        out = tmp_path / f"stop-{when}"
        with monkeypatch.context() as patch:
            stop(patch, when, "fsync", "replace")
            try:
                run_league(LeagueConfig(**config, out=out))
            except Killed:
                pass
            else:
                assert when > 10
                return
        if (out / "config.json").exists():
            run_league(LeagueConfig(**config, out=out, resume=True))
            assert files(out) == expected, f"stopped at write {when}"
    pytest.fail("the run never ended")


def test_a_torn_last_line_is_played_again(finished: Path, tmp_path: Path) -> None:
    config: dict[str, Any] = {"pool": POOL, "game": reduced_model(), "matches": 20, "seed": 5, "exact": False}
    config["out"] = tmp_path / "run"
    run_league(LeagueConfig(**config, record="none"))
    path = tmp_path / "run" / "pairings.jsonl"
    text = path.read_bytes()
    path.write_bytes(text[:-30])
    (tmp_path / "run" / "manifest.json").unlink()
    with pytest.raises(RunError, match="an unfinished run"):
        run_league(LeagueConfig(**config, record="none"))
    run_league(LeagueConfig(**config, record="none", resume=True))
    assert path.read_bytes() == text
    lines = text.splitlines(keepends=True)
    for content in (lines[1], lines[0] + lines[0], lines[0] + lines[2], text + lines[2]):
        path.write_bytes(content)
        with pytest.raises(LeagueError, match="missing, out of order, or of another run"):
            run_league(LeagueConfig(**config, record="none", resume=True))
    for content in (text[:-1], text[:-30], lines[0], b""):
        path.write_bytes(content)
        with pytest.raises(ShuttleError, match=r"missing|incomplete"):
            run_league(LeagueConfig(**config, record="none", resume=True))
        assert path.read_bytes() == content
    run_league(LeagueConfig(**config | {"seed": 6, "out": tmp_path / "other"}, record="none"))
    path.write_bytes((tmp_path / "other/pairings.jsonl").read_bytes())
    with pytest.raises(LeagueError, match="missing, out of order, or of another run"):
        run_league(LeagueConfig(**config, record="none", resume=True))
    first = json.loads(lines[0])
    del first["checksum"]
    contradicting: list[dict[str, Any]] = [
        {"seats": [{}, {}]},
        {"seats": [first["seats"][0] | {"wins": 21}, first["seats"][1]]},
        {"forfeit": ["nobody"]},
    ]
    for change in contradicting:
        path.write_bytes(seal(first | change, indent=None) + b"".join(lines[1:]))
        with pytest.raises(LeagueError, match="the counts of pairing 0 contradict each other"):
            run_league(LeagueConfig(**config, record="none", resume=True))


def test_names_and_reasons_are_never_markup(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rich would take ``[/data]`` for the end of a style."""
    results = [forfeited(round_robin(["[/evil]|\x1b[2J", "=b_`*<i>"])[0], ["=b_`*<i>"], "no file")]
    standings = rank(results[0].names, results, 0)
    console().print(console_table(standings))
    printed = capsys.readouterr().out
    assert "[/evil]|\\x1b[2J" in printed
    assert "=b_`*<i> (forfeited 1)" in printed
    assert b"'=b_" in csv_bytes(ranking_table(standings))


def test_a_finished_run_is_never_overwritten_silently(
    small: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = run_league(LeagueConfig(**small))
    second = run_league(LeagueConfig(**small))
    assert [first.folder, second.folder] == [Path("runs/league-0"), Path("runs/league-0-2")]
    before = files(first.folder)
    with pytest.raises(RunError, match="contains a finished run; --resume continues it, --overwrite replaces it"):
        run_league(LeagueConfig(**small, out=first.folder))
    again = run_league(LeagueConfig(**small, out=first.folder, resume=True))
    assert repr(again.standings) == repr(first.standings)  # NaN is not equal to itself
    assert again.results == first.results
    assert files(first.folder) == before
    run_league(LeagueConfig(**{**small, "matches": 4}, out=first.folder, overwrite=True))
    assert files(first.folder)["results.csv"] != before["results.csv"]
    with pytest.raises(RunError, match="no run to resume named league-0"):
        run_league(LeagueConfig(**small, resume=True))


def test_a_policy_without_a_table_that_changed_is_not_resumed(
    small_model: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    source = tmp_path / "by_score.py"
    source.write_text(
        "def uniform(states):\n    return states.legal / states.legal.sum(1, keepdims=True)\nuniform.reads_score = True\n"
    )
    pool = ("by_score:uniform", "random")
    config: dict[str, Any] = {"pool": pool, "matches": 2, "game": small_model, "exact": False, "out": tmp_path / "run"}
    folder = run_league(LeagueConfig(**config)).folder
    about = json.loads((folder / "manifest.json").read_text())
    assert set(about["sources"]["by_score:uniform"]) == {"by_score.py"}
    (folder / "manifest.json").write_text(json.dumps({**about, "status": "running"}))
    source.write_text(source.read_text() + "# changed\n")
    with pytest.raises(RunError, match="the sources changed"):
        run_league(LeagueConfig(**config, resume=True))


def test_what_cannot_be_resumed(small: dict[str, Any], tmp_path: Path) -> None:
    config = {**small, "out": tmp_path / "run"}
    with pytest.raises(RunError, match="no run to resume in"):
        run_league(LeagueConfig(**config, resume=True))
    run_league(LeagueConfig(**config))
    with pytest.raises(RunError, match=r"other flags \(matches: 2 then, 4 now; seed: 0 then, 1 now\)"):
        run_league(LeagueConfig(**{**config, "matches": 4, "seed": 1}, resume=True))
    manifest = tmp_path / "run" / "manifest.json"
    about = json.loads(manifest.read_text())
    manifest.write_text(json.dumps({**about, "status": "running", "policies": {"random": "0", "safe": "1"}}))
    with pytest.raises(RunError, match="the policies changed"):
        run_league(LeagueConfig(**config, resume=True))
    manifest.write_text("{")
    with pytest.raises(RunError, match="cannot be read"):
        run_league(LeagueConfig(**config, resume=True))
    manifest.unlink()
    log = tmp_path / "run" / "rallies.mcap"
    for change in ({"seed": 1}, {"matches": 4}):
        run_league(LeagueConfig(**config | change | {"out": tmp_path / "other"}, overwrite=True))
        log.write_bytes((tmp_path / "other/rallies.mcap").read_bytes())
        for state in ("running", "finished"):
            manifest.write_text(json.dumps({**about, "status": state}))
            with pytest.raises(LeagueError, match="the log of another run"):
                run_league(LeagueConfig(**config, resume=True))
    manifest.unlink()
    log.unlink()
    with pytest.raises(RecordingError, match="is missing"):
        run_league(LeagueConfig(**config, resume=True))


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ({"matches": 10**30}, "expected `int` <= 10000000"),
        ({"matches": 7}, "expected an even number"),
        ({"batch": 0}, "expected `int` >= 1"),
        ({"seed": -1}, "expected `int` >= 0"),
        ({"pool": ("safe", "random", "safe")}, "names safe twice"),
        ({"pool": ("safe",)}, "needs two entrants"),
        ({"rounds": 3}, "with --format swiss"),
        ({"workers": 0}, "--workers 0: expected `int` >= 1"),
        ({"date": "2021-01-01"}, "give both"),
    ],
)
def test_impossible_flags(flags: dict[str, Any], says: str) -> None:
    with pytest.raises(LeagueError, match=says):
        LeagueConfig(**flags)


def test_an_unknown_entrant_stops_everything_before_it_begins(tmp_path: Path) -> None:
    with pytest.raises(ShuttleError, match="did you mean safe"):
        run_league(LeagueConfig(pool=("sefe", "random"), out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()
    with pytest.raises(ShuttleError, match="no model 'nothing'"):
        run_league(LeagueConfig(game="nothing", out=tmp_path / "run"))


def test_the_default_pool_holds_only_what_can_play_the_game(
    small_model: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert {*ANCHORS, "attacking", "defensive", "safe", "random"} <= set(default_pool(default_game()))
    assert default_pool(load_game(small_model)) == ("attacking", "defensive", "safe", "random", "minimax")
    assert main(["--game", small_model, "--matches", "2", "--out", str(tmp_path / "run")]) == 0
    printed = capsys.readouterr()
    assert "minimax" in printed.out
    assert re.search(r"strokes in [\d.]+ s, [1-9][\d,]* a second", printed.err)


def test_the_command_prints_the_table_and_a_forfeit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_broken.py").write_text(
        "def policy(states):\n    raise FileNotFoundError('no file in [/data] given \x1b[2J')\n"
    )
    out = tmp_path / "[/run]"
    flags = ["--pool", "safe", "my_broken:policy", "random", "--matches", "10", "--out", str(out), "--policy-timeout", "0"]
    flags += ["--game", reduced_model()]
    assert main(flags) == 0
    printed = capsys.readouterr()
    assert "my_broken:policy (forfeited 2)" in printed.out
    assert "no file in [/data] given \\x1b[2J" in printed.err
    assert "\x1b" not in printed.err + printed.out
    assert f"run folder: {out}" in printed.out
    assert printed.out.index("safe") < printed.out.index("random") < printed.out.index("my_broken")
    rows = pyarrow.csv.read_csv(out / "results.csv").to_pylist()
    assert all(row["reason"].startswith("policy 'my_broken:policy' raised") for row in rows if row["forfeit"])
    assert "my_broken:policy&#39; raised" in (out / "report.html").read_text()
    assert [row["forfeit"] for row in rows] == ["my_broken:policy"] * 2 + [""] * 2 + ["my_broken:policy"] * 2
    assert main(flags) == 1
    assert "contains a finished run" in capsys.readouterr().err


def test_without_exact_figures_the_results_are_the_same(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"pool": ("bc", "random"), "matches": 4, "game": reduced_model()}
    runs = [run_league(LeagueConfig(**settings, exact=exact, out=tmp_path / str(exact))) for exact in (True, False)]
    assert runs[0].results == runs[1].results
    assert [np.isnan(run.standings[0].exploitability) for run in runs] == [False, True]


def test_matches_to_eleven_points(tmp_path: Path) -> None:
    out = tmp_path / "run"
    run_league(LeagueConfig(pool=POOL, game=reduced_model(), matches=20, rules="11", exact=False, out=out))
    assert not check(out / "rallies.mcap", reduced_game()).problems
    with RallyLog(out / "rallies.mcap") as log:
        batches = [batch for _, batch in log.batches()]
    match, winner, score = (np.concatenate([getattr(batch, name) for batch in batches]) for name in ("match", "winner", "score"))
    last = np.flatnonzero(np.r_[match[1:] != match[:-1], True])
    points, games = score[last, winner[last]] + 1, score[last, 2 + winner[last]]
    # Best of five: the winner had two games before the last rally, which gave the 11th to 15th point.
    assert (games == 2).all()
    assert points.min() == 11
    assert points.max() <= 15
    odds = exact_odds(reduced_game(), [enter(name, reduced_game()) for name in POOL], rules=RULES["11"]).match
    assert "11 points" in (out / "report.html").read_text()
    assert not np.allclose(odds, exact_odds(reduced_game(), [enter(name, reduced_game()) for name in POOL]).match)


def test_a_policy_that_changes_the_working_directory_moves_no_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "elsewhere").mkdir()
    lines = ("import os", "os.chdir('elsewhere')", "def policy(states):", "    os.chdir('/')")
    last = "    return states.mask / states.mask.sum(axis=1, keepdims=True)"
    (tmp_path / "mover.py").write_text("\n".join((*lines, last)))
    config = LeagueConfig(pool=("mover:policy", "safe"), matches=2, game=reduced_model(), exact=False, out=Path("run"))
    run = run_league(config)
    assert (tmp_path / "run" / MANIFEST).exists()
    assert not any(result.forfeit for result in run.results)
    assert run.folder == Path("run")


def test_saves_of_one_policy_are_equal(tmp_path: Path) -> None:
    game = reduced_game()
    policy = tabulate(resolve("safe", game), game)
    paths = [tmp_path / f"{i}.safetensors" for i in range(5)]
    for path in paths:
        policy.save(path, {"policy": "safe", "made": "here", "b": "c"})
        game.save(path.with_suffix(".game"))
    assert len({path.read_bytes() for path in paths}) == 1
    assert len({path.with_suffix(".game").read_bytes() for path in paths}) == 1
    assert TabulatedPolicy.load(paths[0], game).hash == policy.hash
