"""Tables in Markdown, and the results that they show."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

ROOT: Final = Path(__file__).parents[2]
IMAGES: Final = ROOT / "docs" / "images"


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[str]) -> str:
    """A table in Markdown; columns are right-aligned but for those headed by a name in ``left``."""
    rule = ["---" if heading in left else "--:" for heading in headings]
    return "\n".join("| " + " | ".join(line) + " |" for line in [headings, rule, *rows])


def saved(folder: Literal["benchmarks", "experiments"], name: str) -> Any:
    """The result that a benchmark or an experiment saved in its folder ``results``, as JSON."""
    result: Any = json.loads((ROOT / folder / "results" / f"{name}.json").read_text(encoding="utf-8"))
    return result
