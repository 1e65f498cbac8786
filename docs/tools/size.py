"""The size of the package: lines, shapes that tell whether it is one house, and how many files take part in one step.

    python -m docs.tools.size [ROOT] [--json]

ROOT is the root of a checkout, by default this one. The rule of every figure stands in :data:`RULES`, and is printed. With
``--json``, ``details`` holds the names behind each figure.

A Python file takes part in a step if one of its functions runs, or if a function that runs uses a name from it. A step is traced
when it is executed for the second time, so preparation does not count. A stroke runs uncompiled. Training is too slow for that:
the kernel files of a training step are those of a stroke of ``RallyEnv``. Recording begins where training hands over the rallies
of an iteration, so its files are those of training, the records of rallies and recording, without the kernel that plays.
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
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli

PACKAGE: Final = "shuttle_marl"
PARAMETERS: Final = 8
"""Functions with more parameters are wide."""
RULES: Final = {
    "code": "lines of Python with code: without blank lines, comments and docstrings; lines of other strings count",
    "lines": "all lines of Python",
    "files": "Python files",
    "single_importers": "modules that exactly one other module imports; __init__.py and __main__.py not counted",
    "wide_functions": f"functions with more than {PARAMETERS} parameters, self and cls not counted",
    "circles": "sets of parts of a package (files, and folders as one part) that import each other in a loop; __init__.py and "
    "imports for type checking left out; for the page, files, imports of types included",
    "rally_loops": "modules with a loop in which strokes are decided, by a function of game.rules, kernel.core or kernel.rows, "
    "or by one of the module that computes an outcome, directly or in functions of the module; those three not counted",
    "rally_types": "classes with a field for the strokes of a rally and one for its server or its end",
    "game_types": "classes and aliases of the package game whose names end in Game and that annotate parameters",
    "run_folders": "modules of runs, league, suite and training that append to a file, seal one, or write a manifest's file",
    "policy_codecs": "modules with a function that names the cumulative numbers of a table, and writes or reads files of them",
    "same_names": "names of modules used more than twice; __init__ and __main__ not counted",
}
"""How each figure is counted."""
PATHS: Final = {
    "stroke": "files that take part in a stroke of rally_v0",
    "training_step": "files that take part in an iteration of PPO in self-play",
    "recorded_rally": "files that take part in recording the rallies of an iteration",
    "page_frame": "scripts that the one that draws a frame imports, directly or not; imports of types count",
    "league_config": "files in which a function is called with the configuration of a tournament, or a value in it",
}
"""How the files of each path are counted."""
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
LEAGUE_CONFIG: Final = """
import tempfile
from pathlib import Path
from shuttle_marl.league import LeagueConfig, run_league
def own(text):
    return "".join(list(text))  # no other value is this object
def play():
    with tempfile.TemporaryDirectory() as folder:
        pool, model = (own("random"), own("safe")), own("default")
        config = LeagueConfig(
            pool=pool, game=model, record=own("sample:2"), format=own("gauntlet"), rules=own("15"), profile=own("men"),
            matches=998, seed=987654321, batch=999, policy_timeout=98.5, out=Path(folder) / "run",
        )
        own_values = [value for value in vars(config).values() if value and value is not True]
        traced(lambda: run_league(config), passed=(config, *pool, *(v for v in own_values if v != 1)))
