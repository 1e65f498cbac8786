"""Which functions of the package are called, in a process of tests, its forks, and the interpreters that it starts.

:func:`start` lets functions, as they are imported from then on, append their names to a file when they are called first. A
profile function would be called for every call of every library, and not in other threads.
"""

import ast
import builtins
import importlib.machinery
import os
import resource
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, cast

FILE: Final = "SHUTTLE_MARL_CALLS"
"""Variable of the environment: file of the names, one in a line."""
ROOT: Final = "SHUTTLE_MARL_ROOT"
"""Variable of the environment: copy of the repository, whose functions are noted."""
COMPILERS: Final = {"compiled", "_compiled", "inlined", "cached"}
"""Decorators of functions that do not run as Python."""
COMPILED: Final = {"count_rally"}
"""Functions that are compiled beside their form in Python."""


def start() -> None:
    """Note calls from now on."""
    root, called, write = Path(os.environ[ROOT]), set[str](), os.write  # which tests replace
    file = os.open(os.environ[FILE], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    compile_, builtins_ = importlib.machinery.SourceFileLoader.source_to_code, cast(Any, builtins)

    def note(name: str) -> None:
        if name not in called:
            called.add(name)
            sizes = resource.getrlimit(resource.RLIMIT_FSIZE)  # which tests lower
            resource.setrlimit(resource.RLIMIT_FSIZE, (sizes[1], sizes[1]))
            write(file, f"{name}\n".encode())
            resource.setrlimit(resource.RLIMIT_FSIZE, sizes)

    def source_to_code(loader: Any, data: Any, path: Any, **options: Any) -> Any:
        if Path(str(path)).is_relative_to(root / "shuttle_marl"):
            source, data = Path(path).relative_to(root).as_posix(), ast.parse(data)
            for function, name in list(_functions(data)):
                at = function.lineno
                call = ast.parse(f"note_call({f'{source}:{name}'!r})").body
                function.body[ast.get_docstring(function) is not None : 0] = call
                ast.increment_lineno(call[0], at - 1)
        return compile_(loader, data, path, **options)

    builtins_.note_call = note
    sys.pycache_prefix = f"{root}-bytecode"
    importlib.machinery.SourceFileLoader.source_to_code = source_to_code  # type: ignore


def is_compiled(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> bool:
    """Whether a function does not run as Python."""
    names = {name.id for d in node.decorator_list for name in ast.walk(d) if isinstance(name, ast.Name)}
    return bool(names & COMPILERS) or node.name in COMPILED


def _functions(node: ast.AST, scope: str = "") -> Iterator[tuple[ast.FunctionDef, str]]:
    """Functions that Python runs, with their qualified names."""
    for child in ast.iter_child_nodes(node):
        inner = scope
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if is_compiled(child):
                continue
            is_class = isinstance(child, ast.ClassDef)
            inner = f"{scope}{child.name}." if is_class else f"{scope}{child.name}.<locals>."
            if isinstance(child, ast.FunctionDef):
                yield child, scope + child.name
        yield from _functions(child, inner)
