"""Imports compare every column with those that it repeats, account for every row, and say what they do not understand."""

import json
import os
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from shuttle_marl.commands.data import main
from shuttle_marl.data import DataError, load_account, read_matches
from shuttle_marl.data.column_map import COLUMNS, TEMPLATE_CSV
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import Cleaned
from shuttle_marl.game import court
from tests.data.written_matches import as_csv

MAP = """
source = "club"
discipline = "WS"
[columns]
match = "match"
rally = "rally"
player = "who"
shot = "shot"
area = "area"
winner = "winner"
"""
ROWS = """\
match,rally,who,shot,area,winner
final,1,Ada Alpha,short serve,front-centre,
final,1,Bea Beta,lift,back-left,
final,1,Ada Alpha,smash,middle-right,Ada Alpha
final,2,Ada Alpha,short serve,front-centre,
final,2,Bea Beta,lift,back-left,Bea Beta
"""


def read(folder: Path, rows: str = ROWS, fields: str = MAP) -> Cleaned:
    (folder / "own.csv").write_text(rows, encoding="utf-8")
    (folder / "map.toml").write_text(fields, encoding="utf-8")
    return import_matches(folder / "own.csv", folder / "map.toml")


def test_the_command_that_lists_all_problems_of_a_file_without_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "own.csv"
    path.write_text(TEMPLATE_CSV.replace("smash", "smahs").replace("push", "pusch"), encoding="utf-8")
    with pytest.raises(DataError, match=r"and 1 more; `.*data validate .*own.csv` lists them all"):
        import_matches(path)
    assert main(["validate", str(path)]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 2
    path.write_text(TEMPLATE_CSV, encoding="utf-8")
    assert main(["validate", str(path)]) == 0


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        ("right,Ada Alpha", "right,Ada Alfa", 4, "winner 'Ada Alfa'; expected one of the players, ada-alpha or bea-beta"),
        ("right,Ada Alpha", "right,1", 4, "winner '1'; expected one of the players"),
        ("right,Ada Alpha", "right,-", 4, "winner '-'; expected one of the players"),
        ("Bea Beta", "-", 3, "who '-'; expected a name with letters or digits"),
        ("Bea Beta", "(?)", 3, "expected a name with letters or digits"),
        ("2,Ada Alpha", "2,Ada-Alpha", 5, "'Ada-Alpha' and 'Ada Alpha' would be one player, ada-alpha"),
        ("2,Bea Beta", "2,BEA BETA", 6, "would be one player, bea-beta"),
        ("smash", "Schläger" * 90, 4, "…'; map it in"),
        ('middle-right,Ada Alpha\n', 'middle-right,"Ada Alpha\n', 6, "quotation mark"),
        ("back-left,\n", '"back-left\nfinal,2,Ada Alpha,short serve,front-centre,",\n', 4, "lines that look like rows"),
    ],
)  # fmt: skip
def test_what_is_not_understood_is_refused_with_its_line(tmp_path: Path, old: str, new: str, line: int, says: str) -> None:
    with pytest.raises(DataError) as caught:
        read(tmp_path, ROWS.replace(old, new) if old == "Bea Beta" else ROWS.replace(old, new, 1))
    assert says in str(caught.value)
    assert caught.value.problems[0].line == line


def test_spreadsheets_state_the_delimiter_and_begin_with_a_mark(tmp_path: Path) -> None:
    expected = read(tmp_path).strokes
    assert read(tmp_path, "sep=,\n" + ROWS, "\ufeff" + MAP).strokes.equals(expected)
    assert read(tmp_path, "\ufeffsep=,\r\n" + ROWS.replace("\n", "\r\n")).strokes.equals(expected)
    with pytest.raises(DataError, match="several columns area; rename or remove all but one"):
        read(tmp_path, "\n".join(f"{row},{'' if number else 'area'}" for number, row in enumerate(ROWS.splitlines())))
    with pytest.raises(DataError, match="the delimiter is ';' here"):
        read(tmp_path, "sep=;\n" + ROWS)
    with pytest.raises(DataError, match="line 5: unknown shot 'smahs'"):
        read(tmp_path, "sep=,\n" + ROWS.replace("smash", "smahs"))


