"""Lines of code by room and habits of tests, with their budgets: ``python -m docs.tools.size [--json] [--check]``.

A room is a folder of the package. Lines with code are those without blank lines, comments and docstrings. ``typescript`` are the
lines of TypeScript and CSS of the page, without generated files. ``tests.private_accesses`` are private names of the package:
attributes of others than self, cls and foreign modules, imports, and names for setattr, delattr and getattr;
``tests.setattr`` calls of pytest's monkeypatch.setattr and of unittest.mock.patch. Budgets: ``tool.size`` of ``pyproject.toml``.
"""

import ast
import io
import json
import re
import sys
import tokenize
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

PACKAGE: Final = ROOT / "shuttle_marl"
_OUTSIDE: Final = ("benchmarks", "datasets", "docs", "experiments")
_NAMED_TUPLE: Final = ("_asdict", "_fields", "_make", "_replace")  # public, whatever they look like
_PATCH: Final = re.compile(r".*\.setattr|(.*\.)?patch(\.object|\.multiple)?")


class SizeError(ShuttleError):
    """A figure is greater than its budget, or a room has none."""


def lines_of(text: str) -> int:
    """Number of lines with code of a Python file."""
    left_out = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = {line for token in tokens if token.type not in left_out for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def budgets() -> dict[str, int]:
    """Budgets by the names of :func:`figures`."""
    table: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["size"]
    return {**{f"rooms.{name}": budget for name, budget in table.pop("rooms").items()}, **table}


def size() -> dict[str, Any]:
    """All figures; each room of ``rooms`` with its budget, None without one."""
    package, tests, allowed = _texts(PACKAGE), _texts(ROOT / "tests"), budgets()
    rooms = {path.name: _code(_texts(path)) for path in sorted(PACKAGE.iterdir()) if path.is_dir()}
    outside = {name: _code(_texts(ROOT / name)) for name in _OUTSIDE}
    page = [path for path in PACKAGE.glob("*/page/src/*") if path.suffix in (".ts", ".css") and ".gen" not in path.suffixes]
    places = _places_in_tests()
    return {
        "code": _code(package),
        "lines": sum(len(text.splitlines()) for text in package),
        "files": len(package),
        "rooms": {name: {"code": code, "budget": allowed.get(f"rooms.{name}")} for name, code in rooms.items() if code},
        "outside": {"code": sum(outside.values()), **outside},
        "typescript": sum(len(path.read_text(encoding="utf-8").splitlines()) for path in page),
        "tests": {"code": _code(tests), **{name: {"count": len(found), "places": found} for name, found in places.items()}},
    }


def _texts(folder: Path) -> list[str]:
    return [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]


def _code(texts: Iterable[str]) -> int:
    return sum(map(lines_of, texts))


def _places_in_tests() -> dict[str, list[str]]:
    """Private accesses and patches, as ``file:line``."""
    private, patches = [], []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        nodes, where = list(ast.walk(ast.parse(path.read_text(encoding="utf-8")))), path.relative_to(ROOT)
        imports = [alias for node in nodes if isinstance(node, ast.Import) for alias in node.names]
        foreign = {(alias.asname or alias.name).split(".")[0] for alias in imports if not _is_ours(alias.name)} | {"self", "cls"}
        for node in nodes:
            private += [f"{where}:{node.lineno}" for _ in _private(node, foreign)]  # type: ignore[attr-defined]
            if isinstance(node, ast.Call) and _PATCH.fullmatch(ast.unparse(node.func)):
                patches.append(f"{where}:{node.lineno}")
    return {"private_accesses": private, "setattr": patches}


def _is_ours(module: str | None) -> bool:
    return (module or "").split(".")[0] in (PACKAGE.name, "tests")


def _private(node: ast.AST, foreign: set[str]) -> Iterator[str]:
    """Private names that a node reads or writes."""
    names: list[Any] = []
    match node:
        case ast.Attribute(value=ast.Name(id=owner)) if owner in foreign:
            pass
        case ast.Attribute(attr=name):
            names = [name]
        case ast.ImportFrom(module=module, names=aliases) if _is_ours(module):
            names = [alias.name for alias in aliases]
        case ast.Call(func=ast.Attribute(attr=called) | ast.Name(id=called)) if called in ("setattr", "delattr", "getattr"):
            names = [str(argument.value).rpartition(".")[2] for argument in node.args[:2] if isinstance(argument, ast.Constant)]
    return (name for name in names if re.match("_[^_]", name) and name not in _NAMED_TUPLE)


def figures(found: Mapping[str, Any]) -> dict[str, int]:
    """The figures of :func:`size` by name, with a dot between keys."""
    return {
        **{name: found[name] for name in ("code", "lines", "files", "typescript")},
        **{f"rooms.{name}": room["code"] for name, room in found["rooms"].items()},
        "outside.code": found["outside"]["code"],
        **{f"tests.{name}": of["count"] if isinstance(of, dict) else of for name, of in found["tests"].items()},
    }


def over_budget(found: Mapping[str, int], allowed: Mapping[str, int]) -> list[str]:
    """A line about each figure that is greater than its budget, and about each room that has none."""
    above = [f"{name}: {found[name]:,}, of at most {limit:,}" for name, limit in allowed.items() if found.get(name, 0) > limit]
    return above + [f"{name}: no budget" for name in found if name.startswith("rooms.") and name not in allowed]


def main(*, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False, check: bool = False) -> None:
    """Measure the repository.

    Args:
        as_json: Print JSON.
        check: Fail if a figure is greater than its budget, in `tool.size` of `pyproject.toml`, instead of printing figures.
    """
    found, allowed = size(), budgets()
    if check:
        if lines := over_budget(figures(found), allowed):
            advice = "delete something, or raise the budget in pyproject.toml with a reason beside it"
            raise SizeError("\n".join([*lines, advice]))
        return
    rows = [(name, f"{number:,}", f"{allowed[name]:,}" if name in allowed else "") for name, number in figures(found).items()]
    shown = markdown(("figure", "number", "budget"), rows, left=("figure",))
    sys.stdout.write(json.dumps(found, indent=1) if as_json else f"{shown}\n")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the repository."))
