"""Structure of the package as tables and a diagram: layers from ``pyproject.toml``, paths from :mod:`docs.tools.size`."""

import ast
import tomllib
from typing import Final

from docs.tools import size
from docs.tools.markdown import ROOT, markdown
from docs.tools.size import PACKAGE

_PATHS: Final = {
    "stroke": "one stroke of `rally_v0`",
    "training_step": "one iteration of `train(PPOConfig())`",
    "recorded_rally": "recording the rallies of a training iteration",
    "page_frame": "one frame of the live court",
}


def _layers() -> list[list[str]]:
    """Modules of each layer, highest layer first."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    return [layer.split(" : ") for contract in contracts if contract["type"] == "layers" for layer in contract["layers"]]


def _without_torch() -> set[str]:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    modules = [name for contract in contracts if contract["type"] == "forbidden" for name in contract["source_modules"]]
    return {name.removeprefix(f"{PACKAGE}.") for name in modules}


def _summary(module: str) -> str:
    """First sentence of the docstring of a module or package."""
    folder = ROOT / PACKAGE / module
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split()).split(". ")[0].removesuffix(".").replace("``", "`").replace(":mod:", "")


def layers() -> str:
    """Table of the layers with the first sentence of each docstring."""
    names = [name for layer in _layers() for name in layer]
    no_torch = _without_torch()
    rows = []
    for name in names:
        is_package = (ROOT / PACKAGE / name).is_dir()
        rows.append((f"`{name}{'/' if is_package else '.py'}`", _summary(name), "never" if name in no_torch else ""))
    return markdown(("layer", "contents", "imports PyTorch"), rows, left=("layer", "contents", "imports PyTorch"))


def diagram() -> str:
    """The layers as a Mermaid diagram: each layer imports only from layers below."""
    rows = [f'    L{i}["{" &nbsp; · &nbsp; ".join(layer)}"]' for i, layer in enumerate(_layers())]
    arrows = [f"    {' --> '.join(f'L{i}' for i in range(len(rows)))}"]
    return "\n".join(["```mermaid", "flowchart TD", *rows, *arrows, "```"])


def paths() -> str:
    """Table of the files that take part in each path."""
    found = size.paths()
    rows = [(what, str(len(found[name])), ", ".join(f"`{file}`" for file in found[name])) for name, what in _PATHS.items()]
    return markdown(("path", "files", "where"), rows, left=("path", "where"))
