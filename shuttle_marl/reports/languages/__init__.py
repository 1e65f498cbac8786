"""Languages of the reports and of the page of the live court: a catalogue of texts for each, a JSON file of this folder.

English is the source. Every catalogue has the same keys, and the same fields in braces; there is no fallback. Python fills fields
as ``str.format`` does, with the numbers and dates of the language. The page imports the same files when it is built.
"""

import contextlib
import datetime
import json
import string
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, Final, Literal, get_args

from shuttle_marl.base.errors import ShuttleError

Language = Literal["en", "zh", "id"]  # English, Chinese in simplified characters, Indonesian
LANGUAGES: Final[tuple[Language, ...]] = get_args(Language)
FOLDER: Final = Path(__file__).parent
_CURRENT: Final[ContextVar[Language]] = ContextVar("language", default="en")


class Texts(string.Formatter):
    """The texts of a language by key, such as ``scout.title``."""

    def __init__(self, language: Language) -> None:
        self.language = language
        self.groups: dict[str, dict[str, Any]] = json.loads((FOLDER / f"{language}.json").read_text(encoding="utf-8"))
        own = self.groups["language"]
        self._marks = str.maketrans({",": own["thousands"], ".": own["decimal"]})

    def __call__(self, key: str, **fields: Any) -> str:
        """A text with its fields filled. Raises ShuttleError: the catalogue has no such text."""
        group, _, name = key.partition(".")
        text = self.groups.get(group, {}).get(name)
        if not isinstance(text, str):
            raise ShuttleError(f"{key!r}: no such text in the catalogue of language {self.language}; expected one of its keys")
        return self.vformat(text, (), fields)

    def number(self, value: float, spec: str) -> str:
        """A number by a format specification, with the marks of the language: 1.234,5 in Indonesian."""
        return format(value, spec).translate(self._marks)

    def listed(self, items: Iterable[str]) -> str:
        """Items with commas between them."""
        return self("language.comma").join(items)

    def format_field(self, value: Any, format_spec: str) -> str:
        """The text of a field: dates and formatted numbers as the language writes them."""
        if isinstance(value, datetime.date):
            return self("language.date", year=value.year, month=value.month, day=value.day)
        return self.number(value, format_spec) if format_spec else str(value)


def current() -> Language:
    """The language in which texts are written now."""
    return _CURRENT.get()


@contextlib.contextmanager
def speaking(language: Language) -> Iterator[None]:
    """Write texts in a language within the block."""
    token = _CURRENT.set(language)
    try:
        yield
    finally:
        _CURRENT.reset(token)
