"""Tagging: strokes that a person enters beside a video, what they are saved in, and what players probably play next.

The page holds the state; it follows from the inputs alone. A journal keeps each input, so tagging continues where it stopped, and
the strokes are a table that ``data import`` and the reports read.
"""

import contextlib
import csv
import io
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from shuttle_marl.base import files
from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import check_replaceable, read_file, replace_file
from shuttle_marl.base.runs import Journal, locked
from shuttle_marl.game.court import AREAS, Hands
from shuttle_marl.game.policy import Policy, States, checked_probabilities
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.watch import WatchError
from shuttle_marl.watch.messages import LONGEST_NAME, NAME, SHOWN, Saved, Suggestion, TagFacts, TagRequest, TagRow, TagStroke
from shuttle_marl.watch.recorded import nearest_stroke

_MOST_STATES: Final = 16
"""States of the game that are followed through a rally."""


_HEADER: Final = ",".join(TagRow.__struct_fields__)


class TagFile:
    """The table of the strokes of a video, with the journal of the inputs beside it.

    Args:
        out: the table, a CSV file; continued if its journal exists.

    Raises:
        WatchError: the video does not exist, or the table exists without a journal, or is no longer the one that was saved.
        RunError: the journal is damaged, or another process writes the table.
    """

    def __init__(self, video: Path, out: Path) -> None:
        if not video.is_file():
            raise WatchError(f"--tag {video}: no such file; expected a video that the browser plays, such as .mp4 or .webm")
        if out.suffix.lower() != ".csv":
            raise WatchError(f"--out {out}: expected a name that ends in .csv")
        journal = out.with_suffix(".inputs.jsonl")
        if out.exists() and not journal.exists():
            raise WatchError(f"--out {out}: exists, without its inputs, {journal.name}; choose another name")
        for path in (out, journal):
            check_replaceable(path)
        out.parent.mkdir(parents=True, exist_ok=True)
        self.video, self._out, self._lock = video, out, threading.Lock()
        self._writer = contextlib.ExitStack()
        self._writer.enter_context(locked(out, out.with_suffix(".inputs.lock")))
        self._journal = Journal(journal, "enter the next input", f"move it away, and {out.name} too, and begin again")
        lines = self._journal.read()
        self._journal.keep(len(lines))  # without the half line of a process that was killed
        self._inputs: list[str] = []
        self._before = ""
        self._last: str | None = ""
        for line in lines:
            if not isinstance(entered := line.get("input"), str | None):
                raise WatchError(f"{journal}: {entered!r:.50} is no input; move it away, and {out.name} too, and begin again")
            self._enter(entered)
        self._rows = _rows_of(out) if out.exists() else []

    def close(self) -> None:
        """Let other processes write the table."""
        self._writer.close()

    def _enter(self, entered: str | None) -> None:
        self._before, self._last = content_hash(self._inputs), entered
        if entered is not None:
            self._inputs.append(entered)
        elif self._inputs:
            self._inputs.pop()

    def facts(self) -> TagFacts:
        """What a page needs to continue."""
        with self._lock:
            return TagFacts(
                video=printable(self.video.name),
                out=printable(self._out.name),
                inputs=[*self._inputs],
                rows=len(self._rows),
                after=self._shown(),
                name=NAME,
                longest_name=LONGEST_NAME,
            )

    def save(self, request: TagRequest) -> Saved:
        """Keep an input and the rows that it changed.

        Raises:
            WatchError: it does not continue what is saved.
            RunError, FileWriteError: a file cannot be written.
        """
        with self._lock:
            now, told = content_hash(self._inputs), SHOWN.get([])
            after = request.after or (told[0] if told else content_hash(self._inputs[: request.at]))
            # A page repeats what was not answered.
            repeated = not request.only_rows and (after, request.input) == (self._before, self._last) and after != now
            if not (repeated or after == now) or request.first > len(self._rows):
                raise WatchError("another page has changed the strokes; load this page again")
            if not repeated and not request.only_rows:
                self._journal.append([{"input": request.input}])
                self._enter(request.input)
            if request.rows or request.first < len(self._rows):
                self._rows[request.first :] = map(_line, request.rows)
                replace_file(self._out, "\n".join((_HEADER, *self._rows, "")).encode())
            return Saved(inputs=len(self._inputs), rows=len(self._rows), after=self._shown())

    def _shown(self) -> str:
        """The hash of the inputs, which the connection keeps."""
        now = content_hash(self._inputs)
        with contextlib.suppress(LookupError):
            SHOWN.get()[:] = [now]
        return now


def content_hash(inputs: Sequence[str]) -> str:
    """What pages compare: they must show the same inputs, not only as many."""
    return files.content_hash("\n".join(inputs).encode(errors="surrogatepass"))[:16]


def _rows_of(out: Path) -> list[str]:
    """Rows of the table, in which a spreadsheet may have corrected names."""
    try:
        header, *rows = read_file(out, files.MAX_LINES).decode("utf-8-sig").replace("\r\n", "\n").split("\n")
    except (OSError, UnicodeDecodeError):
        header, rows = "", []
    if header != _HEADER:
        raise WatchError(
            f"--out {out}: another program saved it with other columns, or not with commas and in UTF-8; save it so, or move it "
            "away: the inputs beside it write it again"
        )
    return [row for row in rows if row]


def _line(row: TagRow) -> str:
    named = {"shot": SHOTS, "technique": TECHNIQUES, "height": HEIGHTS, "area": AREAS}
    values = msgspec.structs.asdict(row)
    values |= {name: words[values[name]] for name, words in named.items() if values[name] is not None}
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values.values())
    return text.getvalue()


def suggestions(game: Game, policy: Policy, line: Sequence[TagStroke], receivers: Hands = ("right", "right")) -> list[Suggestion]:
    """Shot types with which a policy continues a rally, and the ways of playing each, the most probable first.

    Who was hurried is not known, and the height of the next contact neither: their probabilities weight the states.

    Args:
        line: strokes so far, all returned; each stands for the nearest legal one.
        receivers: hands of who receives the serve, and of the server.
    """
    states = {ROOT: 1.0}
    for i, stroke in enumerate(line):
        met = {state: w for state, w in states.items() if int(game.contact(state)) == stroke.height} or states
        following: dict[int, float] = {}
        for state, weight in met.items():
            nearest = nearest_stroke(game, state, stroke.shot, stroke.technique, stroke.area, receivers[i % 2])
            pair = np.array([int(game.pair(state, nearest))])
            returned = weight * game.outcome_probabilities(pair)[0, RETURNED_BELOW:]
            for arrival, mass in zip(game.arrivals(pair)[0].tolist(), returned.tolist(), strict=True):
                following[arrival] = following.get(arrival, 0.0) + mass
        states = dict(sorted(following.items(), key=lambda item: -item[1])[:_MOST_STATES])
        total = sum(states.values()) or 1.0
        states = {state: mass / total for state, mass in states.items()}
    asked = States(game=game, state=np.array(list(states), np.int32))
    share = np.array(list(states.values())) @ checked_probabilities(policy, asked)
    table = np.zeros((len(SHOTS), len(TECHNIQUES) * len(HEIGHTS)))
    np.add.at(table, (game.catalogue.shot, game.catalogue.technique * len(HEIGHTS) + game.catalogue.height), share)
    probability, ways = table.sum(axis=1), np.argsort(-table, axis=1, kind="stable")
    return [
        Suggestion(shot=shot, probability=float(probability[shot]), ways=ways[shot].tolist())
        for shot in np.argsort(-probability, kind="stable").tolist()
    ]
