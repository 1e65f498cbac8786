"""The first block of Python of a page runs by itself, in an empty folder: without the commands before it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
_NEEDING = ("docs/analysis.md", "docs/tutorials/own_loop.md")
"""Their first blocks read the files of commands, which they name, or train an agent; the tests of the pages run them."""
BLOCKS = {path.relative_to(ROOT).as_posix(): block[1] for path in PAGES if (block := _BLOCK.search(path.read_text()))}


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in BLOCKS if page not in _NEEDING])
def test_the_first_block_of_a_page_runs_by_itself(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if page == "README.md":  # in a process of its own; the others in this one, because imports take most of their time
        subprocess.run([sys.executable, "-c", BLOCKS[page]], env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True)
    else:
        exec(compile(BLOCKS[page], page, "exec"), {"__name__": "__main__"})
