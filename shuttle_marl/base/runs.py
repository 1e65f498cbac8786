"""Runs: a folder that is created or resumed and locked, and the manifest that makes its results reproducible."""

import contextlib
import dataclasses
import errno
import importlib.metadata
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import shuttle_marl
from shuttle_marl.base import files
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, T, replace_file
from shuttle_marl.base.interrupts import was_interrupted

CONFIG: Final = "config.json"
MANIFEST: Final = "manifest.json"
METRICS: Final = "metrics.jsonl"
"""Evaluations of a training run, one JSON object a line."""
RALLIES: Final = "rallies.mcap"
PAGE: Final = "report.html"
LOCK: Final = ".lock"
"""Lock file of a folder; never replaced or removed, so that all processes lock the same file."""
_ADVICE: Final = "restore it from a backup, or start the run again with --overwrite"
_LEFTOVER: Final = re.compile(rf"\.{re.escape(CONFIG)}\..*\.part")
"""File that remains if a process is killed before it wrote the configuration."""


class RunError(ShuttleError):
    """A run folder that cannot be used."""


class _BusyError(RunError):
    """Another process runs in a folder."""


@dataclasses.dataclass(eq=False)
class Run:
    """A run whose folder is locked, see :func:`open_run`."""

    folder: Path
    about: dict[str, Any] = dataclasses.field(default_factory=dict)
    """Content of the manifest, after :meth:`begin`."""

    @property
    def finished(self) -> bool:
        """Whether the run is finished, see :func:`is_finished`."""
        return is_finished(self.folder)

    def begin(self, packages: Sequence[str], *, same: Mapping[str, Any], **more: Any) -> None:
        """Write the manifest: everything that is needed to reproduce the run.

        Args:
            packages: distributions whose versions affect the results.
            same: entries that stay the same until the run is finished, such as the hash of its game; see :func:`check_same`.
            **more: other entries.

        Raises:
            RunError: an entry changed after the run was started.
        """
        check_same(self.folder, same)
        self.about = {"status": "running", **more, **describe(packages), **same}
        write_json(self.folder / MANIFEST, self.about)

    def finish(self, **figures: Any) -> None:
        """Mark the run as finished, with further entries of its manifest."""
        self.about |= {"status": "finished", **figures}
        write_json(self.folder / MANIFEST, self.about)

    @contextlib.contextmanager
    def resumable(self, saved: Callable[[], str]) -> Iterator[None]:
        """Say in a KeyboardInterrupt what is saved of the run, and how it continues.

        Raises:
            KeyboardInterrupt: Ctrl-C, or an error that it caused in a library.
        """
        try:
            yield
        except (KeyboardInterrupt, Exception) as error:
            if not (isinstance(error, KeyboardInterrupt) or was_interrupted()):
                raise
            raise KeyboardInterrupt(f"interrupted; {saved()}; the same with --resume --out {self.folder} continues") from error


def check_flags(folder: Path, fixed: Mapping[str, Any]) -> None:
    """Check that a run was started with these options.

    Raises:
        RunError: it was not, or its configuration cannot be read.
    """
    before = read_json(folder / CONFIG, dict[str, Any])
    different = [f"{key}: {before.get(key)!r} then, {fixed[key]!r} now" for key in fixed if before.get(key) != fixed[key]]
    if different:
        raise RunError(f"{folder}: was started with other flags ({'; '.join(different)}); give the same ones to resume it")


def check_same(folder: Path, same: Mapping[str, Any]) -> None:
    """Check entries of the manifest of a run that was started before, if there is one; a dictionary may have new keys.

    Raises:
        RunError: an entry changed, or the manifest cannot be read.
    """
    before = read_json(folder / MANIFEST, dict[str, Any]) if (folder / MANIFEST).exists() else {}
    for what, now in same.items():
        known = before.get(what, {})
        if known != ({key: now.get(key) for key in known} if isinstance(known, dict) else now):
            raise RunError(f"{folder}: the {what} changed after the run was started; start a new run with another --out")


