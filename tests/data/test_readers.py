"""Damaged files of other programs, scores in every convention, and the words of seven languages."""

import tempfile
import tomllib
from collections import defaultdict
from importlib.resources import files
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from shuttle_marl.data import DataError
from shuttle_marl.data.column_map import COLUMNS, WORDS
from shuttle_marl.data.inference import read_score, winners_by_score
from shuttle_marl.data.own import import_matches
from shuttle_marl.data.readers.reading import spans_around
from shuttle_marl.data.schema import violations
from shuttle_marl.data.words import LANGUAGES, bare, table
from tests.data.test_cases import CASES

SAMPLES = [path for path in sorted((CASES / "samples_of_each_format").iterdir()) if path.name != "expected.json"]


TIMES = st.integers(0, 12)


@given(spans=st.lists(st.tuples(TIMES, TIMES), max_size=12), moments=st.lists(TIMES, max_size=12))
def test_a_stroke_lies_in_the_last_interval_around_it(spans: list[tuple[int, int]], moments: list[int]) -> None:
    spans.sort()
    expected = [max((i for i, (a, b) in enumerate(spans, 1) if a <= moment <= b), default=0) for moment in moments]
    assert spans_around(spans, moments) == expected


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


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.integers(0, 1), min_size=3, max_size=12).filter(lambda won: len(set(won)) == 2),
    st.integers(0, 2),
    st.booleans(),
    st.integers(0, 1),
)
def test_scores_are_read_in_any_convention(won: list[int], order: int, before: bool, server: int) -> None:
    points, scores, servers, after = [0, 0], [], [], []
    for winner in won:
        start = tuple(points)
        points[winner] += 1
        shown = start if before else tuple(points)
        first = (0, 1, server)[order]
        scores.append((shown[first], shown[1 - first]))
        servers.append(server)
        after.append(tuple(points))
        server = winner
    fresh, zero = np.arange(len(won)) == 0, np.zeros(len(won), np.int64)
    found, winners, reading = winners_by_score(scores, fresh, np.array(servers), np.array(won), zero, zero)
    assert found == after, reading
    assert winners.tolist() == ([*won[:-1], -1] if before else won)
    assert read_score("5\u20133") == read_score(" 5 : 3 ") == (5, 3)
    assert read_score("05-Mar") is None


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
