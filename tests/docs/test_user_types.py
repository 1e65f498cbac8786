"""Checkers of types accept the code of the tutorials, as they do that of a user."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from docs.tools.markdown import ROOT
from tests import needs

pytestmark = pytest.mark.slow(minutes=True)

# PyTorch and TorchRL are not typed throughout.
STRICT = "[mypy]\nstrict = True\nuntyped_calls_exclude = torch\n[mypy-torchrl.*]\nignore_missing_imports = True\n"


def write_tutorials(folder: Path) -> list[str]:
    """Write the Python code of each tutorial to a file; blocks that begin with the name of a file are files of their own."""
    folder.mkdir()
    for page in sorted((ROOT / "docs" / "tutorials").glob("*.md")):
        code = ""
        for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
            if (own := re.match(r"# (\w+\.py)\n", block)) is None:
                code += block + "\n\n"
            else:
                (folder / f"{page.stem}_{own[1]}").write_text(block)
        if code:
            (folder / f"{page.stem}.py").write_text(code)
    return [path.name for path in folder.iterdir()]


def test_tutorials_are_typed(tmp_path: Path) -> None:
    program = needs.installed(Path(__file__).parent / "pyright", tmp_path, "Pyright")
    assert len(write_tutorials(tmp_path / "code")) >= 7
    (tmp_path / "mypy.ini").write_text(STRICT)
    (tmp_path / "pyrightconfig.json").write_text(json.dumps({"include": ["code"]}))
    for command in (
        [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--cache-dir", os.devnull, "code"],
        [program, "node_modules/pyright/index.js", "--pythonpath", sys.executable],
    ):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=400)
        assert done.returncode == 0, done.stdout + done.stderr
