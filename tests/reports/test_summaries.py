"""Figures of strokes: from rallies written down by hand, from logs beside what was recorded, and the commands."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.analysis import main as analysis
from shuttle_marl.commands.options import RallyGameOptions
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.data import Account, write_parquet
from shuttle_marl.data.schema import REASONS, STROKES, Outcome, violations
from shuttle_marl.data.simulated import stroke_table
from shuttle_marl.game import court
from shuttle_marl.game.pairs import load_skill
from shuttle_marl.game.shipped import load_game, model_folder
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.recording import RallyLog
from shuttle_marl.reports import AnalysisError, charts, rally_table, strokes_of, strokes_of_log, summarise
from shuttle_marl.reports.match import match_report, matches_in
from shuttle_marl.reports.summary import hand_of, players_of, with_hands_of_model
from tests import golden
from tests.recording.conftest import read_rallies
from tests.reduced import reduced_model
from tests.reports.played import strokes_of as rallies

SAMPLE = Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet"


def by_hand() -> pa.Table:
    """Two rallies: ann serves, bea lifts, ann smashes a winner; bea serves, of which only her fault in the net was kept."""
    rows = [
        ("ann", 1, 1, "short-serve", Outcome.RETURNED, "returned", 0, 0.5, 2.2),
        ("bea", 1, 2, "lift", Outcome.RETURNED, "returned", 1, -2.0, 6.0),
        ("ann", 1, 3, "smash", Outcome.WINNER, "landed", 3, 2.0, 4.0),
        ("bea", 2, 3, "drop", Outcome.FAULT, "net", 30, 0.2, -0.1),
    ]
    base = dict.fromkeys(STROKES.names)
    table = [
        {
            **base, "match": "final", "source": "simulated", "discipline": "WS", "game": 1, "rally": rally, "stroke": stroke,
            "player": player, "opponent": "bea" if player == "ann" else "ann", "shot": SHOTS.index(shot), "height": 0,
            "technique": 0, "area": 1, "in_court": y > 0, "landing_x": x, "landing_y": y, "clock": clock, "outcome": outcome,
            "reason": REASONS.index(reason),
        }
        for player, rally, stroke, shot, outcome, reason, clock, x, y in rows
    ]  # fmt: skip
    return pa.Table.from_pylist(table, schema=STROKES)


def test_a_left_handed_receiver_has_the_forehand_side_on_the_left() -> None:
    table, place = by_hand(), STROKES.get_field_index("hand")
    for bea, smash in ((None, 2), (0, 2), (1, 0)):
        hands = pa.array([0, bea, 0, bea], pa.int8())
        areas = pa.array([1, 8, 5, 1], pa.int8())
        told = table.set_column(place, STROKES.field(place), hands).set_column(
            STROKES.get_field_index("area"), STROKES.field("area"), areas
        )
        ann, both = summarise(told, "ann"), summarise(told)
        assert np.flatnonzero(ann.areas).tolist() == [1, 3 + smash]
        assert both.areas[8] == pytest.approx(1 / 3)  # of bea to ann, who is right-handed


def test_a_log_becomes_a_table_of_strokes(tournament: Path) -> None:
    strokes = strokes_of(tournament, rallies=10**9)
    assert strokes.schema.equals(STROKES, check_metadata=True)
    with RallyLog(tournament) as log:
        catalogue, names = log.catalogue, [player.name for player in log.policies]
    rallies = read_rallies(tournament)
    assert strokes.num_rows == len(rallies.stroke)
    assert (strokes["shot"].to_numpy() == catalogue.shot[rallies.stroke]).all()
    good = strokes["outcome"].to_numpy() != Outcome.FAULT
    assert (strokes["area"].to_numpy(zero_copy_only=False)[good] == catalogue.area[rallies.stroke][good]).all()
    table = rally_table(strokes)
    assert table["length"].to_pylist() == rallies.length.tolist()
    seat = np.arange(len(rallies))
    assert table["server"].to_pylist() == [names[i] for i in rallies.policy[seat, rallies.server]]
    assert table["winner"].to_pylist() == [names[i] for i in rallies.policy[seat, rallies.winner]]
    assert list(violations(strokes)) == []


def test_samples_of_a_log_depend_on_the_seed(tournament: Path) -> None:
    with RallyLog(tournament) as log:
        some = strokes_of_log(log, rallies=1)
        assert 0 < some.num_rows <= log.strokes.max()
        assert some.equals(strokes_of_log(log, rallies=1))
        assert not some.equals(strokes_of_log(log, rallies=1, seed=1))


def test_samples_are_balanced_over_pairings(tournament: Path) -> None:
    with RallyLog(tournament) as log:
        few, many = (rally_table(strokes_of_log(log, rallies=n)) for n in (30, 600))
        whole = rally_table(strokes_of_log(log, rallies=10**9))
    for sample, least in ((few, 10), (many, 200)):
        pairing = [name.split("-")[0] for name in sample["match"].to_pylist()]
        counts = {name: pairing.count(name) for name in set(pairing)}
        assert len(counts) == 3
        assert min(counts.values()) >= least
        assert max(counts.values()) < 1.6 * least + 130, "no more than a match too many"
    # Matches are whole.
    match = few["match"].to_pylist()
    assert match.count(match[0]) == whole["match"].to_pylist().count(match[0])


def test_an_empty_table_is_refused(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    pq.write_table(STROKES.empty_table(), tmp_path / "none.parquet")
    with pytest.raises(AnalysisError, match="no strokes; record or convert"):
        strokes_of(tmp_path / "none.parquet")


def test_figures_of_a_tournament(valued: pa.Table) -> None:
    weight = np.arange(len(valued)) % 17
    columns = {}
    for name, column in zip(valued.column_names, valued.columns, strict=True):
        if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            columns[name] = (np.nan_to_num(pc.fill_null(column, 0).to_numpy()) * weight).sum()
    found = {name: summarise(valued, name) for name in players_of(valued)}
    golden.check("summaries", {name: dataclasses.asdict(each) for name, each in found.items()} | columns)


@pytest.mark.slow
def test_the_command(tournament: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analysis([str(tournament), "--against", str(SAMPLE), "--out", str(tmp_path / "out"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found)[-1] == "strokes.parquet"
    assert {"bc", "attacking", "random"} < set(found)
    assert found["attacking"]["rating"] > found["random"]["rating"]
    assert found["strokes.parquet"]["rating"] is None
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "rallies.csv", "rallies.parquet", "strokes.csv", "strokes.parquet",
    }  # fmt: skip
    assert analysis([str(tournament)]) == 0
    assert "attacking" in capsys.readouterr().out
    assert analysis([str(tmp_path / "nothing.mcap")]) == 1


def test_a_number_of_rallies_that_cannot_be_meant(tournament: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analysis([str(tournament), "--rallies", "-1"]) == 1
    assert capsys.readouterr().err == "error: python -m shuttle_marl.analysis: rallies -1: expected a whole number, 1 or more\n"


def test_scores_that_no_match_has(tournament: Path) -> None:
    with RallyLog(tournament) as log:
        rallies, names = log.batch(0)[1], [player.name for player in log.policies]
        score = rallies.score.copy()
        score[:, 2:] = 200
        forged = dataclasses.replace(rallies, score=score)
        with pytest.raises(ShuttleError, match="a score or a length of a rally that no match has"):
            stroke_table(forged, log.catalogue, names, ["match"] * len(rallies), np.random.default_rng(0), looks=log.header.looks)


def test_the_game_is_that_of_the_log_and_never_silently_the_shipped_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from shuttle_marl.league import LeagueConfig, run_league

    config = LeagueConfig(pool=("random", "safe"), matches=2, exact=False, game="default:men", out=tmp_path / "men")
    log = str(run_league(config).folder / "rallies.mcap")
    for command in (analysis, recording):
        words = [log, "--json"] if command is analysis else ["check", log]
        assert command(words) == 0
        assert "replayed with equal outcomes" in capsys.readouterr().out or command is analysis
    assert RallyGameOptions().load_for(Path(log)).hash == load_game("default:men").hash
    own = run_league(dataclasses.replace(config, game=reduced_model(), out=tmp_path / "own")).folder / "rallies.mcap"
    assert analysis([str(own)]) == 1
    assert "which is not shipped; name its model with --game" in capsys.readouterr().err
    assert analysis([str(own), "--game", reduced_model(), "--json"]) == 0
    assert "game:" not in capsys.readouterr().err
    assert analysis([str(SAMPLE), "--json"]) == 0
    assert "game: the shipped one, of elite men's and women's singles; --game MODEL" in capsys.readouterr().err


def test_a_drawn_court_is_symmetric_and_as_large_as_a_court() -> None:
    axes = charts.figure(4, 8).subplots()
    charts.draw_court(axes)
    lines = {tuple(sorted(zip(*map(tuple, line.get_data()), strict=True))) for line in axes.lines}
    for across, along in ((-1, 1), (1, -1)):
        assert {tuple(sorted((across * x, along * y) for x, y in line)) for line in lines} == lines
    (mat,) = axes.patches
    assert {tuple(np.abs(corner)) for corner in mat.get_xy()} == {(court.WIDTH / 2, court.HALF_LENGTH)}


def test_a_report_is_of_one_match_of_two() -> None:
    two = rallies("ABw", "ABw", match="xy")
    assert matches_in(two) == ["x", "y"]
    three = rallies("ABw", "Cw")
    for wrong, says in (
        (two, "2 matches of 2 players"),
        (three, "1 matches of 3 players"),
        (STROKES.empty_table(), "0 matches of 0"),
    ):
        with pytest.raises(AnalysisError, match=says):
            match_report(wrong)


MEN = ("viktor-axelsen", "kento-momota")


def test_hands_are_those_of_the_table_and_else_of_the_model() -> None:
    strokes = rallies("BCw", "BCw", hand=[None, 0, None, None])
    named = strokes.set_column(strokes.column_names.index("player"), STROKES.field("player"), pa.array(MEN * 2))
    assert [hand_of(named, name) for name in (*MEN, "x")] == [None, "right", None]
    told = with_hands_of_model(named, load_skill(model_folder()))
    assert told["hand"].to_pylist() == [0, 0, 0, 1], "the table comes first, row by row"


def test_files_without_strokes(tmp_path: Path) -> None:
    empty = STROKES.empty_table()
    write_parquet(empty, tmp_path / "e.parquet", account=Account.of(empty), provenance={})
    with pytest.raises(AnalysisError, match="no strokes; record or convert some first"):
        strokes_of(tmp_path / "e.parquet")
    assert players_of(rallies("ABAw", "Cw", "Dw")) == ["A", "B", "C", "D"], "most strokes first, then by name"
