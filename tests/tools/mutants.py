"""Mutation test: small changes of the code, each of which at least one test should notice.

    python -m tests.tools.mutants [--modules game exact …] [--n 100] [--seed 0] [--jobs 2] [--json]

A mutation (:mod:`tests.tools.mutations`) replaces one comparison, arithmetic or boolean operator, number, truth value, ``not``
or returned value, or lets a check pass that raises. Half of the sample changes files of :data:`CORE`, where a fault changes
results; changes of guards (conditions under which something is raised) are drawn twice as often as others. The tests of the
sampled packages run first, to record which functions each of them calls. A mutant of a Python function is a fork of a process
that has imported everything; the fast tests that call the function run on it, the quickest first, until one fails, then the
others of their files. Other mutants (compiled functions, constants, and functions that imports call) are copies of the
repository, on which the test files of the package run; if no fast test calls a function, its slow tests. The output has the
keys:

- ``tried``: mutants of the sample; ``equivalent``: those that no test can notice, listed in ``equivalent_mutants.toml``.
- ``killed``: a test failed; ``timeouts``: the fast tests took longer than ``--timeout`` seconds; ``survived``: all tests passed.
- ``share``: fraction of mutants noticed, killed or timed out, of those that are not equivalent; ``guards`` and ``strata``:
  ``tried`` and ``share`` of those in guards, in the core and in the rest.
- ``survivors``: file, line, and the source before and after of each survivor.
"""

import dataclasses
import functools
import gc
import hashlib
import importlib
import itertools
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
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final, Literal, get_args

import pytest
import tyro

from tests.tools import instrumentation
from tests.tools.mutations import ROOT, Mutant, mutants

Module = Literal[
    "base", "commands", "data", "dynamics", "env", "exact", "game", "kernel", "league", "policy",
    "recording", "reports", "court", "suite", "training",
]  # fmt: skip
TESTS: Final[dict[str, tuple[str, ...]]] = {
    "base": ("package", "data", "recording", "policy", "league", "reports", "watch", "training/test_run_faults.py"),
    "commands": (
        "package",
        "data",
        "recording",
        "reports",
        "exact/test_exact_commands.py",
        "league",
        "training/test_training_runs.py",
    ),
    "data": ("data", "reports", "dynamics"),
    "dynamics": ("dynamics", "data", "policy", "reports/test_habits.py"),
    "env": ("env", "suite", "policy", "game/test_rules.py"),
    "kernel": ("kernel", "env", "suite", "game/test_rules.py"),
    "reports": ("reports", "exact/test_exact_commands.py", "league", "package", "watch/test_matches.py"),
    "recording": ("recording", "training/test_training_runs.py", "league"),
    "training": ("training", "league", "package/test_golden.py"),
    "court": ("watch", "staging", "scene"),
    "exact": ("exact", "suite/test_adapt.py"),
    "game": (
        *("game", "policy", "exact/test_lists.py", "exact/test_minimax.py", "kernel/test_kernel_draws.py"),
        *("kernel/test_matches_kernel.py", "kernel/test_recovery_kernel.py", "env/test_rally_env.py"),
        *("env/test_recovery_envs.py", "suite/test_targets.py"),
    ),
    "league": ("league",),
    "policy": (
        *("policy", "exact/test_exact_commands.py", "exact/test_scorecards.py", "exact/test_solved_policies.py"),
        *("league/test_programs.py", "training/test_shipped_agents.py"),
    ),
    "suite": ("suite", "experiments/test_suite.py"),
}
"""Folders and files of the tests of each package."""
CORE: Final = tuple(
    f"shuttle_marl/{name}"
    for name in (
        *("game/", "kernel/", "env/", "exact/", "recording/", "data/readers.py", "data/sheet.py", "data/own.py"),
        "league/ranking.py",
    )
)
"""Folders and files of rules, kernel, environments, exact values, recording, readers and ratings."""
GENERAL: Final = tuple(f"package/test_{name}.py" for name in ("refusals", "command_line", "printed"))
"""Tests of all packages: refusals, and what commands print."""
EQUIVALENT: Final = Path(__file__).with_name("equivalent_mutants.toml")
MODULES: Final = "shuttle_marl/court/page/node_modules"
"""Folder of the page's tools, which copies link to."""
LIBRARIES: Final = ("numba", "scipy.optimize", "scipy.stats", "torch", "pandas", "pyarrow.csv", "hypothesis", "sybil", "msgspec")
"""Imported once, before the processes of the tests are forked."""