def test_names_are_compared_in_one_normal_form(tmp_path: Path) -> None:
    rows = ROWS.replace("2,Bea Beta", "2,B\u00e9a Beta").replace("Bea Beta", "Be\u0301a Beta")
    strokes = read(tmp_path, rows, MAP.replace("[columns]", '[values.shot]\n"Scha\u0308del" = "smash"\n[columns]')).strokes
    assert set(strokes["player"].to_pylist()) == {"ada-alpha", "b\u00e9a-beta"}
    with pytest.raises(DataError, match="twice, with different meanings"):
        read(tmp_path, fields=MAP + '[values.shot]\n"Hit" = "smash"\n"HIT" = "clear"\n')
    with pytest.raises(DataError, match="player and winner are both 'who'"):
        read(tmp_path, fields=MAP.replace('winner = "winner"', 'winner = "who"'))


SCORED = """\
match,rally,who,shot,area,winner,p,q,t
final,1,Ada,short serve,front-centre,,{0},{1},1.9
final,1,Bea,lift,back-left,Ada,{1},{0},3.2
final,2,Ada,short serve,front-centre,,{2},{3},20
final,2,Bea,lift,back-left,Bea,{3},{2},21
"""
SCORE_MAP = MAP + 'points = "p"\npoints_opponent = "q"\nseconds = "t"\n'


@pytest.mark.parametrize(
    ("score", "says"),
    [
        (("10.7", 0, 5, 5), "p 10.7; expected a whole number from 0 to 30"),
        ((10, 0, 5, 5), "does not follow from who won"),
        ((1, 0, 2, 0), "score 0:2 after 0:1, 1 rallies before: it does not follow from who won"),
        ((0, 1, 0, 2), "does not follow from who won"),
        ((1, 0, 1, 2), "does not follow from who won"),
    ],
)
def test_the_score_follows_from_who_won(tmp_path: Path, score: tuple[object, ...], says: str) -> None:
    with pytest.raises(DataError, match=says):
        read(tmp_path, SCORED.format(*score), SCORE_MAP)
    fine = read(tmp_path, SCORED.format(1, 0, 1, 1), SCORE_MAP)
    assert fine.warnings == ()
    assert fine.strokes["clock"].to_pylist() == [1, 3, 20, 21]
    with pytest.raises(DataError, match="points and points_opponent, or neither"):
        read(tmp_path, SCORED.format(1, 0, 1, 1), SCORE_MAP.replace('points_opponent = "q"\n', ""))


LI = SCORED.replace("Ada", "Ada Li").format(1, 0, 1, 1)


@pytest.mark.parametrize(
    ("match", "player", "servers", "says"),
    [
        ("second", "\u00c1da Li", "Ada", "'\u00c1da Li' and 'Ada Li' are alike: are they one player"),
        ("second", "\uff21da Li", "Ada", "are alike: are they one player"),
        ("second", "Li, Ada", "Ada", "'Li, Ada' and 'Ada Li' are alike"),
        ("second", "\u0410da Li", "Ada", "are alike: are they one player"),
        ("second", "\u0416da Li", "Ada", "mixes letters of cyrillic and latin"),
        ("FINAL", "Ada Li", "Ada", "'FINAL' and 'final' are alike: are they one match"),
        ("f\u00ednal", "Ada Li", "Ada", "are alike: are they one match"),
        ("second", "Ada Li", "Bea", "line 8: the server did not win the rally before"),
    ],
)
def test_names_that_are_alike_and_servers_are_told(tmp_path: Path, match: str, player: str, servers: str, says: str) -> None:
    second = LI.replace("final", match).splitlines()[1:]
    if servers == "Bea":
        second[2:] = ["second,2,Bea,short serve,front-centre,,1,1,20", "second,2,Ada Li,lift,back-left,Bea,1,1,21"]
    rows = LI + "\n".join(second).replace("Ada Li", f'"{player}"')
    told = read(tmp_path, rows, SCORE_MAP).warnings
    assert [says in text for text in told] == [True]
    assert read(tmp_path, LI, SCORE_MAP).warnings == ()


