"""Packages that import their names when they are first used."""

import ast
import pkgutil
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import lazy_loader


def lazily(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package, for the names that its ``__init__.py`` imports under ``if TYPE_CHECKING``.

    Args:
        package: its ``__name__``.
    """
    names: dict[str, list[str]] = defaultdict(list)
    for node in ast.walk(ast.parse(pkgutil.get_data(package, "__init__.py") or b"")):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{package}."):
            names[str(node.module).removeprefix(f"{package}.")] += [alias.name for alias in node.names]
    load, listed, _ = lazy_loader.attach(package, submod_attrs=names)
    return load, listed
