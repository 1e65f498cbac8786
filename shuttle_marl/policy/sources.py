"""Hashes of the files of user code, so that a resumed run does not mix the results of two versions."""

import ast
import contextlib
import hashlib
import shlex
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

PACKAGE: Final = Path(__file__).parents[1]
_INSTALLED: Final = ("site-packages", "dist-packages")


def source_hashes(name: str) -> dict[str, str]:
    """SHA-256 of the code behind a name, by the file or the package.

    Args:
        name: ``module:attribute``, whose module was imported; ``program:COMMAND``; or a name with files in its parts, such as
            ``table:FILE``. A file of Python counts with those that it imports from its folder or package, directly or not, also
            within functions; imports by computed names, and data that the code reads, are not seen. Code of this package counts
            as a whole.

    Raises:
        OSError: a file cannot be read.
    """
    head, _, rest = name.partition(":")
    path = getattr(sys.modules.get(head), "__file__", None)
    if head == "program":
        with contextlib.suppress(ValueError):  # quotation marks that do not close
            return _hashes((Path(part).parent, Path(part)) for part in shlex.split(rest) if Path(part).is_file())
    elif path is not None:
        file = Path(path)
        return _hashes([(file.parents[head.count(".") + (file.name == "__init__.py")], file)])
    return _hashes((Path(part).parent, Path(part)) for part in rest.split(":") if Path(part).is_file())


def _hashes(starts: Iterable[tuple[Path, Path]]) -> dict[str, str]:
    """Of files, each with the folder of its imports, and of what they import."""
    hashes: dict[str, hashlib._Hash] = {}
    for root, start in starts:
        for path in sorted(PACKAGE.rglob("*.py") if start.is_relative_to(PACKAGE) else set(_with_imports(root, start))):
            inside = path.relative_to(root)
            with path.open("rb") as file:
                content = hashlib.file_digest(file, "sha256").digest()
            hashes.setdefault(inside.parts[0], hashlib.sha256()).update(f"{inside.as_posix()}\0".encode() + content)
    return {key: digest.hexdigest() for key, digest in hashes.items()}


def _with_imports(root: Path, start: Path) -> Iterator[Path]:
    """A file, and what it imports from a folder."""
    top = start.relative_to(root).parts[0]
    found, waiting = set[Path](), [start]
    while waiting:
        path = waiting.pop()
        if path in found or not path.is_file():
            continue
        found.add(path)
        yield path
        for base, parts in _imported(path, root) if path.suffix == ".py" else ():
            if base == root and (parts[0] == PACKAGE.name or (root.name in _INSTALLED and parts[0] != top)):
                continue
            for i in range(len(parts)):
                module = base.joinpath(*parts[: i + 1])
                waiting += [module / "__init__.py", module.with_name(f"{module.name}.py")]


def _imported(path: Path, root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Names that a file imports, each with the folder in which it is looked for; of ``from a import b`` also ``a.b``."""
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):  # of another version of Python
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((root, alias.name.split(".")) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = path.parents[node.level - 1] if node.level else root
            yield from ((base, [*filter(None, (node.module or "").split(".")), alias.name]) for alias in node.names)
