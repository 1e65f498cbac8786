"""Words of badminton in seven languages (``words.toml``), and maps from a user's headers and words to those of this package."""

import dataclasses
import difflib
import functools
import itertools
import re
import tomllib
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import command, did_you_mean
from shuttle_marl.base.files import problem, read_file
from shuttle_marl.data.schema import DISCIPLINES, DataError
from shuttle_marl.game import court
from shuttle_marl.game.scoring import RULES
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES

LANGUAGES: Final = ("en", "zh", "ja", "ko", "id", "da", "hi")  # `id`: Indonesian and Malay
_MARKS: Final = re.compile(r"[\s_\-\u2010-\u2015\u30fb\u2019.:/()'#]+")
_LONGEST: Final = 50
_ALIKE: Final = 0.75  # least similarity of a word that is meant by a misspelt one
_CLEARLY: Final = 0.05  # by which it is more similar than any word of another meaning


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
    """Meanings of the words of a kind in a file. A word with several meanings has that of the language which most of the words of
    the file are of, English if in doubt."""

    def __init__(self, kind: str, texts: Iterable[str], header: Iterable[str] = ()) -> None:
        """Words of a kind, ``column`` or the name of a column, from all texts of a file and headers that tell its language."""
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


def template(name: str) -> str:
    """Example of a file without positions, ``strokes.csv``, or its map with a comment on every setting, ``columns.toml``."""
    text = files(__package__).joinpath("template", name).read_text(encoding="utf-8")
    return text.replace("{shots}", ", ".join(SHOTS)).replace("{areas}", ", ".join(court.AREAS))


COLUMNS: Final[dict[str, str]] = dict(re.findall(r'^(?:# )?(\w+) = "\1"  # (.*)$', template("columns.toml"), re.MULTILINE))
PLAYERS: Final = ("player", "opponent", "winner")  # columns with names of players, whose spellings ``[values.player]`` maps
REQUIRED: Final = ("player", "shot")
FAULTS: Final = ("out", "net", "short", "foul", "error", "forced-error", "unforced-error")
WINNERS: Final = ("landed", "misjudged")
STOPS: Final = ("retired", "walkover", "disqualified")  # endings of a match; nobody won the rally
WORDS: Final[dict[str, tuple[str, ...]]] = {
    "hand": court.HANDS,
    "shot": (*SHOTS, "unknown", "serve"),
    "height": HEIGHTS,
    "technique": TECHNIQUES,
    "area": court.AREAS,
    "ending": ("returned", *FAULTS, *WINNERS, "unknown", "let", *STOPS),
    "forced": ("unforced", "forced"),
    "discipline": DISCIPLINES,
    "side": ("near", "far"),
    "rules": tuple(RULES),
}
_CHOICES: Final = {
    "discipline": ("", *DISCIPLINES),
    "coordinates": ("striker", "court"),
    "areas_seen_by": ("receiver", "striker"),
    "decimal": (".", ","),
    "rules": ("", *RULES),
}
_SETTINGS: Final = ("source", "discipline", "coordinates", "areas_seen_by", "delimiter", "decimal", "rules", "columns", "values")

