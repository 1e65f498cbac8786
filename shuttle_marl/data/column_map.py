"""Column maps from a user's headers and words to those of this package: TOML files, their template, and what headers mean."""

import dataclasses
import difflib
import re
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from shuttle_marl.base.errors import command
from shuttle_marl.base.files import problem, read_file
from shuttle_marl.data.schema import DISCIPLINES
from shuttle_marl.data.strict_csv import DataError, Sheet
from shuttle_marl.data.words import Words
from shuttle_marl.game import court
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES

COLUMNS: Final[dict[str, str]] = {
    "match": "name of the match; its rows are consecutive; without it all are of one match, the name of the file",
    "discipline": "MS or WS, by match; or the same for all: discipline = \"MS\" in the map",
    "game": "game of the match, from 1; without it all are game 1",
    "rally": "rally of the game, from 1; without it a rally begins with each serve",
    "stroke": "stroke of the rally, the serve is 1; without it strokes are counted in the order of the rows",
    "player": "the striker",
    "opponent": "the other player; without it the other name in the match",
    "hand": "right or left, in which the striker holds the racket; without it strokes around the head tell it",
    "shot": f"one of {', '.join(SHOTS)}; serve: the reply tells which; or unknown: the row is dropped",
    "height": "above or below the net at contact; without it smashes, half smashes, clears, drops and net kills are above",
    "technique": "forehand, backhand or around-the-head; without it all are forehand",
    "area": f"where it was met or fell: one of {', '.join(court.AREAS)}; without it the next stroke tells where it was met",
    "ending": "of the last stroke of a rally: out, net, short, foul, error, forced-error, unforced-error (faults), landed, "
    "misjudged (winners), or let: the rally is dropped; empty: returned",
    "forced": "forced or unforced: whether the opponent forced the fault",
    "winner": "winner of the rally, one of its players, in any of its rows; without it and ending, who serves next",
    "score": "points of both, as 5-3, in any row of a rally; whose are first, and whether before or after it, tells who won",
    "points": "points of the striker in this game after the rally",
    "points_opponent": "points of the opponent in this game after the rally",
    "seconds": "time in the video [s]; whole seconds are kept",
    "frame": "frame in the video",
    "confidence": "probability that the row is right, from 0 to 1, of a program that recognised the stroke",
    "side": "near or far: the striker's half; only for coordinates = \"court\"",
    **{
        f"{name}_{axis}": f"{text}, {axis} [m]"
        for name, text in (
            ("landing", "where the shuttle was met or fell"),
            ("contact", "where the striker met the shuttle; empty for serves"),
            ("striker", "where the striker stood"),
            ("receiver", "where the receiver stood"),
        )
        for axis in "xy"
    },
}  # fmt: skip
"""Description of each column."""
PLAYERS: Final = ("player", "opponent", "winner")
"""Columns with names of players, whose spellings ``[values.player]`` maps."""
REQUIRED: Final = ("player", "shot")
_COORDINATES: Final = ("striker", "court")
FAULTS: Final = ("out", "net", "short", "foul", "error", "forced-error", "unforced-error")
WINNERS: Final = ("landed", "misjudged")
WORDS: Final[dict[str, tuple[str, ...]]] = {
    "hand": court.HANDS,
    "shot": (*SHOTS, "unknown", "serve"),
    "height": HEIGHTS,
    "technique": TECHNIQUES,
    "area": court.AREAS,
    "ending": ("returned", *FAULTS, *WINNERS, "unknown", "let"),
    "forced": ("unforced", "forced"),
    "discipline": DISCIPLINES,
    "side": ("near", "far"),
}
"""Words of the columns with words."""
_SETTINGS: Final = ("source", "discipline", "coordinates", "areas_seen_by", "delimiter", "decimal", "columns", "values")

_MOST_BYTES: Final = 1 << 18
_LONGEST_LINE: Final = 2000
_WHOLE: Final = re.compile(r"\A(\d+)[.,]0+\Z")
_SHOWN: Final = 30
"""Headers that a message shows."""

TEMPLATE_CSV: Final = """\
match,game,rally,stroke,player,shot,height,technique,area,ending,points,points_opponent
club final 2026,1,1,1,Anna Example,short-serve,below,backhand,front-centre,,1,0
club final 2026,1,1,2,Berta Sample,lift,below,forehand,back-left,,0,1
club final 2026,1,1,3,Anna Example,smash,above,forehand,middle-right,landed,1,0
club final 2026,1,2,1,Anna Example,short-serve,below,backhand,front-centre,,1,1
club final 2026,1,2,2,Berta Sample,push,below,forehand,back-right,,1,1
club final 2026,1,2,3,Anna Example,clear,above,forehand,back-centre,out,1,1
"""
"""Example of a file, without positions."""


def template_map() -> str:
    """Column map of :data:`TEMPLATE_CSV`, with a comment on every setting."""
    used = TEMPLATE_CSV.partition("\n")[0].split(",")
    lines = [
        "# Source of the matches.",
        'source = "my club"',
        "# MS (men's singles) or WS (women's singles); omit it if a column contains it.",
        'discipline = "WS"',
        "# striker: x to the striker's right, y towards the opponent, from the floor under the middle of the net.",
        "# court: x and y the same for both players, who are near (y < 0) or far: map the column side too.",
        'coordinates = "striker"',
        "# Left and right of areas from the view of the receiver or the striker.",
        'areas_seen_by = "receiver"',
        'delimiter = ","',
        'decimal = "."',
        "",
        "# Your header of each column. Omit columns that you do not have.",
        "[columns]",
    ]
    lines += [f'{"" if name in used else "# "}{name} = "{name}"  # {text}' for name, text in COLUMNS.items()]
    lines += ["", "# Your words = words used here, by column; in values.player, your spellings = names.", "[values.shot]"]
    lines += ['# "Schmetterball" = "smash"', "", "[values.ending]", '# "Aus" = "out"', ""]
    return "\n".join(lines)