@contextlib.contextmanager
def open_run(
    out: Path | None, name: str, fixed: dict[str, Any], *, resume: bool, overwrite: bool, called: str | None = None
) -> Iterator[Run]:
    """Create or resume a run folder, and lock it until the context ends.

    Args:
        out: the requested folder; None: ``runs/NAME``, for a new run with a number appended if that exists.
        fixed: options that affect the results, written to ``config.json``; those of a resumed run must be equal.
        resume: continue the unfinished run in ``out``, or else the latest one of that name.
        overwrite: replace the run in ``out``.
        called: description of the run in errors; default: ``named NAME``.

    Raises:
        RunError: the folder contains a run, and neither resuming nor replacing was requested; or the run to resume does
            not exist or was started with other flags; or another process uses the folder; or the folder cannot be created or
            written.
    """
    if resume and overwrite:
        raise RunError("--resume continues a run and --overwrite replaces it; give one of them")
    default = Path("runs") / name
    with contextlib.ExitStack() as stack:
        with _usable(out or default):
            if out is not None:
                str(out).encode()
                with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                    out.stat()
            if resume:
                folder = _to_resume(out, default, called or f"named {name}")
                stack.enter_context(locked(folder))
                check_flags(folder, fixed)
            else:
                folder = _new(default, stack) if out is None else _empty(out, stack, overwrite=overwrite)
                write_json(folder / CONFIG, fixed)
        yield Run(folder)


@contextlib.contextmanager
def _usable(folder: Path) -> Iterator[None]:
    """Turn errors of the system into a :class:`RunError`."""
    try:
        yield
    except UnicodeEncodeError as error:
        raise RunError(f"--out {str(folder)!a}: expected a name in UTF-8") from error
    except (OSError, ValueError) as error:  # ValueError: an impossible name
        raise RunError(f"{folder}: cannot be used ({files.problem(error)}); name another folder with --out") from error


def _new(default: Path, stack: contextlib.ExitStack) -> Path:
    folder, number = default, 1
    while True:
        if not os.path.lexists(folder):
            # Another process may use the folder as soon as it exists.
            with contextlib.suppress(_BusyError):
                folder.mkdir(parents=True, exist_ok=True)
                stack.enter_context(locked(folder))
                if not _entries(folder):
                    return folder
        number += 1
        folder = default.with_name(f"{default.name}-{number}")


def _empty(out: Path, stack: contextlib.ExitStack, *, overwrite: bool) -> Path:
    _check_free(out, overwrite=overwrite)  # before anything is written
    out.mkdir(parents=True, exist_ok=True)
    stack.enter_context(locked(out))
    _check_free(out, overwrite=overwrite)  # another process may have been faster
    # The configuration is removed last: without it, --overwrite would refuse the rest after a kill.
    for path in sorted(_entries(out), key=lambda path: path.name == CONFIG):
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()
    return out


def _check_free(out: Path, *, overwrite: bool) -> None:
    if not out.exists() or (out.is_dir() and all(_LEFTOVER.fullmatch(path.name) for path in _entries(out))):
        return
    if not (out / CONFIG).is_file():
        raise RunError(f"{out}: contains files that are not a run; name another folder with --out")
    if not overwrite and has_results(out):
        state = "a finished run" if is_finished(out) else "an unfinished run"
        raise RunError(f"{out}: contains {state}; --resume continues it, --overwrite replaces it, --out names another")


def _entries(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.name != LOCK]


def _to_resume(out: Path | None, default: Path, called: str) -> Path:
    """The folder that the user named, or the latest unfinished run of a name."""
    if out is not None:
        folders = [out]
    else:
        numbered = re.compile(rf"{re.escape(default.name)}(-\d+)?")
        found = [path for path in default.parent.glob(f"*/{CONFIG}") if numbered.fullmatch(path.parent.name)]
        newest = sorted(found, key=lambda path: path.stat().st_mtime)
        folders = [path.parent for path in newest if not is_finished(path.parent)]
    if not folders or not (folders[-1] / CONFIG).is_file():
        where = f"in {out}" if out else f"{called} in {default.parent}"
        raise RunError(f"no run to resume {where}; omit --resume to start one")
    return folders[-1]


def has_results(folder: Path) -> bool:
    """Whether a run has written anything besides its own description; one that failed before has not."""
    described = (CONFIG, MANIFEST, LOCK)
    return any(not path.is_dir() and (path.parent != folder or path.name not in described) for path in folder.rglob("*"))


def is_finished(folder: Path) -> bool:
    """Whether a run is finished."""
    with contextlib.suppress(RunError):
        return read_json(folder / MANIFEST, dict[str, Any]).get("status") == "finished"
    return False


@contextlib.contextmanager
def locked(path: Path, file: Path | None = None) -> Iterator[None]:
    """Lock a folder, or another path, against other processes; the lock ends with the process.

    Args:
        file: the lock file, which holds the number of the process; None: that of a folder.

    Raises:
        RunError: another process has locked it, or it cannot be written.
    """
    from filelock import FileLock, Timeout  # noqa: PLC0415  slow to import

    file = file or path / LOCK
    lock = FileLock(file, timeout=0)
    with _usable(path):
        try:
            lock.acquire()
        except Timeout as error:
            told = files.read_file(file, 20).decode(errors="replace")
            which = f"another process ({told})" if told.isdecimal() else "another process"
            raise _BusyError(f"{path}: {which} runs there; wait for it, end it, or name another with --out") from error
        with contextlib.suppress(OSError):
            file.write_text(str(os.getpid()))
    try:
        yield
    finally:
        lock.release()


