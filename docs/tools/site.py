"""Extensions of Sphinx for the documentation site: the navigation, and the selection of public names for the reference."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from docs.tools.markdown import ROOT

if TYPE_CHECKING:
    from sphinx.application import Sphinx

INDEX: Final = "docs/index"  # the first page, without its suffix; its headings and links are the navigation
PAGES: Final = (
    "README.md",
    "CHANGELOG.md",
    "CODE_OF_CONDUCT.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "THIRD_PARTY_NOTICES.md",
    "benchmarks/README.md",
    "datasets/README.md",
    "datasets/sample/CARD.md",
    "docs/*.md",
    "docs/commands/*.md",
    "docs/suite/*.md",
    "docs/tutorials/*.md",
    "docs/notebooks/*.ipynb",
    "shuttle_marl/court/staging/athletes/*.md",
)
"""Pages of the site, relative to the root."""
NOTEBOOKS: Final = ROOT / "docs" / "notebooks"
"""Folder of executed notebooks, which ``docs.tools.notebooks`` makes and git ignores."""
REFERENCE: Final = "docs/reference/shuttle_marl/index"  # first page of the reference, which sphinx-autoapi makes
_WITHOUT_ALL: Final = ("shuttle_marl.env.batched", "shuttle_marl.env.open_spiel")
"""Public modules without ``__all__``: another package exports their names, or only their modules have some."""
_LINK: Final = re.compile(r"\]\(([^)#:]+\.md)\)")


def unpublished() -> list[str]:
    """Python files of the package that define no public name, which sphinx-autoapi need not read."""
    package = ROOT / "shuttle_marl"
    files = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in package.rglob("*.py")
    }
    public = {name for name, path in files.items() if "\n__all__" in path.read_text(encoding="utf-8")} | {*_WITHOUT_ALL}
    for name in [name for name in public if files[name].name == "__init__.py"]:
        tree = ast.parse(files[name].read_text(encoding="utf-8"))
        public |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module in files}
    parents = {name.rpartition(".")[0] for name in public}
    return [str(path) for name, path in sorted(files.items()) if name not in public | parents]


def sections(text: str) -> Iterator[tuple[str, list[str]]]:
    """Headings of the second level of the index, and the pages to which links below each lead, without their suffix.

    A page belongs to the first section that links to it.
    """
    seen: set[str] = set()
    for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        heading, _, body = section.partition("\n")
        pages = [Path(link).with_suffix("").as_posix() for link in _LINK.findall(body)]
        new = [page for page in dict.fromkeys(pages) if page not in seen]
        seen.update(new)
        yield heading.strip(), new


def add_navigation(app: "Sphinx", page: str, source: list[str]) -> None:
    """Add a table of contents for each section to the first page; Sphinx calls this with the text of every page."""
    if page != INDEX:
        return
    for heading, pages in sections(source[0]):
        if heading == "API" and "autoapi.extension" in app.extensions:
            pages = [*pages, f"/{REFERENCE}"]  # noqa: PLW2901
        if heading == "Start":
            pages = [*pages, *(f"notebooks/{path.stem}" for path in sorted(NOTEBOOKS.glob("*.ipynb")))]  # noqa: PLW2901
        entries = "\n".join(pages)
        source[0] += f"\n```{{toctree}}\n:hidden:\n:caption: {heading}\n:maxdepth: 1\n\n{entries}\n```\n"


def read_lazy_imports() -> None:
    """Let sphinx-autoapi see what a package imports lazily: the imports under ``if TYPE_CHECKING`` of its ``__init__.py``."""
    from autoapi import _astroid_utils  # noqa: PLC0415  only the build of the site has it
    from autoapi._parser import Parser  # noqa: PLC0415

    def parse_if(parser: Any, node: Any) -> list[Any]:
        if node.test.as_string() != "TYPE_CHECKING" or not node.root().package:
            return []
        local = [child for child in node.body if _astroid_utils.is_local_import_from(child, "shuttle_marl")]
        return [found for child in local for found in parser._parse_local_import_from(child)]

    Parser.parse_if = parse_if


def is_private(_app: "Sphinx", kind: str, name: str, found: Any, *_: object) -> bool | None:
    """Whether the reference leaves out a name; None: as the settings say. Sphinx calls this with every name of the package.

    Public are the packages and modules with ``__all__``, and what they export. The names of ``shuttle_marl`` itself stand on
    ``docs/api.md`` and, in full, on the pages of their packages.
    """
    if kind in ("package", "module"):
        return found.all is None and name not in _WITHOUT_ALL
    imported = found.imported and name.rpartition(".")[0] in _WITHOUT_ALL
    return True if imported or name.count(".") == 1 else None
