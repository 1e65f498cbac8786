"""The datasheet says what the code does."""

from pathlib import Path

from shuttle_marl.data.schema import DROP_REASONS, STROKES

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
