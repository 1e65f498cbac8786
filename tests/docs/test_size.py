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
PLAY = """
from shuttle_marl.a.top import g
def call():
    try:
        g()
    except Exception:
        pass
def play():
    traced(call)
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        path = tmp_path / "shuttle_marl" / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def test_modules_and_their_imports(root: Path) -> None:
    found = {module.name: module for module in size.modules(root).values()}
    assert set(found) == {f"shuttle_marl{name}" for name in ("", ".base", ".base.errors", ".a", ".a.low", ".a.top", ".a.unused")}
    assert found["shuttle_marl.a.low"].lines == 5
    assert found["shuttle_marl.a.low"].origins == {}
    assert found["shuttle_marl.a.top"].origins == {"low": "shuttle_marl.a.low", "E": "shuttle_marl.base.errors"}


def test_modules_with_one_importer(root: Path) -> None:
    assert [module.name for module in size.single_importers(size.modules(root))] == ["shuttle_marl.a.low"]


def test_files_that_run_and_that_running_code_names(root: Path) -> None:
    parts = size.files_of(root, size.modules(root), PLAY)
    assert {path.name for path in parts} == {"top.py", "low.py", "errors.py"}


PLAY_RUN = """
from shuttle_marl.training import before, run, after
def call():
    before.f()
    run.one_stroke()
    after.f()
def play():
    traced(call, begin="collect", end="save_checkpoint")
"""
RUNS = {
    "before.py": "def f(): return 1\n",
    "after.py": "def f(): return 2\n",
    "kept.py": "def save_checkpoint(): return learned()\ndef learned(): return 3\n",
    "rows.py": "def collect(): return 4\n",
    "run.py": "from shuttle_marl.training import kept, rows\ndef one_stroke():\n    rows.collect()\n    kept.save_checkpoint()\n",
}


def test_a_part_of_what_is_played_is_counted(root: Path) -> None:
    (root / "shuttle_marl/training").mkdir()
    for name, text in {"__init__.py": "", **RUNS}.items():
        (root / "shuttle_marl/training" / name).write_text(text, encoding="utf-8")
    parts = size.files_of(root, size.modules(root), PLAY_RUN)
    assert {path.name for path in parts} == {"run.py", "rows.py", "kept.py"}


def test_a_folder_without_the_package_is_refused(tmp_path: Path) -> None:
    with pytest.raises(size.SizeError, match="no package shuttle_marl here"):
        size.modules(tmp_path)


CLASSES = """class Rally:
    stroke: int
    server: int
class Stroke:
    stroke: int
    number: int
def wide(self, a, b, c, d, e, f, g, h, *, i): ...
def narrow(self, a, b, c, d, e, f, g, *, h): ...
"""


def test_rally_types_and_wide_functions(root: Path) -> None:
    (root / "shuttle_marl/a/low.py").write_text(CLASSES, encoding="utf-8")
    names = size.names_in(size.modules(root))
    assert names["rally_types"] == ["shuttle_marl.a.low.Rally"]
    assert names["wide_functions"] == ["shuttle_marl.a.low.wide"]


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
    names = size.names_in(found)
    assert found[package / "game/player.py"].code == 6
    assert names["rally_loops"] == ["shuttle_marl.game.player"]
    assert names["game_types"] == ["DoublesGame"]
    assert names["run_folders"] == ["shuttle_marl.league.journal"]
    assert size.circles(found, root) == ["shuttle_marl.a: low, top", "page: a, frame"]


THREADED = """
import threading
from shuttle_marl.training import log
from shuttle_marl.recording import writer
def play():
    traced(lambda: (log.before(), log.add(writer.write), log.before()), within="add")
"""


def test_files_within_a_function_and_in_its_threads(root: Path) -> None:
    for folder, name, text in (
        (
            "training",
            "log",
            "import threading\ndef before(): ...\ndef add(write):\n    t = threading.Thread(target=write); t.start(); t.join()\n",
        ),
        ("recording", "writer", "from shuttle_marl.recording import chunk\ndef write(): chunk.compress()\n"),
        ("recording", "chunk", "def compress(): ...\n"),
        ("training", "unused", "def before(): ...\n"),
    ):
        (root / "shuttle_marl" / folder).mkdir(exist_ok=True)
        (root / "shuttle_marl" / folder / "__init__.py").touch()
        (root / "shuttle_marl" / folder / f"{name}.py").write_text(text, encoding="utf-8")
    parts = size.files_of(root, size.modules(root), THREADED)
    assert {path.name for path in parts} == {"log.py", "writer.py", "chunk.py"}


def test_scripts_that_a_frame_imports(tmp_path: Path) -> None:
    for name, text in {
        "frame": 'import type { T } from "./types";\nimport { a,\n  type B } from "./a";\nimport { type C } from "./types";\n',
        "a": 'export { b } from "./b.ts";\nimport { Vector3 } from "three";\n',
        "b": "",
        "types": "",
    }.items():
        (tmp_path / f"{name}.ts").write_text(text, encoding="utf-8")
    assert {path.name for path in size.imported_scripts(tmp_path / "frame.ts")} == {"frame.ts", "a.ts", "b.ts", "types.ts"}
    with pytest.raises(size.SizeError, match=r"none\.ts"):
        size.imported_scripts(tmp_path / "none.ts")


@pytest.mark.parametrize(("setup", "most", "file"), [(size.STROKE, 4, "tables.py")])
def test_files_of_a_stroke(setup: str, most: int, file: str) -> None:
    parts = size.files_of(ROOT, size.modules(ROOT), setup)
    assert file in {path.name for path in parts}
    assert len(parts) <= most, sorted(path.name for path in parts)
