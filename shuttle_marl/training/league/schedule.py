"""Schedule of a league: the turns of each round, with their opponents, durations and learning rates.

In policy space response oracles (PSRO, Lanctot et al., NeurIPS 2017) the opponents are a meta-strategy over the population. With
the exact best response as oracle and a Nash equilibrium as meta-strategy, PSRO is the double oracle method (McMahan, Gordon &
Blum, ICML 2003): iterated best responses, the baseline of a league. Where equilibria are deterministic, it ends in one. In the
game with recovery they mix in the states, and a mixture of whole policies may be exploitable by one of them. There the
meta-strategy is the linear average: the k-th best response counts k times, which is fictitious play in a zero-sum stochastic
game (Leslie, Perkins & Xu, Journal of Economic Theory 2020) with the weights of Tammelin et al. (IJCAI 2015).
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F64, I64, Floats
from shuttle_marl.exact.meta_games import nash
from shuttle_marl.game import draws
from shuttle_marl.training.league.config import LeagueTrainingConfig, MetaSolver
from shuttle_marl.training.league.population import LeagueState, Member, Payoffs, Turn

_DRAW_OPPONENTS: Final = 1 << 16
FLOOR: Final = 0.02  # fraction of the weight that is distributed uniformly, so that every opponent is played
_HARD: Final = 2.0  # exponent: an opponent that is beaten with probability p has the weight (1 - p)^2
_MIN_PROBABILITY: Final = 1e-3  # smaller ones are removed from a meta-strategy: their policies cost time and change little
_SOLVERS: Final[dict[MetaSolver, Callable[[F64], F64]]] = {
    "nash": lambda values: nash(values).row,
    "linear": lambda values: np.arange(1.0, len(values) + 1),
}


def uniform(count: int) -> F64:
    """``[K]`` equal weights."""
    return np.full(count, 1 / count) if count else np.zeros(0)


def prioritised(win: npt.ArrayLike) -> F64:
    """``[K]`` positive probabilities of opponents (Vinyals et al. 2019) by the ``[K]`` chances to beat them; NaN: 1/2."""
    p = np.asarray(win, dtype=np.float64)
    p = np.clip(np.where(np.isnan(p), 0.5, p), 0.0, 1.0)
    if not len(p):
        return p
    weight = (1 - p) ** _HARD
    total = float(weight.sum())
    # The weights vanish if every opponent is beaten with certainty.
    fractions = weight / total if total > 1e-12 else uniform(len(p))
    return (1 - FLOOR) * fractions + FLOOR / len(p)


def chosen(weight: Floats, most: int, rng: np.random.Generator) -> tuple[I64, F64]:
    """Sample the opponents of a turn.

    Args:
        weight: ``[K]`` weights of all opponents, 0 or more.
        rng: generator; used if there are more, to draw them by weight without replacement.

    Returns:
        ``[M]`` indices, ascending, and ``[M]`` fractions of the rallies, which add up to 1.
    """
    positive = np.flatnonzero(np.asarray(weight) > 0)
    if len(positive) <= most:
        return positive, np.asarray(weight[positive] / weight[positive].sum()) if len(positive) else np.zeros(0)
    p = weight[positive] / weight[positive].sum()
    drawn = np.sort(rng.choice(positive, most, replace=False, p=p))
    # The probability of inclusion grows with the weight already, so the fractions are uniform.
    return drawn, uniform(most)


def order(fractions: Sequence[float], length: int = 200) -> I64:
    """``[length]`` indices of opponents, evenly spread; -1: the learner itself, for what remains of the fractions."""
    full = np.r_[max(0.0, 1 - float(np.sum(fractions))), np.asarray(fractions, dtype=np.float64)]
    full /= full.sum()
    owed = np.zeros(len(full))
    out = np.empty(length, np.int64)
    for k in range(length):
        owed += full
        out[k] = int(owed.argmax())
        owed[out[k]] -= 1
    return out - 1


def meta_strategy(solver: MetaSolver, values: npt.ArrayLike) -> F64:
    """``[N]`` probabilities of a population; ``values``: ``[N, N]`` of the row against the column, antisymmetric."""
    strategy = _SOLVERS[solver](np.asarray(values, dtype=np.float64))
    strategy = np.where(strategy >= min(_MIN_PROBABILITY, float(strategy.max())), strategy, 0.0)
    return np.asarray(strategy / strategy.sum())


class Schedule:
    """Schedules the turns of every round; ``payoffs``: payoffs of its policies; missing pairs are solved."""

    def __init__(self, config: LeagueTrainingConfig, state: LeagueState, payoffs: Payoffs) -> None:
        self.config, self.state, self.payoffs = config, state, payoffs

    def turns(self, number: int) -> list[Turn]:
        """The turns of a round, counted from 1."""
        return [self._turn(name, number, *fractions) for name, *fractions in self._learners()]

    def _learners(self) -> list[tuple[str, float, float, float]]:
        """Each learner with its fractions of rallies against best responses and the population, and its relative duration."""
        config = self.config
        if config.variant == "psro":
            return [("oracle", 0.0, 1.0, 1.0)]
        mains = [f"main-agent-{i}" for i in range(config.main_agents)]
        if config.variant == "plain":
            return [(name, 0.0, 0.0, 1.0) for name in mains]
        exploiters = [f"main-exploiter-{i}" for i in range(config.main_exploiters)]
        exploiters += [f"league-exploiter-{i}" for i in range(config.league_exploiters)]
        learners = [(name, config.response_fraction, config.past_fraction, 1.0) for name in mains]
        duration = config.exploiter_fraction
        return learners + [(name, 0.0, 1.0, duration) for name in exploiters if duration]

    def _turn(self, name: str, number: int, responses: float, past: float, duration: float) -> Turn:
        config, member = self.config, self.state.members.get(name, Member())
        weights = self.meta_strategy() if config.variant == "psro" else self._weights(name, number)
        rng = np.random.default_rng((config.seed, number, _number(name), _DRAW_OPPONENTS))
        drawn, fractions = chosen(weights, config.max_opponents, rng)
        fractions = fractions * past
        opponents = [self.state.population[i].hash for i in drawn]
        if config.algorithm == "sac" and config.variant != "plain":
            # SAC has one sign of gamma, so it plays against its last policy instead of itself.
            opponents, fractions = self._without_self_play(name, opponents, fractions, 1 - past - responses)
        target = config.strokes * number // config.n_rounds - config.strokes * (number - 1) // config.n_rounds
        done, turns = (member.turns, config.patience) if duration < 1 else (number - 1, config.n_rounds)
        return Turn(
            member=name,
            round=number,
            fresh=member.turns == 0,
            opponents=tuple(opponents),
            fractions=tuple(float(each) for each in fractions),
            response_fraction=responses,
            strokes=max(1, round(target * duration)),
            remaining=(1 - done / turns, 1 - (done + 1) / turns),
            seed=int(draws.stream(config.seed, number, _number(name))[0] >> np.uint64(33)),
        )

    def _without_self_play(self, name: str, opponents: list[str], fractions: F64, rest: float) -> tuple[list[str], F64]:
        if rest <= 0:
            return opponents, fractions
        if name in self.state.members:
            return [*opponents, self.state.members[name].hash], np.r_[fractions, rest]
        return opponents, fractions * (1 + rest / fractions.sum())

    def _weights(self, name: str, number: int) -> F64:
        config, population = self.config, self.state.population
        weights = np.zeros(len(population))
        if config.variant == "plain":
            return weights
        members = self.state.members
        mains = {member.hash for key, member in members.items() if key.startswith("main-agent")}
        if name.startswith("main-exploiter") and mains:
            return np.array([float(each.hash in mains) for each in population])
        mine = members[name].hash if name in members else ""
        if config.variant == "fictitious" or not mine:
            return weights + 1
        considered = self._considered(name, number)
        wins = self.payoffs.match_wins(mine, [population[i].hash for i in considered])
        weights[considered] = prioritised(wins)
        return weights

    def _considered(self, name: str, number: int) -> I64:
        """Indices of the policies whose odds are solved for prioritised matchmaking: the newest, and some of the others."""
        count, most = len(self.state.population), self.config.max_opponents
        newest = np.arange(max(0, count - most // 2 - 1), count)
        rng = np.random.default_rng((self.config.seed, number, _number(name)))
        others = rng.permutation(count - len(newest))[:most]
        return np.sort(np.r_[others, newest]).astype(np.int64)

    def meta_strategy(self) -> F64:
        """``[N]`` probabilities of the population in psro."""
        solver, hashes = self.config.meta_solver, [each.hash for each in self.state.population]
        assert solver is not None  # set when the game was known
        values = np.zeros(2 * (len(hashes),)) if solver == "linear" else self.payoffs.values(hashes)
        return meta_strategy(solver, values)


def _number(name: str) -> int:
    kind, _, number = name.rpartition("-")
    return {"": 0, "main-agent": 1, "main-exploiter": 2, "league-exploiter": 3}[kind] << 8 | (int(number) if kind else 0)
