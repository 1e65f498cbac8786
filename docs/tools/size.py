"""The size of the package: lines, modules with one importer, wide functions, and how many files take part in one step.

    python -m docs.tools.size [ROOT] [--json]

ROOT is the root of a checkout, by default this one. With ``--json``, the keys are:

- ``lines``, ``files``: Python files of the package, blank lines and comments included.
- ``single_importers``: modules that exactly one other module imports, imports by ``__init__.py`` not counted.
- ``wide_functions``: functions with more than 8 parameters, ``self`` and ``cls`` not counted.
- ``rally_types``: classes that describe a played rally: they have a field for its strokes and one for its server or its end.
- ``paths``: number of files, and of their lines, that take part in a stroke of ``rally_v0`` (``stroke``), an iteration of PPO in
  self-play (``training_step``), the recording of the rallies of an iteration (``recorded_rally``), and one frame of the page
  (``page_frame``).
- ``details``: the names behind each of these numbers.

A Python file takes part in a step if one of its functions runs, or if a function that runs uses a name from it. A step is traced
when it is executed for the second time, so preparation does not count. A stroke runs uncompiled. Training is too slow for that:
the kernel files of a training step are those of a stroke of ``RallyEnv``. Recording begins where training hands over the rallies
of an iteration, so its files are those of training, rally and recording, without the kernel that plays. A TypeScript file takes
part in a frame if the module ``frame.ts`` imports it, directly or not; imports of types count too.
"""

import ast
import dataclasses
import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.commands import cli
from shuttle_marl.errors import ShuttleError

PACKAGE: Final = "shuttle_marl"
PARAMETERS: Final = 8
"""Functions with more parameters are wide."""
STROKE: Final = """
from shuttle_marl import rally_v0
env = rally_v0.env()
def play():
    env.reset(seed=1)
    traced(lambda: env.step(env.action_space(env.agent_selection).sample(env.last()[0]["action_mask"])))
"""
BATCH_STROKE: Final = """
from shuttle_marl.env.batched import RallyEnv
env = RallyEnv(batch=4, seed=1)
def play():
    state = env.reset()
    traced(lambda: env.step(env.rand_action(state)))
"""
_TRAINING: Final = """
import tempfile
from pathlib import Path
from shuttle_marl.training import PPOConfig, train
def play():
    with tempfile.TemporaryDirectory() as folder:
        sizes = dict(batch=4, rows=2, steps=2, minibatch=2, strokes={strokes}, width=4, checkpoint_every=1)
        sizes = {{name: size for name, size in sizes.items() if hasattr(PPOConfig, name)}}
        config = PPOConfig(opponent=("self",), record="{record}", out=Path(folder) / "run", **sizes)
        traced(lambda: train(config), {trace})
"""
TRAINING_STEP: Final = _TRAINING.format(strokes=8, record="none", trace='begin="collect", end="save_checkpoint"')
RECORDED_RALLY: Final = _TRAINING.format(strokes=32, record="all", trace='within="record"')
FRAME: Final = "watch/page/src/frame.ts"
"""Module of the page that draws one frame, relative to the package."""
_TRACE: Final = """
import json, sys, threading
files = {{}}
def note(frame):
    files.setdefault(frame.f_code.co_filename, set()).update(frame.f_code.co_names)
def note_call(frame, event, _):
    if event == "call":
        note(frame)
def traced(call, begin=None, end=None, within=None):
    files.clear()
    noting, over, depth = begin is None and within is None, False, 0
    def profile(frame, event, _):
        nonlocal noting, over, depth
        name = frame.f_code.co_name if "{package}/training/" in frame.f_code.co_filename else None
        if within and name == within:
            depth += (event == "call") - (event == "return")
            noting = depth > 0 or event == "return"
        if event == "call" and name == begin and begin and not over:
            noting = True
            note(frame.f_back)
        if noting:
            note(frame)
        if event == "return" and name == end and noting and end:
            noting, over = False, True
            note(frame.f_back)
        noting = noting and not (within and depth == 0)
    if within:
        threading.setprofile(note_call)
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
{setup}
play()
play()
print("\\n" + json.dumps({{file: sorted(names) for file, names in files.items()}}))
"""
_IMPORT: Final = re.compile(r'^(?:import|export)\b[^"\';]*["\'](\.[^"\']*)["\']', re.MULTILINE)
_STROKES: Final = frozenset({"stroke", "strokes", "pair", "played"})
_ENDS: Final = frozenset({"server", "ending", "ended", "reason"})
_RECORDING: Final = ("training", "rally", "recording")
_ANNOTATED: Final = (f"{PACKAGE}.data.", f"{PACKAGE}.dynamics.")
"""Packages of annotated matches; their types describe annotations."""


class SizeError(ShuttleError):
    """A folder without the package, or a step that cannot be executed."""


