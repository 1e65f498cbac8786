"""Markdown tables, and saved results."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

ROOT: Final = Path(__file__).parents[2]
IMAGES: Final = ROOT / "docs" / "images"


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[str]) -> str:
    """A Markdown table; columns are right-aligned, except for those whose headings are in ``left``."""
    rule = ["---" if heading in left else "--:" for heading in headings]
    return "\n".join("| " + " | ".join(line) + " |" for line in [headings, rule, *rows])


def saved(folder: Literal["benchmarks", "experiments"], name: str) -> Any:
    """Load a result from the folder ``results`` of the benchmarks or experiments."""
    result: Any = json.loads((ROOT / folder / "results" / f"{name}.json").read_text(encoding="utf-8"))
    return result
