"""The size of the repository, imports in a loop, and the files whose functions run in one step.

    python -m docs.tools.size [--json]

Lines with code are those without blank lines, comments and docstrings; lines of other strings count. A step is traced uncompiled
and when it is executed for the second time, so preparation does not count.
"""

import ast
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

import grimp
import tyro

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.commands import cli

PACKAGE: Final = "shuttle_marl"
_OUTSIDE: Final = ("benchmarks", "datasets", "docs", "experiments")
_STROKE: Final = """
from shuttle_marl import rally_v0
env = rally_v0.env()
while True:
    env.reset(seed=1)
    traced(lambda: env.step(env.action_space(env.agent_selection).sample(env.last()[0]["action_mask"])))
"""
_TRAINING: Final = """
import tempfile
from pathlib import Path
from shuttle_marl.training import PPOConfig, train
from {module} import {owner}
step = {owner}.{method}
{owner}.{method} = lambda *arguments: traced(lambda: {call})
with tempfile.TemporaryDirectory() as folder:
    train(PPOConfig(strokes=1000, batch=32, width=4, checkpoint_every=1, record="{record}", out=Path(folder) / "run"))
"""
_ITERATE: Final = {"module": "shuttle_marl.training.learner", "owner": "Trainer", "method": "iterate", "record": "none"}
_RECORD: Final = {"module": "shuttle_marl.training.rally_log", "owner": "RunLog", "method": "record", "record": "all"}
_STEPS: Final = {
    "stroke": _STROKE,
    "training_step": _TRAINING.format(**_ITERATE, call="step(*arguments)"),
    "recorded_rally": _TRAINING.format(**_RECORD, call="[step(*arguments), arguments[0].flush()]"),
}
"""Code that calls ``traced(call)`` with the step, at least twice."""
_FRAME: Final = ROOT / PACKAGE / "watch/page/src/frame.ts"
"""Module of the page that draws one frame."""
_TRACE: Final = """
import json, sys, threading
files, calls = set(), 0
def note(frame, event, _):
    if event == "call":
        files.add(frame.f_code.co_filename)
def traced(call):
    global calls
    calls += 1
    files.clear()
    sys.setprofile(note)
    try:
        result = call()
    finally:
        sys.setprofile(None)
    if calls == 2:
        raise SystemExit
    return result
threading.setprofile(note)  # what a step leaves to threads is a part of it
try:
    exec({setup!r})
finally:
    print("\\n" + json.dumps(sorted(files)))
"""
_IMPORT: Final = re.compile(r'^(?:import|export)\b[^"\';]*["\'](\.[^"\']*)["\']', re.MULTILINE)


def lines_of(text: str) -> int:
    """Number of lines with code of a Python file."""
    left_out = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    lines = {line for token in tokens if token.type not in left_out for line in range(token.start[0], token.end[0] + 1)}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            lines.difference_update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return len(lines)


def circles(*, types: bool = False) -> list[str]:
    """Imports within the package, and files of the page, without which nothing would import itself in a loop.

    The parts of a package are files, and folders as one part. For the page, imports of types count.

    Args:
        types: imports for type checking count in the package too.
    """
    graph = grimp.build_graph(PACKAGE, exclude_type_checking_imports=not types, cache_dir=None)
    found = {pair for module in graph.modules for pair in graph.nominate_cycle_breakers(module)}
    scripts = [path for path in _FRAME.parent.glob("*.ts") if path in _reached(*_imported(path))]
    return [*(f"{here} -> {there}" for here, there in sorted(found)), *(path.name for path in sorted(scripts))]


def files_of(step: str) -> set[str]:
    """Python files of the package whose functions run in a step, relative to the package."""
    command = [sys.executable, "-W", "ignore", "-c", _TRACE.format(setup=_STEPS[step])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    package = f"{ROOT / PACKAGE}{os.sep}"
    return {file.removeprefix(package) for file in json.loads(done.stdout.splitlines()[-1]) if file.startswith(package)}


def _reached(*scripts: Path) -> set[Path]:
    """TypeScript modules and all modules that they import, directly or not."""
    reached, waiting = set[Path](), list(scripts)
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting.extend(_imported(path))
    return reached


def _imported(script: Path) -> Iterator[Path]:
    named = (script.parent / f"{source.removesuffix('.ts')}.ts" for source in _IMPORT.findall(script.read_text(encoding="utf-8")))
    return (path for path in named if path.is_file())


def paths() -> dict[str, list[str]]:
    """Files that take part in each step, relative to the package."""
    frame = {path.relative_to(ROOT / PACKAGE).as_posix() for path in _reached(_FRAME)}
    return {**{step: sorted(files_of(step)) for step in _STEPS}, "page_frame": sorted(frame)}


def size() -> dict[str, Any]:
    """Lines and files of the package, lines with code by folder, imports in a loop, and the files of each step."""
    texts = {name: [p.read_text(encoding="utf-8") for p in (ROOT / name).rglob("*.py")] for name in (PACKAGE, *_OUTSIDE, "tests")}
    code = {name: sum(map(lines_of, found)) for name, found in texts.items()}
    return {
        "code": code[PACKAGE],
        "lines": sum(len(text.splitlines()) for text in texts[PACKAGE]),
        "files": len(texts[PACKAGE]),
        "outside": {"code": sum(code[name] for name in _OUTSIDE), **{name: code[name] for name in _OUTSIDE}},
        "tests": {"code": code["tests"], "lines": sum(len(text.splitlines()) for text in texts["tests"])},
        "circles": circles(),
        "circles_with_types": circles(types=True),
        "paths": paths(),
    }


def main(*, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """Measure the repository.

    Args:
        as_json: Print JSON.
    """
    found = size()
    figures = [(name, f"{found[name]:,}") for name in ("code", "lines", "files")]
    figures += [(f"code, {name}", f"{found[name]['code']:,}") for name in ("outside", "tests")]
    figures += [(f"files, {name}", str(len(files))) for name, files in found["paths"].items()]
    sys.stdout.write(json.dumps(found, indent=1) if as_json else markdown(("figure", "number"), figures, left=("figure",)))


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.size", description="Measure the repository."))
