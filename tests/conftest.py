"""Fixtures that several folders share."""

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Playwright, sync_playwright

from shuttle_marl.watch.server import browser_flags
from tests.needs import chromium


@pytest.fixture(scope="session")
def chromium_program(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A browser for everything that asks for one."""
    with pytest.MonkeyPatch.context() as patch:
        program = chromium(tmp_path_factory.mktemp("chromium"))
        patch.setenv("CHROMIUM", program)
        yield program


@pytest.fixture(scope="session")
def playwright() -> Iterator[Playwright]:
    """One for all tests of this process: it can run only once in a thread."""
    with sync_playwright() as running:
        yield running


@pytest.fixture(scope="session")
def launched() -> Iterator[list[Browser]]:
    """Browsers of this process, the last one in use: one that ends takes only the test with it that ended it."""
    browsers: list[Browser] = []
    yield browsers
    for browser in browsers:
        browser.close()


@pytest.fixture
def browser(playwright: Playwright, chromium_program: str, launched: list[Browser]) -> Browser:
    """A browser without a window."""
    if not launched or not launched[-1].is_connected():
        launched.append(playwright.chromium.launch(executable_path=chromium_program, args=browser_flags()))
    return launched[-1]
