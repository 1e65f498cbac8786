"""Installation hints for extras, in a clone of the repository or for an installed package, and imports on first use."""

import ast
import contextlib
import functools
import pkgutil
import shlex
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import lazy_loader

_EXTRAS: Final = {
    "browser": ("playwright",),
    "frames": ("pandas", "polars"),
    "render": ("pygame",),
    "scene": ("foxglove", "mcap_protobuf"),
    "train": ("lightgbm", "tensordict", "torch", "torchrl"),
}
_APART: Final = ("ray",)  # extras that `make install` omits


def install_hint(extra: str) -> str:
    """How to install an extra: from the clone that the package runs from, or of the installed package."""
    clone = Path(__file__).resolve().parents[2]
    if (clone / "pyproject.toml").is_file():
        command = f"`pip install -e {shlex.quote(f'{clone}[{extra}]')}`"
        return f"{command} installs it" if extra in _APART else f"`make install` in {clone} installs it, or {command}"
    # The package is on no index, so "pip install 'shuttle-marl[…]'" would fail.
    return f"install it again with its extra, in the clone by `pip install '.[{extra}]'`"


def lacking(error: ModuleNotFoundError) -> str | None:
    """Advice on an import that failed because an extra is not installed; None if it failed for another reason."""
    library = (error.name or "").partition(".")[0]
    extra = next((extra for extra, libraries in _EXTRAS.items() if library in libraries), None)
    return extra and f"this needs {library}, which is not installed; {install_hint(extra)}"


@contextlib.contextmanager
def hinted() -> Iterator[None]:
    """Say in an ``ImportError`` how to install the extra that an import lacks."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (hint := lacking(error)) is None or str(error) == hint:
            raise
        raise ModuleNotFoundError(hint, name=error.name) from error


@functools.cache
def lazily(package: str) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of a package, for the names that its ``__init__.py`` imports under ``if TYPE_CHECKING``."""
    names: dict[str, list[str]] = defaultdict(list)
    for node in ast.walk(ast.parse(pkgutil.get_data(package, "__init__.py") or b"")):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"{package}."):
            names[str(node.module).removeprefix(f"{package}.")] += [alias.name for alias in node.names]
    load, listed, _ = lazy_loader.attach(package, submod_attrs=names)
    return load, listed
