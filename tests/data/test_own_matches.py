"""Matches of one's own: simulated ones of a club, with foreign headers and words, and every way to get them wrong."""

import tomllib
from pathlib import Path

import pyarrow as pa
import pytest

from shuttle_marl.commands.data import main
from shuttle_marl.data import DataError, read_matches
from shuttle_marl.data.column_map import COLUMNS, TEMPLATE_CSV, template_map
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import REASONS, Outcome, violations
from shuttle_marl.game import court


def test_the_template_is_a_file_to_start_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["template", "--out", str(tmp_path)]) == 0
    files = [str(tmp_path / name) for name in ("strokes.csv", "columns.toml")]
    assert main(["import", files[0], "--columns", files[1], "--out", str(tmp_path / "x.parquet")]) == 0
    strokes = read_matches(tmp_path / "x.parquet")
    assert strokes["reason"].to_pylist() == [
        REASONS.index(word) for word in ["returned"] * 2 + ["landed"] + ["returned"] * 2 + ["out"]
    ]
    assert set(COLUMNS) <= {line.lstrip("# ").split(" = ")[0] for line in template_map().splitlines()}
    assert tomllib.loads(template_map())["columns"].keys() == set(TEMPLATE_CSV.splitlines()[0].split(","))
    capsys.readouterr()
    for again in (
        ["template", "--out", str(tmp_path)],
        ["import", *files[:1], "--columns", files[1], "--out", str(tmp_path / "x.parquet")],
    ):
        assert main(again) == 1
        assert "already exists" in capsys.readouterr().err
    assert main(["import", files[0], "--columns", files[1], "--out", str(tmp_path / "x.parquet"), "--overwrite"]) == 0


MAP = """
discipline = "MS"
[columns]
match = "match"
rally = "rally"
player = "who"
shot = "shot"
area = "area"
ending = "end"
{more}
"""
ROWS = """match,rally,who,shot,area,end,x,y,side,winner
final,1,Ada,short serve,front-centre,,0.1,2.5,near,
final,1,Bea,lift,back-left,,-2.0,-6.0,far,Ada
final,1,Ada,SMASH,middle-right,landed,-2.0,4.0,near,
final,2,Ada,short serve,front-centre,,0.1,2.5,near,Bea
final,2,Bea,lift,,out,0.5,-7.5,far,
"""


def read(folder: Path, rows: str = ROWS, more: str = "", *, fields: str = MAP) -> pa.Table:
    (folder / "own.csv").write_text(rows, encoding="utf-8")
    (folder / "map.toml").write_text(fields.format(more=more), encoding="utf-8")
    return import_matches(folder / "own.csv", folder / "map.toml").strokes


def test_what_is_not_written_down_is_filled_in(tmp_path: Path) -> None:
    strokes = read(tmp_path)
    assert list(violations(strokes)) == []
    assert strokes["stroke"].to_pylist() == [1, 2, 3, 1, 2]
    assert strokes["height"].to_pylist() == [0, 0, 1, 0, 0]
    assert strokes["opponent"].to_pylist() == ["bea", "ada", "bea", "bea", "ada"]
    assert strokes["game"].to_pylist() == [1] * 5
    assert strokes["source"].to_pylist() == ["own matches"] * 5
    assert [text.split() for text in strokes["inferred"].to_pylist()][1:4] == [["height", "technique"]] * 2 + [["technique"]]
    assert strokes["confidence"].null_count == 5


def test_areas_of_the_striker_are_mirrored(tmp_path: Path) -> None:
    areas = read(tmp_path, fields='areas_seen_by = "striker"\n' + MAP)["area"].to_pylist()
    assert [court.AREAS[a] for a in areas[:3]] == ["front-centre", "back-right", "middle-left"]


def test_coordinates_of_the_court_are_turned(tmp_path: Path) -> None:
    more = 'landing_x = "x"\nlanding_y = "y"\nside = "side"'
    strokes = read(tmp_path, more=more, fields='coordinates = "court"\n' + MAP)
    assert strokes["landing_y"].to_pylist() == [2.5, 6.0, 4.0, 2.5, 7.5]
    assert strokes["landing_x"].to_pylist() == pytest.approx([0.1, 2.0, -2.0, 0.1, -0.5])


