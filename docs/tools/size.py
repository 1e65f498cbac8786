"""The size of the package, imports in a loop, and the files that take part in one step.

    python -m docs.tools.size [ROOT] [--json]

ROOT is the root of a checkout, by default this one. A Python file takes part in a step if one of its functions runs, or if a
function that runs uses a name from it. A step is traced when it is executed for the second time, so preparation does not count.
A stroke runs uncompiled. Training is too slow for that: of compiled files it shows those whose functions Python code uses.
"""

import ast
import dataclasses
import io
import json
import os
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

PACKAGE: Final = "shuttle_marl"
STROKE: Final = """
from shuttle_marl import rally_v0
env = rally_v0.env()
def play():
    env.reset(seed=1)
    traced(lambda: env.step(env.action_space(env.agent_selection).sample(env.last()[0]["action_mask"])))
"""
_TRAINING: Final = """
import tempfile
from pathlib import Path
from shuttle_marl.training import PPOConfig, train
from {module} import {owner}
step = {owner}.{method}
{owner}.{method} = lambda *arguments: traced(lambda: step(*arguments))
def play():
    with tempfile.TemporaryDirectory() as folder:
        sizes = dict(strokes=32, batch=32, width=4, checkpoint_every=1)
        train(PPOConfig(opponent=("self",), record="{record}", out=Path(folder) / "run", **sizes))
"""
_STEPS: Final = {
    "training_step": _TRAINING.format(module="shuttle_marl.training.learner", owner="Trainer", method="iterate", record="none"),
    "recorded_rally": _TRAINING.format(module="shuttle_marl.training.rally_log", owner="RunLog", method="record", record="all"),
}
"""Steps that are methods called in training."""
FRAME: Final = "watch/page/src/frame.ts"
"""Module of the page that draws one frame, relative to the package."""
_TRACE: Final = """
import json, sys, threading
files = {{}}
def note(frame, event, _):
    if event == "call":
        files.setdefault(frame.f_code.co_filename, set()).update(frame.f_code.co_names)
def traced(call):
    files.clear()
    sys.setprofile(note)
    try:
        return call()
    finally:
        sys.setprofile(None)
{setup}
threading.setprofile(note)  # what a step leaves to threads is a part of it
play()
play()
print("\\n" + json.dumps({{file: sorted(names) for file, names in files.items()}}))
"""
_IMPORT: Final = re.compile(r'^(?:import|export)\b[^"\';]*["\'](\.[^"\']*)["\']', re.MULTILINE)


class SizeError(ShuttleError):
    """A folder without the package, or a step that cannot be executed."""


@dataclasses.dataclass(frozen=True)
class Module:
    """A Python file of the package.

    Attributes:
        name: dotted name.
        lines: number of lines.
        code: number of those with code: no blank lines, comments and docstrings; lines of other strings count.
        origins: module of the package from which each name is imported; imports for type checking are left out.
    """

    name: str
    lines: int
    code: int
    origins: dict[str, str]


