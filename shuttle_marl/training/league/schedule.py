"""Schedule of a league: the turns of a round, each with its opponents, its length and its place in the fall of learning rates."""

from typing import Final

import numpy as np

from shuttle_marl.arrays import F64, I64
from shuttle_marl.game import draws
from shuttle_marl.training.league import matchmaking
from shuttle_marl.training.league.config import LeagueTrainingConfig
from shuttle_marl.training.league.population import Payoffs
from shuttle_marl.training.league.psro import meta_strategy
from shuttle_marl.training.league.state import LeagueState, Member
from shuttle_marl.training.league.turns import Turn

LEAST_SECONDS: Final = 0.5
"""Of a turn."""
_DRAW_OPPONENTS: Final = 1 << 16


class Schedule:
    """Makes the turns of every round.

    Args:
        config: of the league.
        state: of the league, which is read.
        payoffs: of its policies; pairs that are not known are solved.
    """

    def __init__(self, config: LeagueTrainingConfig, state: LeagueState, payoffs: Payoffs) -> None:
        self.config, self.state, self.payoffs = config, state, payoffs
        self._elapsed = 0.0

    def turns(self, number: int, elapsed: float) -> list[Turn]:
        """The turns of a round.

        Args:
            number: of the round, counted from 1.
            elapsed: seconds of the run so far.
        """
        config, self._elapsed = self.config, elapsed
        seconds = self._turn_seconds(number)
        if config.way == "psro":
            strategy = self.meta_strategy()
            return [self._turn("oracle", number, strategy, 0.0, 1.0, seconds, share=1.0)]
        turns = []
        for i in range(config.main_agents):
            name = f"main-agent-{i}"
            past = config.past if config.way != "plain" else 0.0
            responses = config.responses if config.way != "plain" else 0.0
            turns.append(self._turn(name, number, self._weights(name, number), responses, past, seconds, share=1.0))
        if config.way != "plain":
            exploiters = [f"main-exploiter-{i}" for i in range(config.main_exploiters)]
            exploiters += [f"league-exploiter-{i}" for i in range(config.league_exploiters)]
            for name in exploiters if config.exploiter_share else []:
                weights = self._weights(name, number)
                turns.append(self._turn(name, number, weights, 0.0, 1.0, seconds, share=config.exploiter_share))
        return turns

    def _turn_seconds(self, number: int) -> float | None:
        """Time for the turn of a main agent, so that all rounds that are left end in time."""
        config = self.config
        if config.seconds is None:
            return None
        assert config.n_rounds is not None
        left = config.seconds - self._elapsed
        # Rounds are longer than planned where most of one would not be learning; the last one takes what is left.
        whole = max(left / max(1, config.n_rounds - number + 1), 2 * self.state.overhead)
        if left < 1.5 * whole:
            whole = left
        return max(LEAST_SECONDS, (whole - self.state.overhead) / self.load)

    @property
    def load(self) -> float:
        """Time that the turns of a round take, as a multiple of that of a main agent."""
        config, exploiters = self.config, 0
        if config.way == "psro":
            return 1.0
        if config.way != "plain":
            exploiters = config.main_exploiters + config.league_exploiters
        return max(1.0, (config.main_agents + exploiters * config.exploiter_share) / config.workers)

    def _turn(
        self,
        name: str,
        number: int,
        weights: F64,
        responses: float,
        past: float,
        seconds: float | None,
        *,
        share: float,
    ) -> Turn:
        config, member = self.config, self.state.members.get(name, Member())
        rng = np.random.default_rng((config.seed, number, _number(name), _DRAW_OPPONENTS))
        drawn, shares = matchmaking.chosen(weights, config.opponents, rng)
        shares = shares * past
        opponents = [self.state.population[i].hash for i in drawn]
        if config.algorithm == "sac" and config.way != "plain":
            # Its values look one stroke ahead with one sign, so its own last policy stands for itself.
            opponents, shares = self._without_itself(name, opponents, shares, 1 - past - responses)
        strokes = None
        if config.strokes is not None:
            assert config.n_rounds is not None
            target = config.strokes * number // config.n_rounds - config.strokes * (number - 1) // config.n_rounds
            strokes = max(1, round(target * share))
        if share < 1:
            remaining = 1 - member.turns / config.patience, 1 - (member.turns + 1) / config.patience
        elif config.seconds is None or seconds is None:
            remaining = 1 - (number - 1) / (config.n_rounds or 1), 1 - number / (config.n_rounds or 1)
        else:
            now = self._elapsed
            ends = now + seconds * self.load + self.state.overhead
            remaining = max(0.0, 1 - now / config.seconds), max(0.0, 1 - ends / config.seconds)
        return Turn(
            member=name,
            round=number,
            fresh=member.turns == 0,
            opponents=tuple(opponents),
            shares=tuple(float(each) for each in shares),
            responses=responses,
            strokes=strokes,
            seconds=None if seconds is None else round(seconds * share, 3),
            remaining=remaining,
            seed=int(draws.stream(config.seed, number, _number(name))[0] >> np.uint64(33)),
        )

    def _without_itself(self, name: str, opponents: list[str], shares: F64, rest: float) -> tuple[list[str], F64]:
        if rest <= 0:
            return opponents, shares
        if name in self.state.members:
            return [*opponents, self.state.members[name].hash], np.r_[shares, rest]
        return opponents, shares * (1 + rest / shares.sum())

    def _weights(self, name: str, number: int) -> F64:
        """``[N]`` weights of the policies so far as opponents of a learner."""
        config, population = self.config, self.state.population
        weights = np.zeros(len(population))
        if config.way == "plain":
            return weights
        members = self.state.members
        mains = {member.hash for key, member in members.items() if key.startswith("main-agent")}
        if name.startswith("main-exploiter") and mains:
            return np.array([float(each.hash in mains) for each in population])
        mine = members[name].hash if name in members else ""
        if config.way == "fictitious" or not mine:
            return weights + 1
        considered = self._considered(name, number)
        wins = self.payoffs.match_wins(mine, [population[i].hash for i in considered])
        weights[considered] = matchmaking.prioritised(wins)
        return weights

    def _considered(self, name: str, number: int) -> I64:
        """Policies so far whose odds are solved for prioritised matchmaking: the newest, and some of the others."""
        count, most = len(self.state.population), self.config.opponents
        newest = np.arange(max(0, count - most // 2 - 1), count)
        rng = np.random.default_rng((self.config.seed, number, _number(name)))
        others = rng.permutation(count - len(newest))[:most]
        return np.sort(np.r_[others, newest]).astype(np.int64)

    def meta_strategy(self) -> F64:
        """``[N]`` probabilities of the policies so far in psro."""
        return meta_strategy(self.config.meta, self.payoffs.values([each.hash for each in self.state.population]))


def _number(name: str) -> int:
    """A number for the name of a learner, for its draws."""
    kind, _, number = name.rpartition("-")
    return {"": 0, "main-agent": 1, "main-exploiter": 2, "league-exploiter": 3}[kind] << 8 | (int(number) if kind else 0)