@dataclasses.dataclass(frozen=True)
class Module:
    """A Python file of the package.

    Attributes:
        name: dotted name.
        lines: number of lines.
        origins: module of the package from which each name is imported; imports for type checking are left out.
        wide: names of functions with more than :data:`PARAMETERS` parameters.
        rally_types: names of classes that describe a played rally.
    """

    name: str
    lines: int
    origins: dict[str, str]
    wide: tuple[str, ...]
    rally_types: tuple[str, ...]


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
        rally_types = () if name.startswith(_ANNOTATED) else tuple(_rally_types(tree))
        found[path] = Module(name, len(text.splitlines()), dict(_imports(tree, known)), tuple(_wide(tree)), rally_types)
    return found


def _wide(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            if len(names) - (names[:1] in (["self"], ["cls"])) > PARAMETERS:
                yield node.name


def _rally_types(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            fields = {s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)}
            if fields & _STROKES and fields & _ENDS:
                yield node.name


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


def single_importers(found: dict[Path, Module]) -> list[Module]:
    """Modules that exactly one other module imports; packages, and imports by packages, are left out."""
    counted = {path: module for path, module in found.items() if path.name not in ("__init__.py", "__main__.py")}
    counts = Counter(name for module in counted.values() for name in set(module.origins.values()) - {module.name})
    return [module for module in counted.values() if counts[module.name] == 1]


def files_of(root: Path, found: dict[Path, Module], setup: str, *, compiled: bool = False) -> set[Path]:
    """Files of the package that take part in a step.

    Args:
        root: of the checkout.
        found: its modules.
        setup: code that defines ``play``, which calls ``traced(call)`` once, see :data:`STROKE`. With ``begin`` and ``end``, the
            step lasts from the first call of the function ``begin`` of training until ``end`` returns; with ``within``, the step
            is every call of that function of training, and everything in other threads.
        compiled: compile the kernel; its functions are not traced then.

    Raises:
        SizeError: the code fails.
    """
    environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_DISABLE_JIT": "0" if compiled else "1"}
    command = [sys.executable, "-W", "ignore", "-c", _TRACE.format(setup=setup, package=PACKAGE)]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SizeError(f"{root}: cannot be executed:\n{done.stderr[-2000:]}")
    ran = {Path(file): names for file, names in json.loads(done.stdout.splitlines()[-1]).items() if Path(file) in found}
    paths = {module.name: path for path, module in found.items()}
    named = {paths[found[file].origins[name]] for file, names in ran.items() for name in names if name in found[file].origins}
    return ran.keys() | {path for path in named if path.name != "__init__.py"}


def imported_scripts(entry: Path) -> set[Path]:
    """A TypeScript module and all modules that it imports, directly or not.

    Raises:
        SizeError: the module does not exist.
    """
    if not entry.is_file():
        raise SizeError(f"{entry}: no such module of the page")
    reached, waiting = set[Path](), [entry.resolve()]
    while waiting:
        path = waiting.pop()
        if path in reached:
            continue
        reached.add(path)
        for source in _IMPORT.findall(path.read_text(encoding="utf-8")):
            target = path.parent / (source if source.endswith(".ts") else f"{source}.ts")
            if target.is_file():
                waiting.append(target.resolve())
    return reached


def size(root: Path) -> dict[str, Any]:
    """All figures of a checkout; see the top of this module."""
    found = modules(root)
    batch_stroke = files_of(root, found, BATCH_STROKE)
    training = {path for path in files_of(root, found, TRAINING_STEP, compiled=True) if path.parent.name == "training"}
    recorded = files_of(root, found, RECORDED_RALLY, compiled=True)
    paths: dict[str, Iterable[Path]] = {
        "stroke": files_of(root, found, STROKE),
        "training_step": training | batch_stroke,
        "recorded_rally": {path for path in recorded if path.relative_to(root / PACKAGE).parts[0] in _RECORDING},
        "page_frame": imported_scripts(root / PACKAGE / FRAME),
    }
    details = {
        "single_importers": [f"{module.name} ({module.lines})" for module in single_importers(found)],
        "rally_types": [f"{module.name}.{name}" for module in found.values() for name in module.rally_types],
        "wide_functions": [f"{module.name}.{name}" for module in found.values() for name in module.wide],
        "paths": {name: sorted(str(path.relative_to(root)) for path in files) for name, files in paths.items()},
    }
    return {
        "lines": sum(module.lines for module in found.values()),
        "files": len(found),
        **{name: len(details[name]) for name in ("single_importers", "rally_types", "wide_functions")},
        "paths": {name: {"files": len(set(files)), "lines": sum(map(_lines, files))} for name, files in paths.items()},
        "details": details,
    }


def _lines(path: Path) -> int:
    return len(path.read_text(encoding="utf-8").splitlines())


def main(root: tyro.conf.Positional[Path] = ROOT, *, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure the package, and print a table in Markdown.

    Args:
        root: Root of a checkout.
        as_json: Print JSON, with the names behind the numbers.
    """
    result = size(root.resolve())
    rows = [(name, f"{result[name]:,}", "") for name in ("lines", "files", "single_importers", "rally_types", "wide_functions")]
    rows += [(f"path: {name}", f"{path['files']:,}", f"{path['lines']:,}") for name, path in result["paths"].items()]
    text = json.dumps(result, indent=1) if as_json else markdown(("", "number", "lines"), rows, left=("",))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the size of the package."))