def read_json(path: Path, kind: type[T]) -> T:
    """Read a JSON file of a run folder as a type, see :func:`shuttle_marl.base.files.read_json`.

    Raises:
        RunError: it is missing or damaged, or not of this type.
    """
    try:
        return files.read_json(path, kind)
    except FileReadError as error:
        raise RunError(f"{path}: cannot be read ({error}); start the run again with --overwrite") from error


def write_json(path: Path, fields: Mapping[str, object]) -> None:
    """Write a JSON object atomically."""
    # Arguments of a command may hold undecodable bytes, which are escaped.
    replace_file(path, (json.dumps(fields, indent=2, ensure_ascii=False) + "\n").encode(errors="backslashreplace"))


class Journal:
    """File of JSON objects, one a line, that one process appends to; each sealed.

    Args:
        go_on: what to do after a write that failed, for errors.
        restore: what to do about a file that cannot be read.
    """

    def __init__(self, path: Path, go_on: str = "continue with --resume", restore: str = _ADVICE) -> None:
        self._path, self._go_on, self._restore = path, go_on, restore

    def append(self, lines: Sequence[dict[str, Any]]) -> None:
        """Append lines, synchronised to the disk. After an error none of them is there, and the next ones can be appended.

        Raises:
            RunError: the file cannot be written.
        """
        content = b"".join(files.seal(line, indent=None) for line in lines)
        try:
            with self._path.open("ab", buffering=0) as file:
                whole = file.seek(0, os.SEEK_END)
                try:
                    if file.write(content) < len(content):
                        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(whole)
                    raise
        except OSError as error:
            reason = f"cannot be written ({error.strerror})"
            raise RunError(f"{self._path}: {reason}; free disk space and {self._go_on}") from error

    def read(self, *, finished: bool = False) -> list[dict[str, Any]]:
        """All lines, without their checksums; an incomplete last one, of a process that was killed, is left out.

        Args:
            finished: the run is finished, so no line may be incomplete.

        Raises:
            RunError: the file cannot be read, or a line is damaged.
        """
        *whole, rest = self._content().split(b"\n")
        if rest and finished:
            raise RunError(f"{self._path}: the last line is incomplete; {self._restore}")
        return [self._parsed(number, line) for number, line in enumerate(whole, 1)]

    def keep(self, count: int) -> None:
        """Remove all but the first lines.

        Raises:
            RunError: the file cannot be read, a line that stays is damaged, or there are fewer.
        """
        whole = self._content()
        *lines, _ = whole.split(b"\n")
        if len(lines) < count:
            raise RunError(f"{self._path}: {len(lines)} lines, expected {count}; {self._restore}")
        for number, line in enumerate(lines[:count], 1):
            self._parsed(number, line)
        kept = b"".join(line + b"\n" for line in lines[:count])
        if kept != whole:
            replace_file(self._path, kept)

    def _content(self) -> bytes:
        try:
            return files.read_file(self._path, files.MAX_LINES)
        except FileNotFoundError:
            return b""
        except OSError as error:
            raise RunError(f"{self._path}: cannot be read ({files.problem(error)}); {self._restore}") from error

    def _parsed(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            return files.unsealed(line)
        except ValueError as error:
            raise RunError(f"{self._path}: line {number} is damaged ({error}); {self._restore}") from error


def describe(packages: Sequence[str]) -> dict[str, Any]:
    """Origin of a run: command, version, commit, machine, and the versions of packages that affect its results."""
    return {
        "command": ["python", *sys.orig_argv[1:]],
        "shuttle_marl": shuttle_marl.__version__,
        "git": _git(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "packages": {name: importlib.metadata.version(name) for name in packages},
    }


def _git() -> dict[str, Any] | None:
    """Commit of the checkout of this package, and whether files of it were changed; None outside of a checkout."""
    here = Path(shuttle_marl.__file__).parent
    try:
        # An installed package may be inside the checkout of another project.
        _run_git(here, "ls-files", "--error-unmatch", "__init__.py")
        commit = _run_git(here, "rev-parse", "HEAD")
        return {"commit": commit, "changed": bool(_run_git(here, "status", "--porcelain", "--untracked-files=no", "."))}
    except (OSError, subprocess.SubprocessError):
        return None


def _run_git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