def modules(root: Path) -> dict[Path, Module]:
    """All modules of the package of a checkout, by path.

    Raises:
        SizeError: there is no package.
    """
    paths = sorted((root / PACKAGE).rglob("*.py"))
    if not paths:
        raise SizeError(f"{root}: no package {PACKAGE} here; give the root of a checkout")
    names = {path: ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__") for path in paths}
    known = frozenset(names.values())
    found = {}
    for path, name in names.items():
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        found[path] = Module(name, len(text.splitlines()), _code(text, tree), dict(_imports(tree, known)))
    return found


def _code(text: str, tree: ast.Module) -> int:
    left_out = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in left_out:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def _imports(node: ast.AST, known: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Every imported name, and the module of the package that it comes from."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.Import):
            yield from ((alias.asname or alias.name, alias.name) for alias in child.names if alias.name in known)
        elif isinstance(child, ast.ImportFrom) and child.module in known:
            for alias in child.names:
                part = f"{child.module}.{alias.name}"
                yield alias.asname or alias.name, part if part in known else str(child.module)
        yield from _imports(child, known)


def circles(found: dict[Path, Module], root: Path) -> list[str]:
    """Parts of a package, and files of the page, that import each other in a loop; a line for each.

    Parts are files, and folders as one part; ``__init__.py`` is left out. For the page, imports of types count.
    """
    edges: dict[str, dict[str, set[str]]] = {}
    for path, module in found.items():
        for target in set(module.origins.values()) if path.name != "__init__.py" else ():
            here, there = module.name.split("."), target.split(".")
            shared = next((i for i, (a, b) in enumerate(zip(here, there, strict=False)) if a != b), None)
            if shared is not None:
                parts = edges.setdefault(".".join(here[:shared]), {})
                parts.setdefault(here[shared], set()).add(there[shared])
    scripts = (root / PACKAGE / FRAME).parent
    edges["page"] = {path.stem: {source.stem for source in _imported(path)} for path in scripts.glob("*.ts")}
    return [f"{name}: {', '.join(sorted(loop))}" for name, parts in edges.items() for loop in _loops(parts)]


def _loops(edges: dict[str, set[str]]) -> list[set[str]]:
    """Largest sets of nodes that reach each other."""
    reached = {node: set(following) for node, following in edges.items()}
    while any(more - reached[a] for a in reached for b in reached[a] if (more := reached.get(b, set()))):
        for direct in reached.values():
            direct.update(*(reached.get(node, ()) for node in list(direct)))
    found = []
    for node in sorted(reached):
        loop = {other for other in reached[node] if node in reached.get(other, ())}
        if len(loop) > 1 and loop not in found:
            found.append(loop)
    return found


def files_of(root: Path, found: dict[Path, Module], setup: str, *, compiled: bool = False) -> set[Path]:
    """Files of the package that take part in a step.

    Args:
        root: of the checkout.
        found: its modules.
        setup: code that defines ``play``, in which ``traced(call)`` is called with the step, see :data:`STROKE`.
        compiled: compile the kernel; its functions are not traced then.

    Raises:
        SizeError: the code fails.
    """
    environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_DISABLE_JIT": "0" if compiled else "1"}
    command = [sys.executable, "-W", "ignore", "-c", _TRACE.format(setup=setup)]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SizeError(f"{root}: cannot be executed:\n{done.stderr[-2000:]}")
    ran = {Path(file): names for file, names in json.loads(done.stdout.splitlines()[-1]).items() if Path(file) in found}
    paths = {module.name: path for path, module in found.items()}
    named = {paths[found[file].origins[name]] for file, names in ran.items() for name in names if name in found[file].origins}
    return ran.keys() | {path for path in named if path.name != "__init__.py"}


def imported_scripts(entry: Path) -> set[Path]:
    """A TypeScript module and all modules that it imports, directly or not."""
    reached, waiting = set[Path](), [entry.resolve()]
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting.extend(_imported(path))
    return reached


def _imported(script: Path) -> Iterator[Path]:
    for source in _IMPORT.findall(script.read_text(encoding="utf-8")):
        target = script.parent / (source if source.endswith(".ts") else f"{source}.ts")
        if target.is_file():
            yield target.resolve()


def paths_of(root: Path, found: dict[Path, Module]) -> dict[str, list[str]]:
    """Files that take part in each step, relative to the package."""
    steps = {
        "stroke": files_of(root, found, STROKE),
        **{name: files_of(root, found, setup, compiled=True) for name, setup in _STEPS.items()},
        "page_frame": imported_scripts(root / PACKAGE / FRAME),
    }
    return {name: sorted(file.relative_to(root / PACKAGE).as_posix() for file in files) for name, files in steps.items()}


def size(root: Path) -> dict[str, Any]:
    """Lines of the package, lines with code, files, imports in a loop, and the files of each step."""
    found = modules(root)
    sums = {what: sum(getattr(module, what) for module in found.values()) for what in ("code", "lines")}
    return {**sums, "files": len(found), "circles": circles(found, root), "paths": paths_of(root, found)}


def main(root: tyro.conf.Positional[Path] = ROOT, *, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure the package.

    Args:
        root: Root of a checkout.
        as_json: Print JSON.
    """
    result = size(root.resolve())
    figures = [(name, f"{result[name]:,}") for name in ("code", "lines", "files")] + [("circles", str(len(result["circles"])))]
    figures += [(name, f"{len(files)} files") for name, files in result["paths"].items()]
    text = json.dumps(result, indent=1) if as_json else markdown(("figure", "number"), figures, left=("figure",))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the size of the package."))
