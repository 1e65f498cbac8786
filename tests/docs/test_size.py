"""The figures of the package's size."""

from pathlib import Path

import pytest

from docs.tools import size
from docs.tools.markdown import ROOT

LOW = """from typing import TYPE_CHECKING
if TYPE_CHECKING:
    from shuttle_marl.a import top
X, _Y = 1, 2
def f(): return X
"""
TOP = """from shuttle_marl.a import low
from shuttle_marl.base.errors import E
Z: int = 3
def g():
    low.f()
    raise E
"""
FILES = {
    "__init__.py": "",
    "base/__init__.py": "",
    "base/errors.py": "class E(Exception): ...\n",
    "a/__init__.py": "from shuttle_marl.a.low import f\n",
    "a/low.py": LOW,
    "a/top.py": TOP,
    "a/unused.py": "import shuttle_marl.base.errors\n",
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "shuttle_marl" / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


COUNTED = '''"""A module."""
# why

def f(game: "DoublesGame") -> str:
    """What it does,
    in two lines."""
    while f(game):
        strike(game)
    return """one
    two"""
'''


def test_code_and_shapes(root: Path) -> None:
    package = root / "shuttle_marl"
    for name, text in {
        "game/__init__.py": "",
        "game/rules.py": "class DoublesGame: ...\nclass SoloGame: ...\ndef strike(game): ...\n",
        "game/player.py": f"from shuttle_marl.game.rules import strike\n{COUNTED}",
        "league/__init__.py": "",
        "league/journal.py": "def add(path):\n    with path.open('ab') as file:\n        file.write(b'')\n",
        "league/play.py": "from shuttle_marl.league import journal\n",
        "a/low.py": "import shuttle_marl.a.top\n",
        "watch/page/src/frame.ts": 'import { a } from "./a";\n',
        "watch/page/src/a.ts": 'import { type B } from "./frame";\n',
    }.items():
        (package / name).parent.mkdir(exist_ok=True, parents=True)
        (package / name).write_text(text, encoding="utf-8")
    found = size.modules(root)
    assert {module.name for module in size.single_importers(found)} >= {"shuttle_marl.league.journal"}
    names = size.names_in(found)
    assert found[package / "game/player.py"].code == 6
    assert names["rally_loops"] == ["shuttle_marl.game.player"]
    assert names["game_types"] == ["DoublesGame"]
    assert names["run_folders"] == ["shuttle_marl.league.journal"]
    assert size.circles(found, root) == ["shuttle_marl.a: low, top", "page: a, frame"]


def test_files_of_a_stroke() -> None:
    parts = size.files_of(ROOT, size.modules(ROOT), size.STROKE)
    assert "tables.py" in {path.name for path in parts}
    assert len(parts) <= 4, sorted(path.name for path in parts)
