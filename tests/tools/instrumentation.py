"""Instrumentation of the package for :mod:`tests.tools.mutants`, in a process of tests and the interpreters that it starts.

:func:`note_calls` lets functions, as they are imported from then on, append their names to a file when they are called first. A
profile function would be called for every call of every library, and not in other threads. :func:`change` exchanges modules.
"""

import ast
import builtins
import importlib.machinery
import os
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final, cast

FILE: Final = "SHUTTLE_MARL_CALLS"
"""Variable of the environment: file of the names, one in a line."""
ROOT: Final = "SHUTTLE_MARL_ROOT"
"""Variable of the environment: copy of the repository, whose functions are noted."""
CHANGED: Final = "SHUTTLE_MARL_CHANGED"
"""Variable of the environment: folder of changed files, as in the repository."""
IMPORT: Final = "import "
"""Before the name of a function that the import of a module calls."""
COMPILERS: Final = {"compiled", "_compiled", "inlined", "cached"}
"""Decorators of functions that do not run as Python."""
COMPILED: Final = {"count_rally", "mix"}
"""Functions that are compiled beside their form in Python."""


def note_calls() -> Callable[[str], None]:
    """Note calls from now on; return a function that writes a line between them, after which all are noted again."""
    root, called, write = Path(os.environ[ROOT]), set[str](), os.write  # which tests replace
    package = str(root / "shuttle_marl")
    file = os.open(os.environ[FILE], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    compile_, builtins_ = importlib.machinery.SourceFileLoader.source_to_code, cast(Any, builtins)

    def write_line(line: str) -> None:
        if len(set(resource.getrlimit(resource.RLIMIT_FSIZE))) == 1:  # else a test lowers it
            write(file, f"{line}\n".encode())

    def note(name: str) -> None:
        if name not in called:
            line = f"{IMPORT}{name}" if is_import(sys._getframe(1)) else name
            called.add(line)
            write_line(line)

    def is_import(frame: FrameType | None) -> bool:
        while frame:
            if frame.f_code.co_name == "<module>" and frame.f_code.co_filename.startswith(package):
                return frame.f_globals["__name__"] != "__main__"
            frame = frame.f_back
        return False

    def mark(line: str) -> None:
        called.clear()
        write_line(line)

    def source_to_code(loader: Any, data: Any, path: Any, **options: Any) -> Any:
        if str(path).startswith(package):
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
    return mark


def change() -> None:
    """Import files of the package from the folder of changed files from now on, if they are there."""
    if CHANGED not in os.environ:
        return
    root, changed = Path(os.environ[ROOT]), Path(os.environ[CHANGED])
    get_code = importlib.machinery.SourceFileLoader.get_code
    new = {str(root / path.relative_to(changed)): path.read_bytes() for path in changed.rglob("*.py")}

    def get_changed(loader: Any, fullname: Any) -> Any:
        return compile(new[loader.path], loader.path, "exec") if loader.path in new else get_code(loader, fullname)

    importlib.machinery.SourceFileLoader.get_code = get_changed  # type: ignore


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
