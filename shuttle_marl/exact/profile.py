"""Exact evaluation of two fixed policies: values of all states, and cross-play of many policies."""

import dataclasses
import functools
import itertools
import operator
from collections.abc import Callable, Sequence
from typing import Final, Protocol, TypeVar, cast

import numpy as np

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.exact.fixed_point import FIRST_RALLY_STATE, TOLERANCE, ExactError
from shuttle_marl.exact.match import Odds
from shuttle_marl.exact.met import met
from shuttle_marl.exact.solver import BlockLinear, ProfileValue, solve_players
from shuttle_marl.exact.sweeps import Chances, block_expected, block_mean, listed
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.policy import TabulatedPolicy, cumulative_positions, from_pair_probabilities
from shuttle_marl.game.scoring import BWF, Rules, match_win_probability
from shuttle_marl.game.tables import Game


class StatePolicy(Protocol):
    """A policy that reads the state alone, such as :class:`shuttle_marl.game.policy.TabulatedPolicy`."""

    @property
    def game(self) -> Game:
        """The tables with which the player strikes."""
        ...

    def pair_probabilities(self) -> F64:
        """``[P]`` probability of each legal pair given its state."""
        ...

    def block_probabilities(self, block: int) -> F64:
        """``[base pairs]`` the same in one block of states."""
        ...

    def position_probabilities(self) -> F64 | None:
        """``[S, 9]`` probability of each position where the opponent is in each state; None: those of people."""
        ...

    def __hash__(self) -> int: ...


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class PairPolicy:
    """A policy with probabilities that are not rounded to the resolution of a table.

    Attributes:
        game: the tables with which the player strikes.
        probability: ``[P]`` of each legal pair, or ``[base pairs]`` if it does not depend on the efforts; they sum to 1 in each
            state.
        positions: ``[S, 9]`` probability of each position where the opponent is in each state; None: those of people.
    """

    game: Game
    probability: F64
    positions: F64 | None = None

    def pair_probabilities(self) -> F64:
        """``[P]`` the same; see :class:`StatePolicy`."""
        return np.concatenate([self.block_probabilities(block) for block in range(self.game.n_blocks)])

    def block_probabilities(self, block: int) -> F64:
        """``[base pairs]`` the same in one block of states."""
        alike = len(self.probability) == self.game.n_base_pairs
        return self.probability if alike else self.probability[self.game.block_pairs(block)]

    def position_probabilities(self) -> F64 | None:
        """``[S, 9]`` probability of each position where the opponent is in each state; None: those of people."""
        return self.positions


def positions_of(policy: StatePolicy) -> F64:
    """``[S, 9]`` probabilities of the positions of a policy of the game with recovery: its own, or those of people."""
    own = policy.position_probabilities()
    return policy.game.people_positions(np.arange(policy.game.n_states)) if own is None else own


def tabulated_pairs(policy: PairPolicy) -> TabulatedPolicy:
    """The table of a policy, rounded to 1/65535."""
    waits = None if policy.positions is None else cumulative_positions(policy.positions)
    return dataclasses.replace(from_pair_probabilities(policy.game, policy.pair_probabilities()), waits=waits)


PolicyT = TypeVar("PolicyT", TabulatedPolicy, PairPolicy)
SomeT = TypeVar("SomeT", bound=StatePolicy)
OtherT = TypeVar("OtherT", bound=StatePolicy)
_LAYOUT: Final = (
    "catalogue.names", "levels", "edge_own", "edge_incoming", "edge_duel", "reply_start", "reply_count", "reply_edge",
)  # fmt: skip
"""Attributes of games with the same states and strokes."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class InducedChain:
    """Markov chain of one player's strokes under a policy.

    Attributes:
        game: the tables with which the player strikes.
        reward: ``[S]`` expected reward to the striker of the stroke played: probability of a winner minus probability of a fault.
        chance: for each block ``[base pairs]`` probability of each legal pair given its state, of a table in units of 1/65535, in
            the order of :func:`shuttle_marl.exact.sweeps.listed`; blocks that are alike share an array.
        contraction: largest probability that the rally continues, over the rally states.
    """

    game: Game
    reward: F64
    chance: tuple[Chances, ...]
    contraction: float

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.solver.Striker`."""

        def linear(plain: F64, after_attack: F64) -> F64:
            return -block_mean(self.game, block, self.chance[block], plain, after_attack)

        return self.reward[self.game.block_states(block)] + linear(plain, after_attack), linear


