"""Version of the code that computes values, for keys of caches; quick to import."""

import functools
import hashlib
from pathlib import Path
from typing import Final

_PACKAGES: Final = ("exact", "game", "kernel", "policy")
"""Everything between the tables of a game and a cached value."""


@functools.cache
def sources_hash() -> str:
    """Hash of the source code of the game, its kernel, the solvers and the policies: results of other versions are not used."""
    root = Path(__file__).parents[1]
    sources = sorted(path for name in _PACKAGES for path in (root / name).rglob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
