"""An HTML document in one file: its frame, tables that can be sorted, and text that is never markup.

The content security policy allows the one style sheet and the one script that are in the file, by their hashes, and no
request. Text from outside goes through :func:`text` only.
"""

import base64
import dataclasses
import hashlib
import html
import math
from collections.abc import Sequence
from importlib.resources import files

from shuttle_marl.errors import printable


class Html(str):
    """Markup that was made here; any other string is text."""

    __slots__ = ()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell of a table.

    Attributes:
        shown: text, or markup that was made here.
        key: what it is sorted by; None: behind all others.
    """

    shown: str
    key: float | str | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a table.

    Attributes:
        name: its heading.
        about: a line about it, shown when one points at the heading.
        left: whether it is aligned to the left, as text is.
        words: whether lines in it may break.
        falling: whether the first click puts the largest on top.
    """

    name: str
    about: str = ""
    left: bool = False
    words: bool = False
    falling: bool = True


def text(value: str) -> Html:
    """Text as markup that shows it; markup as it is."""
    return value if isinstance(value, Html) else Html(html.escape(printable(value)))


def element(tag: str, *content: str, **attributes: str | float) -> Html:
    """An element of HTML or SVG.

    Args:
        tag: its name.
        content: text or markup.
        attributes: by name; ``_`` stands for ``-``, and one at the end is left out.
    """
    named = "".join(f' {key.rstrip("_").replace("_", "-")}="{_value(value)}"' for key, value in attributes.items())
    return Html(f"<{tag}{named}>{''.join(map(text, content))}</{tag}>")


def _value(value: str | float) -> str:
    if isinstance(value, float):
        # Two decimals of a pixel; the same bytes on every machine.
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return html.escape(printable(str(value)))


def number(value: float, form: str) -> Cell:
    """A figure; empty for NaN."""
    return Cell(shown="", key=None) if math.isnan(value) else Cell(shown=format(value, form), key=value)


def share(value: float, decimals: int = 1) -> Cell:
    """A share in per cent; empty for NaN."""
    return Cell(shown="", key=None) if math.isnan(value) else Cell(shown=f"{100 * value:.{decimals}f} %", key=value)


def name(value: str) -> Cell:
    """A name."""
    return Cell(shown=value, key=value.casefold())


def table(columns: Sequence[Column], rows: Sequence[Sequence[Cell]], caption: str = "") -> Html:
    """A table that is sorted by a click on a heading."""
    heads = [
        element(
            "th",
            element("button", column.name, type="button", **({"title": column.about} if column.about else {})),
            scope="col",
            class_="left" if column.left else "",
            data_first="falling" if column.falling and not column.left else "rising",
        )
        for column in columns
    ]
    lines = []
    for row in rows:
        cells = []
        for column, cell in zip(columns, row, strict=True):
            key = "" if cell.key is None else cell.key if isinstance(cell.key, str) else repr(float(cell.key))
            cells.append(
                element("td", cell.shown, class_="words" if column.words else "left" if column.left else "", data_key=key)
            )
        lines.append(element("tr", *cells))
    parts = [element("caption", caption)] if caption else []
    body = [element("thead", element("tr", *heads)), element("tbody", *lines)]
    return element("div", element("table", *parts, *body, class_="sortable"), class_="wide", tabindex="0")


def paragraph(*content: str) -> Html:
    """A paragraph."""
    return element("p", *content)


def code(value: str) -> Html:
    """Text as code."""
    return element("code", value)


def section(heading: str, *content: str) -> Html:
    """A section; its heading is linked to from the top."""
    return element("section", element("h2", heading), *content, id=_anchor(heading))


def _anchor(heading: str) -> str:
    return "-".join(heading.lower().split())


def document(title: str, subtitle: str, headings: Sequence[str], content: Sequence[str]) -> bytes:
    """A whole document.

    Args:
        title: its title.
        subtitle: what it is about, in a line.
        headings: of its sections.
        content: the sections.
    """
    style, script = (files(__package__).joinpath(f"report.{kind}").read_text(encoding="utf-8") for kind in ("css", "js"))
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
    links = [element("a", heading, href=f"#{_anchor(heading)}") for heading in headings]
    head = [
        Html('<meta charset="utf-8">'),
        Html(f'<meta http-equiv="Content-Security-Policy" content="{policy}">'),
        Html('<meta name="viewport" content="width=device-width, initial-scale=1">'),
        Html('<link rel="icon" href="data:,">'),
        element("title", title),
        Html(f"<style>{style}</style>"),
    ]
    body = [
        element("header", element("h1", title), element("p", subtitle, class_="subtitle"), element("nav", *links)),
        element("main", *content),
        Html(f"<script>{script}</script>"),
    ]
    page = element("html", element("head", *head), element("body", *body), lang="en")
    return f"<!doctype html>\n{page}\n".encode()


def _hash(content: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}"
