"""Damaged files of other programs, and the words of seven languages."""

import tempfile
import tomllib
from collections import defaultdict
from importlib.resources import files
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.schema import violations
from shuttle_marl.data.words import COLUMNS, LANGUAGES, WORDS, bare, table
from tests.data.test_cases import CASES

SAMPLES = [path for path in sorted((CASES / "samples_of_each_format").iterdir()) if path.name != "expected.json"]


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(SAMPLES), st.integers(0, 20_000), st.binary(max_size=3), st.booleans())
def test_damage_is_told_or_accounted_for(sample: Path, at: int, junk: bytes, cut: bool) -> None:
    content = sample.read_bytes()
    at %= len(content)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "f"
        path.write_bytes(content[:at] + junk + (b"" if cut else content[at + len(junk) :]))
        error, cleaned = None, None
        try:
            cleaned = import_matches(path)
        except DataError as caught:
            error = caught
        if error is not None:
            assert str(path) in str(error)
            return
    account = cleaned.account
    assert account.strokes == account.strokes_kept + sum(account.dropped.values())
    assert account.strokes_kept == cleaned.strokes.num_rows
    assert list(violations(cleaned.strokes)) == []


def test_the_table_has_every_meaning_in_every_language_once() -> None:
    everything = tomllib.loads(files("shuttle_marl.data").joinpath("words.toml").read_text(encoding="utf-8"))
    for kind in ("shot", "height", "technique", "ending", "forced", "discipline", "side", "depth", "side_of_area"):
        for meaning, words in everything[kind].items():
            assert set(words) == set(LANGUAGES), (kind, meaning)
            assert all(words.values())
    for kind in ("column", *WORDS):
        known = COLUMNS if kind == "column" else WORDS[kind]
        assert set(everything[kind]) <= set(known)
        for language, meant in table(kind).items():
            assert set(meant.values()) <= set(known), (kind, language)
    for kind in {*WORDS, "column"} - {"area"}:
        meanings: dict[tuple[str, str], set[str]] = defaultdict(set)
        for meaning, words in everything[kind].items():
            for language, spellings in words.items():
                for spelling in spellings:
                    meanings[language, bare(spelling)].add(meaning)
        assert {word: found for word, found in meanings.items() if len(found) > 1} == {}, kind
    areas: dict[tuple[str, str], set[str]] = defaultdict(set)
    for depth, of_depth in everything["depth"].items():
        for side, of_side in everything["side_of_area"].items():
            for language in LANGUAGES:
                for a in of_depth[language]:
                    for b in of_side[language]:
                        areas[language, bare(a + b)].add(f"{depth}-{side}")
                        areas[language, bare(b + a)].add(f"{depth}-{side}")
    assert {word: found for word, found in areas.items() if len(found) > 1} == {}
