"""Real matches for the live court: their whole rallies, the nearest strokes of the game, and strokes that a person tags."""

import collections
import contextlib
import csv
import dataclasses
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from shuttle_marl.base import files
from shuttle_marl.base.arrays import I64
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import check_replaceable, read_file, replace_file
from shuttle_marl.base.runs import Journal, locked
from shuttle_marl.data.schema import NAMES, Outcome, rally_starts
from shuttle_marl.game.court import seen_by, steps_between
from shuttle_marl.game.scoring import Score
from shuttle_marl.game.stroke import N_SERVES
from shuttle_marl.game.tables import Game


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class WholeRally:
    """A rally from its serve to the stroke that ended it, none missing.

    Attributes:
        number: of the rally in the data, with its game.
        players: identifiers at seats 0 and 1; seat 0 strikes first in the match.
        score: before the rally.
        rows: of its strokes in the table.
        ended: by a fault or a winner.
    """

    match: str
    number: tuple[int, int]
    players: tuple[str, str]
    score: Score
    rows: I64
    ended: Outcome


def whole_rallies(strokes: pa.Table) -> Iterator[WholeRally]:
    """The whole rallies of a table of schema :data:`~shuttle_marl.data.schema.STROKES`, in its order."""
    names = ("match", "game", "rally", "stroke", "player", "opponent", "shot", "outcome")
    match, game, rally, stroke, player, opponent, shot, outcome = (strokes[n].to_numpy(zero_copy_only=False) for n in names)
    after = np.stack([strokes[name].to_numpy() for name in ("points", "points_opponent")], axis=1)
    last = -1
    for first, end in itertools.pairwise(rally_starts(strokes).tolist()):
        if last < 0 or match[first] != match[last]:
            seats, finished, points = (str(player[first]), str(opponent[first])), tuple[tuple[int, int], ...](), (0, 0)
        elif game[first] != game[last]:
            finished, points = (*finished, points), (0, 0)
        last, server, rows = first, seats.index(player[first]), np.arange(first, end)
        known = not np.isnan(after[first]).any()
        if known:  # otherwise they are those of the rally before
            points = int(after[first, server]), int(after[first, 1 - server])
        ended, serves = Outcome(outcome[end - 1]), stroke[first] == 1 and shot[first] < N_SERVES
        if serves and (np.diff(stroke[rows]) == 1).all() and ended in (Outcome.FAULT, Outcome.WINNER):
            winner = (server + len(rows) - (ended == Outcome.WINNER)) % 2
            before = [max(0, points[seat] - (known and seat == winner)) for seat in (0, 1)]
            games = [sum(ends[seat] > ends[1 - seat] for ends in finished) for seat in (0, 1)]
            score = Score(points=(before[0], before[1]), games=(games[0], games[1]), finished=finished, server=server)
            number = int(game[first]), int(rally[first])
            yield WholeRally(match=str(match[first]), number=number, players=seats, score=score, rows=rows, ended=ended)


def event(match: str, players: tuple[str, str]) -> str:
    """Name of a match without its players: ``KOREA OPEN 2019 Final`` of ``Kento_MOMOTA_CHOU_Tien_Chen_KOREA_OPEN_2019_Final``."""
    words, (one, other) = match.replace("_", " ").split(), tuple(map(_letters, players))
    ends = [k for k in range(2, len(words)) if _letters("".join(words[:k])) in (one + other, other + one)]
    return " ".join(words[ends[0] if ends else 0 :])


def _letters(text: str) -> str:
    return "".join(filter(str.isalnum, text.casefold()))


def nearest_stroke(game: Game, state: int, shot: int, technique: int, area: int | None, receiver: str = "right") -> int:
    """The legal stroke nearest to an annotated one: by shot type, then technique, then area.

    Args:
        area: as the receiver sees it; None: not known.
        receiver: hand of the receiver.
    """
    legal, catalogue = game.legal_strokes(state), game.catalogue
    distance = 1000.0 * (catalogue.shot[legal] != shot) + 10.0 * (catalogue.technique[legal] != technique)
    if area is not None:
        distance = distance + steps_between(catalogue.area[legal].astype(int), seen_by(receiver, area))
    return int(legal[int(distance.argmin())])


