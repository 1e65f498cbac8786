"""References to parts of the package in docstrings and on the pages of the documentation lead somewhere."""

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
REFERENCE = re.compile(r":\w+:`~?(shuttle_marl[\w.]*)`|(?:from|import) (shuttle_marl[\w.]*)|``(shuttle_marl(?:\.\w+)+)``")
FOLDERS = ("shuttle_marl", "docs", "benchmarks", "experiments")


def leads_somewhere(reference: str) -> bool:
    """Whether a dotted name is a module, or an attribute of one at any depth."""
    parts = reference.rstrip(".").split(".")
    for depth in range(len(parts), 0, -1):
        try:
            found: object = importlib.import_module(".".join(parts[:depth]))
        except ModuleNotFoundError:
            continue
        for name in parts[depth:]:
            if not hasattr(found, name) and name not in getattr(found, "__annotations__", {}):
                return False
            found = getattr(found, name, None)
        return True
    return False


def test_references_lead_somewhere() -> None:
    files = [path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*")) if path.suffix in (".py", ".md")]
    found = {(name, path) for path in files for match in REFERENCE.finditer(path.read_text()) for name in match.groups() if name}
    missing = [f"{path.relative_to(ROOT)}: {name}" for name, path in sorted(found) if not leads_somewhere(name)]
    assert not missing, "\n".join(missing)
