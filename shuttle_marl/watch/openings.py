"""Openings: the strokes that follow the first strokes of a rally, with their values."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from shuttle_marl.base.arrays import F64, I32
from shuttle_marl.exact import Solution
from shuttle_marl.game.rules import RETURNED_BELOW, IllegalStrokeError
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.reports.rally import Players, decision


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Opening:
    """The K strokes that are possible after a line of strokes from the serve, the most frequent first; seat 0 serves.

    A stroke reaches the receiver below or above the net at random, and hurries them at random. A stroke that is legal in several
    of these states has the mean of its values, weighted by the probabilities of the states.

    Attributes:
        line: catalogue indices of the strokes so far.
        stroke: ``[K]`` catalogue indices.
        available: ``[K]`` probability that the stroke is legal, given that the line was played.
        share: ``[K]`` probability with which the striker's policy chooses the stroke, given that the line was played.
        p_succ: ``[K]`` probability that the stroke is good.
        p_ret: ``[K]`` probability that the opponent returns a good one.
        support: ``[K]`` number of real strokes behind these two, the smaller of both contacts; NaN if unknown.
        win: ``[K]`` probability that the striker wins the rally with the stroke, under both policies from then on.
        optimal: ``[K]`` the same if both play perfectly from then on.
    """

    line: tuple[int, ...]
    seat: int
    stroke: I32
    available: F64
    share: F64
    p_succ: F64
    p_ret: F64
    support: F64
    win: F64
    optimal: F64


def opening(game: Game, line: Sequence[int], players: Players, solution: Solution) -> Opening:
    """The strokes after a line.

    Args:
        game: tables of the game, or the game of a pair.
        line: catalogue indices of the first strokes of a rally, all of them returned.
        players: policies of both seats and their values.

    Raises:
        IllegalStrokeError: a stroke of the line is not legal there.
        GameError: the support of the game's model cannot be read.
    """
    found = [
        (weight, decision(game, state, len(line) % 2, players, solution)) for state, weight in states_after(game, line).items()
    ]
    weight = np.concatenate([np.full(len(choice.stroke), w) for w, choice in found])
    stroke, group = np.unique(np.concatenate([choice.stroke for _, choice in found]), return_inverse=True)
    total = np.bincount(group, weight).astype(np.float64)

    def of(name: str) -> F64:
        return np.concatenate([getattr(choice, name) for _, choice in found])

    def mean(name: str) -> F64:
        return np.asarray(np.bincount(group, weight * of(name)) / total)

    support = np.full(len(stroke), np.inf)
    np.minimum.at(support, group, of("support"))
    share = np.bincount(group, weight * of("probability")).astype(np.float64)
    order = np.argsort(-share, kind="stable")
    return Opening(
        line=tuple(line),
        seat=len(line) % 2,
        stroke=stroke[order].astype(np.int32),
        available=total[order],
        share=share[order],
        p_succ=mean("p_succ")[order],
        p_ret=mean("p_ret")[order],
        support=support[order],
        win=mean("win")[order],
        optimal=mean("optimal")[order],
    )


def states_after(game: Game, line: Sequence[int]) -> dict[int, float]:
    """States of the next striker after a line whose strokes were all returned, with their probabilities.

    Raises:
        IllegalStrokeError: a stroke is not legal there; ``row`` is its number, from 0.
    """
    states = {ROOT: 1.0}
    for i, stroke in enumerate(line):
        tables = game.seats[i % 2]
        following: dict[int, float] = {}
        for state, weight in states.items():
            pair = int(tables.pair(state, stroke)) if 0 <= stroke < tables.n_strokes else -1
            if pair < 0:
                continue
            returned = weight * tables.outcome_probabilities(np.array([pair]))[0, RETURNED_BELOW:]
            for arrival, mass in zip(tables.arrivals(np.array([pair]))[0].tolist(), returned.tolist(), strict=True):
                following[arrival] = following.get(arrival, 0.0) + mass
        total = sum(following.values())
        if not total:
            raise IllegalStrokeError(f"stroke {i + 1} of the opening is not legal there, or is never returned", stroke, i)
        states = {state: mass / total for state, mass in following.items() if mass}
    return states
