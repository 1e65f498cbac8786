"""Structure of the package as a table and a diagram: the layers of ``pyproject.toml``."""

import ast
import tomllib
from typing import Final

from docs.tools.markdown import ROOT, markdown

PACKAGE: Final = "shuttle_marl"
_CONTRACTS: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
_LAYERS: Final = [layer.split(" : ") for contract in _CONTRACTS if contract["type"] == "layers" for layer in contract["layers"]]
"""Modules of each layer, highest layer first."""
_NO_TORCH: Final = {name for contract in _CONTRACTS if contract["type"] == "forbidden" for name in contract["source_modules"]}


def _summary(module: str) -> str:
    """First sentence of the docstring of a module or package."""
    folder = ROOT / PACKAGE / module
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split()).split(". ")[0].removesuffix(".").replace("``", "`").replace(":mod:", "")


def layers() -> str:
    """Table of the layers with the first sentence of each docstring."""
    rows = []
    for name in (name for layer in _LAYERS for name in layer):
        kind = "/" if (ROOT / PACKAGE / name).is_dir() else ".py"
        rows.append((f"`{name}{kind}`", _summary(name), "never" if f"{PACKAGE}.{name}" in _NO_TORCH else ""))
    return markdown(("layer", "contents", "imports PyTorch"), rows, left=("layer", "contents", "imports PyTorch"))


def diagram() -> str:
    """The layers as a Mermaid diagram: each layer imports only from layers below."""
    rows = [f'    L{i}["{" &nbsp; · &nbsp; ".join(layer)}"]' for i, layer in enumerate(_LAYERS)]
    arrows = [f"    {' --> '.join(f'L{i}' for i in range(len(rows)))}"]
    return "\n".join(["```mermaid", "flowchart TD", *rows, *arrows, "```"])