@dataclasses.dataclass
class Task:
    """Tests to run, on a mutant or to record their calls, and how that ended: an exit status, or None after a timeout."""

    tests: list[str]
    mutant: Mutant | None = None
    slow: bool = False
    limit: float = 3600.0
    status: int | None = None
    seconds: float = 0.0

    @property
    def verdict(self) -> str:
        if self.status is None:
            return "survived" if self.slow else "timeouts"  # slow tests may take longer without any fault
        return "survived" if self.status in (0, 5) else "killed"


def run(tasks: list[Task], target: Callable[[Task, int], None], jobs: int) -> Iterator[Task]:
    """Call a function with each task, and the number of its place among those that run, in forks of this process."""
    waiting, places = tasks[::-1], list(range(jobs))
    running: dict[int, Any] = {}
    while waiting or running:
        while waiting and places:
            task, place = waiting.pop(), places.pop()
            process = multiprocessing.get_context("fork").Process(target=target, args=(task, place))
            process.start()
            running[process.sentinel] = process, task, place, time.monotonic()
        multiprocessing.connection.wait(list(running), 1.0)
        for sentinel, (process, task, place, start) in list(running.items()):
            task.seconds = time.monotonic() - start
            if process.is_alive() and task.seconds <= task.limit:
                continue
            task.status = process.exitcode
            if process.is_alive():
                os.killpg(process.pid, signal.SIGKILL)
            process.join()
            places.append(place)
            del running[sentinel]
            yield task


def _enter(root: Path, output: Path, machine_code: Path, *startup: Path) -> None:
    """Let this process, which is a fork, run the tests of a copy."""
    os.setsid()
    os.chdir(root)
    os.environ |= {"PYTHONPATH": os.pathsep.join(map(str, (root, *startup))), "NUMBA_CACHE_DIR": str(machine_code)}
    for name in [name for name in sys.modules if name.split(".")[0] in ("shuttle_marl", "tests", "conftest", "docs")]:
        del sys.modules[name]
    sys.path[:] = [str(root), *(path for path in sys.path if path and Path(path).resolve() != ROOT)]
    _write_to(output)


def _write_to(output: Path) -> None:
    file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(file, 1), os.dup2(file, 2)


def _pytest(tests: list[str], plugin: object = None, slow: bool = False) -> int:
    flags = ["-x", "-q", "-m", "slow" if slow else "not slow", "-p", "no:cacheprovider", "-p", "no:xdist"]
    return int(pytest.main([*flags, *tests], plugins=[plugin] if plugin else []))


def _run_copy(template: Path, task: Task, place: int) -> None:
    """Run tests of a copy with a mutation: links, until a file is replaced."""
    # The folder has the same name as for the mutant before, so what that compiled is found.
    root, mutant = template.with_name(f"copy-{place}"), task.mutant
    assert mutant is not None
    if root.exists():
        done = root.rename(tempfile.mkdtemp(dir=template.parent))  # a test's process may still write there
        shutil.rmtree(done, ignore_errors=True)
    shutil.copytree(template, root, symlinks=True, copy_function=os.link)
    (root / mutant.file).unlink()
    (root / mutant.file).write_bytes(mutant.source())
    _enter(root, Path(f"{root}.txt"), Path(f"{root}-machine-code") if mutant.function else root / "machine-code")
    os._exit(_pytest(task.tests, slow=task.slow))


