"""Identity of the solvers, for what is kept between runs. Imports nothing that takes time."""

import functools
import hashlib
from pathlib import Path


@functools.cache
def solvers_hash() -> str:
    """Hash of the source code that solves: what another version solved is not read."""
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()[:16]
