"""HTML pages from Jinja2 templates: one file each, which makes no request, with tables that are sorted by a click.

The content security policy allows the one style sheet and the one script of the page, by their hashes. Templates escape all text;
only charts are markup.
"""

import base64
import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Generic, TypeVar

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from shuttle_marl.errors import printable

T = TypeVar("T")
_TEMPLATES: Final = "templates"


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: its text.
        key: what it is sorted by; None: after all others.
    """

    text: str = ""
    key: float | str | None = None


@dataclasses.dataclass(frozen=True)
class Column(Generic[T]):
    """A column of a table.

    Attributes:
        heading: its heading.
        cell: its cell in the row of an item.
        about: tooltip of the heading.
        left: whether it is aligned to the left, as text is.
        wrap: whether lines in it may break.
        ascending: whether the first click puts the smallest key on top.
    """

    heading: str
    cell: Callable[[T], Cell]
    _: dataclasses.KW_ONLY
    about: str = ""
    left: bool = False
    wrap: bool = False
    ascending: bool = False


@dataclasses.dataclass(frozen=True)
class Table:
    """A table: columns, and rows of one cell for each of them."""

    columns: Sequence[Column[Any]]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""


def table(items: Iterable[T], columns: Sequence[Column[T]], caption: str = "") -> Table:
    """The table with a row for each item."""
    return Table(columns, [[column.cell(item) for column in columns] for item in items], caption)


def number(value: float, form: str) -> Cell:
    """A number in a format; empty for NaN."""
    return Cell() if math.isnan(value) else Cell(format(value, form), value)


def percent(value: float, decimals: int = 1) -> Cell:
    """A fraction in per cent; empty for NaN."""
    return Cell() if math.isnan(value) else Cell(f"{100 * value:.{decimals}f} %", value)


def interval(low: float, high: float, form: str) -> Cell:
    """An interval, sorted by its width; empty for NaN."""
    return Cell() if math.isnan(low) else Cell(f"{low:{form}} to {high:{form}}", high - low)


def name(value: str) -> Cell:
    """Text, sorted without regard to case."""
    return Cell(value, value.casefold())


@functools.cache
def _environment() -> Environment:
    return Environment(
        loader=PackageLoader(__package__, _TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value, keep="\n") if type(value) is str else value,
    )


def render(template: str, **content: Any) -> bytes:
    """A page as the content of a file.

    Args:
        template: file name of a template that extends ``page.html.j2``.
        content: variables of the template; ``title`` and ``subtitle`` at least.
    """
    environment = _environment()
    assert environment.loader is not None
    style, script = (environment.loader.get_source(environment, f"page.{kind}")[0] for kind in ("css", "js"))
    policy = "; ".join(
        [
            "default-src 'none'",
            f"style-src '{_hash(style)}'",
            f"script-src '{_hash(script)}'",
            "img-src data:",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    frame = {"policy": policy, "style": Markup(style), "script": Markup(script), "headings": []}
    return environment.get_template(template).render(**frame, **content).encode()


def _hash(content: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}"
