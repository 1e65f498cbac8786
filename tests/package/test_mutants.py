"""The mutation test: which changes it makes; and a sample of the fuzz test of all file formats."""

import json
import subprocess
import sys

import pytest

from tests.fuzz import FORMATS
from tests.mutants import mutants

SOURCE = '''"""A module of 1 page."""
__all__ = ["f", 2]
LIMIT: Final[Literal[3]] = 4
@cache(maxsize=5)
def f(x: "int | 6", *names: str) -> Literal[7]:
    """Eight is 8."""
    if not x <= LIMIT and -x in names:
        raise ValueError(f"{x + 9}", 10)
    x += [True]
    return (
        x
        - g(zip(x, x, strict=False)))
class C:
    @compiled
    def g(self):
        def inner(): return None
        return lambda: "é" + self, 1.5
'''


def test_one_change_each() -> None:
    found = [(mutant.line, mutant.function, mutant.after) for mutant in mutants("m.py", SOURCE)]
    assert found == [
        (3, "", "LIMIT: Final[Literal[3]] = 5"),
        (7, "f", "if (not x <= LIMIT or -x in names):"),
        (7, "f", "if (x <= LIMIT) and -x in names:"),
        (7, "f", "if not (x < LIMIT) and -x in names:"),
        (7, "f", "if not (x > LIMIT) and -x in names:"),
        (7, "f", "if not x <= LIMIT and (-x not in names):"),
        (7, "f", "if not x <= LIMIT and (x) in names:"),
        (9, "f", "x += [False]"),
        (10, "f", "return None"),
        (11, "f", "(x + g(zip(x, x, strict=False))))"),
        (17, "", "return None"),
        (17, "", 'return lambda: "é" + self, 2.5'),
    ]


@pytest.mark.slow(minutes=True)
def test_no_damaged_or_forged_file_does_harm() -> None:
    command = [sys.executable, "-m", "tests.fuzz", "--n", str(2 * len(FORMATS)), "--seed", "11", "--jobs", "1", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    counts = json.loads(done.stdout)
    assert counts["tried"] == 2 * len(FORMATS)
    assert all(counts[name] == 0 for name in ("tracebacks", "hangs", "wrong", "code_run"))
    assert counts["refused"] > counts["accepted"] > 0
    assert counts["peak_mb"] < 1000