class _Forks:
    """Plugin of pytest: after the collection, runs tests on mutants of functions, each in a fork."""

    def __init__(self, template: Path, tasks: list[Task], jobs: int, results: multiprocessing.connection.Connection) -> None:
        self.template, self.tasks, self.jobs, self.results = template, tasks, jobs, results

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.session, self.items = session, {item.nodeid: item for item in session.items}
        numbers = {id(task): number for number, task in enumerate(self.tasks)}
        for task in run(self.tasks, self._run, self.jobs):
            self.results.send((numbers[id(task)], task.status, task.seconds))
        return True

    def _run(self, task: Task, place: int) -> None:
        os.setsid()
        work = self.template.with_name(f"fork-{place}")
        shutil.rmtree(work, ignore_errors=True)
        mutant, temporary = task.mutant, work / "temporary"
        assert mutant is not None
        changed = work / "changed" / mutant.file
        for folder in (changed.parent, temporary):
            folder.mkdir(parents=True)
        changed.write_bytes(mutant.source())
        _write_to(work / "output.txt")
        os.environ |= {instrumentation.CHANGED: str(work / "changed"), "XDG_CACHE_HOME": str(work / "cache")}
        instrumentation.change()
        _exchange(self.template / mutant.file, mutant)
        vars(vars(self.session.config)["_tmp_path_factory"])["_basetemp"] = temporary
        items = [self.items[test] for test in task.tests]
        for item, following in zip(items, [*items[1:], None], strict=True):
            self.session.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if self.session.testsfailed:
                os._exit(1)
        os._exit(0)


def _exchange(path: Path, mutant: Mutant) -> None:
    """Let the mutant's function, where it was imported, and what it has defined run the code of the mutant."""

    def inner(code: CodeType) -> Iterator[CodeType]:
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                yield constant
                yield from inner(constant)

    new = {(code.co_qualname, code.co_firstlineno): code for code in inner(compile(mutant.source(), path, "exec"))}
    outer = mutant.function.split(".<locals>")[0]
    gc.unfreeze()  # the collection of tests is frozen, and would not be found
    for function in [each for each in gc.get_objects() if isinstance(each, FunctionType)]:
        code = function.__code__
        if code.co_qualname.split(".<locals>")[0] == outer and code.co_filename == str(path):
            function.__code__ = new.get((code.co_qualname, code.co_firstlineno), code)


def _serve(template: Path, tasks: list[Task], jobs: int, results: multiprocessing.connection.Connection) -> None:
    """Collect all tests, and send how each task ended."""
    _enter(template, template.with_name("forks.txt"), template.with_name("machine-code"), _startup(template, "change"))
    os.environ[instrumentation.ROOT] = str(template)
    os._exit(
        _pytest(sorted({test.split("::")[0] for task in tasks for test in task.tests}), _Forks(template, tasks, jobs, results))
    )


def run_forks(template: Path, tasks: list[Task], jobs: int) -> Iterator[Task]:
    """Run tests on mutants of functions: in one process that imports everything once."""
    if not tasks:
        return
    receiver, sender = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("fork").Process(target=_serve, args=(template, tasks, jobs, sender))
    process.start()
    sender.close()
    for _ in tasks:
        try:
            number, status, seconds = receiver.recv()
        except EOFError:
            raise SystemExit(template.with_name("forks.txt").read_text()[-3000:]) from None
        yield dataclasses.replace(tasks[number], status=status, seconds=seconds)
    process.join()


class _Marks:
    """Plugin of pytest: marks where tests, and fixtures that several tests share, begin and end."""

    def __init__(self, mark: Callable[[str], None]) -> None:
        self.mark = mark

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        fixtures = [name for name, found in vars(item)["_fixtureinfo"].name2fixturedefs.items() if found[-1].scope != "function"]
        return (yield from self._timed("test", item.nodeid, fixtures))

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        return (yield from self._timed("fixture", fixturedef.argname, []))

    def _timed(self, kind: str, name: str, fixtures: list[str]) -> Any:
        start = time.monotonic()
        self.mark(json_.dumps([kind, name, fixtures]))
        try:
            return (yield)
        finally:
            self.mark(json_.dumps(["end", time.monotonic() - start]))


def _record_file(template: Path, task: Task, place: int) -> None:
    """Note which functions the tests of a file call."""
    output = _output(template, *task.tests)
    os.environ |= {instrumentation.FILE: f"{output}.calls", instrumentation.ROOT: str(template)}
    _enter(template, output, template.with_name("machine-code"), _startup(template, "note_calls"))
    mark = instrumentation.note_calls()
    os._exit(_pytest(task.tests, _Marks(mark)))


