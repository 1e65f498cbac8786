"""Runs: a folder that is created or resumed and locked, its manifest, checkpoints and journals, and Ctrl-C at safe points.

Libraries turn a KeyboardInterrupt inside of them into other errors, or lose it: within :func:`interrupts_held` it is noted, and
:func:`check_interrupt` raises it.
"""

import contextlib
import dataclasses
import errno
import importlib.metadata
import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, Final

import shuttle_marl
from shuttle_marl.base import files
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import FileReadError, T, hash_in, problem, read_hashed, read_sealed, replace_file, replace_with_card

CONFIG: Final = "config.json"
MANIFEST: Final = "manifest.json"
METRICS: Final = "metrics.jsonl"
RESULTS: Final = "results.json"
RALLIES: Final = "rallies.mcap"
PAGE: Final = "report.html"
LOCK: Final = ".lock"  # lock file of a folder; never replaced or removed, so that all processes lock the same file
_ABOUT: Final = "about.json"
_RETAINED: Final = 2
_BOTH: Final = "--resume continues a run and --overwrite replaces it; give one of them"
_ADVICE: Final = "restore it from a backup, or start the run again with --overwrite"
_LEFTOVER: Final = re.compile(rf"\.{re.escape(CONFIG)}\..*\.part")
"""File that remains if a process is killed before it wrote the configuration."""
_noted: Final[list[int]] = []  # interrupts within `interrupts_held`


class RunError(ShuttleError):
    """A run folder that cannot be used."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of every run: its folder, and the model of its game."""

    error: ClassVar[type[ShuttleError]]  # of a value that is out of bounds

    out: Path | None = None
    """Run folder; default: runs/ and the name of the run, such as league-0 or ppo-0; numbered if that exists."""
    resume: bool = False
    """Continue the unfinished run in --out, or else the latest one of the default name."""
    overwrite: bool = False
    """Replace the run in --out."""
    game: str = "default"
    """Model of the game: a shipped one or a folder."""

    def __post_init__(self) -> None:
        files.check_bounds(self, self.error)
        if self.resume and self.overwrite:
            raise self.error(_BOTH)


class _BusyError(RunError):
    """Another process runs in a folder."""


@dataclasses.dataclass(eq=False)
class Run:
    """A run whose folder is locked, see :func:`open_run`."""

    folder: Path
    about: dict[str, Any] = dataclasses.field(default_factory=dict)  # content of the manifest, after `begin`

    @property
    def finished(self) -> bool:
        """Whether the run is finished, see :func:`is_finished`."""
        return is_finished(self.folder)

    def begin(self, packages: Sequence[str], *, same: Mapping[str, Any], **more: Any) -> None:
        """Write the manifest: everything that is needed to reproduce the run.

        Args:
            packages: distributions whose versions affect the results.
            same: entries that stay the same until the run is finished, such as the hash of its game; see :meth:`check_same`.
            **more: other entries.

        Raises:
            RunError: an entry changed after the run was started.
        """
        self.check_same(same)
        self.about = {"status": "running", **more, **describe(packages), **same}
        write_json(self.folder / MANIFEST, self.about)

    def check_same(self, same: Mapping[str, Any]) -> None:
        """Check entries of the manifest of a run that was started before, if there is one; a dictionary may have new keys.

        Raises:
            RunError: an entry changed, or the manifest cannot be read.
        """
        before = read_json(self.folder / MANIFEST, dict[str, Any]) if (self.folder / MANIFEST).exists() else {}
        for what, now in same.items():
            known = before.get(what, {})
            if known != ({key: now.get(key) for key in known} if isinstance(known, dict) else now):
                raise RunError(f"{self.folder}: the {what} changed after the run was started; start a new run with another --out")

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
            if not (isinstance(error, KeyboardInterrupt) or _noted):
                raise
            advice = f"the same command with --resume --out {self.folder} continues"
            raise KeyboardInterrupt(f"interrupted; {saved()}; {advice}") from error

    def save(self, number: int, about: dict[str, Any], content: dict[str, bytes]) -> None:
        """Write the checkpoint ``checkpoints/NUMBER``, and remove all but the latest two.

        Args:
            about: its description, which is written last, with the hashes of the files.
            content: of its files, by name.

        Raises:
            RunError: it cannot be written; earlier ones are intact.
        """
        folder = self.folder / "checkpoints" / f"{number:08d}"
        try:
            shutil.rmtree(folder, ignore_errors=True)
            replace_with_card(folder / _ABOUT, about, content)
        except ShuttleError as error:
            raise RunError(f"{folder}: cannot be written ({error}); free some space and continue with --resume") from error
        for old in self._checkpoints()[:-_RETAINED]:
            shutil.rmtree(old, ignore_errors=True)

    def saved(self, *names: str) -> tuple[dict[str, Any], list[bytes]] | None:
        """Description and files of the last checkpoint; None without one. Raises RunError: it is damaged."""
        if not (folders := self._checkpoints()):
            return None
        try:
            about = read_sealed(folders[-1] / _ABOUT)
            return about, [read_hashed(folders[-1] / name, hash_in(about, name)) for name in names]
        except (OSError, ValueError, FileReadError) as error:
            raise RunError(
                f"{folders[-1]}: cannot be read ({problem(error)}); delete it to continue from the one before"
            ) from error

    @property
    def last(self) -> int:
        """Number of the last checkpoint; 0 without one."""
        return max((int(path.name) for path in self._checkpoints()), default=0)

    def _checkpoints(self) -> list[Path]:
        return sorted(path.parent for path in self.folder.glob(f"checkpoints/[0-9]*/{_ABOUT}"))