def test_the_winner_of_a_rally_says_how_it_ended(tmp_path: Path) -> None:
    fields = MAP.replace('ending = "end"', 'winner = "winner"')
    strokes = read(tmp_path, fields=fields, rows=ROWS.replace("lift,,out", "lift,back-left,out"))
    assert strokes["outcome"].to_pylist() == [0, 0, Outcome.WINNER, 0, Outcome.WINNER]
    assert set(strokes["reason"].to_pylist()) == {REASONS.index("returned"), REASONS.index("unknown")}


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("SMASH", "smahs", 4, "unknown shot 'smahs'; did you mean smash"),
        ("SMASH", "Schmetterball", 4, r"map it in \[values.shot\] to one of short-serve"),
        ("back-left", "midfield", 3, "unknown area 'midfield'"),
        ("final,1,Bea", "final,one,Bea", 3, "rally 'one' is not a number"),
        ("final,2,Bea", "final,2,Cleo", 6, "match 'final' has 3 players"),
        ("final,1,Bea", "final,1,", 3, "who ''; expected a name"),
        ("lift,,out", "lift,,", 6, "neither an ending nor a winner"),
        ("lift,back-left,", "lift,back-left,net", 3, "ending 'net' of a stroke that is not the last"),
        ("final,1,Ada,short serve", "final,1,Ada,clear", 2, "the first stroke of a rally, and no other, is a serve"),
        ("landed,-2.0,4.0,near,", "landed,-2.0", 4, "7 fields instead of 10"),
        ("final,2,Ada", "final,2,Bea", 6, "players alternate in a rally"),
    ],
)
def test_every_problem_is_told_with_its_line(tmp_path: Path, old: str, new: str, line: int, says: str) -> None:
    with pytest.raises(DataError, match=says) as caught:
        read(tmp_path, rows=ROWS.replace(old, new, 1))
    assert caught.value.problems[0].line == line


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ('delimeter = ";"\n' + MAP, "no setting 'delimeter'; did you mean delimiter"),
        ('decimal = ";"\n' + MAP, "decimal = ';'"),
        (MAP + 'gme = "x"', "no column 'gme'; did you mean game"),
        (MAP + 'game = "nowhere"', "missing column nowhere"),
        (MAP + "game = 3", r"\[columns\] game = 3; expected the name of a column, in quotes"),
        (MAP + '[values.shot]\n"x" = "smsh"', "'x' = 'smsh'; expected one of short-serve"),
        (MAP + "[[", "no readable TOML"),
        ('coordinates = "court"\n' + MAP, "needs the column side"),
        ('source = ""\n' + MAP, "expected a line of text"),
        (MAP.replace('shot = "shot"', ""), "lacks shot"),
        (MAP.replace('discipline = "MS"', ""), "unknown discipline"),
        ("columns = 3", "expected a table"),
    ],
)
def test_settings_with_something_wrong(tmp_path: Path, fields: str, says: str) -> None:
    with pytest.raises(DataError, match=says):
        read(tmp_path, fields=fields)


def test_names_may_have_commas_and_spellings_are_merged(tmp_path: Path) -> None:
    rows = ROWS.replace("Bea", '"Müller, Bea"').replace("final,2,Ada", "final,2,A. Lovelace")
    strokes = read(tmp_path, rows=rows, more='[values.player]\n"Ada" = "Lovelace, A."\n"a. lovelace" = "Lovelace, A."\n')
    assert set(strokes["player"].to_pylist()) == {"lovelace-a", "müller-bea"}
    with pytest.raises(DataError, match=r"\[values.player\] 'ada' = ''; expected a name"):
        read(tmp_path, rows=rows, more='[values.player]\n"ada" = ""\n')


def test_blank_rows_are_skipped_and_duplicates_are_named(tmp_path: Path) -> None:
    lines = ROWS.splitlines()
    assert read(tmp_path, rows="\n".join([*lines[:3], "", "," * 9, *lines[3:], ",,,,,,,,,"])).num_rows == 5
    with pytest.raises(DataError, match=r"line 4: duplicate of the row before"):
        read(tmp_path, rows="\n".join([*lines[:3], lines[2], *lines[3:]]))


def test_problems_of_all_kinds_are_listed_once_in_one_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rallies = [ROWS.splitlines()[0]]
    for number in range(1, 40):
        end = "smahs" if number < 30 else "SMASH"
        serve = "clear" if number == 35 else "short serve"
        rallies += [
            f"final,{number},Ada,{serve},front-centre,,,,,",
            f"final,{number},Bea,lift,back-left,,,,,",
            f"final,{number},Ada,{end},middle-right,landed,,,,",
        ]
    (tmp_path / "own.csv").write_text("\n".join(rallies), encoding="utf-8")
    (tmp_path / "map.toml").write_text(MAP.format(more=""), encoding="utf-8")
    flags = ["validate", str(tmp_path / "own.csv"), "--columns", str(tmp_path / "map.toml")]
    assert main(flags) == 1
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 2
    assert "line 4: unknown shot 'smahs'; did you mean smash? (29 times, first here)" in printed[0]
    assert "line 104: expected: the first stroke of a rally, and no other, is a serve" in printed[1]
    with pytest.raises(DataError, match="ending 'landed' contradicts who won") as caught:
        read(tmp_path, rows=ROWS.replace(",far,Ada", ",far,Bea"), more='winner = "winner"')
    assert caught.value.problems[0].line == 4
    with pytest.raises(
        DataError, match=r"and 1 more; `.*python -m shuttle_marl.data validate .*own.csv --columns .*map.toml` li"
    ):
        read(tmp_path, rows=ROWS.replace("SMASH", "smahs").replace("lift,,out", "lift,,ouut"))
    read(tmp_path)
    assert main(flags) == 0
    assert main(flags[:2]) == 1
    assert "columns that the map does not name are not read" in capsys.readouterr().out
