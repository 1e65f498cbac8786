"""Every file that was ever handed over, and what is right: folders in ``cases``, with ``expected.json`` beside the files.

``expected.json`` maps the label of each case to an object; the entries of ``all`` hold for every case of the folder.

- ``input``, ``map``: a file of the folder, or a list of lines; ``name``: what the input is called.
- ``change``, ``change_map``: texts of the input and of the map, and those in their place.
- ``refused``: words of the problems; an input without this entry is read.
- ``said``, ``unsaid``: words that are, or are not, among the warnings and what was inferred or lost; ``warnings``: words of each.
- ``format``, ``rows``, ``kept``, ``dropped``: the account of the rows.
- ``strokes``: values by column; ``counts``: numbers of some values by column.
- ``score_before``: points and games before rallies of the live court, by number.
- ``commands``: run in a folder with ``table.parquet``, the imported input, the last one after ``copies`` of files; ``printed``
  and ``unprinted``: words of it; ``json``: entries of what it prints; ``files``: words of files.
- ``issue``: what is not right yet; the case has to fail until this entry is removed.
"""

import json
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from shuttle_marl.data import Cleaned, DataError, named, write_parquet
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import violations
from shuttle_marl.game import default_game

CASES: Final = Path(__file__).parent / "cases"
PATIENCE: Final = 30
"""Time of the processor after which a command hangs [s]."""


def cases() -> Iterator[Any]:
    for path in sorted(CASES.glob("*/expected.json")):
        told = json.loads(path.read_text(encoding="utf-8"))
        usual = told.pop("all", {})
        for label, own in told.items():
            case = usual | own
            marks = [pytest.mark.slow] if "commands" in case else []
            if "issue" in case:
                marks.append(pytest.mark.xfail(reason=case["issue"], strict=True, raises=AssertionError))
            yield pytest.param(path.parent, case, id=f"{path.parent.name}: {label}", marks=marks)


def written(told: str | list[str], changes: dict[str, str], folder: Path, path: Path) -> Path:
    """The file of an entry, after its changes."""
    text = "\n".join(told) if isinstance(told, list) else (folder / told).read_bytes().decode()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.encode())
    return path


def compare(case: dict[str, Any], cleaned: Cleaned, file: Path) -> None:
    account, strokes, told = cleaned.account, cleaned.strokes, cleaned.provenance
    assert list(violations(strokes)) == []
    assert account.strokes == account.strokes_kept + sum(account.dropped.values())
    said = "\n".join((*cleaned.warnings, *told["inferred"], *told["lost"]))
    assert [words for words in case.get("said", ()) if words not in said] == [], said
    assert [words for words in case.get("unsaid", ()) if words in said] == [], said
    if "warnings" in case:
        assert len(case["warnings"]) == len(cleaned.warnings), said
        assert all(words in warning for words, warning in zip(case["warnings"], cleaned.warnings, strict=True)), said
    found = {"format": told["format"], "rows": account.strokes, "kept": len(strokes), "dropped": account.dropped}
    assert {name: value for name, value in found.items() if name in case} == {n: case[n] for n in found if n in case}
    values = {name: column.to_pylist() for name, column in zip(strokes.column_names, named(strokes).columns, strict=True)}
    for name, expected in case.get("strokes", {}).items():
        assert values[name] == (pytest.approx(expected, abs=1e-3) if float in map(type, expected) else expected), name
    for name, counts in case.get("counts", {}).items():
        assert {value: values[name].count(value) for value in counts} == counts, name
    if "score_before" in case:
        from shuttle_marl.court.recorded import RealRallies

        court = RealRallies(file, default_game(), strokes)
        scores = {number: court.rally(int(number) - 1).score for number in case["score_before"]}
        assert {number: [[*score.points], [*score.games]] for number, score in scores.items()} == case["score_before"]


def run(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "shuttle_marl", *words], capture_output=True, text=True, encoding="utf-8", check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE)),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(("folder", "case"), cases())
def test_a_case_gives_what_is_right(folder: Path, case: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "input" in case:
        name = case.get("name", "final" if isinstance(case["input"], list) else Path(case["input"]).name)
        file = written(case["input"], case.get("change", {}), folder, Path(name))
        columns = written(case["map"], case.get("change_map", {}), folder, Path("map.toml")) if "map" in case else None
        if "refused" in case:
            with pytest.raises(DataError) as caught:
                import_matches(file, columns)
            problems = "\n".join(map(str, caught.value.problems))
            assert [words for words in case["refused"] if words not in problems] == [], problems
            assert case.get("rows", caught.value.rows) == caught.value.rows
            return
        cleaned = import_matches(file, columns)
        compare(case, cleaned, file)
        write_parquet(cleaned.strokes, Path("table.parquet"), account=cleaned.account, provenance=dict(cleaned.provenance))
    if "commands" in case:
        *before, last = case["commands"]
        for command in before:
            run(*command.split())
        for old, new in case.get("copies", {}).items():
            shutil.copy(old, new)
        printed = run(*last.split())
        assert all(words in printed for words in case.get("printed", ())), printed
        assert not any(words in printed for words in case.get("unprinted", ())), printed
        if "json" in case:
            assert json.loads(printed) | case["json"] == json.loads(printed)
        for name, words in case.get("files", {}).items():
            assert words in Path(name).read_text(encoding="utf-8"), name