def copies(strokes: pa.Table) -> list[str]:
    """Sentences on pairs of games that share half of their strokes, at least 10, in rallies of the same strokes."""
    names = strokes["match"].combine_chunks().dictionary_encode()
    match, names, game = names.indices.to_numpy(), names.dictionary.to_pylist(), strokes["game"].to_numpy()
    codes = np.stack([strokes[name].fill_null(-1).to_numpy() for name in ("shot", "technique", "area")], axis=1).astype(np.int8)
    owner: dict[bytes, tuple[int, int]] = {}
    total, shared = collections.Counter[tuple[int, int]](), collections.Counter[tuple[tuple[int, int], tuple[int, int]]]()
    for begin, end in itertools.pairwise(rally_starts(strokes).tolist()):
        unit = int(match[begin]), int(game[begin])
        first = owner.setdefault(codes[begin:end].tobytes(), unit)
        total[unit] += end - begin
        shared[first, unit] += end - begin
    return [
        f"game {unit[1]} of {names[unit[0]]!r} has the strokes of game {first[1]} of {names[first[0]]!r}: are they one?"
        for (first, unit), count in shared.items()
        if first != unit and count >= max(10, 0.5 * min(total[first], total[unit]))
    ]


class TaggingError(ShuttleError):
    """Tagged strokes that cannot be continued."""


class TaggedStrokes:
    """The table of tagged strokes, with the journal of the inputs beside it.

    Args:
        out: the table, a CSV file; continued if its journal exists.

    Attributes:
        inputs: that hold; an input of None takes the last one back.
        rows: lines of the table.
        last: input, and the hash of the inputs before it.

    Raises:
        TaggingError: the table exists without a journal, or is no longer the one that was saved.
        RunError: the journal is damaged, or another process writes the table.
    """

    def __init__(self, out: Path, columns: Sequence[str]) -> None:
        if out.suffix.lower() != ".csv":
            raise TaggingError(f"--out {out}: expected a name that ends in .csv")
        journal = out.with_suffix(".inputs.jsonl")
        if out.exists() and not journal.exists():
            raise TaggingError(f"--out {out}: exists, without its inputs, {journal.name}; choose another name")
        for path in (out, journal):
            check_replaceable(path)
        out.parent.mkdir(parents=True, exist_ok=True)
        self.path, self._header, self._writer = out, ",".join(columns), contextlib.ExitStack()
        self._writer.enter_context(locked(out, out.with_suffix(".inputs.lock")))
        self._journal = Journal(journal, "enter the next input", f"move it away, and {out.name} too, and begin again")
        lines = self._journal.read()
        self._journal.keep(len(lines))  # without the half line of a process that was killed
        self.inputs: list[str] = []
        self.last: tuple[str | None, str] = "", ""
        for line in lines:
            if not isinstance(entered := line.get("input"), str | None):
                raise TaggingError(f"{journal}: {entered!r:.50} is no input; move it away, and {out.name} too, and begin again")
            self._enter(entered)
        self.rows = self._saved() if out.exists() else []

    def close(self) -> None:
        """Let other processes write the table."""
        self._writer.close()

    def enter(self, entered: str | None) -> None:
        """Keep an input; a RunError if the journal cannot be written."""
        self._journal.append([{"input": entered}])
        self._enter(entered)

    def replace(self, first: int, rows: Sequence[Mapping[str, Any]]) -> None:
        """Replace the rows from a number on; a FileWriteError if the table cannot be written."""
        if rows or first < len(self.rows):
            self.rows[first:] = map(_line, rows)
            replace_file(self.path, "\n".join((self._header, *self.rows, "")).encode())

    @property
    def hash(self) -> str:
        """What pages compare: they must show the same inputs, not only as many."""
        return content_hash(self.inputs)

    def _enter(self, entered: str | None) -> None:
        self.last = entered, self.hash
        if entered is not None:
            self.inputs.append(entered)
        elif self.inputs:
            self.inputs.pop()

    def _saved(self) -> list[str]:
        """Rows of the table, in which a spreadsheet may have corrected names."""
        try:
            header, *rows = read_file(self.path, files.MAX_LINES).decode("utf-8-sig").replace("\r\n", "\n").split("\n")
        except (OSError, UnicodeDecodeError):
            header, rows = "", []
        if header != self._header:
            told = "another program saved it with other columns, or not with commas and in UTF-8"
            raise TaggingError(f"--out {self.path}: {told}; save it so, or move it away: the inputs beside it write it again")
        return [row for row in rows if row]


def content_hash(inputs: Sequence[str]) -> str:
    """Hash of inputs."""
    return files.content_hash("\n".join(inputs).encode(errors="surrogatepass"))[:16]


def _line(row: Mapping[str, Any]) -> str:
    """A row of the table, with names for codes."""
    text = io.StringIO()
    values = (NAMES[name][value] if name in NAMES and isinstance(value, int) else value for name, value in row.items())
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()
