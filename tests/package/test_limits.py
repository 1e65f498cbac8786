"""Limits of sizes, times and counts: a change of one is a decision, so their list is written down."""

import ast
import importlib
from pathlib import Path

import shuttle_marl
from shuttle_marl.data.schema import RANGES
from tests import golden

PACKAGE = Path(shuttle_marl.__file__).parent
NAMES = ("MAX", "MOST", "LEAST", "MIN", "LONGEST", "LIMIT")


def test_limits_are_those_that_somebody_decided() -> None:
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.AnnAssign) and (name := ast.unparse(node.target)).lstrip("_").startswith(NAMES):
                found[f"{module}.{name}"] = getattr(importlib.import_module(module), name)
    assert len(found) > 100
    golden.check("limits", found | {"ranges of columns": RANGES})
