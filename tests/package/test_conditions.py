"""Every command where something is missing: it works, or says in one line why not; it never ends with a traceback."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
from numba.core import caching

from shuttle_marl.commands import (
    analysis,
    data,
    dynamics,
    exact,
    league,
    policies,
    recording,
    report,
    scout,
    suite,
    training,
    watch,
)
from tests.reduced import reduced_model

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "tests" / "data" / "cases" / "samples_of_each_format"
CHEAP = {
    "analysis": ["log.mcap --rallies 50 --game {model} --out pictures", "matches.csv"],
    "data download": ["--out raw --base-url http://127.0.0.1:9/"],
    "data convert": ["raw --out converted.parquet"],
    "data import": ["matches.csv --out imported.parquet", "matches.csv --json"],
    "data template": ["--out template"],
    "data summary": ["matches.parquet"],
    "data validate": ["matches.parquet"],
    "dynamics fit": ["--data matches.parquet --out model --jobs 2"],
    "dynamics evaluate": ["--data matches.parquet --split train --model {model}"],
    "dynamics card": ["--model {model}"],
    "exact solve": ["--game {model}"],
    "exact evaluate": ["bc --game {model}"],
    "exact best-response": ["random --game {model} --save best.table"],
    "exact holes": ["random --game {model} --top 2"],
    "exact crossplay": ["bc random --game {model}"],
    "exact depth": ["nobody --game {model}"],
    "league": ["--pool bc random --game {model} --matches 2 --out tournament", "report tournament --out tournament.html"],
    "policies": ["--game {model}"],
    "recording info": ["log.mcap"],
    "recording check": ["log.mcap --game {model}"],
    "recording recover": ["log.mcap --out recovered.mcap"],
    "recording export": ["log.mcap rallies.parquet"],
    "recording show": ["log.mcap --rally 0"],
    "recording scene": ["log.mcap --rally 0 --game {model} --out scene.mcap"],
    "report": ["matches.csv --game {model} --out report.html"],
    "scout": ["--list", "Ada", "viktor-axelsen --game {model}"],
    "suite list": [""],
    "suite show": ["exploit-entrance-v1"],
    "suite run": ["exploit-entrance-v1 --method bc --quick --game {model} --out run"],
    "suite verify": ["run --game {model}"],
    "suite board": ["run --game {model} --out board.md"],
    "suite frontier": ["exploit-entrance-v1 --opponent bc --game {model}"],
    "suite figure": ["exploit-entrance-v1 --game {model} --out figure.svg"],
    "suite new-submission": ["exploit-v1 --author alice --out submission"],
    "suite data": ["offline-v1 --quick --seeds 1 --game {model} --out logs"],
    "training ppo": ["--game {model} --strokes 256 --batch 256 --width 8 --out ppo"],
    "training a2c": ["--game {model} --strokes 256 --batch 256 --width 8 --out a2c"],
    "training sac": ["--game {model} --strokes 256 --batch 256 --width 8 --out sac"],
    "watch": ["--replay none.mcap"],
    "": ["--help", "--version"],
}
"""Arguments of cheap runs by command."""

PROCESSES = ("league train --rounds 1 --strokes 2000 --workers 2", "training ppo --seeds 2 --jobs 2 --strokes 2000")
"""Runs in several processes."""
DRIVER = """
import io, json, os, pwd, sys, traceback
from multiprocessing import synchronize
from pathlib import Path

from shuttle_marl import __main__ as run_as

def nothing(*_, **__):
    raise OSError(38, "Function not implemented")

def nobody(*_):
    raise KeyError("no entry")

package = str(Path(run_as.__file__).parent)

def read_only(event, details):
    if event == "open" and details[2] & (os.O_WRONLY | os.O_RDWR) and str(details[0]).startswith(package):
        raise PermissionError(13, "Permission denied", details[0])

condition, encoding = sys.argv[1], os.environ.get("PYTHONIOENCODING", "utf-8")
if condition == "no semaphores":
    synchronize.SemLock.__init__ = nothing
if condition == "no HOME":
    pwd.getpwuid = nobody
if condition == "closed HOME":
    sys.addaudithook(read_only)