def test_games_times_and_numbers_that_cannot_be_are_told(tmp_path: Path) -> None:
    fields, rows = SCORE_MAP + 'game = "g"\n', SCORED.format(1, 0, 1, 1).replace("final,", "final,1,").replace("h,r", "h,g,r")
    later = rows.partition("\n")[2].replace("final,1", "final,3")
    assert "line 6: games of the match are missing" in read(tmp_path, rows + later, fields).warnings[0]
    with pytest.raises(DataError, match="line 3: the time is before that of the stroke before"):
        read(tmp_path, rows.replace("1.9", "3.9"), fields)
    with pytest.raises(DataError, match="t '1e308' is too large"):
        read(tmp_path, rows.replace("1.9", "1e308"), fields)


@pytest.mark.parametrize("word", ["let", "重发球", "Diulang"])
@pytest.mark.parametrize("numbers", ["12234", "12345", None])
def test_lets_are_no_rallies(tmp_path: Path, word: str, numbers: str | None) -> None:
    lines = ["rally,who,shot,ending,score"]
    for rally, score in enumerate(("1-0", "2-0", "2-0", "2-1", "2-2")):
        number, ending = numbers[rally] if numbers else "", (word if rally == 1 else "out" if rally % 2 else "landed")
        striker, other = ("Ada", "Bea") if rally < 4 else ("Bea", "Ada")
        lines += [f"{number},{striker},short serve,,", f"{number},{other},lift,,", f"{number},{striker},smash,{ending},{score}"]
    lines[9] = lines[9].replace("out", "landed")
    rows = "\n".join(lines) if numbers else "\n".join(line.partition(",")[2] for line in lines)
    (tmp_path / "own.csv").write_text(rows)
    cleaned = import_matches(tmp_path / "own.csv")
    assert cleaned.account.dropped == {"let": 3}
    assert cleaned.strokes["rally"].to_pylist() == np.repeat([1, 2, 3, 4], 3).tolist()
    assert cleaned.warnings == ()


