"""The built page is verified before it is served."""

from pathlib import Path

import pytest

from shuttle_marl.watch import building
from shuttle_marl.watch.server import browser_flags


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A built page as in a wheel, without its source."""
    for name in building.FILES:
        (tmp_path / name).write_text(name)
    (tmp_path / building._STAMP).write_text(building._stamp("0" * 64, tmp_path))
    monkeypatch.setattr(building, "BUILT", tmp_path)
    monkeypatch.setattr(building, "SOURCE", tmp_path / "missing")
    return tmp_path


@pytest.mark.parametrize("name", [*building.FILES, building._STAMP])
def test_a_damaged_page_is_refused(name: str, built: Path) -> None:
    assert building.build() == built
    content = bytearray((built / name).read_bytes())
    content[len(content) // 2] ^= 1
    (built / name).write_bytes(content)
    assert building._is_built("0" * 64) is False
    if name != building._STAMP:  # the hash of the source is unknown in a wheel
        with pytest.raises(building.BuildError, match="damaged; install the package again"):
            building.build()


def test_browsers_of_users_have_a_sandbox(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert "--no-sandbox" not in browser_flags(mesa=False)