def _output(template: Path, file: str) -> Path:
    return template.with_name(f"{file.replace('/', '-')}.txt")


def _startup(template: Path, function: str) -> Path:
    """Folder of what each interpreter runs first: a function of :mod:`tests.tools.instrumentation`."""
    folder = template.with_name(f"startup-{function}")
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(f"from tests.tools import instrumentation\n\ninstrumentation.{function}()\n")
    return folder


@dataclasses.dataclass
class Calls:
    """Duration, called functions and shared fixtures of a test, or of a fixture that several tests share."""

    seconds: float = 0.0
    functions: set[str] = dataclasses.field(default_factory=set)
    fixtures: list[str] = dataclasses.field(default_factory=list)


def _read_calls(lines: list[str]) -> tuple[dict[str, Calls], set[str]]:
    """For each test its calls, and the functions that imports call."""
    found: dict[tuple[str, str], Calls] = defaultdict(Calls)
    stack = [Calls()]
    imports: set[str] = set()
    for line in lines:
        if not line.startswith("["):
            (imports if line.startswith(instrumentation.IMPORT) else stack[-1].functions).add(
                line.removeprefix(instrumentation.IMPORT)
            )
            continue
        kind, *fields = json_.loads(line)
        if kind == "end":
            stack.pop().seconds += fields[0]
            stack[-1].seconds -= fields[0]
        else:
            stack.append(found[kind, fields[0]])
            stack[-1].fixtures = fields[1]
    tests = {name: each for (kind, name), each in found.items() if kind == "test"}
    for each in tests.values():
        for fixture in each.fixtures:
            each.seconds += found["fixture", fixture].seconds
            each.functions |= found["fixture", fixture].functions
    return tests, imports


def _record(files: list[str], template: Path, jobs: int, folder: Path) -> dict[str, dict[str, Any]]:
    """For each test file: ``tests``, each with its seconds and the functions that it calls, and those that ``imports`` call."""
    found = {file: json_.loads(path.read_text()) for file in files if (path := folder / f"{file}.json").exists()}
    digests = {file: hashlib.sha256((ROOT / file).read_bytes()).hexdigest() for file in files}
    tasks = [Task([file]) for file in files if found.get(file, {}).get("digest") != digests[file]]
    failing = []
    for task in run(tasks, functools.partial(_record_file, template), jobs):
        (file,), output = task.tests, _output(template, *task.tests)
        if task.verdict == "survived":
            tests, imports = _read_calls(Path(f"{output}.calls").read_text().splitlines())
            found[file] = {"digest": digests[file], "imports": sorted(imports)}
            found[file]["tests"] = {name: [each.seconds, sorted(each.functions)] for name, each in tests.items()}
            path = folder / f"{file}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json_.dumps(found[file]))
        else:
            failing.append(file)
            print(output.read_text()[-3000:], file=sys.stderr, flush=True)
    if failing:
        raise SystemExit(f"tests fail without a mutation: {', '.join(failing)}")
    return found


def _test_files(file: str) -> list[str]:
    """Test files of the package of a file."""
    found = [ROOT / "tests" / name for name in (*TESTS[file.split("/")[1]], *GENERAL)]
    files = {test for path in found for test in (path.glob("test_*.py") if path.is_dir() else [path]) if test.exists()}
    return [test.relative_to(ROOT).as_posix() for test in sorted(files)]


def _stratum(mutant: Mutant) -> str:
    return "core" if mutant.file.startswith(CORE) else "rest"


