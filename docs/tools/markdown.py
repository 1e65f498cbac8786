"""Markdown tables, saved results, and files that are generated."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file

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


def write_or_check(path: Path, text: str, *, check: bool, problem: str = "outdated") -> None:
    """Write a generated file, or check it.

    Args:
        path: file.
        text: content.
        check: write nothing.
        problem: what the error says of a file with another content.

    Raises:
        ShuttleError: with ``check``, the file does not exist or has another content.
    """
    if not check:
        replace_file(path, text.encode())
    elif not path.is_file() or path.read_text(encoding="utf-8") != text:
        raise ShuttleError(f"{path.name}: {problem}; run this without --check")
