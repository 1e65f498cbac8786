"""The size of the package: files and lines, names, and how many files take part in one stroke.

    python -m docs.tools.size [ROOT] [--json]

ROOT is the root of a checkout, by default of this one; two checkouts are compared by two calls. Lines are those of Python files,
blank ones and comments included. Public names are what a module defines at its top level without a leading underscore. A module
has one importer if exactly one other module of the package, packages' ``__init__`` aside, imports it or a name from it.

Files of a stroke are counted while it is played for the second time, so that preparation does not count: those of which any
function runs, and those from which such a function takes a name. Compiled functions run as Python; but in training, where that
would take hours, environment and kernel are those of a stroke of `RallyEnv`. A stroke of training is an iteration of PPO in
self-play, from the collector to the checkpoint, that records nothing, evaluates nothing and shapes no reward.
"""

import ast
import dataclasses
import json
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final

import tyro
from rich.console import Console

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.commands import cli
from shuttle_marl.errors import ShuttleError

PACKAGE: Final = "shuttle_marl"
STROKES: Final = {
    "a stroke of `rally_v0`": """
from shuttle_marl import rally_v0
env = rally_v0.env()
def play():
    env.reset(seed=1)
    traced(lambda: env.step(env.action_space(env.agent_selection).sample(env.last()[0]["action_mask"])))
""",
    "a stroke of `RallyEnv`": """
from shuttle_marl.env.batched import RallyEnv
env = RallyEnv(batch=4, seed=1)
def play():
    state = env.reset()
    traced(lambda: env.step(env.rand_action(state)))
""",
}
"""Code that plays, by its name in the table; compiled functions run as Python."""
TRAINING: Final = """
import tempfile
from pathlib import Path
from shuttle_marl.training import PPOConfig, train
def play():
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        sizes = dict(batch=4, rows=2, steps=2, minibatch=2, strokes=8, width=4, checkpoint_every=1)
        sizes = {name: size for name, size in sizes.items() if hasattr(PPOConfig, name)}
        config = PPOConfig(opponent=("self",), record="none", out=out, **sizes)
        traced(lambda: train(config), begin="collect", end="save_checkpoint")
"""
_TRACE: Final = """
import json, sys
files = {{}}
def note(frame):
    files.setdefault(frame.f_code.co_filename, set()).update(frame.f_code.co_names)
def traced(call, begin=None, end=None):
    files.clear()
    noting, over = begin is None, False
    def profile(frame, event, _):
        nonlocal noting, over
        name = frame.f_code.co_name if "{package}/training/" in frame.f_code.co_filename else None
        if event == "call" and name == begin and begin and not over:
            noting = True
            note(frame.f_back)
        if noting:
            note(frame)
        if event == "return" and name == end and noting and end:
            noting, over = False, True
            note(frame.f_back)
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
{setup}
play()
play()
print("\\n" + json.dumps({{file: sorted(names) for file, names in files.items()}}))
"""


class SizeError(ShuttleError):
    """A folder that holds no package, or one that cannot be played."""


@dataclasses.dataclass(frozen=True)
class Module:
    """A file of the package.

    Attributes:
        name: with dots.
        lines: of the file.
        names: public names that it defines at its top level.
        origins: by name, the module of the package that it is imported from; without imports for type checking only.
    """

    name: str
    lines: int
    names: tuple[str, ...]
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
        found[path] = Module(name, len(text.splitlines()), tuple(_public(tree)), dict(_imports(tree, known)))
    return found


def _public(tree: ast.Module) -> Iterator[str]:
    for node in tree.body:
        targets: list[ast.expr] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            targets = [ast.Name(node.name)]
        elif isinstance(node, ast.Assign):
            targets = [name for target in node.targets for name in (target.elts if isinstance(target, ast.Tuple) else [target])]
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        yield from (target.id for target in targets if isinstance(target, ast.Name) and not target.id.startswith("_"))


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


def with_one_importer(found: dict[Path, Module]) -> list[Module]:
    """Modules that exactly one other module imports; packages, and imports by packages, are left out."""
    rooms = {path: module for path, module in found.items() if path.name not in ("__init__.py", "__main__.py")}
    counts = Counter(name for module in rooms.values() for name in set(module.origins.values()) - {module.name})
    return [module for module in rooms.values() if counts[module.name] == 1]


def parts_of(root: Path, found: dict[Path, Module], setup: str, *, compiled: bool = False) -> set[Path]:
    """Files of the package of a checkout that take part in what is played.

    Args:
        root: of the checkout.
        found: its modules.
        setup: defines ``play``, which calls ``traced`` once; see :data:`STROKES`. It is traced from the first call of a function
            ``begin`` of training until a function ``end`` returns, where they are given.
        compiled: leave compiled functions compiled; their files are not seen then.

    Raises:
        SizeError: it cannot be played.
    """
    environment = {**os.environ, "PYTHONPATH": str(root), "NUMBA_DISABLE_JIT": "0" if compiled else "1"}
    command = [sys.executable, "-W", "ignore", "-c", _TRACE.format(setup=setup, package=PACKAGE)]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SizeError(f"{root}: cannot play:\n{done.stderr[-2000:]}")
    ran = {Path(file): names for file, names in json.loads(done.stdout.splitlines()[-1]).items() if Path(file) in found}
    paths = {module.name: path for path, module in found.items()}
    named = {paths[found[file].origins[name]] for file, names in ran.items() for name in names if name in found[file].origins}
    return ran.keys() | {path for path in named if path.name != "__init__.py"}


def size(root: Path) -> dict[str, Any]:
    """All figures of a checkout, as JSON."""
    found = modules(root)
    lonely = with_one_importer(found)
    strokes = {name: parts_of(root, found, setup) for name, setup in STROKES.items()}
    training = {path for path in parts_of(root, found, TRAINING, compiled=True) if path.parent.name == "training"}
    strokes["a stroke of training"] = training | strokes["a stroke of `RallyEnv`"]
    return {
        "the package": _sums(list(found.values())),
        "modules with one importer": _sums(lonely),
        **{name: _sums([found[path] for path in sorted(paths)]) for name, paths in strokes.items()},
    }


def _sums(parts: list[Module]) -> dict[str, Any]:
    return {
        "files": len(parts),
        "lines": sum(p.lines for p in parts),
        "public names": sum(len(p.names) for p in parts),
        "modules": [p.name for p in parts],
    }


def main(root: tyro.conf.Positional[Path] = ROOT, *, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Count, and print a table in Markdown.

    Args:
        root: Root of a checkout.
        as_json: Print JSON with the names of the modules.
    """
    result = size(root.resolve())
    rows = [(what, *(f"{figures[name]:,}" for name in ("files", "lines", "public names"))) for what, figures in result.items()]
    text = json.dumps(result, indent=1) if as_json else markdown(("", "files", "lines", "public names"), rows, left=("",))
    Console(soft_wrap=True).print(text, markup=False, highlight=False)


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Count the files, lines and names of the package."))
