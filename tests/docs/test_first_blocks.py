"""The first block of Python of every page runs by itself, in a fresh process and an empty folder."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
_BLOCK = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
_LONG = "own_loop"
"""Its first block trains an agent; the test of the page runs it."""
BLOCKS = {path.relative_to(ROOT).as_posix(): block[1] for path in PAGES if (block := _BLOCK.search(path.read_text()))}


def _commands_before(page: str) -> str:
    """The commands of a page before its first block of Python; a block that names their output files needs them."""
    text = (ROOT / page).read_text()
    before = text[: text.index(BLOCKS[page])]
    return "\n".join(re.findall(r"^```bash run\n(.*?)^```", before, re.DOTALL | re.MULTILINE))


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in BLOCKS if _LONG not in page])
def test_the_first_block_of_a_page_runs_by_itself(page: str, tmp_path: Path) -> None:
    scripts = str(Path(sys.executable).parent)
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PATH": f"{scripts}{os.pathsep}{os.environ['PATH']}"}
    commands = _commands_before(page)
    if commands and re.search(r"runs/|mine|\.mcap", BLOCKS[page]):
        subprocess.run(
            ["bash", "-euo", "pipefail", "-c", commands], cwd=tmp_path, env=environment, capture_output=True, check=True
        )
    done = subprocess.run(
        [sys.executable, "-c", BLOCKS[page]], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