@pytest.mark.parametrize(
    ("content", "rows"),
    [
        (ROWS.replace("smash", "smahs"), 5), (ROWS + ",,,,,\n\nfinal,3,Cleo,clear,middle,Cleo\n", 7), ("", 0),
        (ROWS.splitlines()[0], 0), ("a,b\n1,2\n", 0), (ROWS + "final\n", 6), ("\x00\x01", 0), ("<x/>", 0), ("[1", 0),
    ],
)  # fmt: skip
def test_a_refused_file_accounts_for_its_rows(
    content: str, rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    read(tmp_path)
    (tmp_path / "own.csv").write_text(content)
    assert main(["import", str(tmp_path / "own.csv"), "--columns", str(tmp_path / "map.toml"), "--json"]) == 1
    out, told = capsys.readouterr()
    said = json.loads(out)
    assert (said["rows"], said["kept"], sum(said["dropped"].values())) == (rows, 0, rows)
    assert said["problems"][0] in told


@pytest.mark.parametrize(("scale", "says"), [(1 / 13.4, "are these metres"), (0.3, "are these metres"), (1.4, "a third of")])
def test_coordinates_are_metres(tmp_path: Path, scale: float, says: str) -> None:
    fields = MAP.replace('area = "area"', 'landing_x = "x"\nlanding_y = "y"')
    rng = np.random.default_rng(0)
    lines = ["match,rally,who,shot,x,y,winner"]
    for rally in range(1, 21):
        for i, who in enumerate(("Ada", "Bea", "Ada")):
            x, y = rng.uniform(-2.5, 2.5) * scale, rng.uniform(1, 6.7) * scale
            lines.append(f"m,{rally},{who},{('short serve', 'lift', 'smash')[i]},{x:.3f},{y:.3f},{'Ada' if i == 2 else ''}")
    try:
        told = read(tmp_path, "\n".join(lines), fields).warnings
    except DataError as error:
        told = tuple(str(problem) for problem in error.problems)
        assert scale < 0.1, "what is certainly wrong is refused"
    assert any(says in text for text in told), told


def test_decimal_commas_are_the_same_numbers(tmp_path: Path) -> None:
    fields = MAP.replace('area = "area"', 'landing_x = "x"\nlanding_y = "y"')
    lines = ["match;rally;who;shot;x;y;winner"]
    for rally in range(1, 21):
        for i, who in enumerate(("Ada", "Bea", "Ada")):
            shot, winner = ("short serve", "lift", "smash")[i], "Ada" if i == 2 else ""
            lines.append(f"m;{rally};{who};{shot};{-1.5 + 0.1 * rally + i / 7:.3f};{1.25 + rally / 9 + i:.3f};{winner}")
    points = "\n".join(lines)
    plain = read(tmp_path, points, 'delimiter = ";"\n' + fields).strokes
    commas = read(tmp_path, points.replace(".", ","), 'delimiter = ";"\ndecimal = ","\n' + fields).strokes
    assert commas.equals(plain)
    assert plain["landing_y"][1].as_py() == pytest.approx(1.25 + 1 / 9 + 1, abs=1e-3)


def whole_table(seed: int, rallies: int) -> list[dict[str, str]]:
    """Rows in which every column that may repeat another does."""
    rng = np.random.default_rng(seed)
    players = ("Ada", "Bea")
    rows, score, server = [], [0, 0], 0
    for rally in range(1, rallies + 1):
        length, landing = int(rng.integers(2, 6)), np.zeros(2)
        winner = int(rng.integers(2))
        score[winner] += 1
        for stroke in range(1, length + 1):
            striker, last = (server + stroke - 1) % 2, stroke == length
            contact, landing = -landing, np.array([rng.choice([-1.9, 0.0, 1.9]), rng.choice([1.2, 3.6, 5.9])])
            sign = 1 if striker == 0 else -1
            area = court.AREAS[int(court.area_of(*landing[:, None].astype(np.float32))[0])]
            won = striker == winner
            if last and not won:
                landing = np.array([0.0, 7.5])
                area = "back-centre"
            x, y = sign * landing
            rows.append({
                "match": "final", "discipline": "WS", "game": "1", "rally": str(rally), "stroke": str(stroke),
                "player": players[striker], "opponent": players[1 - striker],
                "shot": "short-serve" if stroke == 1 else str(rng.choice(["clear", "lift", "net-shot"])), "area": area,
                "ending": "" if not last else "landed" if won else "out", "winner": players[winner],
                "points": str(score[striker]), "points_opponent": str(score[1 - striker]), "side": ("near", "far")[striker],
                "landing_x": f"{x}", "landing_y": f"{y}",
                **({"contact_x": "", "contact_y": ""} if stroke == 1 else
                   {"contact_x": f"{sign * contact[0]}", "contact_y": f"{sign * contact[1]}"}),
            })  # fmt: skip
        server = winner
    return rows


WHOLE_MAP = 'coordinates = "court"\n[columns]\n' + "".join(f'{name} = "{name}"\n' for name in whole_table(0, 1)[0])
PLAYERS = ("Ada", "Bea", "Cleo")
SCORES = ("0", "1", "2", "3", "30")
OTHERS = {
    "match": ("semi-final",), "discipline": ("MS",), "game": ("2",), "rally": ("1", "2", "9"), "stroke": ("1", "2", "5", "7"),
    "player": PLAYERS, "opponent": PLAYERS, "winner": PLAYERS, "points": SCORES, "points_opponent": SCORES, "area": court.AREAS,
    "ending": ("", "landed", "out", "net"), "side": ("near", "far"), "contact_x": ("3", "-3"), "contact_y": ("4.2", "-4.2"),
}  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4), st.sampled_from(sorted(OTHERS)), st.data())
def test_one_changed_cell_is_refused_or_told(seed: int, rallies: int, column: str, data: st.DataObject) -> None:
    rows = whole_table(seed, rallies)
    with tempfile.TemporaryDirectory() as folder:
        fine = read(Path(folder), as_csv(rows), WHOLE_MAP)
        assume(not fine.warnings)  # few points may all lie near the net
        assert fine.strokes.num_rows == len(rows)
        row = data.draw(st.integers(0, len(rows) - 1))
        before = rows[row][column]
        rows[row][column] = data.draw(st.sampled_from([value for value in OTHERS[column] if value != before]))
        try:
            told = read(Path(folder), as_csv(rows), WHOLE_MAP).warnings
        except DataError as error:
            told = tuple(map(str, error.problems))
    assert told


