"""Mutation test: small changes of the code, each of which at least one test should notice.

    python -m tests.mutants [--modules game exact …] [--n 100] [--seed 0] [--jobs 2] [--json]

A mutation replaces one comparison, arithmetic or boolean operator, number, truth value, ``not`` or returned value, or lets a
check pass that raises. Decorators, annotations, ``__all__`` and error messages stay. Changes of guards (conditions under which
something is raised, and limits) are drawn twice as often as others. Each mutant of a random sample is a copy of the repository in
a temporary folder. Compiled functions, those that they inline and constants are compiled anew for it; after other changes the
machine code of the mutant before is used. The test files whose fast tests call the changed function run on it, the quickest
first, until a test fails; if no fast test calls it, the slow tests of its package run. The output has the keys:

- ``tried``: mutants of the sample; ``equivalent``: those that no test can notice, listed in ``equivalent_mutants.toml``.
- ``killed``: a test failed; ``timeouts``: the fast tests took longer than ``--timeout`` seconds; ``survived``: all tests passed.
- ``share``: fraction of mutants noticed, killed or timed out, of those that are not equivalent; ``guards``: ``tried`` and
  ``share`` of those in guards.
- ``survivors``: file, line, and the source before and after of each survivor.
"""

import ast
import copy
import dataclasses
import hashlib
import importlib
import json as json_
import multiprocessing
import multiprocessing.connection
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, Literal, get_args

import pytest
import tyro

from tests import calls
from tests.calls import is_compiled

ROOT: Final = Path(__file__).resolve().parents[1]
Module = Literal[
    "analysis", "base", "coach", "commands", "data", "dynamics", "env", "exact", "game", "kernel", "league", "pages", "policy",
    "recording", "scene", "staging", "suite", "training", "watch",
]  # fmt: skip
TESTS: Final[dict[str, tuple[str, ...]]] = {
    "analysis": (
        *("analysis", "coach", "data/test_simulated_strokes.py", "exact/test_exact_commands.py", "league/test_pair_league.py"),
        *("suite/test_offline.py", "watch/test_matches.py"),
    ),
    "base": ("package", "data", "recording", "policy", "league", "coach", "watch", "training/test_run_faults.py"),
    "coach": ("coach", "analysis"),
    "commands": (
        "package",
        "data",
        "recording",
        "coach",
        "exact/test_exact_commands.py",
        "league",
        "training/test_training_runs.py",
    ),
    "data": ("data", "analysis", "dynamics"),
    "dynamics": ("dynamics", "data", "policy"),
    "env": ("env", "suite", "policy"),
    "kernel": ("kernel", "env", "suite"),
    "pages": ("coach", "league", "package", "analysis"),
    "recording": ("recording", "training/test_training_runs.py", "league"),
    "scene": ("scene", "watch"),
    "staging": ("staging", "scene"),
    "training": ("training", "league", "package/test_golden.py"),
    "watch": ("watch",),
    "exact": ("exact", "suite/test_adapt.py"),
    "game": (
        *("game", "policy", "exact/test_lists.py", "exact/test_minimax.py", "kernel/test_kernel_draws.py"),
        *("kernel/test_matches_kernel.py", "env/test_rally_env.py", "suite/test_targets.py"),
    ),
    "league": ("league",),
    "policy": (
        *("policy", "exact/test_exact_commands.py", "exact/test_scorecards.py", "exact/test_solved_policies.py"),
        *("league/test_programs.py", "training/test_shipped_agents.py"),
    ),
    "suite": ("suite", "experiments/test_suite.py"),
}
"""Folders and files of the tests of each package."""
GENERAL: Final = tuple(f"package/test_{name}.py" for name in ("limits", "refusals", "command_line", "printed"))
"""Tests of all packages: limits and settings, refusals, and what commands print."""
EQUIVALENT: Final = Path(__file__).with_name("equivalent_mutants.toml")
MODULES: Final = "shuttle_marl/watch/page/node_modules"
"""Folder of the page's tools, which copies link to."""
OPERATORS: Final = {
    **{"Lt": "LtE GtE", "LtE": "Lt Gt", "Gt": "GtE LtE", "GtE": "Gt Lt", "Eq": "NotEq", "NotEq": "Eq", "Is": "IsNot"},
    **{"IsNot": "Is", "In": "NotIn", "NotIn": "In", "And": "Or", "Or": "And", "Add": "Sub", "Sub": "Add", "Mult": "Div"},
    **{"Div": "Mult", "FloorDiv": "Mult", "Mod": "FloorDiv", "Pow": "Mult", "BitAnd": "BitOr", "BitOr": "BitAnd"},
    **{"BitXor": "BitAnd", "LShift": "RShift", "RShift": "LShift"},
}
"""Classes of :mod:`ast` that replace an operator, one at a time."""
LIBRARIES: Final = ("numba", "scipy.optimize", "scipy.stats", "torch", "pandas", "pyarrow.csv", "hypothesis", "sybil", "msgspec")
"""Imported once, before the processes of the tests are forked."""