def block_chances(policy: StatePolicy, block: int) -> Chances:
    """``[base pairs]`` probability of each legal pair of one block given its state, of a table in units of 1/65535."""
    return policy.block_units(block) if isinstance(policy, TabulatedPolicy) else policy.block_probabilities(block)


def induced(policy: StatePolicy) -> InducedChain:
    """The chain of a policy, with the exact probabilities of its table.

    Raises:
        ExactError: a rally under the policy may never end.
    """
    game = policy.game
    reward, largest = np.empty(game.n_states), 0.0
    chances: list[Chances] = []
    for block in range(game.n_blocks):
        states = game.block_states(block)
        chance = listed(game, block_chances(policy, block))
        # Most policies ignore the efforts, or all but their own: each table is stored once.
        chances.append(next((seen for seen in chances if np.array_equal(seen, chance)), chance))
        reward[states], continuation = block_expected(game, block, chance)
        continuation[:FIRST_RALLY_STATE] = 0.0
        largest = max(largest, float(continuation.max()))
        if largest >= 1:
            state = states.start + int(continuation.argmax())
            raise ExactError(f"no stroke of the policy ever ends the rally in state: {game.describe(state)}")
    return InducedChain(game=game, reward=reward, chance=tuple(chances), contraction=largest)


def check_opponents(first: Game, second: Game) -> None:
    """Check that two players can meet: same layout, and if one has tables of a pair, the other has those of the opponent.

    Raises:
        ExactError: they cannot.
    """
    check_same_layout(first, second)
    for game, other in ((first, second), (second, first)):
        if game.whole is not None and not _meets(game, other):
            players = people_of(game).players
            raise ExactError(
                f"{players[game.seat]} strikes with the tables of a pair, and the opponent does not strike as "
                f"{players[1 - game.seat]} does; move its policy to those tables with exact.moved(policy, game.opposite)"
            )


def _meets(game: Game, other: Game) -> bool:
    """Whether other tables are those of the opponent: of the other player against this one."""
    if other.whole is None:
        return False
    mine, theirs = people_of(game).players, people_of(other).players
    return (mine[game.seat], mine[1 - game.seat]) == (theirs[1 - other.seat], theirs[other.seat])


def moved(policy: PolicyT, game: Game) -> PolicyT:
    """A policy in another game of the same layout: the same strokes in every state, with the outcomes of those tables.

    Args:
        game: the tables, such as one of :attr:`shuttle_marl.game.tables.Game.seats`.

    Raises:
        ExactError: the layouts differ.
    """
    check_same_layout(policy.game, game)
    return dataclasses.replace(policy, game=game)


def facing(policy: SomeT, opponent: OtherT) -> tuple[SomeT, OtherT]:
    """Two policies with the tables that hold while the receiver waits as the other policy does; as they are without recovery."""
    if policy.game.recovery is None:
        return policy, opponent
    first = cast("SomeT", moved(cast("PairPolicy", policy), met_by(policy.game, opponent)))
    if policy is opponent:
        return first, cast("OtherT", first)
    return first, cast("OtherT", moved(cast("PairPolicy", opponent), met_by(opponent.game, policy)))


@functools.lru_cache(maxsize=4)
def met_by(game: Game, policy: StatePolicy) -> Game:
    """The game against a receiver who waits as a policy does: itself where receivers have no choice."""
    return met(game, policy.position_probabilities()) if game.hides else game


def check_same_layout(first: Game, second: Game) -> None:
    """Check that two games have the same states and strokes; their probabilities may differ.

    Raises:
        ExactError: their layouts differ.
    """
    if first is second:
        return
    for part in _LAYOUT:
        if not np.array_equal(*map(operator.attrgetter(part), (first, second))):
            raise ExactError(
                f"the two players' games differ in {part}, so their states are not the same; "
                "compile both from the same catalogue, with the same rule of legality and the same number of levels of effort"
            )