_MOST_BYTES: Final = 1 << 18
_LONGEST_LINE: Final = 2000
_WHOLE: Final = re.compile(r"\A(\d+)[.,]0+\Z")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """Map from a user's headers and words to those of this package."""

    source: str = ""  # source of the matches; empty: that of the format
    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)  # header by name of `COLUMNS`; none: as its words mean
    values: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)  # own word by the user's in lower case
    discipline: str = ""  # of all matches; empty: that of a column, or of known players
    coordinates: str = "striker"  # `striker`: as in the schema; `court`: the same for both players
    areas_seen_by: str = "receiver"  # `receiver` or `striker`, from whose view left and right are
    delimiter: str = ""  # of values; empty: a comma, and without columns what the header has most of
    decimal: str = "."
    rules: str = ""  # of the matches, of `RULES`; empty: those that the scores tell
    guessed: bool = False  # whether the columns are those that the words of the header mean
    file: Path | None = None  # with the map; None: there is none

    @classmethod
    def read(cls, path: Path) -> "ColumnMap":
        """Read a TOML file."""
        try:
            text = read_file(path, _MOST_BYTES).decode("utf-8-sig")
            if any(len(line) > _LONGEST_LINE for line in text.splitlines()):  # time and memory of a dotted key are quadratic
                raise ValueError(f"a line of more than {_LONGEST_LINE:,} characters")
            fields = tomllib.loads(text)
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(path, f"no readable TOML ({problem(error)})") from error
        try:
            return dataclasses.replace(cls._checked(fields), file=path)
        except (TypeError, ValueError, AttributeError) as error:
            raise DataError(path, f"{error}; `{command('data', 'template')}` writes an example") from error

    @classmethod
    def _checked(cls, fields: dict[str, Any]) -> "ColumnMap":
        _known(fields, _SETTINGS, "setting")
        columns, values = fields.get("columns", {}), fields.get("values", {})
        _known(columns, COLUMNS, "column")
        _known(values, (*WORDS, "player"), "column with words")
        for name, column in columns.items():
            if not isinstance(column, str):
                raise ValueError(f"[columns] {name} = {column!r}; expected the name of a column, in quotes")
            if others := [other for other in columns if other != name and columns[other] == column]:
                raise ValueError(f"[columns] {name} and {others[0]} are both {column!r}; map a column once")
        lower: dict[str, dict[str, str]] = {name: {} for name in values}
        for name, words in values.items():
            for word, meant in words.items():
                if name == "player" and not (isinstance(meant, str) and meant.strip() and meant.isprintable()):
                    raise ValueError(f"[values.player] {word!r} = {meant!r}; expected a name")
                if name != "player" and meant not in WORDS[name]:
                    raise ValueError(f"[values.{name}] {word!r} = {meant!r}; expected one of {', '.join(WORDS[name])}")
                if lower[name].setdefault(plain(word), meant) != meant:
                    raise ValueError(f"[values.{name}] {word!r} stands there twice, with different meanings")
        found = cls(**{**fields, "columns": {name: nfc(column) for name, column in columns.items()}, "values": lower})
        for name, allowed in _CHOICES.items():
            if (value := getattr(found, name)) not in allowed:
                raise ValueError(f"{name} = {value!r}; expected one of {', '.join(map(repr, allowed))}")
        if "source" in fields and not (isinstance(found.source, str) and found.source.strip() and found.source.isprintable()):
            raise ValueError(f"source = {found.source!r}; expected a line of text")
        delimiter = fields.get("delimiter", ";")
        if not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter == found.decimal:
            raise ValueError(f"delimiter = {found.delimiter!r}; expected one character, another than decimal")
        return found.with_columns(found.columns) if columns else found

    def with_columns(self, columns: Mapping[str, str]) -> "ColumnMap":
        """The map with these columns."""
        if missing := [name for name in REQUIRED if name not in columns]:
            raise ValueError(f"[columns] lacks {', '.join(missing)}")
        if len({"points", "points_opponent"} & set(columns)) == 1:
            raise ValueError("[columns] needs points and points_opponent, or neither")
        if self.coordinates == "court" and "side" not in columns:
            raise ValueError('coordinates = "court" needs the column side')
        return dataclasses.replace(self, columns=columns)


def nfc(text: str) -> str:
    """Text in Unicode normal form C: letters with marks are one character each, as far as possible."""
    return unicodedata.normalize("NFC", text)


def plain(word: str) -> str:
    """A word as it is compared: without capitals and spaces around it; a whole number without decimals."""
    return whole(nfc(word)).casefold()


def whole(text: str) -> str:
    """A text without spaces around it; ``4`` for ``4.0``, which a spreadsheet makes of it in a column with gaps."""
    return _WHOLE.sub(r"\1", text.strip())


def _known(fields: Any, allowed: Mapping[str, Any] | Sequence[str], what: str) -> None:
    if not isinstance(fields, dict):
        raise TypeError(f"expected a table, not {fields!r}")
    for name in fields:
        if name not in allowed:
            raise ValueError(f"no {what} {name!r}{did_you_mean(name, allowed) or '; expected one of ' + ', '.join(allowed)}")