@dataclasses.dataclass(frozen=True)
class Mutant:
    """One change of a file.

    Attributes:
        file: path in the repository.
        function: qualified name of the innermost function around the change; empty if there is none or it is compiled.
        line: number of the first changed line.
        before, after: source lines without and with the change.
        guard: whether the change is one of a guard.
        lines: numbers of the changed lines, from 0, the last excluded; ``new``: what stands there instead.
    """

    file: str
    function: str
    line: int
    before: str
    after: str
    guard: bool
    lines: tuple[int, int] = dataclasses.field(repr=False)
    new: bytes = dataclasses.field(repr=False)

    def source(self) -> bytes:
        """Content of the changed file."""
        old, (first, last) = (ROOT / self.file).read_bytes().splitlines(keepends=True), self.lines
        return b"".join([*old[:first], self.new, *old[last:]])


def variants(node: ast.AST) -> Iterator[ast.AST]:
    """Copies of a node with one change of its own."""

    def changed(**fields: Any) -> ast.AST:
        new = copy.copy(node)
        vars(new).update(fields)
        return new

    def is_sequence(x: ast.AST) -> bool:  # other operators would only raise TypeError
        return isinstance(x, ast.JoinedStr | ast.List | ast.Tuple) or (isinstance(x, ast.Constant) and isinstance(x.value, str))

    def others(op: ast.AST) -> list[Any]:
        return [getattr(ast, name)() for name in OPERATORS.get(type(op).__name__, "").split()]

    match node:
        case ast.Compare(ops=ops):
            yield from (changed(ops=[*ops[:at], op, *ops[at + 1 :]]) for at in range(len(ops)) for op in others(ops[at]))
        case ast.BinOp(op=op) | ast.AugAssign(op=op) | ast.BoolOp(op=op):
            if not any(map(is_sequence, ast.iter_child_nodes(node))):
                yield from (changed(op=other) for other in others(op))
        case ast.UnaryOp(op=ast.Not() | ast.USub(), operand=operand):
            yield operand
        case ast.Constant(value=bool(value)):
            yield changed(value=not value)
        case ast.Constant(value=int(value) | float(value)):
            yield changed(value=value + 1)
        case ast.Return(value=value) if value is not None and not (isinstance(value, ast.Constant) and value.value is None):
            yield changed(value=ast.Constant(None))


def mutants(file: str, source: str) -> Iterator[Mutant]:
    """All mutants of a file."""
    lines = source.encode().splitlines(keepends=True)

    def visit(node: ast.AST, scope: str, function: str, guard: bool) -> Iterator[Mutant]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            is_function = isinstance(node, ast.FunctionDef)
            function = scope + node.name if is_function and not is_compiled(node) else ""
            scope += f"{node.name}.<locals>." if is_function else f"{node.name}."
            node.decorator_list = []
        elif isinstance(node, ast.expr | ast.Return | ast.AugAssign):
            yield from (make(node, variant, function, guard) for variant in variants(node))
        if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Raise):
            yield make(node.test, ast.Constant(False), function, True)
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.arguments):  # defaults are computed where the function is defined
                for default in filter(None, (*child.defaults, *child.kw_defaults)):
                    yield from visit(default, "", "", guard)
            elif not _is_excluded(node, child):
                yield from visit(child, scope, function, guard or _is_guard(node, child))

    def make(node: Any, variant: ast.AST, function: str, guard: bool) -> Mutant:
        first, last = node.lineno - 1, node.end_lineno
        text = ast.unparse(variant) if isinstance(variant, ast.stmt | ast.Constant) else f"({ast.unparse(variant)})"
        head, tail = lines[first][: node.col_offset], lines[last - 1][node.end_col_offset :]
        new = head + text.encode() + tail + b"\n" * (last - 1 - first)  # other lines keep their numbers
        before, after = (b" ".join(x.split()).decode() for x in (b"".join(lines[first:last]), new))
        return Mutant(file, function, node.lineno, before, after, guard, (first, last), new)

    yield from visit(ast.parse(source), "", "", False)