"""
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
def traced(call, begin=None, end=None, within=None, passed=None):
    files.clear()
    noting, over, depth = begin is None and within is None, False, 0
    parts = set(map(id, passed or ()))
    def profile(frame, event, _):
        nonlocal noting, over, depth
        if parts:
            if event == "call" and not parts.isdisjoint(map(id, frame.f_locals.values())):
                files.setdefault(frame.f_code.co_filename, set())
            return
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
_DECIDES: Final = frozenset(f"{PACKAGE}.{name}" for name in ("game.rules", "kernel.core", "kernel.rows"))
_DECIDING: Final = frozenset({"strike", "strike_one", "outcome_of", "play"})
_CODING: Final = frozenset({"compress", "decompress", "stream_reader", "frombuffer", "save", "read_tensors"})
_FOLDERS: Final = ("runs", "base.runs", "league", "suite", "training")
_STROKES: Final = frozenset({"stroke", "strokes", "pair", "played"})
_ENDS: Final = frozenset({"server", "ending", "ended", "reason"})
_RECORDING: Final = ("training", "rally", "game/rally", "recording")
_ANNOTATED: Final = (f"{PACKAGE}.data.", f"{PACKAGE}.dynamics.")
"""Packages of annotated matches; their types describe annotations."""


class SizeError(ShuttleError):
    """A folder without the package, or a step that cannot be executed."""


@dataclasses.dataclass(frozen=True)
class Module:
    """A Python file of the package.

    Attributes:
        name: dotted name.
        text: its content.
        tree: its syntax tree.
        origins: module of the package from which each name is imported; imports for type checking are left out.
    """

    name: str
    text: str
    tree: ast.Module
    origins: dict[str, str]

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.text.splitlines())

    @property
    def code(self) -> int:
        """Number of lines with code, see :data:`RULES`."""
        left_out = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
        lines: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            if token.type not in left_out:
                lines.update(range(token.start[0], token.end[0] + 1))
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
                lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        return len(lines)


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
        found[path] = Module(name, text, tree, dict(_imports(tree, known)))
    return found


def names_in(found: dict[Path, Module]) -> dict[str, list[str]]:
    """The names behind every figure of :data:`RULES` that counts names."""
    counted = {path: module for path, module in found.items() if path.name not in ("__init__.py", "__main__.py")}
    every = counted.values()
    stems = Counter(path.stem for path in counted)
    played = [module for module in every if not module.name.startswith(_ANNOTATED)]
    game_names = {name for module in every if module.name.startswith(f"{PACKAGE}.game.") for name in _game_names(module.tree)}
    annotations = {n for module in every for n in _annotations(module.tree)}
    return {
        "single_importers": [f"{module.name} ({module.lines})" for module in single_importers(found)],
        "wide_functions": [f"{module.name}.{name}" for module in found.values() for name in _wide(module.tree)],
        "rally_types": [f"{module.name}.{name}" for module in played for name in _rally_types(module.tree)],
        "rally_loops": [module.name for module in every if module.name not in _DECIDES and _loops_over_strokes(module)],
        "game_types": sorted(game_names & annotations),
        "run_folders": [m.name for m in every if m.name.removeprefix(f"{PACKAGE}.").startswith(_FOLDERS) and _writes_run(m.tree)],
        "policy_codecs": [m.name for m in every if _codes_tables(m.tree)],
        "same_names": sorted(f"{name} ({n})" for name, n in stems.items() if n > 2),
    }


def circles(found: dict[Path, Module], root: Path) -> list[str]:
    """Parts of a package, and files of the page, that import each other in a loop; a line for each."""
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


def _calls(node: ast.AST) -> set[str]:
    called = (n.func for n in ast.walk(node) if isinstance(n, ast.Call))
    return {f.id if isinstance(f, ast.Name) else f.attr for f in called if isinstance(f, ast.Name | ast.Attribute)}


def _loops_over_strokes(module: Module) -> bool:
    functions = {n.name: n for n in ast.walk(module.tree) if isinstance(n, ast.FunctionDef)}
    decides = {name for name in _DECIDING if module.origins.get(name) in _DECIDES} | ({"_outcome"} & functions.keys())
    while more := {name for name, node in functions.items() if _calls(node) & decides} - decides:
        decides |= more
    loops = (n for n in ast.walk(module.tree) if isinstance(n, ast.For | ast.While))
    return any(_calls(loop) & decides for loop in loops)


def _game_names(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else ()
        for name in [node.name] if isinstance(node, ast.ClassDef) else [t.id for t in targets if isinstance(t, ast.Name)]:
            if name.endswith("Game"):
                yield name


def _annotations(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.arg) and node.annotation:
            yield from re.findall(r"\w+", ast.unparse(node.annotation))


def _writes_run(tree: ast.Module) -> bool:
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
    modes = (a.value for n in calls if _calls(n) & {"open"} for a in n.args if isinstance(a, ast.Constant))
    return bool(_calls(tree) & {"seal"}) or any(str(mode).startswith("a") for mode in modes)


def _codes_tables(tree: ast.Module) -> bool:
    functions = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef))
    return any("cumulative" in ast.unparse(function) and _calls(function) & _CODING for function in functions)


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
        if path not in reached:
            reached.add(path)
            waiting.extend(_imported(path))
    return reached


def _imported(script: Path) -> Iterator[Path]:
    for source in _IMPORT.findall(script.read_text(encoding="utf-8")):
        target = script.parent / (source if source.endswith(".ts") else f"{source}.ts")
        if target.is_file():
            yield target.resolve()


def size(root: Path) -> dict[str, Any]:
    """All figures of a checkout; see the top of this module."""
    found = modules(root)
    batch_stroke = files_of(root, found, BATCH_STROKE)
    training = {path for path in files_of(root, found, TRAINING_STEP, compiled=True) if path.parent.name == "training"}
    recorded = files_of(root, found, RECORDED_RALLY, compiled=True)
    paths: dict[str, Iterable[Path]] = {
        "stroke": files_of(root, found, STROKE),
        "training_step": training | batch_stroke,
        "recorded_rally": {path for path in recorded if path.relative_to(root / PACKAGE).as_posix().startswith(_RECORDING)},
        "page_frame": imported_scripts(root / PACKAGE / FRAME),
        "league_config": files_of(root, found, LEAGUE_CONFIG, compiled=True),
    }
    details: dict[str, Any] = {
        **names_in(found),
        "circles": circles(found, root),
        "paths": {name: sorted(str(path.relative_to(root)) for path in files) for name, files in paths.items()},
    }
    sums = {
        "code": sum(module.code for module in found.values()),
        "lines": sum(module.lines for module in found.values()),
        "files": len(found),
    }
    return {
        **{name: sums[name] if name in sums else len(details[name]) for name in RULES},
        "paths": {name: {"files": len(set(files)), "lines": sum(map(_lines, files))} for name, files in paths.items()},
        "rules": {**RULES, "paths": PATHS},
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
    rows = [(name, f"{result[name]:,}", rule) for name, rule in RULES.items()]
    rows += [(name, f"{path['files']:,}", f"{PATHS[name]} ({path['lines']:,} lines)") for name, path in result["paths"].items()]
    text = json.dumps(result, indent=1) if as_json else markdown(("figure", "number", "rule"), rows, left=("figure", "rule"))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the size of the package."))
