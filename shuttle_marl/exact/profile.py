"""Exact evaluation of two fixed policies: values of all states, also with recovery.

If one player's positions are fixed, the other one strikes in a game without recovery, whose tables are the means over these
positions (:func:`met`): everything else that is exact is computed there.
"""

import dataclasses
import functools
import operator
import weakref
from typing import Final, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I32, I64, U8, U16
from shuttle_marl.base.compiling import compiled
from shuttle_marl.exact.fixed_point import FIRST_RALLY_STATE, TOLERANCE, BlockLinear, ExactError, ProfileValue, solve_players
from shuttle_marl.exact.sweeps import Chances, block_expected, block_mean, listed
from shuttle_marl.game.draws import HURRY_ONE
from shuttle_marl.game.layout import ALL, Indices
from shuttle_marl.game.pairs import people_of
from shuttle_marl.game.policy import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.game.recovery import NO_CHOICE
from shuttle_marl.game.tables import Game


class StatePolicy(Protocol):
    """A policy that reads the state alone, such as :class:`shuttle_marl.game.policy.TabulatedPolicy`."""

    @property
    def game(self) -> Game:
        """The tables with which the player strikes."""

    def pair_probabilities(self) -> F64:
        """``[P]`` probability of each legal pair given its state."""

    def block_probabilities(self, block: int) -> F64:
        """``[base pairs]`` the same in one block of states."""

    def position_probabilities(self) -> F64:
        """``[S, 9]`` probability of each position where the opponent is in each state."""

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

    def position_probabilities(self) -> F64:
        """``[S, 9]`` probability of each position where the opponent is in each state; see :class:`StatePolicy`."""
        return self.game.people_positions(np.arange(self.game.n_states)) if self.positions is None else self.positions

    def waiting_at(self, positions: F64 | None) -> "PairPolicy":
        """The same strokes, and ``[S, 9]`` positions; None: as before."""
        return self if positions is None else dataclasses.replace(self, positions=positions)


PolicyT = TypeVar("PolicyT", TabulatedPolicy, PairPolicy)
SomeT = TypeVar("SomeT", bound=StatePolicy)
OtherT = TypeVar("OtherT", bound=StatePolicy)


def tabulated_pairs(policy: PairPolicy) -> TabulatedPolicy:
    """The table of a policy, rounded to 1/65535."""
    return from_pair_probabilities(policy.game, policy.pair_probabilities()).waiting_at(policy.positions)


_LAYOUT: Final = (
    "catalogue.names", "levels", "edge_own", "edge_incoming", "edge_duel", "reply_start", "reply_count", "reply_edge",
)  # fmt: skip
"""Attributes of games with the same states and strokes."""


class Rows(NamedTuple):
    """Outcomes of a block by position, see :class:`shuttle_marl.game.recovery.Waiting`."""

    choices: I32
    position: I8
    start: I64
    limits: U16  # [G, R, 3] thresholds in G games
    hurry: U8  # [G, R, 2] chances of a hurried receiver


