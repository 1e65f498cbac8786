"""The built page is verified before it is served, and its first rally is the shipped one."""

import importlib.util
import os
import shutil
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from docs.tools.first_rally import first_rally
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands.watch import MatchOptions, RallyOptions, watch
from shuttle_marl.court import WatchError, building
from shuttle_marl.court.answers import shipped_rally
from shuttle_marl.court.server import browser_flags, browser_program
from tests.staging.reader import read


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The builder in a checkout of a small page, with a program in the place of Node that says on which build it wrote."""
    for path, text in (("page/build.mjs", "1"), ("page/src/a.ts", "2"), ("page/node_modules/esbuild/x", "3")):
        (tmp_path / "watch" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "watch" / path).write_text(text)
    (tmp_path / "reports" / "languages").mkdir(parents=True)
    (tmp_path / "reports" / "languages" / "en.json").write_text("{}")
    program = tmp_path / "bin" / "node"
    program.parent.mkdir()
    program.write_text(
        "#!/bin/sh\nif [ -f fails ]; then echo no such module >&2; exit 1; fi\necho >> ../builds\n"
        'for name in index.html watch.js watch.css; do wc -l < ../builds > "$2/$name"; done\n'
    )
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(program.parent), prepend=os.pathsep)
    shutil.copy(building.__file__, tmp_path / "watch" / "building.py")
    spec = importlib.util.spec_from_file_location("building_of_a_checkout", tmp_path / "watch" / "building.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


def test_a_page_is_built_once_for_each_state_of_its_source(checkout: Any) -> None:
    page, said = checkout.SOURCE, list[str]()

    def builds() -> int:
        return int((checkout.build(said.append) / "watch.js").read_text())

    assert (builds(), builds(), said) == (1, 1, ["building the page …"])
    (page / "src" / "a.ts").write_text("changed")
    assert builds() == 2
    (page / "src" / "a.ts").rename(page / "src" / "b.ts")
    assert builds() == 3
    (page.parents[1] / "reports" / "languages" / "en.json").write_text("[]")
    assert builds() == 4
    (page / "node_modules" / "esbuild" / "x").write_text("changed")
    assert builds() == 4, "modules of others do not count"
    (checkout.BUILT / "watch.css").unlink()
    assert builds() == 5
    (page / "fails").touch()
    with pytest.raises(checkout.BuildError, match=r"^the page cannot be built: no such module$"):
        checkout.build()
    assert (checkout.BUILT / "watch.js").read_text().strip() == "5"
    assert not list(page.parent.glob(".built-*")), "nothing is left over"


def test_an_installed_page_that_is_not_complete_is_refused(checkout: Any) -> None:
    checkout.build()
    shutil.rmtree(checkout.SOURCE)
    assert checkout.build() == checkout.BUILT
    (checkout.BUILT / "watch.css").unlink()
    with pytest.raises(checkout.BuildError, match="install it again where npm works"):
        checkout.build()


def test_browsers_of_users_have_a_sandbox(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    assert "--no-sandbox" not in browser_flags()


def test_the_shipped_rally_is_that_of_the_default_match() -> None:
    expected = first_rally()
    found = shipped_rally(expected.key)
    assert found is not None, "run python -m docs.tools.first_rally"
    assert msgspec.json.encode(found.reply) == msgspec.json.encode(expected.reply)
    shown, staged = read(found.motion), read(expected.motion)
    np.testing.assert_allclose(shown.position, staged.position, atol=0.01)
    np.testing.assert_allclose(shown.shuttle, staged.shuttle, atol=0.01)


def test_what_is_missing_is_said_before_any_work(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(WatchError, match="is the day of the skill of --players; give both"):
        watch(match=MatchOptions(date="2021-07-31"))
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CHROMIUM", raising=False)
    with pytest.raises(WatchError, match="needs Chromium or Chrome; install it"):
        browser_program()
    with pytest.raises(ShuttleError, match=r"none\.mcap"):
        watch(rallies=RallyOptions(replay=tmp_path / "none.mcap"))