def test_import_prints_what_became_of_every_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read(tmp_path, ROWS.replace("smash", "unknown").replace("\nfinal,2", "\n,,,,,\n\nfinal,2", 1).replace("winner\n", "winner\n"))
    flags = ["import", str(tmp_path / "own.csv"), "--columns", str(tmp_path / "map.toml")]
    assert main([*flags, "--json"]) == 0
    inferred = ["contact heights, from the shot types: 2 of 4 strokes", "techniques, taken as forehand: 4 of 4 strokes"]
    lost = ["hand unknown, played as right-handed: ada-alpha, bea-beta (2 of 2 players)"]
    dropped = {"empty row": 1, "unknown shot type": 1}
    expected = {"format": "CSV", "rows": 6, "kept": 4, "dropped": dropped, "inferred": inferred, "lost": lost, "warnings": []}
    assert json.loads(capsys.readouterr().out) == expected
    assert main([*flags, "--out", str(tmp_path / "o.parquet"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == expected
    assert load_account(tmp_path / "o.parquet").strokes == 6
    assert main(["validate", str(tmp_path / "o.parquet")]) == 0


def test_a_file_with_the_names_used_here_needs_no_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.csv").write_text(as_csv([{**row, "note": "x"} for row in whole_table(1, 3)]))
    assert main(["import", str(tmp_path / "own.csv"), "--json"]) == 1
    assert "are not on the sides" not in capsys.readouterr().err
    rows = [{name: value for name, value in row.items() if name[-2:] not in ("_x", "_y")} for row in whole_table(1, 3)]
    (tmp_path / "own.csv").write_text(as_csv([{**row, "note": "x"} for row in rows]))
    assert main(["import", str(tmp_path / "own.csv"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == told["kept"] == len(rows)
    assert ["'note'" in text for text in told["warnings"]] == [True]
    (tmp_path / "own.csv").write_text("a,b\n1,2\n")
    assert main(["import", str(tmp_path / "own.csv")]) == 1
    assert "lacks player, shot, or map your headers with --columns" in capsys.readouterr().err
    assert "stroke" in COLUMNS


def test_a_table_that_went_through_pandas(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pandas = pytest.importorskip("pandas")
    assert read(tmp_path).strokes.num_rows == 5
    flags = ["import", str(tmp_path / "own.csv"), "--columns", str(tmp_path / "map.toml"), "--out", str(tmp_path / "t.parquet")]
    assert main(flags) == 0
    strokes, frame = read_matches(tmp_path / "t.parquet"), pandas.read_parquet(tmp_path / "t.parquet")
    frame.to_parquet(tmp_path / "p.parquet", index=False)
    assert read_matches(tmp_path / "p.parquet").equals(strokes)
    capsys.readouterr()
    assert main(["validate", str(tmp_path / "p.parquet")]) == 0
    assert "another program wrote this file" in capsys.readouterr().out
    frame[frame["rally"] == 2].to_parquet(tmp_path / "p.parquet")
    assert read_matches(tmp_path / "p.parquet").num_rows == load_account(tmp_path / "p.parquet").strokes == 2
    for change, says in (
        ({"rally": frame["rally"] + 0.5}, "column 'rally' is no int16"),
        ({"player": None}, "column 'player' lacks 5 values"),
        ({"height": 1}, "serves are struck below the net"),
        ({"more": 1}, "expected the columns of a table of"),
    ):
        frame.assign(**change).to_parquet(tmp_path / "p.parquet")
        with pytest.raises(DataError, match=says):
            read_matches(tmp_path / "p.parquet")


def test_too_little_memory_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def too_little(*_: object) -> None:
        raise pa.ArrowMemoryError("malloc of size 64 failed")

    monkeypatch.setattr("shuttle_marl.data.table.table_files.read_parquet", too_little)
    assert main(["validate", str(Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet")]) == 1
    assert "not enough memory (malloc of size 64 failed)" in capsys.readouterr().err


def hostile(folder: Path, kind: str) -> list[str]:
    """A hostile file, and the arguments of the command that reads it."""
    folder = folder / kind
    folder.mkdir()
    read(folder)
    path, header = folder / "own.csv", ROWS.splitlines()[0] + "\n"
    contents = {
        "rows": header + "a,1,b,c,d,e\n" * 600_000,
        "short": header + "a\n" * 1_000_000,
        "empty": header + ",,,,,\n" * 600_000,
        "matches": header + "".join(f"f{i},1,p{i % 2},clear,middle,p{i % 2}\n" for i in range(300_000)),
        "cell": header + "x" * 1_000_000,
        "json": "[" + ",".join(['{"shot":"x"}'] * 600_000) + "]",
        "xml": "<file><ALL_INSTANCES>" + "<instance/>" * 2_500_000 + "</ALL_INSTANCES></file>",
    }
    if kind == "large":
        with path.open("wb") as file:
            file.truncate(1 << 36)
    elif kind in contents:
        path.write_text(contents[kind])
    elif kind == "names":
        strokes = read_matches(Path(__file__).parents[2] / "datasets" / "sample" / "strokes.parquet")
        name = pa.DictionaryArray.from_arrays(pa.array(np.zeros(2000, np.int8)), pa.array(["x" * 1_000_000]))
        numbers = pa.array(np.zeros(2000, np.int8))
        columns = {field.name: name if pa.types.is_string(field.type) else numbers for field in strokes.schema}
        pq.write_table(pa.table(columns), folder / "t.parquet", store_schema=False)
        return ["validate", str(folder / "t.parquet")]
    else:
        (folder / "map.toml").write_text("a=" + "[" * 200_000 if kind == "deep" else "a." * 100_000 + "b=1")
    return ["import", str(path), "--columns", str(folder / "map.toml")]


READ_ALL = """
import json, sys
from shuttle_marl.commands.data import main
sys.exit([main(flags) for flags in json.loads(sys.argv[1])] != [1] * len(json.loads(sys.argv[1])))
"""


@pytest.mark.slow
def test_hostile_files_are_refused_in_bounded_memory_and_time(tmp_path: Path) -> None:
    kinds = ("large", "rows", "short", "empty", "matches", "cell", "json", "xml", "names", "deep", "dotted")

    def bounded() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))
        resource.setrlimit(resource.RLIMIT_CPU, (60, 60))  # [s]

    done = subprocess.run(
        [sys.executable, "-c", READ_ALL, json.dumps([hostile(tmp_path, kind) for kind in kinds])],
        preexec_fn=bounded,
        env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert "not enough memory" not in done.stderr, "refused before the memory is used"
