"""Tagging: what a page of a video continues and saves (:mod:`shuttle_marl.data.matches`), and what players probably play next.

The page holds the state; it follows from the inputs alone.
"""

import contextlib
import json
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from shuttle_marl.base.errors import printable
from shuttle_marl.court import WatchError
from shuttle_marl.court.messages import LONGEST_NAME, NAME, SHOWN, Saved, Suggestion, TagFacts, TagRequest, TagRow, TagStroke
from shuttle_marl.court.values import arrivals
from shuttle_marl.data.matches import TaggedStrokes, content_hash, nearest_stroke
from shuttle_marl.game.court import N_AREAS, Hands, mirrored
from shuttle_marl.game.policy import Policy, States, checked_probabilities
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.stroke import HEIGHTS, SHOTS, TECHNIQUES
from shuttle_marl.game.tables import ROOT, Game

_MOST_STATES: Final = 16
"""States of the game that are followed through a rally."""


class TagFile:
    """The tagged strokes of a video, as its page continues them.

    Args:
        out: the table, a CSV file; continued if its journal exists.
        rules: of the match; None: those of the journal, or else of the sport.

    Raises:
        WatchError: the video does not exist, or the match was begun by other rules.
        TaggingError, RunError: as :class:`~shuttle_marl.data.matches.TaggedStrokes`.
    """

    def __init__(self, video: Path, out: Path, rules: RulesName | None = None) -> None:
        if not video.is_file():
            raise WatchError(f"--tag {video}: no such file; expected a video that the browser plays, such as .mp4 or .webm")
        self.video, self._lock = video, threading.Lock()
        self._strokes, self._rules = TaggedStrokes(out, TagRow.__struct_fields__, video), rules or "21"
        begun = rules
        with contextlib.suppress(IndexError, KeyError, TypeError, ValueError):  # the first input is the setup
            begun = json.loads(self._strokes.inputs[0])["rules"]
        if rules not in (None, begun):
            self.close()
            raise WatchError(f"--rules {rules}: {out} was begun by the rules {begun!s:.20}; continue it without --rules")

    def close(self) -> None:
        """Let other processes write the table."""
        self._strokes.close()

    def facts(self) -> TagFacts:
        """What a page needs to continue."""
        with self._lock:
            return TagFacts(
                video=printable(self.video.name),
                out=printable(self._strokes.path.name),
                inputs=[*self._strokes.inputs],
                rows=len(self._strokes.rows),
                after=self._shown(),
                name=NAME,
                longest_name=LONGEST_NAME,
                rules=self._rules,
            )

    def save(self, request: TagRequest) -> Saved:
        """Keep an input and the rows that it changed.

        Raises:
            WatchError: it does not continue what is saved.
            RunError, FileWriteError: a file cannot be written.
        """
        strokes = self._strokes
        with self._lock:
            now, told = strokes.hash, SHOWN.get([])
            after = request.after or (told[0] if told else content_hash(strokes.inputs[: request.at]))
            # A page repeats what was not answered.
            repeated = not request.only_rows and (request.input, after) == strokes.last and after != now
            if not (repeated or after == now) or request.first > len(strokes.rows):
                raise WatchError("another page has changed the strokes; load this page again")
            if not repeated and not request.only_rows:
                strokes.enter(request.input)
            strokes.replace_from(request.first, [msgspec.structs.asdict(row) for row in request.rows])
            return Saved(inputs=len(strokes.inputs), rows=len(strokes.rows), after=self._shown())

    def _shown(self) -> str:
        """The hash of the inputs, which the connection keeps."""
        now = self._strokes.hash
        with contextlib.suppress(LookupError):
            SHOWN.get()[:] = [now]
        return now


def suggestions(game: Game, policy: Policy, line: Sequence[TagStroke], receivers: Hands = ("right", "right")) -> list[Suggestion]:
    """Shot types with which a policy continues a rally, the most probable first, with ways of playing them and targets.

    Who was hurried is not known, and the height of the next contact neither: their probabilities weight the states. Each stroke
    of the line stands for the nearest legal one; ``receivers``: hands of who receives the serve, and of the server.
    """
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
