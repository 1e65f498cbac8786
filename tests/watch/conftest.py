"""The page built once, a server of it, and a browser without a window."""

import contextlib
import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, Playwright, sync_playwright

from shuttle_marl.watch.building import SOURCE, BuildError, build, node
from shuttle_marl.watch.video import browser_flags

START = 240.0
"""Time that a server has to start [s]."""
HERE = Path(__file__).parent


def missing(reason: str) -> None:
    """Skip what needs something that is not here; where every change is checked, fail."""
    if os.environ.get("CI") == "true":
        raise RuntimeError(reason)
    pytest.skip(reason)


@pytest.fixture(scope="session")
def page_folder() -> Path:
    """The built page."""
    try:
        return build()
    except BuildError as error:
        missing(str(error))
        raise


def run_script(name: str, folder: Path, *arguments: str) -> bytes:
    """Output of a script of tests that uses the source of the page; it is built into a folder."""
    program, built = str(node()), folder / f"{name}.mjs"
    options = {
        "entryPoints": [str(HERE / "scripts" / name)],
        "outfile": str(built),
        "bundle": True,
        "platform": "node",
        "format": "esm",
    }
    code = f"import {{ build }} from 'esbuild'; await build({json.dumps(options)});"
    subprocess.run([program, "--input-type=module", "-e", code], cwd=SOURCE, check=True, capture_output=True)
    return subprocess.run([program, str(built), *arguments], check=True, capture_output=True).stdout


@dataclasses.dataclass
class Served:
    """A server in a process of its own."""

    address: str
    process: subprocess.Popen[str]


@contextlib.contextmanager
def serving(*flags: str, cwd: Path | None = None) -> Iterator[Served]:
    command = [sys.executable, "-m", "shuttle_marl.watch", "--no-browser", "--port", "0", *flags]
    root = str(HERE.parents[1])
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=cwd, env=env)
    assert process.stderr is not None
    try:
        said, end = "", time.monotonic() + START
        while time.monotonic() < end:
            line = process.stderr.readline()
            said += line
            if found := re.match(r"(http://\S+/) shows", line):
                yield Served(found[1], process)
                return
            assert line, said
        raise AssertionError(said)
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        process.stderr.close()


@pytest.fixture(scope="session")
def served(page_folder: Path) -> Iterator[Served]:
    with serving("--a", "bc", "--b", "minimax", "--seed", "5") as server:
        yield server


def browser_program(folder: Path) -> tuple[str, dict[str, str], list[str]]:
    """Chromium: of the machine, else from npm. Its path, what its environment needs, and further flags."""
    for name in (os.environ.get("CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome"):
        if name and (found := shutil.which(name)):
            return found, {}, browser_flags()
    program = node()
    npm = shutil.which("npm")
    if program is None or npm is None:
        missing("needs Chromium, or Node and npm to fetch it")
    for file in ("package.json", "package-lock.json", "where.mjs"):
        shutil.copy(HERE / "browser" / file, folder)
    done = subprocess.run(
        [str(npm), "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=folder, capture_output=True, check=False
    )
    if done.returncode:
        missing(f"Chromium cannot be fetched: {done.stderr.decode()[-500:]}")
    found = json.loads(subprocess.run([str(program), "where.mjs"], cwd=folder, capture_output=True, check=True).stdout)
    env = {"LD_LIBRARY_PATH": found["libraries"], "FONTCONFIG_PATH": found["fonts"]}
    return found["path"], env, [*browser_flags(mesa=False), "--single-process", "--no-zygote"]


@pytest.fixture(scope="session")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="session")
def browser(playwright: Playwright, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    path, env, flags = browser_program(tmp_path_factory.mktemp("chromium"))
    opened = playwright.chromium.launch(executable_path=path, args=flags, env={**os.environ, **env})
    yield opened
    opened.close()


class Viewer:
    """A page that is open, and what went wrong in it."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.errors: list[str] = []
        self.outside: list[str] = []
        page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("request", lambda request: self._asked(request.url))

    def _asked(self, url: str) -> None:
        if not url.startswith(("http://127.0.0.1:", "data:", "blob:", "file:")):
            self.outside.append(url)

    def open(self, address: str) -> "Viewer":
        self.page.goto(address)
        self.until(lambda: bool(self.page.evaluate("!!(window.viewer && window.viewer.state().ready)")))
        return self

    def state(self, *names: str) -> Any:
        script = "(names) => { const s = window.viewer.state(); return names.map((name) => s[name] ?? null); }"
        found = self.page.evaluate(script, list(names))
        return found[0] if len(names) == 1 else found

    def until(self, holds: Callable[[], bool], seconds: float = 180.0) -> None:
        """Wait until something holds."""
        end = time.monotonic() + seconds
        while not holds():
            if time.monotonic() > end:
                told = self.page.evaluate("document.querySelector('[role=alert]:not(.hidden)')?.textContent ?? ''")
                raise AssertionError(f"waited {seconds} s in vain; errors {self.errors}; the page says {told!r}")
            self.page.wait_for_timeout(50)

    def press(self, *keys: str) -> "Viewer":
        for key in keys:
            self.page.keyboard.press(key)
        return self

    def analysed(self) -> "Viewer":
        self.until(lambda: self.state("analysis") is not None)
        return self


@pytest.fixture
def viewer(browser: Browser) -> Iterator[Viewer]:
    context = browser.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
    opened = Viewer(context.new_page())
    opened.page.set_default_timeout(120_000)
    yield opened
    assert opened.errors == []
    assert opened.outside == []
    context.close()