@dataclasses.dataclass(frozen=True, kw_only=True)
class ColumnMap:
    """Map from a user's headers and words to those of this package.

    Attributes:
        source: source of the matches; empty: that of the format.
        columns: header by name of :data:`COLUMNS`; none: those that the words of the header mean (:meth:`filled`).
        values: by column, word of this package by the user's word in lower case.
        discipline: of all matches; empty: that of a column, or of known players.
        coordinates: ``striker``: as in the schema; ``court``: the same for both players.
        areas_seen_by: ``receiver`` or ``striker``, from whose view left and right are.
        delimiter: of values; empty: a comma, and without columns what the header has most of.
        guessed: whether the columns are those that the words of the header mean.
    """

    source: str = ""
    columns: Mapping[str, str] = dataclasses.field(default_factory=dict)
    values: Mapping[str, Mapping[str, str]] = dataclasses.field(default_factory=dict)
    discipline: str = ""
    coordinates: str = "striker"
    areas_seen_by: str = "receiver"
    delimiter: str = ""
    decimal: str = "."
    guessed: bool = False

    @classmethod
    def read(cls, path: Path) -> "ColumnMap":
        """Read a TOML file.

        Raises:
            DataError: it cannot be read, or has an invalid setting.
        """
        try:
            text = read_file(path, _MOST_BYTES).decode("utf-8-sig")
            if any(len(line) > _LONGEST_LINE for line in text.splitlines()):  # time and memory of a dotted key are quadratic
                raise ValueError(f"a line of more than {_LONGEST_LINE:,} characters")
            fields = tomllib.loads(text)
        except (OSError, ValueError, RecursionError) as error:
            raise DataError(path, f"no readable TOML ({problem(error)})") from error
        try:
            return cls._checked(fields)
        except (TypeError, ValueError, AttributeError) as error:
            raise DataError(path, f"{error}; `{command('data', 'template')}` writes an example") from error

    def filled(self, sheet: Sheet) -> "ColumnMap":
        """The map of a table; without columns, those that the words of its header mean.

        Raises:
            DataError: a required column is missing.
        """
        if self.columns:
            return self
        words = Words("column", sheet.header)
        found: dict[str, str] = {name: name for name in sheet.header if name in COLUMNS}
        for name in sheet.header:
            meaning = words.meaning(name)
            if meaning is not None and name not in COLUMNS:
                found.setdefault(meaning, name)
        if "shot" not in found and "stroke" in found and not any(map(str.isdigit, sheet.columns[found["stroke"]])):
            found["shot"] = found.pop("stroke")
        if "technique" not in found and "hand" in found:
            told = set(sheet.columns[found["hand"]])
            if any(map(Words("technique", told).meaning, told)):
                found["technique"] = found.pop("hand")
        try:
            _check_columns(found, self.coordinates)
        except ValueError as error:
            header = ", ".join(map(repr, sheet.header[:_SHOWN]))
            raise DataError(sheet.path, f"{error}, or map your headers with --columns; the header is {header}") from error
        return dataclasses.replace(self, columns=found, guessed=True)

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
        columns = {name: nfc(column) for name, column in columns.items()}
        lower: dict[str, dict[str, str]] = {name: {} for name in values}
        for name, words in values.items():
            for word, meant in words.items():
                if name == "player":
                    if not isinstance(meant, str) or not meant.strip() or not meant.isprintable():
                        raise ValueError(f"[values.player] {word!r} = {meant!r}; expected a name")
                elif meant not in WORDS[name]:
                    raise ValueError(f"[values.{name}] {word!r} = {meant!r}; expected one of {', '.join(WORDS[name])}")
                if lower[name].setdefault(plain(word), meant) != meant:
                    raise ValueError(f"[values.{name}] {word!r} stands there twice, with different meanings")
        found = cls(**{**fields, "columns": columns, "values": lower})
        for name, value, allowed in (
            ("discipline", found.discipline, ("", *DISCIPLINES)),
            ("coordinates", found.coordinates, _COORDINATES),
            ("areas_seen_by", found.areas_seen_by, ("receiver", "striker")),
            ("decimal", found.decimal, (".", ",")),
        ):
            if value not in allowed:
                raise ValueError(f"{name} = {value!r}; expected one of {', '.join(map(repr, allowed))}")
        if "source" in fields and not (isinstance(found.source, str) and found.source.strip() and found.source.isprintable()):
            raise ValueError(f"source = {found.source!r}; expected a line of text")
        delimiter = fields.get("delimiter", ";")
        if not isinstance(delimiter, str) or len(delimiter) != 1 or delimiter == found.decimal:
            raise ValueError(f"delimiter = {found.delimiter!r}; expected one character, another than decimal")
        if columns:
            _check_columns(columns, found.coordinates)
        return found


def _check_columns(columns: Mapping[str, str], coordinates: str) -> None:
    if missing := [name for name in REQUIRED if name not in columns]:
        raise ValueError(f"[columns] lacks {', '.join(missing)}")
    if len({"points", "points_opponent"} & set(columns)) == 1:
        raise ValueError("[columns] needs points and points_opponent, or neither")
    if coordinates == "court" and "side" not in columns:
        raise ValueError('coordinates = "court" needs the column side')


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
            close = difflib.get_close_matches(name, list(allowed), n=1)
            hint = f"; did you mean {close[0]}?" if close else f"; expected one of {', '.join(allowed)}"
            raise ValueError(f"no {what} {name!r}{hint}")
