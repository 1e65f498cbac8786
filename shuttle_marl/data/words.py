"""Words of badminton in seven languages, for the headers and the values of files of others: the table ``words.toml``."""

import difflib
import functools
import itertools
import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterable, Mapping
from importlib.resources import files
from typing import Final

LANGUAGES: Final = ("en", "zh", "ja", "ko", "id", "da", "hi")
"""English, Chinese, Japanese, Korean, Indonesian and Malay, Danish, Hindi."""
_MARKS: Final = re.compile(r"[\s_\-\u2010-\u2015\u30fb\u2019.:/()'#]+")
_LONGEST: Final = 50
_ALIKE: Final = 0.75
"""Least similarity of a word that is meant by a misspelt one."""
_CLEARLY: Final = 0.05
"""By which it is more similar than any word of another meaning."""


def bare(text: str) -> str:
    """A text as words are compared: without capitals, spaces, hyphens and the like."""
    return _MARKS.sub("", unicodedata.normalize("NFKC", text).casefold())


@functools.cache
def table(kind: str) -> Mapping[str, Mapping[str, str]]:
    """By language, the meaning of each word of a kind, which is bare."""
    everything = _file()
    found: dict[str, dict[str, str]] = {language: {} for language in LANGUAGES}
    for meaning, words in everything[kind].items():
        for language, spellings in words.items():
            found[language] |= dict.fromkeys(map(bare, spellings), meaning)
        found["en"][bare(meaning)] = meaning
    if kind == "area":
        depths, sides = everything["depth"], everything["side_of_area"]
        for language, depth, side in itertools.product(LANGUAGES, depths, sides):
            for a, b in itertools.product(depths[depth][language], sides[side][language]):
                found[language] |= {bare(a + b): f"{depth}-{side}", bare(b + a): f"{depth}-{side}"}
    return found


@functools.cache
def _file() -> dict[str, dict[str, dict[str, list[str]]]]:
    return tomllib.loads(files(__package__).joinpath("words.toml").read_text(encoding="utf-8"))


class Words:
    """Meanings of the words of a kind in a file.

    A word with several meanings has that of the language which most of the words of the file are of, English if in doubt.
    """

    def __init__(self, kind: str, texts: Iterable[str], header: Iterable[str] = ()) -> None:
        """Words of a kind.

        Args:
            kind: ``column``, or the name of a column with words.
            texts: all of them in the file.
            header: headers of the file, which tell its language too.
        """
        self._table, headers = table(kind), table("column")
        told, around = {bare(text) for text in texts}, {bare(text) for text in header}
        known = {name: len(told & self._table[name].keys()) + len(around & headers[name].keys()) for name in LANGUAGES}
        self._languages = sorted(LANGUAGES, key=lambda language: -known[language])

    def meaning(self, text: str) -> str | None:
        """What a word means, None if it is unknown."""
        word = bare(text)
        return next((self._table[language][word] for language in self._languages if word in self._table[language]), None)

    def ambiguous(self, text: str) -> str:
        """A sentence on a word that has another meaning in another language; empty for others."""
        word, meaning = bare(text), self.meaning(text)
        others = sorted({found for name in LANGUAGES if (found := self._table[name].get(word, meaning)) != meaning and found})
        return f"{text.strip()!r} as {meaning}, by the language of the file; in another: {', '.join(others)}" if others else ""

    def meant(self, text: str, more: Collection[str] = ()) -> str | None:
        """What a misspelt word means: that of the most similar word, or one of ``more``; None if that is not clear."""
        meanings = {bare(word): word for word in more}
        for language in reversed(self._languages):
            meanings |= self._table[language]
        word = bare(text[:_LONGEST])
        likeness: dict[str, float] = {}
        for other in difflib.get_close_matches(word, meanings, n=8, cutoff=_ALIKE):  # most similar first
            likeness.setdefault(meanings[other], difflib.SequenceMatcher(None, other, word).ratio())
        if not likeness:
            return None
        best, *others = likeness
        return best if all(likeness[best] - likeness[other] > _CLEARLY for other in others) else None
