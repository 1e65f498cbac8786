"""Each promise of SECURITY.md and docs/own_data.md has a test: ``python -m tests.package.test_promises`` lists them."""

import ast
import json
import re
import tomllib
from pathlib import Path
from typing import Any, Final

ROOT: Final = Path(__file__).parents[2]
PROMISES: Final[list[dict[str, Any]]] = tomllib.loads(
    Path(__file__).with_name("promises.toml").read_text(encoding="utf-8")
)["promise"]  # fmt: skip


def test_every_promise_stands_on_its_page() -> None:
    for promise in PROMISES:
        page = (ROOT / promise["page"]).read_text(encoding="utf-8")
        assert promise["text"] in page, promise["text"]


def test_every_promise_has_a_test() -> None:
    for promise in PROMISES:
        assert promise["tests"], promise["text"]
        for test in promise["tests"]:
            function, _, case = test.removesuffix("]").partition("[")
            file, name = function.split("::")
            tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
            assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test
            folder, _, label = case.partition(": ")
            path = ROOT / "tests" / "data" / "cases" / folder / "expected.json"
            assert not case or label in json.loads(path.read_text(encoding="utf-8")), test


def test_every_guarantee_is_a_promise() -> None:
    """A new line under the guarantees of SECURITY.md needs a test; the last one is about the fuzzer itself."""
    text = (ROOT / "SECURITY.md").read_text(encoding="utf-8").partition("## What the package guarantees")[2]
    guarantees = re.split(r"^- ", text, flags=re.MULTILINE)[1:-1]
    assert len(guarantees) >= 4
    for guarantee in guarantees:
        assert any(promise["text"] in guarantee for promise in PROMISES), guarantee


if __name__ == "__main__":
    for each in PROMISES:
        print(f"{each['page']}: {' '.join(each['text'].split())}", *each["tests"], sep="\n    ")  # noqa: T201
