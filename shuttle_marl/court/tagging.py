"""Tagging: what a page of a video continues and saves, and what players probably play next.

The page holds the state; it follows from the inputs alone.
"""

import contextlib
import csv
import io
import json
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import MAX_LINES, check_replaceable, content_hash, read_file, replace_file
from shuttle_marl.base.runs import Journal, locked
from shuttle_marl.court import WatchError
from shuttle_marl.court.messages import LONGEST_NAME, NAME, SHOWN, Saved, Suggestion, TagFacts, TagRequest, TagRow, TagStroke
from shuttle_marl.court.values import arrivals
from shuttle_marl.data.matches import nearest_stroke
from shuttle_marl.data.schema import NAMES
from shuttle_marl.game.court import N_AREAS, Hands, mirrored
from shuttle_marl.game.policy import Policy, States, checked_probabilities
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import ROOT, Game

_MOST_STATES: Final = 16  # states of the game that are followed through a rally


class TagFile:
    """The tagged strokes of a video: a table, with the journal of the inputs beside it; ``out``: the table, a CSV file; continued
    if its journal exists; ``rules``: of the match (None: those of the journal, or else of the sport). Raises WatchError: the
    video does not exist, or the match was begun by other rules; or the table exists without a journal, is no longer the one that
    was saved, or is of another film. Raises RunError: the journal is damaged, or another process writes the table."""

    def __init__(self, video: Path, out: Path, rules: RulesName | None = None) -> None:
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
        self.video, self._out, self._rules = video, out, rules or "21"
        self._lock, self._writer = threading.Lock(), contextlib.ExitStack()
        self._writer.enter_context(locked(out, out.with_suffix(".inputs.lock")))
        self._inputs: list[str] = []  # that hold
        self._last: tuple[str | None, str] = "", ""  # input, and the hash of the inputs before it
        restore = f"move it away, and {out.name} too, and begin again"
        self._journal = Journal(journal, "enter the next input", restore)
        lines = self._journal.read()
        self._journal.keep(len(lines))  # without the half line of a process that was killed
        self._film: dict[str, Any] = {"film": video.name, "bytes": video.stat().st_size}  # in front of the first input
        if lines and "bytes" in lines[0] and lines[0]["bytes"] != self._film["bytes"]:
            told = f"{lines[0].get('film')!r:.100} of {lines[0]['bytes']!r:.20} bytes, not of {video} of {self._film['bytes']:,}"
            raise WatchError(f"--out {out}: holds the strokes of the film {told}; choose another --out for it")
        for line in lines:
            if "bytes" in line:
                self._film = {}
            elif not isinstance(entered := line.get("input"), str | None):
                raise WatchError(f"{journal}: {entered!r:.50} is no input; {restore}")
            else:
                self._enter(entered)
        self._rows = self._saved() if out.exists() else []
        begun = rules
        with contextlib.suppress(IndexError, KeyError, TypeError, ValueError):  # the first input is the setup
            begun = json.loads(self._inputs[0])["rules"]
        if rules not in (None, begun):
            self.close()
            raise WatchError(f"--rules {rules}: {out} was begun by the rules {begun!s:.20}; continue it without --rules")

    def close(self) -> None:
        """Let other processes write the table."""
        self._writer.close()

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
                rules=self._rules,
            )

    def save(self, request: TagRequest) -> Saved:
        """Keep an input and the rows that it changed. Raises WatchError: it does not continue what is saved. Raises RunError,
        FileWriteError: a file cannot be written."""
        with self._lock:
            now, told = _hash(self._inputs), SHOWN.get([])
            after = request.after or (told[0] if told else _hash(self._inputs[: request.at]))
            # A page repeats what was not answered.
            repeated = not request.only_rows and (request.input, after) == self._last and after != now
            if not (repeated or after == now) or request.first > len(self._rows):
                raise WatchError("another page has changed the strokes; load this page again")
            if not repeated and not request.only_rows:
                self._journal.append([*([self._film] if self._film else []), {"input": request.input}])
                self._film = {}
                self._enter(request.input)
            if request.rows or request.first < len(self._rows):
                self._rows[request.first :] = map(_line, request.rows)
                replace_file(self._out, "\n".join((_HEADER, *self._rows, "")).encode())
            return Saved(inputs=len(self._inputs), rows=len(self._rows), after=self._shown())

    def _enter(self, entered: str | None) -> None:
        self._last = entered, _hash(self._inputs)
        if entered is not None:
            self._inputs.append(entered)
        elif self._inputs:
            self._inputs.pop()

    def _shown(self) -> str:
        """The hash of the inputs, which the connection keeps."""
        now = _hash(self._inputs)
        with contextlib.suppress(LookupError):
            SHOWN.get()[:] = [now]
        return now

    def _saved(self) -> list[str]:
        """Rows of the table, in which a spreadsheet may have corrected names."""
        try:
            header, *rows = read_file(self._out, MAX_LINES).decode("utf-8-sig").replace("\r\n", "\n").split("\n")
        except (OSError, UnicodeDecodeError):
            header, rows = "", []
        if header != _HEADER:
            told = "another program saved it with other columns, or not with commas and in UTF-8"
            raise WatchError(f"--out {self._out}: {told}; save it so, or move it away: the inputs beside it write it again")
        return [row for row in rows if row]


