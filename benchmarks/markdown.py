"""What benchmarks and the writers of their tables share: where it was measured, saved results, and Markdown."""

import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[1]
RESULTS: Final = ROOT / "benchmarks" / "results"


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]], left: Sequence[str]) -> str:
    """A table in Markdown; columns are right-aligned but for those headed by a name in ``left``."""
    rule = ["---" if heading in left else "--:" for heading in headings]
    return "\n".join("| " + " | ".join(line) + " |" for line in [headings, rule, *rows])


def saved(name: str) -> Any:
    """What a benchmark or an experiment saved under ``benchmarks/results/``."""
    result: Any = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return result


def this_machine() -> dict[str, Any]:
    """Where this process measures: Python, kind of machine, cores; goes into the results of every benchmark."""
    return {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}


def machine(result: dict[str, Any]) -> str:
    """Where it was measured, in words."""
    return f"Python {result['python']}, {result['machine']}, {result['cores']} cores."
