"""The site: navigation, reference, pages of commands and of rallies, and the description of the sample."""

import ast
import re

import pytest

import shuttle_marl
from docs.tools import command_reference, croissant, notebooks, site
from docs.tools.markdown import ROOT


def test_every_page_of_the_site_is_in_the_navigation() -> None:
    found = {page for _, pages in site.sections((ROOT / "docs/index.md").read_text()) for page in pages}
    paths = {(ROOT / "docs" / f"{page}.md").resolve() for page in found}
    pages = {path for pattern in site.PAGES for path in ROOT.glob(pattern) if path.suffix == ".md"}
    assert pages - paths == {ROOT / "docs/index.md"}
    assert paths <= pages


def test_the_reference_has_every_public_name() -> None:
    """Sphinx reads the module that defines a name, and the name is in ``__all__`` of a package below the top."""
    unread = set(site.unpublished())
    exported = set()
    for path in (ROOT / "shuttle_marl").glob("*/**/*.py"):
        text = path.read_text(encoding="utf-8")
        if str(path) not in unread and "\n__all__" in text:
            (names,) = (
                ast.literal_eval(node.value)
                for node in ast.parse(text).body
                if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
            )
            exported |= set(names)
    batched = ROOT / "shuttle_marl/env/batched.py"
    assert str(batched) not in unread
    own = {node.name for node in ast.parse(batched.read_text()).body if isinstance(node, ast.ClassDef)}
    assert set(shuttle_marl.__all__) - {"__version__"} <= exported | own
    assert str(ROOT / "shuttle_marl/commands/cli.py") in unread


def test_every_public_name_has_an_example() -> None:
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md"]
    blocks = [
        block
        for page in pages
        for block in re.findall(r"^```python[^\n]*\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)
    ]
    used = set(re.findall(r"\w+", "\n".join(blocks)))
    assert set(shuttle_marl.__all__) - {"__version__"} - used == set()


def test_the_page_of_commands_is_their_help() -> None:
    command_reference.main(check=True)


def test_the_sample_is_described() -> None:
    croissant.main(check=True)


@pytest.mark.parametrize("name", notebooks.NAMES)
def test_tutorials_are_notebooks(name: str) -> None:
    text = notebooks.text_form(name)
    assert text.startswith("---\njupyter:")
    assert "bash run" not in text
    links = re.findall(r"\]\(([^)#]+\.md)", text)
    assert all((ROOT / "docs/notebooks" / link).resolve().is_file() for link in links if not link.startswith("http"))
