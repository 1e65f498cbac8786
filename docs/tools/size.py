"""The size of the repository, imports in a loop, counts of ideas, habits of tests, and the files whose functions run in one step.

    python -m docs.tools.size [--json] [--check]

Lines with code are those without blank lines, comments and docstrings; lines of other strings count. :data:`RULES` and
:data:`TEST_RULES` say how the other figures are counted, :mod:`docs.tools.structure` how the files of a step are found.
``--check`` compares figures with their limits, the table ``tool.size`` of ``pyproject.toml``.
"""

import ast
import functools
import io
import json
import operator
import re
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import grimp
import tyro

from docs.tools.markdown import ROOT, markdown
from docs.tools.structure import FRAME, PACKAGE, imported, paths, reached
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

_OUTSIDE: Final = ("benchmarks", "datasets", "docs", "experiments")
RULES: Final = {
    "circles": "imports, those for type checking too, and files of the page without which nothing imports itself in a loop",
    "stroke_values": "modules of reports and watch that call Game.stroke_values, which says what strokes are worth",
    "integrity_schemes": "modules that compare a SHA-256 of bytes with a stored one, in a function that computes it or by a "
    "function of theirs; all that compare CRCs count once, as the checksums of MCAP",
    "caches": "modules that write files into the user's cache folder, or into a database",
    "single_importers": "modules that exactly one other module imports, imports for type checking not counted",
    "wide_functions": "functions with more than 8 parameters, self and cls not counted",
    "same_names": "names of modules used more than twice; __init__.py and __main__.py not counted",
}
"""How each list of names is counted."""
TEST_RULES: Final = {
    "private_accesses": "private names in tests: attributes of others than self, cls and modules of other packages, imports, and "
    "names for setattr, delattr and getattr",
    "setattr": "calls of setattr of pytest's monkeypatch, and of unittest.mock.patch",
}
"""How the places in tests are counted."""
_NAMED_TUPLE: Final = ("_asdict", "_fields", "_make", "_replace")
"""Public, whatever they look like."""


class SizeError(ShuttleError):
    """A figure is greater than its limit."""


def lines_of(text: str) -> int:
    """Number of lines with code of a Python file."""
    left_out = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = {line for token in tokens if token.type not in left_out for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def names() -> dict[str, list[str]]:
    """The names behind each figure of :data:`RULES`."""
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    loops = {pair for module in graph.modules for pair in graph.nominate_cycle_breakers(module)}
    scripts = [path for path in FRAME.parent.glob("*.ts") if path in reached(*imported(path))]
    trees = {path.relative_to(ROOT / PACKAGE): ast.parse(path.read_text("utf-8")) for path in (ROOT / PACKAGE).rglob("*.py")}
    run = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True, cache_dir=None)
    own = {name: path for path in trees if (name := ".".join((PACKAGE, *path.with_suffix("").parts))) in graph.modules}
    calls = {str(path): _calls(tree) for path, tree in trees.items()}
    stems = Counter(path.stem for path in own.values() if path.stem != "__main__")
    wide = {str(path): [node.name for node in ast.walk(tree) if _parameters(node) > 8] for path, tree in trees.items()}  # type: ignore[attr-defined]
    checked = {str(path): set().union(*_compared(tree)) for path, tree in trees.items()}
    return {
        "circles": [*(f"{here} -> {there}" for here, there in sorted(loops)), *(path.name for path in sorted(scripts))],
        "stroke_values": [f for f in calls if f.startswith(("reports", "watch")) and "stroke_values" in calls[f]],
        "integrity_schemes": [
            *(f for f in calls if checked[f] & {"sha256", *_that_call(trees[Path(f)], "sha256")}),
            *["MCAP"] * any("crc32" in found for found in checked.values()),
        ],
        "caches": [f for f in calls if "connect" in calls[f] or {"cache_folder", "replace_file"} <= calls[f]],
        "single_importers": sorted(module for module in own if len(run.find_modules_that_directly_import(module)) == 1),
        "wide_functions": [f"{path}: {name}" for path, found in wide.items() for name in found],
        "same_names": sorted(name for name, times in stems.items() if times > 2),
    }


def _calls(tree: ast.AST) -> set[str]:
    called = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    return {f.id if isinstance(f, ast.Name) else f.attr for f in called if isinstance(f, ast.Name | ast.Attribute)}


def _that_call(tree: ast.AST, name: str) -> set[str]:
    return {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and name in _calls(node)}


def _compared(tree: ast.AST) -> Iterator[set[str]]:
    """Names of the functions whose results each equation compares."""
    return (
        _calls(node) for node in ast.walk(tree) if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Eq | ast.NotEq)
    )


def _parameters(node: ast.AST) -> int:
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return 0
    found = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len(found) - (found[:1] in (["self"], ["cls"]))


