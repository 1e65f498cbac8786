"""Version of the solvers, for keys of caches; quick to import."""

import functools
import hashlib
from pathlib import Path


@functools.cache
def solvers_hash() -> str:
    """Hash of the source code of the solvers, so that cached results of other versions are not used."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
