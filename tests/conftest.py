"""Fixtures that several folders share."""

from collections.abc import Iterator

import pytest

from tests.needs import chromium


@pytest.fixture(scope="session")
def chromium_program(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A browser for everything that asks for one."""
    with pytest.MonkeyPatch.context() as patch:
        program = chromium(tmp_path_factory.mktemp("chromium"))
        patch.setenv("CHROMIUM", program)
        yield program
