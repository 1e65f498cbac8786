"""The page built once, a server of it, and a browser without a window."""

import atexit
import contextlib
import dataclasses
import functools
import http.client
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
import pytest

from shuttle_marl.court import messages
from shuttle_marl.court.answers import Answers
from shuttle_marl.court.building import SOURCE, BuildError, build, node
from shuttle_marl.court.match import PolicyTables
from shuttle_marl.court.server import Server, application, bind
from shuttle_marl.game import default_game
from shuttle_marl.game.shipped import load_game, origin_of
from tests.needs import missing
from tests.reduced import reduced_model

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

T = TypeVar("T")
START = 240.0
"""Time that a server has to start [s]."""
HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def page_folder() -> Path:
    """The built page."""
    try:
        return build()
    except BuildError as error:
        missing(str(error))
        raise


@pytest.fixture(scope="session")
def tables() -> PolicyTables:
    """Policies of the shipped game, tabulated and solved once."""
    return PolicyTables(default_game())


@pytest.fixture(scope="session")
def policies() -> PolicyTables:
    """Policies of a small game with recovery that knows the model of its imitated players."""
    model = load_game(reduced_model(()))
    game = dataclasses.replace(model, recovery=load_game("default:recovery").recovery)
    object.__setattr__(game, "origin", origin_of(model))
    return PolicyTables(game)


@functools.cache
def script(name: str) -> Path:
    """A script of tests that uses the source of the page, built; removed at the end of the process."""
    folder = Path(tempfile.mkdtemp(prefix="script-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    built = folder / f"{name}.mjs"
    options = {
        "entryPoints": [str(HERE / "scripts" / name)],
        "outfile": str(built),
        "bundle": True,
        "platform": "node",
        "format": "esm",
    }
    code = f"import {{ build }} from 'esbuild'; await build({json.dumps(options)});"
    subprocess.run([str(node()), "--input-type=module", "-e", code], cwd=SOURCE, check=True, capture_output=True)
    return built


def run_script(name: str, *arguments: str) -> bytes:
    """Output of a script of tests."""
    return subprocess.run([str(node()), str(script(name)), *arguments], check=True, capture_output=True).stdout


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


@contextlib.contextmanager
def running(folder: Path, **options: Any) -> Iterator[tuple[str, int]]:
    """A server in a thread, which answers nothing; yields its address."""
    with contextlib.closing(bind("127.0.0.1", 0)) as listener:
        server = Server(application(lambda _: b"", folder, **options))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield listener.getsockname()
        finally:
            server.should_exit = True
            thread.join()


def get(port: int, path: str, **headers: str) -> tuple[int, bytes, dict[str, str]]:
    """Status, content and headers of an answer."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=60)) as connection:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read(), {name.lower(): value for name, value in answer.getheaders()}


@pytest.fixture(scope="session")
def served(page_folder: Path) -> Iterator[Served]:
    with serving("--a", "bc", "--b", "minimax", "--seed", "5") as server:
        yield server


def replied(answers: Answers, request: messages.Request, kind: type[T]) -> T:
    """The reply to a request, without its body."""
    content = answers(request)
    return msgspec.json.decode(content[4 : 4 + int.from_bytes(content[:4], "little")], type=kind)


class Viewer:
    """A page that is open, and what went wrong in it."""

    def __init__(self, page: "Page") -> None:
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

    def seek(self, time: float) -> "Viewer":
        """Show the rally at a time."""
        self.page.evaluate("(t) => window.viewer.seek(t)", time)
        return self

    def play(self, playing: bool = True) -> "Viewer":
        """Resume or pause the playback."""
        return self if self.state("playing") == playing else self.press(" ")

    def enter(self, mode: str) -> None:
        """Show a mode, paused."""
        self.play(False)
        self.page.locator(f"#tab-{mode}").click()
        self.until(lambda: self.state("turn" if mode == "play" else "analysis") is not None)
        if mode == "learn":
            self.page.locator(".quiz button").first.wait_for()
        self.until(lambda: self.state("mode") == mode and not self.press(*" " * self.state("playing")).state("playing"))

    def analysed(self) -> "Viewer":
        """Wait for the analysis, paused: a page that plays draws all the time."""
        self.play(False)
        self.until(lambda: self.state("analysis") is not None)
        return self


@pytest.fixture
def viewer(browser: "Browser") -> Iterator[Viewer]:
    # The layout of laptops in a small window: without a graphics card, the time of a picture is that of its pixels.
    context = browser.new_context(viewport={"width": 1152, "height": 640}, reduced_motion="reduce")
    opened = Viewer(context.new_page())
    opened.page.set_default_timeout(120_000)
    yield opened
    assert opened.errors == []
    assert opened.outside == []
    context.close()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """A browser on a busy machine may be late once; the rerun stands in the report, and a second failure counts."""
    for item in items:
        if "viewer" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.flaky(reruns=1))