def places_in_tests() -> dict[str, list[str]]:
    """The places behind each figure of :data:`TEST_RULES`, as ``file:line``."""
    found: dict[str, list[str]] = {name: [] for name in TEST_RULES}
    for path in sorted((ROOT / "tests").rglob("*.py")):
        tree, where = ast.parse(path.read_text(encoding="utf-8")), path.relative_to(ROOT)
        foreign = {"self", "cls"} | {
            (alias.asname or alias.name).split(".")[0]
            for node in ast.walk(tree)
            if isinstance(node, ast.Import)
            for alias in node.names
            if alias.name.split(".")[0] not in (PACKAGE, "tests")
        }
        for node in ast.walk(tree):
            found["private_accesses"] += [f"{where}:{node.lineno}" for _ in _private(node, foreign)]  # type: ignore[attr-defined]
            if isinstance(node, ast.Call) and re.fullmatch(
                r".*\.setattr|(.*\.)?patch(\.object|\.multiple)?", ast.unparse(node.func)
            ):
                found["setattr"].append(f"{where}:{node.lineno}")
    return found


def _private(node: ast.AST, foreign: set[str]) -> list[str]:
    """Private names that a node reads or writes."""
    match node:
        case ast.Attribute(value=ast.Name(id=owner)) if owner in foreign:
            return []
        case ast.Attribute(attr=name):
            names = [name]
        case ast.ImportFrom(module=module, names=aliases):
            names = [alias.name for alias in aliases] if (module or "").split(".")[0] in (PACKAGE, "tests") else []
        case ast.Call(func=ast.Attribute(attr=called) | ast.Name(id=called)) if called in ("setattr", "delattr", "getattr"):
            texts = (argument.value for argument in node.args[:2] if isinstance(argument, ast.Constant))
            names = [text.rpartition(".")[2] for text in texts if isinstance(text, str)]
        case _:
            names = []
    return [name for name in names if re.match("_[^_]", name) and name not in _NAMED_TUPLE]


def size() -> dict[str, Any]:
    """Lines and files of the package, lines with code by folder, names by rule, and the files of each step."""
    texts = {name: [p.read_text(encoding="utf-8") for p in (ROOT / name).rglob("*.py")] for name in (PACKAGE, *_OUTSIDE, "tests")}
    code = {name: sum(map(lines_of, found)) for name, found in texts.items()}
    found = names()
    return {
        "code": code[PACKAGE],
        "lines": sum(len(text.splitlines()) for text in texts[PACKAGE]),
        "files": len(texts[PACKAGE]),
        "outside": {"code": sum(code[name] for name in _OUTSIDE), **{name: code[name] for name in _OUTSIDE}},
        "tests": {
            "code": code["tests"],
            "lines": sum(len(text.splitlines()) for text in texts["tests"]),
            **{name: {"count": len(places), "places": places} for name, places in places_in_tests().items()},
        },
        **{name: len(counted) for name, counted in found.items()},
        "names": found,
        "rules": RULES | TEST_RULES,
    }


def over_limits(found: Mapping[str, Any], limits: Mapping[str, int]) -> list[str]:
    """A line about each figure that is greater than its limit.

    Args:
        found: result of :func:`size`.
        limits: by name, with a dot between keys.
    """
    lines = []
    for name, limit in limits.items():
        figure: Any = functools.reduce(operator.getitem, name.split("."), found)
        number = figure["count"] if isinstance(figure, dict) else figure
        if number > limit:
            lines.append(f"{name}: {number:,}, of at most {limit:,}")
    return lines


def main(*, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False, check: bool = False) -> None:
    """Measure the repository.

    Args:
        as_json: Print JSON.
        check: Fail if a figure is greater than its limit, in `tool.size` of `pyproject.toml`, instead of printing figures.
    """
    found = size()
    if check:
        limits = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["size"]
        if lines := over_limits(found, limits):
            raise SizeError(
                "\n".join([*lines, "python -m docs.tools.size --json lists the places; limits stand in pyproject.toml"])
            )
        return
    found["paths"] = paths()
    figures = [(name, f"{found[name]:,}", RULES.get(name, "")) for name in ("code", "lines", "files", *RULES)]
    figures += [(f"code, {name}", f"{found[name]['code']:,}", "") for name in ("outside", "tests")]
    figures += [(f"tests, {name}", f"{found['tests'][name]['count']:,}", rule) for name, rule in TEST_RULES.items()]
    figures += [(f"files, {name}", str(len(files)), "") for name, files in found["paths"].items()]
    shown = markdown(("figure", "number", "rule"), figures, left=("figure", "rule"))
    sys.stdout.write(json.dumps(found, indent=1) if as_json else f"{shown}\n")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the repository."))