@contextlib.contextmanager
def open_run(out: Path | None, name: str, fixed: dict[str, Any], *, resume: bool, overwrite: bool) -> Iterator[Run]:
    """Create or resume a run folder, and lock it until the context ends.

    Args:
        out: the requested folder; None: ``runs/NAME``, for a new run with a number appended if that exists.
        fixed: options that affect the results, written to ``config.json``; those of a resumed run must be equal.
        resume: continue the unfinished run in ``out``, or else the latest one of that name.
        overwrite: replace the run in ``out``.

    Raises:
        RunError: the folder contains a run, and neither resuming nor replacing was requested; or the run to resume does
            not exist or was started with other flags; or another process uses the folder; or the folder cannot be created or
            written.
    """
    if resume and overwrite:
        raise RunError(_BOTH)
    default = Path("runs") / name
    with contextlib.ExitStack() as stack:
        with _usable(out or default):
            if out is not None:
                str(out).encode()
                with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                    out.stat()
            if resume:
                folder = _to_resume(out, default)
                stack.enter_context(locked(folder))
                before = read_json(folder / CONFIG, dict[str, Any])
                if different := [
                    f"{key}: {before.get(key)!r} then, {now!r} now" for key, now in fixed.items() if before.get(key) != now
                ]:
                    flags = "; ".join(different)
                    advice = "give the same ones to resume it, or begin a new run if this version has no such flag"
                    raise RunError(f"{folder}: was started with other flags ({flags}); {advice}")
            else:
                folder = _new(default, stack) if out is None else _empty(out, stack, overwrite=overwrite)
                write_json(folder / CONFIG, fixed)
        yield Run(folder)


@contextlib.contextmanager
def _usable(folder: Path) -> Iterator[None]:
    try:
        yield
    except UnicodeEncodeError as error:
        raise RunError(f"--out {str(folder)!a}: expected a name in UTF-8") from error
    except (OSError, ValueError) as error:  # ValueError: an impossible name
        raise RunError(f"{folder}: cannot be used ({problem(error)}); name another folder with --out") from error


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


def _to_resume(out: Path | None, default: Path) -> Path:
    if out is not None:
        folders = [out]
    else:
        numbered = re.compile(rf"{re.escape(default.name)}(-\d+)?")
        found = [path for path in default.parent.glob(f"*/{CONFIG}") if numbered.fullmatch(path.parent.name)]
        newest = sorted(found, key=lambda path: path.stat().st_mtime)
        folders = [path.parent for path in newest if not is_finished(path.parent)]
    if not folders or not (folders[-1] / CONFIG).is_file():
        where = f"in {out}" if out else f"named {default.name} in {default.parent}"
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
    """Read a JSON file of a run folder as a type. Raises RunError: it is missing or damaged, or not of this type."""
    try:
        return files.read_json(path, kind)
    except FileReadError as error:
        raise RunError(f"{path}: cannot be read ({error}); start the run again with --overwrite") from error


def write_json(path: Path, fields: Mapping[str, object]) -> None:
    """Write a JSON object atomically."""
    # Arguments of a command may hold undecodable bytes, which are escaped.
    replace_file(path, (json.dumps(fields, indent=2, ensure_ascii=False) + "\n").encode(errors="backslashreplace"))


class Journal:
    """File of JSON objects, one a line, each sealed, that one process appends to; ``go_on``, ``restore``: advice in errors."""

    def __init__(self, path: Path, go_on: str = "continue with --resume", restore: str = _ADVICE) -> None:
        self._path, self._go_on, self._restore = path, go_on, restore

    def append(self, lines: Sequence[dict[str, Any]]) -> None:
        """Append lines, synchronised to the disk; after an error none is there, and others can be. Raises RunError: no room."""
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
        """Remove all but the first lines. Raises RunError: unreadable, a line that stays is damaged, or there are fewer."""
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
            raise RunError(f"{self._path}: cannot be read ({problem(error)}); {self._restore}") from error

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


@contextlib.contextmanager
def interrupts_held() -> Iterator[None]:
    """Hold Ctrl-C back until :func:`check_interrupt` or the end of the context; a second one is raised at once.

    It has no effect in other threads than the main one, within another such context, and where the caller handles SIGINT.

    Raises:
        KeyboardInterrupt: at the end, if it was not raised before.
    """
    if not _is_main() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, _note)
    try:
        yield
        check_interrupt()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _noted.clear()


def check_interrupt() -> None:
    """Raise a KeyboardInterrupt that is held back."""
    if _noted and _is_main():
        raise KeyboardInterrupt


@contextlib.contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C for a moment, in this thread and for ever in processes that start within; it is raised at the end."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _is_main() -> bool:
    return threading.current_thread() is threading.main_thread()


def _note(number: int, frame: FrameType | None) -> None:
    _noted.append(number)
    if len(_noted) > 1:
        signal.default_int_handler(number, frame)
    os.write(2, b"\nstopping at the next safe point; Ctrl-C again stops at once\n")  # a signal may interrupt a print
