"""Content of the pages: sections of blocks, which one template writes."""

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

from markupsafe import Markup

from shuttle_marl.coach.words import words
from shuttle_marl.pages import Table, Viewer, render


@dataclasses.dataclass(frozen=True)
class Block:
    """A part of a section.

    Attributes:
        kind: how the template writes it.
        text: paragraph, caption, or title of a card.
        items: lines of a list or of a card; pairs of tiles.
        content: a chart or a table, or the data of sliders.
        example: number of the rally that a card plays; None: none.
        label: of the button that plays it.
    """

    kind: Literal["text", "list", "card", "tiles", "chart", "courts", "table", "sliders"]
    text: str = ""
    items: Sequence[Any] = ()
    content: Any = None
    example: int | None = None
    label: str = ""


def text(content: str) -> Block:
    """A paragraph."""
    return Block("text", content)


def chart(content: Markup, caption: str) -> Block:
    """A chart."""
    return Block("chart", caption, content=content)


def shown(content: Table) -> Block:
    """A table."""
    return Block("table", content=content)


@dataclasses.dataclass(frozen=True)
class Section:
    """A section, which begins with one sentence in plain words."""

    heading: str
    lead: str
    blocks: Sequence[Block]


def page(title: str, subtitle: str, sections: Sequence[Section], *, rallies: str = "", viewer: Viewer | None = None) -> bytes:
    """The page of a report.

    Args:
        rallies: staged rallies, as JSON that cannot end a script element; empty: none.
    """
    say = words()
    return render(
        __package__ or "",
        "report.html.j2",
        assets=("coach.css", "coach.js"),
        viewer=viewer,
        title=title,
        subtitle=subtitle,
        sections=sections,
        rallies=Markup(rallies.replace("<", "\\u003c")),
        say=say,
        language=say("language.tag"),
        save_table=say("report.save_table"),
    )
