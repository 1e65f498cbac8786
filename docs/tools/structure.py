"""Structure of the package as tables and a diagram: layers from ``pyproject.toml``, and the files that take part in one step.

A step is traced uncompiled and when it is executed for the second time, so preparation does not count.
"""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from docs.tools.markdown import ROOT, markdown

PACKAGE: Final = "shuttle_marl"

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
FRAME: Final = ROOT / PACKAGE / "watch/page/src/frame.ts"
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
_PATHS: Final = {
    "stroke": "one stroke of `rally_v0`",
    "training_step": "one iteration of `train(PPOConfig())`",
    "recorded_rally": "recording the rallies of a training iteration",
    "page_frame": "one frame of the live court",
}


def _layers() -> list[list[str]]:
    """Modules of each layer, highest layer first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    return [layer.split(" : ") for contract in contracts if contract["type"] == "layers" for layer in contract["layers"]]


def _without_torch() -> set[str]:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    modules = [name for contract in contracts if contract["type"] == "forbidden" for name in contract["source_modules"]]
    return {name.removeprefix(f"{PACKAGE}.") for name in modules}


def _summary(module: str) -> str:
    """First sentence of the docstring of a module or package."""
    folder = ROOT / PACKAGE / module
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split()).split(". ")[0].removesuffix(".").replace("``", "`").replace(":mod:", "")


def layers() -> str:
    """Table of the layers with the first sentence of each docstring."""
    names = [name for layer in _layers() for name in layer]
    no_torch = _without_torch()
    rows = []
    for name in names:
        is_package = (ROOT / PACKAGE / name).is_dir()
        rows.append((f"`{name}{'/' if is_package else '.py'}`", _summary(name), "never" if name in no_torch else ""))
    return markdown(("layer", "contents", "imports PyTorch"), rows, left=("layer", "contents", "imports PyTorch"))


def diagram() -> str:
    """The layers as a Mermaid diagram: each layer imports only from layers below."""
    rows = [f'    L{i}["{" &nbsp; · &nbsp; ".join(layer)}"]' for i, layer in enumerate(_layers())]
    arrows = [f"    {' --> '.join(f'L{i}' for i in range(len(rows)))}"]
    return "\n".join(["```mermaid", "flowchart TD", *rows, *arrows, "```"])


def files_of(step: str) -> set[str]:
    """Python files of the package whose functions run in a step, relative to the package."""
    command = [sys.executable, "-W", "ignore", "-c", _TRACE.format(setup=_STEPS[step])]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    package = f"{ROOT / PACKAGE}{os.sep}"
    return {file.removeprefix(package) for file in json.loads(done.stdout.splitlines()[-1]) if file.startswith(package)}


def reached(*scripts: Path) -> set[Path]:
    """TypeScript modules and all modules that they import, directly or not."""
    reached, waiting = set[Path](), list(scripts)
    while waiting:
        path = waiting.pop()
        if path not in reached:
            reached.add(path)
            waiting.extend(imported(path))
    return reached


def imported(script: Path) -> Iterator[Path]:
    """TypeScript modules that a module imports."""
    named = (script.parent / f"{source.removesuffix('.ts')}.ts" for source in _IMPORT.findall(script.read_text(encoding="utf-8")))
    return (path for path in named if path.is_file())


def paths() -> dict[str, list[str]]:
    """Files that take part in each step, relative to the package."""
    frame = {path.relative_to(ROOT / PACKAGE).as_posix() for path in reached(FRAME)}
    return {**{step: sorted(files_of(step)) for step in _STEPS}, "page_frame": sorted(frame)}


def path_table() -> str:
    """Table of the files that take part in each path."""
    found = paths()
    rows = [(what, str(len(found[name])), ", ".join(f"`{file}`" for file in found[name])) for name, what in _PATHS.items()]
    return markdown(("path", "files", "where"), rows, left=("path", "where"))