_HEADER: Final = ",".join(TagRow.__struct_fields__)


def _hash(inputs: Sequence[str]) -> str:
    """Pages that show the same inputs have the same hash."""
    return content_hash("\n".join(inputs).encode(errors="surrogatepass"))[:16]


def _line(row: TagRow) -> str:
    text, fields = io.StringIO(), msgspec.structs.asdict(row).items()
    values = (NAMES[name][value] if name in NAMES and isinstance(value, int) else value for name, value in fields)
    csv.writer(text, lineterminator="").writerow("" if value is None else value for value in values)
    return text.getvalue()


def suggestions(game: Game, policy: Policy, line: Sequence[TagStroke], receivers: Hands = ("right", "right")) -> list[Suggestion]:
    """Shot types with which a policy continues a rally, the most probable first, with ways of playing them and targets. Who was
    hurried is not known, and the height of the next contact neither: their probabilities weight the states. Each stroke of the
    line stands for the nearest legal one; ``receivers``: hands of who receives the serve, and of the server."""
    states = {ROOT: 1.0}
    for i, stroke in enumerate(line):
        met = {state: w for state, w in states.items() if int(game.contact(state)) == stroke.height} or states
        pairs: dict[int, float] = {}
        for state, weight in met.items():
            nearest = nearest_stroke(game, state, stroke.shot, stroke.technique, stroke.area, receivers[i % 2])
            pairs[int(game.pair(state, nearest))] = weight
        following = arrivals(pairs, game)
        states = dict(sorted(following.items(), key=lambda item: -item[1])[:_MOST_STATES])
        total = sum(states.values()) or 1.0
        states = {state: mass / total for state, mass in states.items()}
    asked = States(game=game, state=np.array(list(states), np.int32))
    share = np.array(list(states.values())) @ checked_probabilities(policy, asked)
    table = np.zeros((len(SHOTS), len(TECHNIQUES) * len(HEIGHTS)))
    np.add.at(table, (game.catalogue.shot, game.catalogue.technique * len(HEIGHTS) + game.catalogue.height), share)
    probability, ways = table.sum(axis=1), np.argsort(-table, axis=1, kind="stable")
    targets, area = np.zeros((len(SHOTS), N_AREAS)), game.catalogue.area
    np.add.at(targets, (game.catalogue.shot, mirrored(area) if receivers[len(line) % 2] == "left" else area), share)
    targets /= np.maximum(probability, np.finfo(float).tiny)[:, None]
    return [
        Suggestion(
            shot=shot, probability=float(probability[shot]), ways=ways[shot].tolist(), areas=targets[shot].round(5).tolist()
        )
        for shot in np.argsort(-probability, kind="stable").tolist()
    ]
