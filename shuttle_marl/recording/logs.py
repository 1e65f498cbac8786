"""Logs of rallies for learning from data: strokes of a behaviour policy against a fixed opponent.

Methods see the rules of the game (states, legal strokes, what follows a return) and no probabilities: :func:`blank` replaces
those.
"""

import dataclasses
import functools
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F32, I8, I32, I64, Bools
from shuttle_marl.base.files import content_hash
from shuttle_marl.game.draws import HURRY_ONE, ONE
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import play_rallies

_MARGIN: Final = 1.1
_STROKES: Final = 2.0
"""Initial guess of the strokes of one player in a rally."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """Strokes of both players, rally after rally; the learner's seat is 0.

    Attributes:
        game: the rules, with the probabilities of :func:`blank`.
        state: ``[N]`` state in which each stroke was struck.
        pair: ``[N]`` legal pair of the state and the stroke.
        stroke: ``[N]`` catalogue index.
        own: ``[N]`` whether the behaviour policy struck; else the opponent.
        outcome: ``[N]`` index into :data:`shuttle_marl.game.rules.OUTCOMES`.
        probability: ``[N]`` of the stroke under the behaviour policy; NaN for strokes of the opponent.
        rally: ``[N]`` number of the rally, from 0.
        won: ``[R]`` whether the behaviour policy won the rally.
    """

    game: Game
    state: I32
    pair: I64
    stroke: I32
    own: Bools
    outcome: I8
    probability: F32
    rally: I32
    won: Bools

    def __len__(self) -> int:
        return len(self.state)

    @functools.cached_property
    def hash(self) -> str:
        """SHA-256 of the columns, hexadecimal."""
        columns = (self.state, self.stroke, self.own, self.outcome, self.rally, self.won)
        return content_hash(*(column.tobytes() for column in columns))

    @functools.cached_property
    def transitions(self) -> "Transitions":
        """The single-agent view: the opponent is part of the environment."""
        rows = np.flatnonzero(self.own)
        rally = self.rally[rows]
        last = np.append(rally[1:] != rally[:-1], True)
        won = self.won[rally]
        return Transitions(
            game=self.game,
            state=self.state[rows],
            pair=self.pair[rows],
            stroke=self.stroke[rows],
            probability=self.probability[rows],
            reward=np.where(last, won, False).astype(np.float32),
            following=np.where(last, -1, np.append(self.state[rows][1:], -1)).astype(np.int32),
            rally=rally,
            won=won,
            n_rallies=len(self.won),
            idle_wins=int(self.won.sum() - won[last].sum()),
        )

    def table(self) -> pa.Table:
        """The columns as a table with names of strokes and outcomes, for Parquet."""
        names = self.game.catalogue.names
        strokes = pa.DictionaryArray.from_arrays(pa.array(self.stroke), pa.array(names))
        own_last, incoming = (
            pa.DictionaryArray.from_arrays(pa.array(column), pa.array([*names, "none"]))
            for column in (self.game.own(self.state), self.game.incoming(self.state))
        )
        return pa.table({
            "rally": self.rally,
            "own": self.own,
            "state": self.state,
            "own_last": own_last,
            "incoming": incoming,
            "contact": self.game.contact(self.state).astype(np.int8),
            "hurried": self.game.hurried(self.state).astype(np.bool_),
            "stroke": strokes,
            "outcome": self.outcome,
            "probability": self.probability,
            "won": self.won[self.rally],
        })  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Transitions:
    """Strokes of the behaviour policy alone: (state, stroke, reward, next own state).

    Attributes:
        game: the rules, with the probabilities of :func:`blank`.
        state, pair, stroke, probability: ``[M]`` as in :class:`Log`.
        reward: ``[M]`` 1 if the rally was won and this was its last own stroke, else 0.
        following: ``[M]`` next own state in the rally; -1: none.
        rally: ``[M]`` number of the rally.
        won: ``[M]`` whether the rally was won.
        n_rallies: number of rallies, including those that ended before the first own stroke.
        idle_wins: how many of those were won.
    """

    game: Game
    state: I32
    pair: I64
    stroke: I32
    probability: F32
    reward: F32
    following: I32
    rally: I32
    won: Bools
    n_rallies: int
    idle_wins: int

    def __len__(self) -> int:
        return len(self.state)

    @functools.cached_property
    def first(self) -> Bools:
        """``[M]`` whether the stroke is the first own one of its rally."""
        return np.append(True, self.rally[1:] != self.rally[:-1])[: len(self)]


@functools.lru_cache(maxsize=4)
def blank(game: Game) -> Game:
    """The rules of a game: the same states and strokes, equally likely ends of strokes, and every second receiver hurried."""
    threshold = np.tile(np.array([1, 2, 3], dtype=np.uint16) * np.uint16(ONE // 4), (game.n_base_pairs, 1))
    hurry = np.full_like(game.hurry, HURRY_ONE // 2)
    return dataclasses.replace(game, threshold=threshold, hurry=hurry, fault_odds=np.full(game.levels, ONE, dtype=np.int32))


def play_log(players: tuple[TabulatedPolicy, TabulatedPolicy], strokes: int, seed: int) -> Log:
    """The log of a behaviour policy at seat 0 against an opponent.

    Args:
        players: behaviour policy and opponent, of one game.
        strokes: number of strokes of the behaviour policy; the log ends with the rally in which it is reached.
    """
    game, rallies = players[0].game, int(strokes / _STROKES) + 10
    while True:
        played = play_rallies(game, players, rallies, seed=seed)
        reached = np.cumsum(np.bincount(played.row_of_stroke[played.striker == 0], minlength=len(played)))
        if reached[-1] >= strokes:
            return log_of(game, played.slice(0, int(np.searchsorted(reached, strokes)) + 1), players[0])
        rallies = int(rallies * max(_MARGIN, _MARGIN * strokes / reached[-1]))


def log_of(game: Game, rallies: Rallies, player: TabulatedPolicy) -> Log:
    """The log of rallies in which ``player`` is at seat 0."""
    state, stroke = rallies.states(game), rallies.stroke.astype(np.int32)
    pair = game.pair(state, stroke).astype(np.int64)
    own = rallies.striker == 0
    probability = np.full(len(state), np.nan, dtype=np.float32)
    probability[own] = player.probability_of(pair[own])
    return Log(
        game=blank(game),
        state=state,
        pair=pair,
        stroke=stroke,
        own=own,
        outcome=rallies.outcome(game.catalogue),
        probability=probability,
        rally=rallies.row_of_stroke.astype(np.int32),
        won=rallies.winner == 0,
    )
