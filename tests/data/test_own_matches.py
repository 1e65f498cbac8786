"""Matches of one's own through the command line: the template, all problems at once, files that are never written, and names."""

import re
import shutil
import tomllib
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from shuttle_marl.commands import analysis, data, dynamics, report
from shuttle_marl.commands.data import main
from shuttle_marl.data import DataError, read_matches
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import REASONS
from shuttle_marl.data.words import COLUMNS, template
from tests.data.test_cases import CASES

FINAL = CASES / "a_match_of_two_games" / "final.csv"


def test_the_template_is_a_file_to_start_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["template", "--out", str(tmp_path)]) == 0
    files = [str(tmp_path / name) for name in ("strokes.csv", "columns.toml")]
    assert main(["import", files[0], "--columns", files[1], "--out", str(tmp_path / "x.parquet")]) == 0
    strokes = read_matches(tmp_path / "x.parquet")
    assert strokes["reason"].to_pylist() == [
        REASONS.index(word) for word in ["returned"] * 2 + ["landed"] + ["returned"] * 2 + ["out"]
    ]
    header = (tmp_path / "strokes.csv").read_text(encoding="utf-8").splitlines()[0].split(",")
    written = tomllib.loads((tmp_path / "columns.toml").read_text(encoding="utf-8"))
    assert written["columns"] == {name: name for name in COLUMNS if name in header}
    capsys.readouterr()
    for again in (
        ["template", "--out", str(tmp_path)],
        ["import", *files[:1], "--columns", files[1], "--out", str(tmp_path / "x.parquet")],
    ):
        assert main(again) == 1
        assert "already exists" in capsys.readouterr().err
    assert main(["import", files[0], "--columns", files[1], "--out", str(tmp_path / "x.parquet"), "--overwrite"]) == 0


@pytest.mark.parametrize("mapped", [True, False])
def test_all_problems_are_listed_once(mapped: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "own.csv").write_text(
        template("strokes.csv").replace("smash", "smahs").replace("push", "pusch"), encoding="utf-8"
    )
    (tmp_path / "map.toml").write_text(template("columns.toml"), encoding="utf-8")
    flags = [str(tmp_path / "own.csv"), *(["--columns", str(tmp_path / "map.toml")] if mapped else [])]
    with pytest.raises(DataError, match=r"and 1 more; `.*data validate .*own.csv.* lists them all") as caught:
        import_matches(Path(flags[0]), tmp_path / "map.toml" if mapped else None)
    assert (" --columns " in str(caught.value)) == mapped
    assert main(["validate", *flags]) == 1
    assert len(capsys.readouterr().out.splitlines()) == 2
    (tmp_path / "own.csv").write_text(template("strokes.csv"), encoding="utf-8")
    assert main(["validate", *flags]) == 0


def test_no_match_goes_on_after_a_player_retired(tmp_path: Path) -> None:
    rallies = ["game,rally,player,opponent,shot,ending", "1,1,ada,bea,short serve,out", "1,2,bea,ada,short serve,retired"]
    (tmp_path / "own.csv").write_text("\n".join(rallies), encoding="utf-8")
    assert read_matches(tmp_path / "own.csv")["reason"].to_pylist()[-1] == REASONS.index("stopped")
    (tmp_path / "own.csv").write_text("\n".join([*rallies, "1,3,ada,bea,short serve,out"]), encoding="utf-8")
    with pytest.raises(DataError, match="line 3: ending 'retired'; this ends a match, and rallies of it follow; remove them"):
        read_matches(tmp_path / "own.csv")


