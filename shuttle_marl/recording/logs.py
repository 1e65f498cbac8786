"""Logs of rallies for learning from data, also as Minari data sets: a behaviour policy against a fixed opponent.

Methods see the rules of the game and no probabilities: :func:`blank` replaces those.
"""

import dataclasses
import functools
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final
from unittest import mock

import gymnasium
import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F32, I8, I32, I64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.extras import install_hint
from shuttle_marl.base.files import content_hash
from shuttle_marl.game.draws import HURRY_ONE, ONE
from shuttle_marl.game.layout import observations
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import play_rallies

_MARGIN: Final = 1.1
_STROKES: Final = 2.0  # initial guess of the strokes of one player in a rally


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """Strokes of both players, rally after rally; the learner's seat is 0."""

    game: Game  # the rules, with the probabilities of `blank`
    state: I32  # [N] state in which each stroke was struck
    pair: I64  # [N] legal pair of the state and the stroke
    stroke: I32  # [N] catalogue index
    own: Bools  # [N] whether the behaviour policy struck; else the opponent
    outcome: I8  # [N] index into `OUTCOMES`
    probability: F32  # [N] of the stroke under the behaviour policy; NaN for strokes of the opponent
    rally: I32  # [N] number of the rally, from 0
    waited: I8  # [N] where the receiver waited; the middle without recovery
    won: Bools  # [R] whether the behaviour policy won the rally

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
            **{name: getattr(self, name)[rows] for name in ("state", "pair", "stroke", "probability")},
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
        state, pair, stroke, probability: ``[M]`` as in :class:`Log`.
    """

    game: Game  # the rules, with the probabilities of `blank`
    state: I32
    pair: I64
    stroke: I32
    probability: F32
    reward: F32  # [M] 1 if the rally was won and this was its last own stroke, else 0
    following: I32  # [M] next own state in the rally; -1: none
    rally: I32  # [M] number of the rally
    won: Bools  # [M] whether the rally was won
    n_rallies: int  # number of rallies, including those that ended before the first own stroke
    idle_wins: int  # how many of those were won

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
        waited=rallies.places,
        won=rallies.winner == 0,
    )


def write_minari(data: Transitions, name: str, folder: Path, model: str, opponent: str) -> None:
    """Write a Minari data set: the single-agent view, one episode for each rally with an own stroke.

    Observations are those of ``shuttle_marl/Rally-v0``, with the mask of legal strokes; the one after the last stroke is zero,
    because the rally is over. A reward is 1 for the last own stroke of a rally that was won. Infos hold the state of the game and
    the probability of the stroke under the behaviour policy.

    Args:
        name: id of the data set, such as ``shuttle_marl/offline-bc-v0``.
        folder: of the data sets, as in the environment variable ``MINARI_DATASETS_PATH``.
        model, opponent: names of the game and of the opponent, for the environment of the data set.

    Raises:
        ShuttleError: Minari is not installed, or the data set exists.
    """
    try:
        import minari  # noqa: PLC0415  an extra
    except ModuleNotFoundError as error:
        raise ShuttleError(f"Minari is not installed; {install_hint('minari')}") from error
    env = gymnasium.make("shuttle_marl:shuttle_marl/Rally-v0", opponent=opponent, game=model)
    with warnings.catch_warnings(), mock.patch.dict(os.environ, {"MINARI_DATASETS_PATH": str(folder.resolve())}):
        warnings.simplefilter("ignore", UserWarning)  # optional metadata are missing
        try:
            minari.create_dataset_from_buffers(name, list(_episodes(data)), env=env)
        except ValueError as error:
            raise ShuttleError(f"{folder}: {error}") from error


def _episodes(data: Transitions) -> Iterator[Any]:
    from minari.data_collector import EpisodeBuffer  # noqa: PLC0415  an extra

    seen, mask = observations(data.game, data.state), data.game.mask(data.state).astype(np.int8)
    for rows in np.split(np.arange(len(data)), np.flatnonzero(data.first)[1:]):
        last = rows == rows[-1]
        yield EpisodeBuffer(
            observations={
                "observation": np.pad(seen[rows], ((0, 1), (0, 0))),
                "action_mask": np.pad(mask[rows], ((0, 1), (0, 0))),
            },
            actions=data.stroke[rows].astype(np.int64),
            rewards=data.reward[rows],
            terminations=last,
            truncations=np.zeros_like(last),
            infos={
                "state": np.append(data.state[rows], -1)[:, None],
                "probability": np.append(data.probability[rows], np.float32(np.nan))[:, None],
            },
        )
