"""A sample of the fuzz test of all file formats."""

import json
import subprocess
import sys

import pytest

from tests.tools.fuzz import FORMATS


@pytest.mark.slow(minutes=True)
def test_no_damaged_or_forged_file_does_harm() -> None:
    command = [sys.executable, "-m", "tests.tools.fuzz", "--n", str(len(FORMATS)), "--seed", "11", "--jobs", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    counts = json.loads(done.stdout)
    assert counts["tried"] == len(FORMATS)
    assert all(counts[name] == 0 for name in ("tracebacks", "hangs", "wrong", "code_run"))
    assert counts["refused"] > counts["accepted"] > 0
    assert counts["peak_mb"] < 1000