for words in json.loads(Path("commands.json").read_text()):
    if condition == "head":
        read, write = os.pipe()
        os.close(read)
        os.dup2(write, 1)
        os.close(write)
        sys.stdout = open(1, "w", closefd=False)
    elif condition == "closed":
        sys.stdout = None
    else:
        sys.stdout = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    said = io.BytesIO()
    sys.stderr = io.TextIOWrapper(said, encoding=encoding, write_through=True)
    try:
        status = run_as.main(words)
        sys.stdout.flush()
    except SystemExit as stop:
        status = stop.code
    except BaseException:
        status = traceback.format_exc()
    with Path("results.jsonl").open("a") as results:
        results.write(json.dumps([words, status, said.getvalue().decode(encoding)]) + "\\n")
os._exit(0)  # what is left for a closed output is not written
"""
CONDITIONS: dict[str, tuple[str, dict[str, str]]] = {
    "no semaphores": ("", {"PYTHONIOENCODING": "ascii"}),
    "no HOME": ("", {"PYTHONIOENCODING": "latin-1", "HOME": ""}),
    "closed HOME": ("", {"PYTHONIOENCODING": "cp1252", "HOME": "home"}),
    "closed": (">&-", {}),
    "head": ("", {}),
}
"""Redirection and environment by name of a condition; three of them have an encoding without most letters."""
POWERLESS = ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]
"""The superuser without the right to enter every folder."""


def test_cheap_runs_of_every_command() -> None:
    modules = (analysis, data, dynamics, exact, league, policies, recording, report, scout, suite, training, watch)
    every = {""}
    for module in modules:
        name, parts = module.__name__.rpartition(".")[2], module.COMMANDS
        every |= {f"{name} {part}" for part in parts} if isinstance(parts, dict) else {name}
    assert {*CHEAP} == every


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small log, and a match as CSV file and as stroke table."""
    folder = tmp_path_factory.mktemp("inputs")
    shutil.copy(SAMPLES / "rallies.csv", folder / "matches.csv")
    played = ["--pool", "bc", "random", "--matches", "2", "--game", reduced_model(), "--out", str(folder / "run")]
    assert league.main(played) == 0
    shutil.move(folder / "run" / "rallies.mcap", folder / "log.mcap")
    shutil.rmtree(folder / "run")
    assert data.main(["import", str(folder / "matches.csv"), "--out", str(folder / "matches.parquet")]) == 0
    return folder


@pytest.fixture(scope="module")
def machine_code(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the compiler's cache: a condition does not concern what is compiled already."""
    folder, locator = tmp_path_factory.mktemp("machine-code"), cast(Any, caching.UserProvidedCacheLocator)
    for kept in (ROOT / "shuttle_marl").rglob("__pycache__"):
        place = folder / locator.get_suitable_cache_subpath(str(kept.parent / "__init__.py"))
        shutil.copytree(kept, place, ignore=shutil.ignore_patterns("*.pyc", "*.tmp.*"))
    return folder


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs bash")
@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_command_works_or_says_why_not(condition: str, inputs: Path, machine_code: Path, tmp_path: Path) -> None:
    shutil.copytree(inputs, tmp_path, dirs_exist_ok=True)
    commands = [[*name.split(), *run.format(model=reduced_model()).split()] for name, runs in CHEAP.items() for run in runs]
    if condition == "no semaphores":
        commands += [f"{run} --game {reduced_model()} --out processes".split() for run in PROCESSES]
    commands += [[*name.split(), "--help"] for name in CHEAP if name]
    (tmp_path / "commands.json").write_text(json.dumps(commands))
    redirection, changed = CONDITIONS[condition]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(machine_code), **changed}
    (tmp_path / "home").mkdir(mode=0)
    powerless = POWERLESS if os.geteuid() == 0 and shutil.which("setpriv") else []
    shell = [*powerless, "bash", "-c", f'exec "$0" "$@" {redirection}', sys.executable, "-c", DRIVER, condition]
    done = subprocess.run(shell, env=environment, cwd=tmp_path, stderr=subprocess.PIPE, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    results = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [words for words, _, _ in results] == commands
    for words, status, said in results:
        assert isinstance(status, int), (words, status)
        errors = [line for line in said.splitlines() if line.startswith("error:")]
        assert (status, len(errors)) in ((0, 0), (1, 1), (130, 0), (141, 0)), (words, status, said)
