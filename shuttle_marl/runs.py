"""Run folders: made, found again, held by one process, and described so that anybody can make the same run again."""

import contextlib
import importlib.metadata
import json
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import shuttle_marl
from shuttle_marl.errors import ShuttleError
from shuttle_marl.files import replace_file

CONFIG: Final = "config.json"
MANIFEST: Final = "manifest.json"


class RunError(ShuttleError):
    """A run folder that cannot be used."""


def open_folder(
    out: Path | None, name: str, fixed: dict[str, Any], *, resume: bool, overwrite: bool, called: str | None = None
) -> Path:
    """The folder to run in: made for a new run, found for a resumed one.

    Args:
        out: the folder that was asked for; None: ``runs/NAME``, for a new run with a number behind it if that exists.
        name: of the run.
        fixed: what decides the results, written to ``config.json``; a resumed run must agree.
        resume: go on with the unfinished run in ``out``, or else with the latest one of that name.
        overwrite: replace the run that stands in ``out``.
        called: the run in words, for errors; default ``named NAME``.

    Raises:
        RunError: a run stands in the folder and was not to be resumed or replaced; or the run to resume is not there or was
            started with other flags.
    """
    default = Path("runs") / name
    if resume:
        return _resumed(out, default, fixed, called or f"named {name}")
    folder = _new(out, default, overwrite=overwrite)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: the run folder cannot be made ({error.strerror}); name another with --out") from error
    write_json(folder / CONFIG, fixed)
    return folder


def _new(out: Path | None, default: Path, *, overwrite: bool) -> Path:
    if out is None:
        folder, number = default, 1
        while folder.exists():
            number += 1
            folder = default.with_name(f"{default.name}-{number}")
        return folder
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return out
    if not (out / CONFIG).is_file():
        raise RunError(f"{out}: holds something that is no run; name another folder with --out")
    if not overwrite:
        state = "a finished run" if is_finished(out) else "an unfinished run"
        raise RunError(f"{out}: holds {state}; --resume goes on with it, --overwrite replaces it, --out names another")
    with locked(out):
        shutil.rmtree(out)
    return out


def _resumed(out: Path | None, default: Path, fixed: dict[str, Any], called: str) -> Path:
    if out is not None:
        folders = [out]
    else:
        newest = sorted(default.parent.glob(f"{default.name}*/{CONFIG}"), key=lambda p: p.stat().st_mtime)
        folders = [path.parent for path in newest if not is_finished(path.parent)]
    if not folders or not (folders[-1] / CONFIG).is_file():
        where = f"in {out}" if out else f"{called} in {default.parent}"
        raise RunError(f"there is no run to resume {where}; leave --resume out to start one")
    folder = folders[-1]
    before = read_json(folder / CONFIG)
    different = [f"{key}: {before.get(key)!r} then, {fixed[key]!r} now" for key in fixed if before.get(key) != fixed[key]]
    if different:
        raise RunError(f"{folder}: was started with other flags ({'; '.join(different)}); give the same ones to resume it")
    return folder


def is_finished(folder: Path) -> bool:
    """Whether a run came to its end."""
    with contextlib.suppress(RunError):
        return read_json(folder / MANIFEST).get("status") == "finished"
    return False


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a run folder, so that no second process runs in it.

    Raises:
        RunError: another process holds it.
    """
    try:
        import fcntl  # noqa: PLC0415  not on Windows
    except ImportError:
        yield
        return
    try:
        file = (folder / CONFIG).open("rb+")
    except OSError as error:
        raise RunError(f"{folder}: cannot be written ({error.strerror}); name another folder with --out") from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process, however it ends
        except OSError as error:
            raise RunError(f"{folder}: another process plays there; wait for it or name another with --out") from error
        yield


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        RunError: it is missing or damaged.
    """
    try:
        fields = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(fields, dict):
            return fields
        problem = "no object"
    except (OSError, ValueError) as error:
        problem = str(error)
    raise RunError(f"{path}: cannot be read ({problem}); start the run anew with --overwrite")


def write_json(path: Path, fields: dict[str, Any]) -> None:
    """Write a JSON object, whole or not at all."""
    replace_file(path, (json.dumps(fields, indent=2, ensure_ascii=False) + "\n").encode())


def describe(packages: Sequence[str]) -> dict[str, Any]:
    """What made a run: command, version, commit, machine, and the versions of the packages that decide its results."""
    return {
        "command": ["python", *sys.orig_argv[1:]],
        "shuttle_marl": shuttle_marl.__version__,
        "git": _git(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: importlib.metadata.version(name) for name in packages},
    }


def _git() -> dict[str, Any] | None:
    """Commit of the checkout that this package is part of, and whether files of it were changed; None outside of one."""
    here = Path(shuttle_marl.__file__).parent
    try:
        # An installed package may lie inside somebody's checkout without being a part of it.
        _run_git(here, "ls-files", "--error-unmatch", "__init__.py")
        commit = _run_git(here, "rev-parse", "HEAD")
        return {"commit": commit, "changed": bool(_run_git(here, "status", "--porcelain", "--untracked-files=no", "."))}
    except (OSError, subprocess.SubprocessError):
        return None


def _run_git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