def evaluate(policy: StatePolicy, opponent: StatePolicy, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """The exact value of player 0 playing ``policy`` against player 1 playing ``opponent``.

    Player i strikes with the tables of the game of its policy: the same in the symmetric game; if players have profiles of their
    own, the game with the striker's success and the receiver's return.

    Raises:
        ExactError: the two games have different layouts, or play may never end.
    """
    check_opponents(policy.game, opponent.game)
    policy, opponent = facing(policy, opponent)
    first = induced(policy)
    return evaluate_chains(first, first if opponent is policy else induced(opponent), tolerance=tolerance)


def evaluate_chains(first: InducedChain, second: InducedChain, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """:func:`evaluate` for known chains of games with the same layout."""
    return solve_players(first, second, tolerance, affine=True)[0]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Crossplay:
    """Odds of N policies against each other.

    Attributes:
        serving: ``[N, M]`` probability that the policy of the row wins a rally that it serves against the policy of the column.
        receiving: ``[N, M]`` probability that the policy of the row wins a rally that the policy of the column serves.
        error_bound: absolute error bound of all probabilities.
    """

    serving: F64
    receiving: F64
    error_bound: float

    @property
    def rally(self) -> F64:
        """``[N, M]`` probability that the policy of the row wins a rally, both serving equally often."""
        return (self.serving + self.receiving) / 2

    def match(self, rules: Rules = BWF) -> F64:
        """``[N, M]`` probability that the policy of the row wins a match, the first serve drawn at random."""
        return match_win_probability(self.serving, self.receiving, rules=rules)


def odds_of_pairs(
    policies: Sequence[StatePolicy],
    pairs: Sequence[tuple[int, int]],
    *,
    tolerance: float = TOLERANCE,
    progress: Callable[[], object] | None = None,
) -> list[tuple[Odds, Odds]]:
    """Odds of both policies of each pair of indices, solved on all cores; arguments and errors as for :func:`crossplay`."""
    hidden = any(policy.game.recovery is not None for policy in policies)
    chains = [] if hidden else list(in_threads(induced, policies))

    def solve(pair: tuple[int, int]) -> tuple[Odds, Odds]:
        if hidden:  # the tables depend on both
            value = evaluate(policies[pair[0]], policies[pair[1]], tolerance=tolerance)
        else:
            value = evaluate_chains(chains[pair[0]], chains[pair[1]], tolerance=tolerance)
        return value.odds(0), value.odds(1)

    found = []
    for odds in in_threads(solve, pairs):
        found.append(odds)
        if progress is not None:
            progress()
    return found


def crossplay(
    policies: Sequence[StatePolicy],
    opponents: Sequence[StatePolicy] | None = None,
    *,
    tolerance: float = TOLERANCE,
    progress: Callable[[], object] | None = None,
) -> Crossplay:
    """Exact odds of every pair of policies, including each against itself.

    Pairs are solved on all cores; results do not depend on their number.

    Args:
        policies: N policies of games with the same layout.
        opponents: M policies of the opponent, such as those of the other player of a pair; None: the same N.
        progress: called when one of the ``N (N + 1) / 2`` or ``N M`` pairs is solved.

    Raises:
        ExactError: there is no policy, two games have different layouts, policies of a pair do not meet those of the other
            player, or play may never end.
    """

    def solve(everyone: Sequence[StatePolicy], pairs: Sequence[tuple[int, int]]) -> list[tuple[Odds, Odds]]:
        for i, j in pairs:
            check_opponents(everyone[i].game, everyone[j].game)
        return odds_of_pairs(everyone, pairs, tolerance=tolerance, progress=progress)

    return crossplay_by(solve, policies, opponents)


def crossplay_by(
    solve: Callable[[list[SomeT], list[tuple[int, int]]], list[tuple[Odds, Odds]]],
    policies: Sequence[SomeT],
    opponents: Sequence[SomeT] | None,
) -> Crossplay:
    """:func:`crossplay` by a function that gives the odds of both policies of each pair of indices."""
    if not policies or (opponents is not None and not opponents):
        raise ExactError("crossplay of no policies: give one or more")
    everyone, n = [*policies, *(opponents or ())], len(policies)
    if opponents is None:
        pairs = list(itertools.combinations_with_replacement(range(n), 2))
    else:
        pairs = list(itertools.product(range(n), range(n, len(everyone))))
    found = solve(everyone, pairs)
    serving, receiving = np.full((2, len(everyone), len(everyone)), np.nan)
    for (i, j), (first, second) in zip(pairs, found, strict=True):
        serving[i, j], receiving[i, j], serving[j, i] = first.serving, first.receiving, second.serving
    if opponents is None:
        receiving = 1 - serving.T
    columns = slice(0 if opponents is None else n, None)
    bound = max(odds.error_bound for odds, _ in found)
    return Crossplay(serving=serving[:n, columns], receiving=receiving[:n, columns], error_bound=bound)
