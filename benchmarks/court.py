"""The live court in a process of its own, and pages of it."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

from playwright.sync_api import Page


@contextlib.contextmanager
def serving(*flags: str, port: int = 0, cache: str | None = None) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Address and process of a server, which keeps compiled code in a folder, or where it usually does."""
    command = [sys.executable, "-m", "shuttle_marl.watch", "--no-browser", "--port", str(port), *flags]
    env = None if cache is None else {**os.environ, "NUMBA_CACHE_DIR": cache}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=env) as process:
        assert process.stderr is not None
        try:
            for line in process.stderr:
                if found := re.match(r"(http://\S+/) shows", line):
                    yield found[1], process
                    return
            raise RuntimeError("the server did not start")
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


def until(page: Page, script: str, seconds: float = 120.0) -> None:
    """Wait until an expression of the page is true."""
    end = time.monotonic() + seconds
    while not page.evaluate(f"!!({script})"):
        if time.monotonic() > end:
            raise TimeoutError(f"waited in vain for {script}; the page says {page.inner_text('body')[:500]}")
        page.wait_for_timeout(10)
