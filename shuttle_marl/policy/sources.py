"""Hashes of the files of user code, so that a resumed run does not mix the results of two versions."""

import contextlib
import hashlib
import shlex
import sys
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).parents[1]


def source_hashes(name: str) -> dict[str, str]:
    """SHA-256 of the code behind a name, by the file or the package.

    Args:
        name: ``module:attribute``, whose module was imported; ``program:COMMAND``; or a name with files in its parts, such as
            ``table:FILE``. A module of a package, and code of this one, counts with the whole package, any other file alone:
            what it imports, and data that the code reads, are not seen.

    Raises:
        OSError: a file cannot be read.
    """
    head, _, rest = name.partition(":")
    module = getattr(sys.modules.get(head), "__file__", None)
    if module is not None and head != "program":
        levels = head.count(".") + (Path(module).name == "__init__.py")
        return _hashes(Path(module).parents[levels - 1] if levels else Path(module))
    parts = rest.split(":")
    if head == "program":
        with contextlib.suppress(ValueError):  # quotation marks that do not close
            parts = shlex.split(rest)
    return _hashes(*(Path(part) for part in parts if Path(part).is_file()))


def _hashes(*paths: Path) -> dict[str, str]:
    """Of files, and of packages by their folders."""
    hashes = {}
    for path in (PACKAGE if path.is_relative_to(PACKAGE) else path for path in paths):
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path]
        content = b"".join(f"{file.relative_to(path.parent).as_posix()}\0".encode() + file.read_bytes() for file in files)
        hashes[path.name] = hashlib.sha256(content).hexdigest()
    return hashes