def _tasks(todo: list[Mutant], recorded: dict[str, dict[str, Any]], timeout: float) -> tuple[list[Task], list[Task]]:
    """Tests for each mutant: in a fork of a process that has imported everything, and in a copy."""
    imports = {name for file in recorded.values() for name in file["imports"]}
    forks, copies = [], []
    for mutant in todo:
        name = f"{mutant.file}:{mutant.function}"
        tests = {file: recorded[file]["tests"] for file in _test_files(mutant.file)}
        calling = {test: seconds for file in tests.values() for test, (seconds, called) in file.items() if name in called}
        files = sorted(tests, key=lambda file: sum(seconds for seconds, _ in tests[file].values()))
        if mutant.function:
            callers = {test.split("::")[0] for test in calling}
            files = [file for file in files if file in callers or name in recorded[file]["imports"]] or files
        first = sorted(calling, key=lambda test: calling[test])
        # Then others of these files: some find a cached result where they call the function on their own.
        rest = [test for file in files for test in tests[file] if test not in calling]
        limit = timeout + 2 * sum(seconds for file in files for seconds, _ in tests[file].values())
        if mutant.function and first and name not in imports:
            forks.append(Task([*first, *rest], mutant, limit=limit))
        else:
            slow = bool(mutant.function) and not first and name not in imports
            copies.append(Task(files, mutant, slow=slow, limit=timeout if slow else limit))
    return forks, copies


def main(
    modules: tuple[Module, ...] = get_args(Module),
    n: int = 100,
    seed: int = 0,
    jobs: int = 2,
    timeout: float = 600.0,
    recorded: Path | None = None,
    json: bool = False,
) -> None:
    """Run tests on mutants of the code.

    Args:
        modules: packages to change.
        n: size of the random sample, half of it in the core; 0: all mutants.
        seed: random seed.
        jobs: number of processes.
        timeout: seconds after which tests are stopped.
        recorded: folder that keeps which functions the tests call, to save that first run when only tests change.
        json: print JSON.
    """
    for library in LIBRARIES:
        importlib.import_module(library)
    sources = [path for module in modules for path in sorted((ROOT / "shuttle_marl" / module).rglob("*.py"))]
    every = [m for path in sources for m in mutants(path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))]
    strata: dict[str, list[Mutant]] = {"core": [], "rest": []}
    for mutant in every:
        strata[_stratum(mutant)] += [mutant] * (1 + mutant.guard)
    for number, drawn in enumerate(strata.values()):
        random.Random(2 * seed + number).shuffle(drawn)
    sample = [mutant for drawn in strata.values() for mutant in list(dict.fromkeys(drawn))[: -(-n // 2) or None]]
    known = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["mutant"]
    equivalent = {(entry["file"], entry["before"], entry["after"]) for entry in known}
    todo = [mutant for mutant in sample if (mutant.file, mutant.before, mutant.after) not in equivalent]
    counts: dict[str, Counter[str]] = {name: Counter() for name in ("all", "guards", *strata)}
    survivors = []
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as folder:
        template, ignored = Path(folder) / "template", (".git", ".venv", "node_modules", "raw", "runs", ".*_cache")
        shutil.copytree(ROOT, template, symlinks=True, ignore=shutil.ignore_patterns(*ignored))
        if (ROOT / MODULES).exists():
            (template / MODULES).symlink_to(ROOT / MODULES)
        files = sorted({file for mutant in todo for file in _test_files(mutant.file)})
        forks, copies = _tasks(todo, _record(files, template, jobs, recorded or Path(folder)), timeout)
        ended = (run_forks(template, forks, jobs), run(copies, functools.partial(_run_copy, template), jobs))
        for task in itertools.chain(*ended):
            assert task.mutant is not None
            for name in ("all", _stratum(task.mutant), *["guards"] * task.mutant.guard):
                counts[name][task.verdict] += 1
            if task.verdict == "survived":
                survivors.append({name: getattr(task.mutant, name) for name in ("file", "line", "before", "after")})
            print(f"{task.verdict} in {task.seconds:.0f} s: {task.mutant}", file=sys.stderr, flush=True)
    rates = {
        name: {"tried": found.total(), "share": 1 - found["survived"] / max(1, found.total())} for name, found in counts.items()
    }
    result: dict[str, Any] = {"tried": len(sample), **{name: counts["all"][name] for name in ("killed", "survived", "timeouts")}}
    result |= {"equivalent": len(sample) - len(todo), "share": rates["all"]["share"], "guards": rates["guards"]}
    result |= {"strata": {name: rates[name] for name in strata}, "survivors": survivors}
    print(json_.dumps(result) if json else "\n".join(f"{name}: {value}" for name, value in result.items()))


if __name__ == "__main__":
    tyro.cli(main)
