"""Writes what the default tournament asks of the shipped policies into the package, so that no user computes it again.

    python -m docs.tools.known

To be called when the default model or a shipped policy changes; ``tests/package`` compares samples with computed ones.
"""

import contextlib
import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

from shuttle_marl.base.cache import KNOWN, NAME, known_key
from shuttle_marl.base.files import content_hash

_HASH: Final = 64  # length of the hash in front of a result


def main() -> None:
    """Play the default tournament with an empty cache, and keep what it stored there."""
    KNOWN.unlink(missing_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        league = ["league", "--matches", "2", "--record", "none", "--out", f"{temporary}/run"]
        environment = {**os.environ, "XDG_CACHE_HOME": temporary}
        subprocess.run([sys.executable, "-m", "shuttle_marl", *league], check=True, env=environment)
        (computed,) = Path(temporary).rglob(NAME)
        with contextlib.closing(sqlite3.connect(computed)) as cache, contextlib.closing(sqlite3.connect(KNOWN)) as known, known:
            for (kind,) in cache.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name").fetchall():
                rows = {known_key(key): content[_HASH:] for key, content in cache.execute(f"SELECT key, content FROM {kind}")}
                known.execute(f"CREATE TABLE {kind} (key BLOB PRIMARY KEY, content BLOB NOT NULL) WITHOUT ROWID")
                stored = ((key, content_hash(key, rows[key]).encode() + rows[key]) for key in sorted(rows))
                known.executemany(f"INSERT INTO {kind} VALUES (?, ?)", stored)
                sys.stdout.write(f"{kind}: {len(rows)} results\n")


if __name__ == "__main__":
    main()