def _is_guard(node: ast.AST, child: ast.AST) -> bool:
    """Whether a child is the condition of an error, or a limit."""
    match node:
        case ast.If(test=test, body=[*_, ast.Raise()]):
            return child is test
        case ast.AnnAssign(target=ast.Name(id=name), value=value) | ast.Assign(targets=[ast.Name(id=name)], value=value):
            return child is value and name.lstrip("_").startswith(("MAX", "MOST", "LEAST", "MIN", "LONGEST", "LIMIT"))
    return False


def _is_excluded(node: ast.AST, child: ast.AST) -> bool:
    if child in (getattr(node, "annotation", None), getattr(node, "returns", None)):
        return True
    match child:
        case ast.Assign(targets=[ast.Name(id="__all__")]) | ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return True
        case ast.Raise() | ast.JoinedStr() | ast.keyword(arg="strict") | ast.Call(func=ast.Attribute(value=ast.Name(id="_LOG"))):
            return True
    return False


@dataclasses.dataclass
class Task:
    """Tests to run, on a mutant or to record their calls, and how that ended: an exit status, or None after a timeout."""

    files: list[str]
    mutant: Mutant | None = None
    slow: bool = False
    status: int | None = None
    seconds: float = 0.0
    calls: list[str] = dataclasses.field(default_factory=list)

    @property
    def verdict(self) -> str:
        if self.status is None:
            return "survived" if self.slow else "timeouts"  # slow tests may take longer without any fault
        return "survived" if self.status in (0, 5) else "killed"


