"""Imports compare every column with those that it repeats, account for every row, and say what they do not understand."""

import json
import os
import re
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
from shuttle_marl.data import DataError, read_matches, validate, write_parquet
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import Cleaned
from shuttle_marl.data.table import load_counted
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
    assert load_counted(tmp_path / "o.parquet")[1].strokes == 6
    assert main(["validate", str(tmp_path / "o.parquet")]) == 0


@pytest.mark.parametrize(("column", "gone", "told"), [
    ("game", [1], "1 games are missing"),
    ("rally", [1, 5, 6], "6 rallies are missing"),
    ("stroke", [2], "[0-9]+ strokes, [0-9]+ last strokes are missing"),
    ("outcome", ["fault"], "[0-9]+ last strokes are missing"),
])  # fmt: skip
def test_rows_that_were_filtered_out_are_missed(tmp_path: Path, column: str, gone: list[object], told: str) -> None:
    case, path = Path(__file__).parent / "cases/games_without_a_column", tmp_path / "t.parquet"
    cleaned = import_matches(case / "match.csv", case / "map.toml")
    write_parquet(cleaned.strokes, path, account=cleaned.account, provenance={})
    assert read_matches(path).num_rows == cleaned.strokes.num_rows
    table = pq.read_table(path)
    without = table.filter(pa.array([value not in gone for value in table[column].to_pylist()]))
    for kept, why in ((without, "the account has .* strokes"), (without.replace_schema_metadata(None), told)):
        pq.write_table(kept, path)
        with pytest.warns(UserWarning, match=why):
            assert read_matches(path).num_rows == without.num_rows
        assert any(re.search(why, str(found)) for report in [validate(path)] for found in (*report.problems, *report.notes))


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
    assert read_matches(tmp_path / "p.parquet").num_rows == load_counted(tmp_path / "p.parquet")[1].strokes == 2
    for change, says in (
        ({"rally": frame["rally"] + 0.5}, "column 'rally' is no int16"),
        ({"player": None}, "column 'player' lacks 5 values"),
        ({"height": 1}, "serves are struck below the net"),
        ({"more": 1}, "expected the columns of a table of"),
    ):
        frame.assign(**change).to_parquet(tmp_path / "p.parquet")
        with pytest.raises(DataError, match=says):
            read_matches(tmp_path / "p.parquet")


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
