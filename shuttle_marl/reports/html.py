"""Pages: self-contained HTML files with tables and charts, for the reports of tournaments, of matches and of players."""

import base64
import dataclasses
import functools
import hashlib
import math
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Generic, TypeVar

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from shuttle_marl.base.errors import isolated, printable

T = TypeVar("T")
_TEMPLATES: Final = "templates"
_MARKUP: Final = re.compile(r"[\\`*\[\]<>|~&#]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")
"""Special characters of Markdown or HTML; an underscore within a word is none."""


@dataclasses.dataclass(frozen=True)
class Cell:
    """A cell of a table."""

    text: str = ""
    key: float | str | None = None  # what it is sorted by; None: after all others
    link: str = ""  # address that it leads to; empty: none
    kind: str = ""  # class in the style sheet; empty: that of its column. `shade-0` to `shade-10`: colours from lost to won


@dataclasses.dataclass(frozen=True)
class Heading:
    """The heading of a column of a table."""

    heading: str
    _: dataclasses.KW_ONLY
    about: str = ""  # tooltip of the heading
    left: bool = False  # whether the column is aligned to the left, as text is
    wrap: bool = False  # whether lines in it may break
    ascending: bool = False  # whether the first click puts the smallest key on top

    @property
    def kind(self) -> str:
        """Class of its cells in the style sheet."""
        return "words" if self.wrap else "left" if self.left else ""


@dataclasses.dataclass(frozen=True)
class Column(Heading, Generic[T]):
    """A column of a table; ``brief``: whether a short form of the table has it."""

    cell: Callable[[T], Cell]
    _: dataclasses.KW_ONLY
    brief: bool = True


@dataclasses.dataclass(frozen=True)
class Table:
    """A table: columns, and rows of one cell for each of them."""

    columns: Sequence[Column[Any]]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""


def table(items: Iterable[T], columns: Sequence[Column[T]], caption: str = "") -> Table:
    """The table with a row for each item."""
    return Table(columns, [[column.cell(item) for column in columns] for item in items], caption)


def escaped(text: str) -> str:
    """Text, escaped for Markdown."""
    return _MARKUP.sub(r"\\\g<0>", printable(text))


def number(value: float, form: str) -> Cell:
    """A number in a format; empty for NaN."""
    return Cell() if math.isnan(value) else Cell(format(value, form), value)


def percent(value: float, decimals: int = 1) -> Cell:
    """A fraction in per cent; empty for NaN."""
    return Cell() if math.isnan(value) else Cell(f"{100 * value:z.{decimals}f} %", value)


def interval(low: float, high: float, form: str) -> Cell:
    """An interval, sorted by its width; empty for NaN."""
    return Cell() if math.isnan(low) else Cell(f"{low:{form}} to {high:{form}}", high - low)


def name(value: str) -> Cell:
    """Text, sorted without regard to case."""
    return Cell(value, value.casefold())


@dataclasses.dataclass(frozen=True, kw_only=True)
class Viewer:
    """A program that a page contains and opens in frames of its own."""

    script: str  # its module, in the form in which it stands in a script element
    style: str


@functools.cache
def _environment(package: str) -> Environment:
    return Environment(
        loader=ChoiceLoader([PackageLoader(package, _TEMPLATES), PackageLoader(__package__, _TEMPLATES)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: isolated(printable(value, keep="\n")) if type(value) is str else value,
    )


def render(package: str, template: str, *, assets: Sequence[str] = (), viewer: Viewer | None = None, **content: Any) -> bytes:
    """A page as the content of a file.

    Args:
        package: package with a folder ``templates``.
        template: file name of a template there that extends ``page.html.j2``.
        assets: more style sheets and scripts from that folder, by file name.
        viewer: program that the page contains.
        content: variables of the template; ``title`` and ``subtitle`` at least.
    """
    environment = _environment(package)

    def source(name: str) -> str:
        assert environment.loader is not None
        return environment.loader.get_source(environment, name)[0]

    style = "".join(source(name) for name in ("page.css", *assets) if name.endswith(".css"))
    script = "".join(source(name) for name in ("page.js", *assets) if name.endswith(".js"))
    run = [f"'{_hash(script)}'"]
    policy = {"default-src": "'none'", "style-src": f"'{_hash(style)}'", "img-src": "data:"}
    if viewer is not None:
        # Frames inherit the policy; the viewer sets styles of elements, and reads motions and models from memory.
        run.append(f"'{_hash(viewer.script)}'")
        memory = dict.fromkeys(("frame-src", "media-src", "worker-src"), "blob:")
        policy |= {"style-src": "'unsafe-inline'", "img-src": "data: blob:", "connect-src": "data: blob:", **memory}
    policy |= {"script-src": " ".join(run), "base-uri": "'none'", "form-action": "'none'"}
    frame: dict[str, Any] = {
        "policy": "; ".join(f"{name} {value}" for name, value in policy.items()),
        "style": Markup(style),
        "script": Markup(script),
        "viewer": None if viewer is None else {"script": Markup(viewer.script), "style": Markup(viewer.style)},
        "headings": [],
    }
    return environment.get_template(template).render(**frame, **content).encode()


def _hash(content: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}"
