"""The task ``text-v0``: positions in words, one stroke as the answer; for language models, programs and policies.

A position is a JSON object with the keys ``id``, ``text``, ``legal`` (names of the legal strokes) and ``observation`` (numbers
of the state). An answer is the name of a stroke. Values are those of perfect play.
"""

import functools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.files import content_hash
from shuttle_marl.base.programs import Program
from shuttle_marl.env.words import Position, position
from shuttle_marl.exact import solve, visits
from shuttle_marl.exact.lists import cells_of, list_policy, mean_losses
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.value import Value
from shuttle_marl.suite.frontier import POINTS
from shuttle_marl.suite.method import Method, called, made
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.task import Arena, Case, Outcome, Setting, Task

POSITIONS: Final = 500
_QUICK: Final = 20
_CANDIDATES: Final = 40_000
"""Commonest states of bc from which positions are chosen."""
SECONDS: Final = 120.0
"""Time limit of programs for an answer [s]."""
_HARD: Final = 0.02
"""Loss of both constant lists in a position, as a probability of winning the rally."""


class TextSetting(Setting):
    """Setting of ``text``, the argument of a method; policies use its tables, and language models do without."""

    def program(self, name: str) -> "LineProgram":
        """``program:COMMAND``, which answers positions in lines of JSON."""
        return LineProgram(name.partition(":")[2])


class Text(Task):
    """Choose a stroke in 500 positions that are described in words.

    Given: positions in which constant lists of strokes lose, with the legal strokes. Score: mean regret of the answers, the
    rallies that they lose against perfect play, in points; an illegal answer counts as the worst legal stroke. Also the fraction
    of legal answers, and the mean probability with which bc plays them. One list of strokes does well: an entrance.
    """

    name = "text-v0"
    access = "samples"
    roles = ()
    answers = ("strokes",)
    metric = "regret"
    zero = "perfect play"
    entrance = True
    higher_is_better = False
    optimum = 0.0
    seeds = 1
    variants: ClassVar[Mapping[str, str]] = {"dev": "women"}
    protocol = "method(setting: TextSetting) -> object with answer(position: dict) -> name of a stroke"

    def all_cases(self, arena: Arena) -> list[Case]:
        """One; that of a quick run has fewer positions, so it is another case."""
        return [Case(name=f"positions/{_QUICK}" if arena.quick else "positions")]

    def play(self, arena: Arena, case: Case, method: Method, seed: int, folder: Path) -> Outcome:  # noqa: ARG002
        """Ask for one answer in each position."""
        player = made(method, TextSetting(game=arena.game, model=arena.model, seed=seed, folder=folder), self.name, "answer")
        answers = [called(self.name, player.answer, position) for position in positions(arena)]
        # No name of a stroke is so long.
        return Outcome(answers={"strokes": [answer[:100] if isinstance(answer, str) else None for answer in answers]})

    def given(self, arena: Arena, case: Case, seed: int) -> Iterable[str]:  # noqa: ARG002
        """The positions."""
        return (content_hash(json_lines(positions(arena))),)

    def score(self, arena: Arena, case: Case, seed: int, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Regret, fraction of legal answers, and probability under bc."""
        pair = _answered(arena, outcome)
        legal, likeness = pair >= 0, np.zeros(len(pair))
        likeness[legal] = arena.policy("bc").probability_of(pair[legal])
        regret = np.mean(list(self.parts(arena, case, outcome).values()))
        return {"regret": float(regret), "legal": float(legal.mean()), "likeness": float(likeness.mean())}

    def parts(self, arena: Arena, case: Case, outcome: Outcome) -> dict[str, float]:  # noqa: ARG002
        """Regret in each position."""
        regret, of_state = regrets(arena.game), arena.game.pairs_of
        answered = zip(chosen_states(arena).tolist(), _answered(arena, outcome).tolist(), strict=True)
        lost = [regret[pair] if pair >= 0 else regret[of_state(state)].max() for state, pair in answered]
        return {str(number): POINTS * float(each) for number, each in enumerate(lost)}


def _answered(arena: Arena, outcome: Outcome) -> I64:
    """Legal pair of each answer; -1: not a legal stroke."""
    game, states, names = arena.game, chosen_states(arena), list(arena.game.catalogue.names)
    answers = outcome.answers.get("strokes")
    if not isinstance(answers, list) or len(answers) != len(states):
        raise SuiteError(f"expected {len(states)} answers")
    named = zip(states.tolist(), answers, strict=True)
    return np.array([int(game.pair(state, names.index(name))) if name in names else -1 for state, name in named])


@functools.lru_cache(maxsize=2)
def regrets(game: Game) -> F64:
    """``[P]`` probability of winning the rally that each legal stroke loses against the best one, under perfect play."""
    solution = solve(game)
    win = Value(game, solution.value, opponent=solution.policy[1]).win()
    best = np.zeros(game.n_states)
    best[game.playable] = np.maximum.reduceat(win, game.first_pairs)
    return np.asarray(game.of_pairs(best) - win)


@functools.lru_cache(maxsize=2)
def chosen_states(arena: Arena) -> I64:
    """States of the positions: hard for both constant lists, an equal number after each incoming shot type if possible."""
    game, bc = arena.game, arena.policy("bc")
    weight, value = visits(bc, bc, tolerance=1e-6).states[0], solve(game).value[1]
    common = np.argsort(-weight, kind="stable")[:_CANDIDATES]
    common = common[weight[common] > 0]
    regret, hard = regrets(game), np.ones(len(common), dtype=bool)
    for cell in (cells_of(game), cells_of(game, "incoming_shot", "contact")):
        listed = list_policy(game, cell, mean_losses(game, cell, value, weight))
        row, pair = game.pairs(common)
        hard &= np.bincount(row, listed.probability_of(pair) * regret[pair]) > _HARD
    found = common[hard]
    if not len(found):
        raise SuiteError("text-v0: constant lists are almost optimal in all common states of this game")
    shot = game.incoming_shot(found)
    # The k-th commonest state of every shot type comes before the next ones of any.
    place = np.zeros(len(found), dtype=np.int64)
    for each in np.unique(shot):
        place[shot == each] = np.arange((shot == each).sum())
    return np.asarray(found[np.argsort(place, kind="stable")][: _QUICK if arena.quick else POSITIONS], dtype=np.int64)


def positions(arena: Arena) -> list[Position]:
    """The positions of the split, see the description of this module."""
    return [position(arena.game, state, number) for number, state in enumerate(chosen_states(arena).tolist())]


class LineProgram:
    """A program that reads each position as a line of JSON and answers with one line, the name of a stroke.

    Args:
        command: program and arguments in shell syntax; no shell is started.
    """

    def __init__(self, command: str) -> None:
        self._program = Program(command, SECONDS)

    def answer(self, place: Position) -> str:
        """Its answer."""
        self._program.write(json_lines([place]))
        line = self._program.read_line().decode(errors="replace").strip()
        try:
            return str(json.loads(line)["stroke"])  # as programs answer in other tasks
        except (ValueError, TypeError, KeyError):
            return line


def json_lines(places: Sequence[Position]) -> bytes:
    """Positions as a file of JSON lines."""
    return b"".join(json.dumps(place).encode() + b"\n" for place in places)
