"""Matches played out, for policies that read the score: they have no table, so nothing about them is exact."""

import dataclasses
import math
from statistics import NormalDist
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import binomtest

from shuttle_marl import draws, scoring
from shuttle_marl.policy.base import Policy, States, checked_probabilities
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import ROOT, WINNER, strike

_Z: Final = NormalDist().inv_cdf(0.975)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SampledOdds:
    """What came of a number of matches, with 95 % intervals.

    Attributes:
        matches: number of matches.
        rallies: number of rallies.
        strokes: number of strokes.
        rally: share of the rallies won.
        rally_interval: its interval, matches taken as independent and the rallies of one not.
        match: share of the matches won.
        match_interval: its interval (Wilson, J. Am. Stat. Assoc. 1927).
    """

    matches: int
    rallies: int
    strokes: int
    rally: float
    rally_interval: tuple[float, float]
    match: float
    match_interval: tuple[float, float]


def sample(policy: Policy, opponent: TabulatedPolicy, *, matches: int, seed: int = 0, name: str = "policy") -> SampledOdds:
    """Play matches of a policy against a tabulated one; seats and the first serve are balanced over four matches.

    Args:
        policy: may read the score.
        opponent: a table.
        matches: how many.
        seed: names every draw.
        name: of the policy, for errors.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the legal strokes.
    """
    game, table = opponent.game, opponent.padded()
    number = np.arange(matches)
    seat, score = number & 1, scoring.new((number >> 1) & 1)
    key = draws.stream(seed, number)
    state = np.full(matches, ROOT, dtype=np.int32)
    striker = score.server.astype(np.int64)
    rallies, won = np.zeros(matches, dtype=np.int64), np.zeros(matches, dtype=np.int64)
    strokes = counter = 0
    while len(alive := np.flatnonzero(~score.over)):
        bits = draws.draw(key[alive], counter)
        choice = draws.choice_draw(bits)
        k = (table[state[alive]] <= choice[:, None]).sum(axis=1)
        own = np.flatnonzero(striker[alive] == seat[alive])
        at = alive[own]
        if len(at):
            states = States(game=game, state=state[at], score=score.seen_by(striker)[at])
            k[own] = _choose(checked_probabilities(policy, states, name), states, choice[own])
        outcome, following = strike(game, state[alive], k, draws.outcome_draw(bits))
        ended = following < 0
        over = alive[ended]
        winner = np.full(matches, -1)
        winner[over] = np.where(outcome[ended] == WINNER, striker[over], 1 - striker[over])
        rallies[over] += 1
        won[over] += winner[over] == seat[over]
        score = scoring.step(score, winner)
        striker[alive] = np.where(ended, score.server[alive], 1 - striker[alive])
        state[alive] = np.where(ended, ROOT, following)
        strokes += len(alive)
        counter += 1
    wins = int((score.winner == seat).sum())
    share = float(won.sum() / rallies.sum())
    # Ratio of sums over matches: the variance of its numerator's deviations, matches being independent.
    interval = binomtest(wins, matches).proportion_ci(method="wilson")
    spread = _Z * math.sqrt(float(((won - share * rallies) ** 2).sum())) / float(rallies.sum())
    return SampledOdds(
        matches=matches,
        rallies=int(rallies.sum()),
        strokes=strokes,
        rally=share,
        rally_interval=(max(0.0, share - spread), min(1.0, share + spread)),
        match=wins / matches,
        match_interval=(float(interval.low), float(interval.high)),
    )


def _choose(p: npt.NDArray[np.float64], states: States, draw: npt.NDArray[np.int32]) -> npt.NDArray[np.intp]:
    """Which of its legal strokes is played, from ``[B, n]`` chances and draws in [0, 65535)."""
    total = np.cumsum(p, axis=1)
    stroke = (np.rint(total / total[:, -1:] * draws.CHOICE_ONE) > draw[:, None]).argmax(axis=1)
    return states.game.reply_rank[states.incoming, states.contact, stroke].astype(np.intp)
