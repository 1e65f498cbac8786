"""The datasheet says what the code does."""

from pathlib import Path

import pytest

from shuttle_marl.data import matches_of, upstream
from shuttle_marl.data.schema import DROP_REASONS, STROKES
from shuttle_marl.game import court

DATASHEET = Path(__file__).parents[2] / "docs" / "datasheet.md"
LINES = DATASHEET.read_text(encoding="utf-8").splitlines()


def test_fields() -> None:
    expected = [
        f"| `{f.name}` | {f.type} | {'yes' if f.nullable else 'no'} | {f.metadata[b'description'].decode()} |" for f in STROKES
    ]
    start = LINES.index("| field | type | null | meaning |") + 2
    assert LINES[start : start + len(expected) + 1] == [*expected, ""]


def test_drop_reasons() -> None:
    start = LINES.index("| dropped because | rows | that is |") + 2
    rows = [line.split(" | ") for line in LINES[start : LINES.index("", start)]]
    assert [(row[0].removeprefix("| "), row[2].removesuffix(" |")) for row in rows] == list(DROP_REASONS.items())


def test_splits() -> None:
    for split in ("train", "validation", "test"):
        assert any(line.startswith(f"| {split} | {len(matches_of(split))} |") for line in LINES)


@pytest.mark.parametrize("metres", [court.HALF_WIDTH, court.HALF_LENGTH, court.SIDE_CUT, court.MIDDLE_CUT, court.BACK_CUT])
def test_drawing(metres: float) -> None:
    assert any(f"= {metres:.2f}" in line or f"= +{metres:.2f}" in line for line in LINES)


def test_citations_and_licence() -> None:
    text = " ".join(LINES)
    assert "2306.04948" in text
    assert "2306.15664" in text
    assert upstream.LICENCE_NOTE.partition(";")[0] in text