def _run_tests(copied: Path, task: Task, machine_code: str) -> None:
    """Run tests of a copy in this process, which is a fork; exit with the status of pytest."""
    os.setsid()
    os.chdir(copied)
    os.environ |= {"PYTHONPATH": str(copied), "NUMBA_CACHE_DIR": machine_code}
    for name in [name for name in sys.modules if name.split(".")[0] in ("shuttle_marl", "tests", "conftest", "docs")]:
        del sys.modules[name]
    sys.path[:] = [str(copied), *(path for path in sys.path if path and Path(path).resolve() != ROOT)]
    # Beside the copy, in which a test compares all files with those of the repository.
    output = os.open(copied.parent / f"output-{os.getpid()}.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1), os.dup2(output, 2)
    if not task.mutant:
        os.environ |= {calls.FILE: f"{copied}-calls-{os.getpid()}.txt", calls.ROOT: str(copied)}
        os.environ["PYTHONPATH"] += f"{os.pathsep}{_startup(copied)}"
        calls.start()
    marked = "slow" if task.slow else "not slow"
    status = pytest.main(["-x", "-q", "-m", marked, "-p", "no:cacheprovider", "-p", "no:xdist", *task.files])
    os._exit(int(status))


def _startup(copied: Path) -> Path:
    """Folder of what each interpreter runs first."""
    folder = Path(f"{copied}-startup")
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text("from tests import calls\n\ncalls.start()\n")
    return folder


def run(tasks: list[Task], template: Path, jobs: int, timeout: float) -> Iterator[Task]:
    """Run tasks in parallel, without a mutation in the template, else in copies of it: links, until a file is replaced."""
    waiting, slots = tasks[::-1], [template.with_name(f"copy-{job}") for job in range(jobs)]
    running: dict[int, Any] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            task, folder, machine_code = waiting.pop(), template, ""
            if task.mutant:
                folder = slots.pop()
                shutil.copytree(template, folder, symlinks=True, copy_function=os.link)
                # The folder has the same name as for the mutant before, so what that compiled is found.
                machine_code = f"{folder}-machine-code" if task.mutant.function else f"{folder}/machine-code"
                (folder / task.mutant.file).unlink()
                (folder / task.mutant.file).write_bytes(task.mutant.source())
            process = multiprocessing.get_context("fork").Process(target=_run_tests, args=(folder, task, machine_code))
            process.start()
            running[process.sentinel] = process, task, folder, time.monotonic()
        multiprocessing.connection.wait(list(running), 1.0)
        for sentinel, (process, task, folder, start) in list(running.items()):
            task.seconds = time.monotonic() - start
            if process.is_alive() and task.seconds <= timeout:
                continue
            task.status = process.exitcode
            if process.is_alive():
                os.killpg(process.pid, signal.SIGKILL)
            process.join()
            if task.mutant:
                done = folder.rename(tempfile.mkdtemp(dir=template.parent))  # a test's process may still write there
                shutil.rmtree(done, ignore_errors=True)
                slots.append(folder)
            elif task.verdict == "survived":
                task.calls = sorted(set(Path(f"{folder}-calls-{process.pid}.txt").read_text().splitlines()))
            else:
                output = (folder.parent / f"output-{process.pid}.txt").read_text()
                print(f"{task.files[0]} fails without a mutation:\n{output[-3000:]}", file=sys.stderr, flush=True)
            del running[sentinel]
            yield task


def _record(files: list[str], template: Path, jobs: int, kept: Path) -> dict[str, dict[str, Any]]:
    """For each test file, the functions that it calls and the seconds that it takes."""
    found = json_.loads(kept.read_text()) if kept.exists() else {}
    digests = {file: hashlib.sha256((ROOT / file).read_bytes()).hexdigest() for file in files}
    tasks = [Task([file]) for file in files if found.get(file, {}).get("digest") != digests[file]]
    for task in run(tasks, template, jobs, 3600.0):
        if task.verdict == "survived":
            found[task.files[0]] = {"digest": digests[task.files[0]], "seconds": task.seconds, "calls": task.calls}
            kept.write_text(json_.dumps(found))
    if failing := [task.files[0] for task in tasks if task.verdict != "survived"]:
        raise SystemExit(f"tests fail without a mutation: {', '.join(failing)}")
    return found


def _test_files(file: str) -> list[str]:
    """Test files of the package of a file."""
    found = [ROOT / "tests" / name for name in (*TESTS[file.split("/")[1]], *GENERAL)]
    files = {test for path in found for test in (path.glob("test_*.py") if path.is_dir() else [path])}
    return [test.relative_to(ROOT).as_posix() for test in sorted(files)]


def main(
    modules: tuple[Module, ...] = get_args(Module),
    n: int = 100,
    seed: int = 0,
    jobs: int = 2,
    timeout: float = 600.0,
    calls: Path | None = None,
    json: bool = False,
) -> None:
    """Run tests on mutants of the code.

    Args:
        modules: packages to change.
        n: size of the random sample; 0: all mutants.
        seed: random seed.
        jobs: number of processes.
        timeout: seconds after which tests are stopped.
        calls: JSON file that keeps which functions each test file calls, to save that first run when only tests change.
        json: print JSON.
    """
    for library in LIBRARIES:
        importlib.import_module(library)
    sources = [path for module in modules for path in sorted((ROOT / "shuttle_marl" / module).rglob("*.py"))]
    every = [m for path in sources for m in mutants(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))]
    drawn = every + [mutant for mutant in every if mutant.guard]
    random.Random(seed).shuffle(drawn)
    sample = list(dict.fromkeys(drawn))[: n or None]
    known = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["mutant"]
    equivalent = {(entry["file"], entry["before"], entry["after"]) for entry in known}
    todo = [mutant for mutant in sample if (mutant.file, mutant.before, mutant.after) not in equivalent]
    counts, guards = Counter[str](), Counter[str]()
    survivors = []
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        template, ignored = Path(folder) / "template", (".git", ".venv", "node_modules", "raw", ".*_cache")
        shutil.copytree(ROOT, template, symlinks=True, ignore=shutil.ignore_patterns(*ignored))
        if (ROOT / MODULES).exists():
            (template / MODULES).symlink_to(ROOT / MODULES)
        tests = sorted({file for mutant in todo for file in _test_files(mutant.file)})
        seen = _record(tests, template, jobs, calls or Path(folder) / "calls.json")
        tasks = []
        for mutant in todo:
            files = sorted(_test_files(mutant.file), key=lambda file: seen[file]["seconds"])
            callers = [file for file in files if f"{mutant.file}:{mutant.function}" in seen[file]["calls"]]
            tasks.append(Task(callers or files, mutant, slow=bool(mutant.function) and not callers))
        for task in run(tasks, template, jobs, timeout):
            assert task.mutant is not None
            counts[task.verdict] += 1
            guards[task.verdict] += task.mutant.guard
            if task.verdict == "survived":
                survivors.append({name: getattr(task.mutant, name) for name in ("file", "line", "before", "after")})
            print(f"{task.verdict} in {task.seconds:.0f} s: {task.mutant}", file=sys.stderr, flush=True)
    result: dict[str, Any] = {"tried": len(sample), **{name: counts[name] for name in ("killed", "survived", "timeouts")}}
    result |= {"equivalent": len(sample) - len(todo), "share": 1 - counts["survived"] / max(1, len(todo))}
    tried = guards.total()
    result |= {"guards": {"tried": tried, "share": 1 - guards["survived"] / max(1, tried)}, "survivors": survivors}
    print(json_.dumps(result) if json else "\n".join(f"{name}: {value}" for name, value in result.items()))


if __name__ == "__main__":
    tyro.cli(main)