@pytest.mark.parametrize(("column", "cells", "told"), [
    ("winner", ("bea", "bea", "ada"), "winner 'ada' of the rally .* nobody won; expected no winner"),
    ("score", ("0-1", "0-2", "1-2"), "points rise in the rally .* nobody won; expected those before it"),
    ("score", ("0-1", "0-2", "0-2"), ""),
])  # fmt: skip
def test_nobody_wins_the_rally_in_which_a_player_retired(
    column: str, cells: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = ("1,1,ada,bea,short serve,out", "1,2,bea,ada,short serve,landed", "1,3,bea,ada,short serve,retired")
    lines = [
        f"game,rally,player,opponent,shot,ending,{column}",
        *(f"{row},{cell}" for row, cell in zip(rows, cells, strict=True)),
    ]
    (tmp_path / "own.csv").write_text("\n".join(lines), encoding="utf-8")
    assert main(["validate", str(tmp_path / "own.csv")]) == 0
    printed = capsys.readouterr().out
    assert re.search(f"line 4: {told}", printed) if told else "expected" not in printed, printed


def test_one_match_under_two_names_is_not_fitted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "o.parquet")
    assert main(["import", str(CASES / "one_match_under_two_names" / "another_name.csv"), "--out", out]) == 0
    capsys.readouterr()
    assert main(["validate", out]) == 0
    assert "has the strokes of game 1 of 'final'" in capsys.readouterr().out
    with pytest.warns(UserWarning, match="has the strokes of game 1 of 'final': are they one"):  # also where it is not fitted
        read_matches(out)
    assert dynamics.main(["fit", "--data", out, "--out", str(tmp_path / "m"), "--validation-share", "0.5"]) == 1
    assert "would count its strokes twice" in " ".join(capsys.readouterr().err.split())


def test_no_output_is_an_input(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    content, fields = FINAL.read_text(encoding="utf-8"), 'discipline = "WS"\n'
    Path("strokes.csv").write_text(content)
    Path("map.toml").write_text(fields)
    Path("hard.csv").hardlink_to("strokes.csv")
    Path("folder").mkdir()
    Path("folder/strokes.csv").write_text(content)
    assert data.main(["import", "strokes.csv", "--columns", "map.toml", "--out", "match.parquet"]) == 0
    table_before = Path("match.parquet").read_bytes()
    for command, arguments in (
        (report.main, "match.parquet --out match.parquet"),
        (report.main, f"match.parquet --out {tmp_path}/folder/../match.parquet"),
        (report.main, "strokes.csv --out hard.csv"),
        (report.main, "strokes.csv --columns map.toml --out map.toml"),
        (data.main, "import strokes.csv --out strokes.csv --overwrite"),
        (data.main, "import strokes.csv --columns map.toml --out map.toml --overwrite"),
        (analysis.main, "folder/strokes.csv --out folder"),
        (analysis.main, "match.parquet --against folder/strokes.csv --out folder"),
    ):
        capsys.readouterr()
        assert command(arguments.split()) == 1, arguments
        assert "is not written, because it is" in " ".join(capsys.readouterr().err.split()), arguments
    assert Path("match.parquet").read_bytes() == table_before
    assert Path("strokes.csv").read_bytes() == Path("folder/strokes.csv").read_bytes() == content.encode()
    assert Path("map.toml").read_text() == fields
    assert not Path("page.html").exists()


def test_no_name_is_left_in_a_pseudonymous_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(FINAL, "Anna Example v Berta.csv")
    Path("Berta.xml").write_text(FINAL.with_name("sportscode.xml").read_text().replace(">ending<", ">Coach of Anna<"))
    Path("map.toml").write_text('discipline = "WS"\n')
    for name in ("Anna Example v Berta.csv", "Berta.xml"):
        out = Path(name + ".parquet")
        flags = ["import", name, "--columns", "map.toml", "--anonymous", "--hand", "Anna Example=left", "--out", str(out)]
        assert data.main(flags) == 0
        told = pq.read_table(out)
        assert b"anna" not in repr((told.schema.metadata, told.to_pylist())).lower().encode(), name
        assert b"berta" not in repr((told.schema.metadata, told.to_pylist())).lower().encode(), name
        assert data.main(["validate", str(out)]) == 0
