"""The benchmark of start-up."""

import sys

from benchmarks import startup


def test_cpu_time_is_that_of_the_command() -> None:
    busy = [sys.executable, "-c", "import time\nwhile time.process_time() < 0.3: pass"]
    assert 0.3 <= startup.cpu_seconds(busy, 1) < 3