def rows_of(games: tuple[Game, ...], block: int) -> Rows:
    """The rows of one block of states of games with the same layout and feasible positions."""
    return _rows_of(games, block // games[0].levels)


@functools.lru_cache(maxsize=8)
def _rows_of(games: tuple[Game, ...], level: int) -> Rows:
    first = games[0].waiting
    if len(games) == 1:
        return Rows(first.choices, first.position, first.start, first.limits[level : level + 1], first.hurry[None])
    limits, hurry = (np.stack(part) for part in zip(*((g.waiting.limits[level], g.waiting.hurry) for g in games), strict=True))
    return Rows(first.choices, first.position, first.start, limits, hurry)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MetGame(Game):
    """The game against a receiver whose positions are known: the means of the tables over them."""

    of: Game  # the game with recovery
    table: tuple[int, ...]  # for each block the row of the following two; blocks that are alike share one
    mean_limits: F64  # [T, base pairs, 3] thresholds, not rounded
    mean_hurry: F64  # [T, base pairs, 2] chances of a hurried receiver, not rounded

    def __post_init__(self) -> None:
        """Its layout is that of a game that was checked."""
        self.__dict__["limits"] = self.mean_limits

    @property
    def tables(self) -> Game:
        """The game that has its layout."""
        return self.of

    def table_of(self, block: int) -> int:
        """Row of ``limits`` that holds in a block."""
        return self.table[block]

    def hurry_at(self, table: int) -> F64:  # type: ignore[override]
        """``[base pairs, 2]`` chances of a hurried receiver."""
        return self.mean_hurry[table]

    def limit_row(self, pairs: slice | Indices = ALL) -> I64:
        """``[...]`` row of legal pairs in ``limits`` as ``[T * base pairs, 3]``."""
        block, base = np.divmod(self._numbers(pairs), self.n_base_pairs)
        return np.asarray(np.array(self.table, dtype=np.int64)[block] * self.n_base_pairs + base)

    def hurry_of(self, pairs: slice | Indices = ALL) -> F64:
        """``[..., 2]`` probability that the receiver of a return is hurried."""
        return self.mean_hurry.reshape(-1, 2)[self.limit_row(pairs)] / HURRY_ONE


def met(game: Game, positions: F64) -> MetGame:
    """The game against a receiver who chooses positions.

    Args:
        game: with recovery, the tables with which the striker strikes.
        positions: ``[S, 9]`` their probabilities in each state of the striker.
    """
    table: list[int] = []
    known: list[tuple[int, F64]] = []
    limits, hurry = [], []
    for block in range(game.n_blocks):
        here, level = np.ascontiguousarray(positions[game.block_states(block)], dtype=np.float64), block // game.levels
        found = next((k for k, (other, before) in enumerate(known) if other == level and np.array_equal(before, here)), None)
        if found is None:
            found = len(known)
            known.append((level, here))
            limits.append(np.empty((game.n_base_pairs, 3)))
            hurry.append(np.empty((game.n_base_pairs, 2)))
            _means(here, game.base_pair_start, rows_of((game,), block), limits[-1], hurry[-1])
        table.append(found)
    fields = {field.name: getattr(game, field.name) for field in dataclasses.fields(Game) if field.init}
    fields["recovery"] = NO_CHOICE
    return MetGame(**fields, of=game, table=tuple(table), mean_limits=np.stack(limits), mean_hurry=np.stack(hurry))


@compiled
def _means(positions: F64, pair_start: I32, rows: Rows, limits: F64, hurry: F64) -> None:
    """Mean tables over ``[base states, 9]`` probabilities of positions."""
    for s in range(positions.shape[0]):
        m, row = rows.choices[s], rows.start[s]
        for pair in range(pair_start[s], pair_start[s + 1]):
            fault = winner = below = late_low = late_high = 0.0
            for i in range(m):
                share, r = positions[s, rows.position[s, i]], row + i
                won, under = float(rows.limits[0, r, 1]), float(rows.limits[0, r, 2])
                fault += share * float(rows.limits[0, r, 0])
                winner += share * won
                below += share * under
                late_low += share * (under - won) * rows.hurry[0, r, 0]
                late_high += share * (65536.0 - under) * rows.hurry[0, r, 1]
            limits[pair, 0], limits[pair, 1], limits[pair, 2] = fault, winner, below
            hurry[pair, 0] = late_low / (below - winner) if below > winner else 0.0
            hurry[pair, 1] = late_high / (65536.0 - below) if below < 65536.0 else 0.0
            row += m


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class InducedChain:
    """Markov chain of one player's strokes under a policy.

    Attributes:
        chance: for each block ``[base pairs]`` probability of each legal pair given its state, of a table in units of 1/65535, in
            the order of :func:`shuttle_marl.exact.sweeps.listed`; blocks that are alike share an array.
    """

    game: Game  # the tables with which the player strikes
    reward: F64  # [S] expected reward to the striker of the stroke played: probability of a winner minus probability of a fault
    chance: tuple[Chances, ...]
    contraction: float  # largest probability that the rally continues, over the rally states

    def block_sweep(self, block: int, plain: F64, after_attack: F64) -> tuple[F64, BlockLinear]:
        """Values of one block and their linear part; see :class:`~shuttle_marl.exact.fixed_point.Striker`."""

        def linear(plain: F64, after_attack: F64) -> F64:
            return -block_mean(self.game, block, self.chance[block], plain, after_attack)

        return self.reward[self.game.block_states(block)] + linear(plain, after_attack), linear


def block_chances(policy: StatePolicy, block: int) -> Chances:
    """``[base pairs]`` probability of each legal pair of one block given its state, of a table in units of 1/65535."""
    return policy.block_units(block) if isinstance(policy, TabulatedPolicy) else policy.block_probabilities(block)


_CHAINS: Final[weakref.WeakKeyDictionary[StatePolicy, InducedChain]] = weakref.WeakKeyDictionary()


def induced(policy: StatePolicy) -> InducedChain:
    """The chain of a policy, with the exact probabilities of its table; kept as long as the policy.

    Raises:
        ExactError: a rally under the policy may never end.
    """
    found = _CHAINS.get(policy)
    if found is None:
        found = _CHAINS[policy] = _induced(policy)
    return found


def _induced(policy: StatePolicy) -> InducedChain:
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
        if game.whole is None:
            continue
        player, opponent = _player_and_opponent(game)
        if other.whole is None or _player_and_opponent(other) != (opponent, player):
            wrong = f"{player} strikes with the tables of a pair, and the opponent does not strike as {opponent} does"
            raise ExactError(f"{wrong}; move its policy to those tables with exact.moved(policy, game.opposite)")


def _player_and_opponent(game: Game) -> tuple[str, str]:
    players = people_of(game).players
    return players[game.seat], players[1 - game.seat]


def moved(policy: PolicyT, game: Game) -> PolicyT:
    """A policy in another game of the same layout: the same strokes in every state, with the outcomes of those tables.

    Args:
        game: the tables, such as one of :attr:`shuttle_marl.game.tables.Game.seats`.

    Raises:
        ExactError: the layouts differ.
    """
    check_same_layout(policy.game, game)
    return policy if policy.game is game else dataclasses.replace(policy, game=game)


def facing(policy: SomeT, opponent: OtherT) -> tuple[SomeT, OtherT]:
    """Two policies with the tables that hold while the receiver waits as the other policy does; as they are without recovery."""
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
            advice = "compile both from the same catalogue, with the same rule of legality and levels of effort"
            raise ExactError(f"the two players' games differ in {part}, so their states are not the same; {advice}")


def evaluate(policy: StatePolicy, opponent: StatePolicy, *, tolerance: float = TOLERANCE) -> ProfileValue:
    """The exact value of player 0 playing ``policy`` against player 1 playing ``opponent``.

    Player i strikes with the tables of the game of its policy: the same in the symmetric game; if players have profiles of their
    own, the game with the striker's success and the receiver's return.

    Raises:
        ExactError: the two games have different layouts, or play may never end.
    """
    check_opponents(policy.game, opponent.game)
    policy, opponent = facing(policy, opponent)
    return solve_players(induced(policy), induced(opponent), tolerance, affine=True)[0]
