"""Fixtures that several folders share; what only they need is imported when one is used: every process reads this file."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Playwright


@pytest.fixture(scope="session")
def chromium_program() -> Iterator[str]:
    """A browser for everything that asks for one, fetched once for all processes of this session."""
    from filelock import FileLock

    from tests.needs import chromium

    session = Path(os.environ["SESSION_FOLDER"])
    with pytest.MonkeyPatch.context() as patch:
        with FileLock(session / "chromium.lock"):
            program = chromium(session / "chromium")
        patch.setenv("CHROMIUM", program)
        yield program


@pytest.fixture(scope="session")
def playwright() -> Iterator["Playwright"]:
    """One for all tests of this process: it can run only once in a thread."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="session")
def launched() -> Iterator[list["Browser"]]:
    """Browsers of this process, the last one in use: one that ends takes only the test with it that ended it."""
    browsers: list[Browser] = []
    yield browsers
    for browser in browsers:
        browser.close()


@pytest.fixture
def browser(playwright: "Playwright", chromium_program: str, launched: list["Browser"]) -> "Browser":
    """A browser without a window."""
    from shuttle_marl.court.server import browser_flags

    if not launched or not launched[-1].is_connected():
        launched.append(playwright.chromium.launch(executable_path=chromium_program, args=browser_flags()))
    return launched[-1]
