"""A rally stroke by stroke, in plain Python: a draw, the stroke that a policy chooses, its outcome, and the next state.

    stepper, draws = stepper_of(game), RallyDraws(seed)
    state, player = ROOT, draws.first_server(rally)
    for i in itertools.count():
        stroke = choose(policies[player], game, state, draws.choice(rally, i))
        played, state = stepper.step(state, player, stroke, draws.outcome(rally, i))
        if played.outcome < RETURNED_BELOW:
            break
        player = 1 - player

With recovery ``step`` also takes the receiver's position: ``choose(…, waits=True) - n``, by ``draws.position``.

The rule is that of :mod:`shuttle_marl.game.rules` and the draws are those of :mod:`shuttle_marl.game.draws`, without
the cost of numpy calls on single numbers; tests hold both equal.
"""

import bisect
import functools
from array import array
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, I8, U64
from shuttle_marl.game.draws import choice_draw, draw, first_server, outcome_draw, position_draw, stream
from shuttle_marl.game.observation import EFFORT, SWAP, features
from shuttle_marl.game.policy import LAGS, Policy, States, checked_positions, checked_probabilities, drawn_strokes
from shuttle_marl.game.rally.record import Rally
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import HURRIED_BELOW, RETURNED_BELOW
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.game.thresholds import ONE


class Stroke(NamedTuple):
    """A stroke that was played.

    Attributes:
        player: seat of the striker, 0 or 1.
        stroke: catalogue index.
        outcome: index into :data:`shuttle_marl.game.rules.OUTCOMES`.
        p_succ: probability that the stroke was good.
        p_ret: probability that a good stroke was returned; in the game with recovery by a receiver who waits as people do, so it
            tells nothing of the position.
    """

    player: int
    stroke: int
    outcome: int
    p_succ: float
    p_ret: float


class _Flat(Protocol):
    """A flat table."""

    def __getitem__(self, entry: int, /) -> int: ...


class Stepper:
    """A game, or that of a pair, prepared for playing strokes one at a time; read-only. :func:`stepper_of` shares one per game.

    Attributes:
        game: the tables, or the game of a pair.
        n_actions: number of strokes and positions.
        observations: ``[2 base states, 60]`` float32 observation of the striker in each state, then of the receiver, efforts
            zero; with recovery ``[2 base states, 61]``, the last number zero.
    """

    def __init__(self, game: Game) -> None:
        self.game = game
        seen = features(game)
        self.observations = np.pad(np.concatenate([seen, seen[:, SWAP]]), ((0, 0), (0, game.hides)))
        self._n, self._one = game.n_strokes, ONE
        self.n_actions = game.n_actions
        masks = game.reply_mask.reshape(-1, self._n).astype(np.int8)
        self._masks = np.pad(masks, ((0, 0), (0, self.n_actions - self._n)))
        # A memoryview yields Python integers four times as fast as an array, without the memory of a list.
        self._rank = _view(game.reply_rank)
        self._limits: Sequence[Sequence[_Flat]] = [[_view(limits) for limits in tables.limits] for tables in game.seats]
        self._pair_start = _view(game.base_pair_start)
        self._first_reply = _view(game.first_reply)
        self._hurry: Sequence[_Flat] = [_view(tables.hurry) for tables in game.seats]
        self._arrival = _view(4 * game.reply_edge + game.edge_attack[game.reply_edge])
        self._incoming = _view(game.edge_incoming)
        self._size, self._levels = game.n_base_states, game.levels
        self._next_block = [tuple(b * self._size for b in game.block_following(block)) for block in range(game.n_blocks)]
        waiting = [tables.waiting for tables in game.seats]
        self._met: Sequence[Sequence[_Flat]] = [[_view(limits) for limits in tables.limits] for tables in waiting]
        self._late: Sequence[_Flat] = [_view(tables.hurry) for tables in waiting]
        self._feasible = waiting[0].place >= 0
        self._place, self._choices, self._first_row = (
            _view(table) for table in (waiting[0].place, waiting[0].choices, waiting[0].start)
        )
        self._only = _view(np.where(waiting[0].choices > 1, -1, waiting[0].position[:, 0]))
        highest = max(1, game.levels - 1)
        self._efforts = [(own / highest, other / highest) for own in range(game.levels) for other in range(game.levels)]

    def __deepcopy__(self, memo: dict[int, Any]) -> "Stepper":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return stepper_of, (self.game,)

    def observe(self, state: int, *, receiver: bool = False) -> F32:
        """``[60]`` observation of the striker in a state, or of the receiver; with recovery ``[61]``. A new array."""
        block, base = divmod(state, self._size)
        row: F32 = self.observations[base + self._size * receiver].copy()
        if block:
            efforts = self._efforts[block]
            row[_EFFORTS] = efforts[::-1] if receiver else efforts
        return row

    def legal_action_mask(self, state: int) -> I8:
        """``[n_actions]`` int8 legal strokes of a state, a new array."""
        mask: I8 = self._masks[self._reply(state)].copy()
        return mask

    def position_mask(self, state: int) -> I8:
        """``[n_actions]`` int8 feasible positions of a receiver who has a choice, a new array."""
        mask = np.zeros(self.n_actions, np.int8)
        mask[self._n :] = self._feasible[state % self._size]
        return mask

    def chooses_position(self, state: int) -> bool:
        """Whether the receiver can wait at more than one position."""
        return bool(self._only[state % self._size] < 0)

    def only_position(self, state: int) -> int | None:
        """Where a receiver without a choice waits; None: they have one."""
        only: int = self._only[state % self._size]
        return None if only < 0 else only

    def is_feasible(self, state: int, position: int) -> bool:
        """Whether a receiver can wait at a position."""
        return 0 <= position < N_POSITIONS and self._place[N_POSITIONS * (state % self._size) + position] >= 0

    def is_legal(self, state: int, stroke: int) -> bool:
        """Whether a stroke is in the catalogue and legal in a state."""
        return 0 <= stroke < self._n and self._rank[self._reply(state) * self._n + stroke] >= 0

    @staticmethod
    def is_hurried(state: int) -> bool:
        """Whether the striker is hurried in a state."""
        return bool(state & 2)

    def step(self, state: int, player: int, stroke: int, draw: int, position: int | None = None) -> tuple[Stroke, int]:
        """Play a legal stroke.

        Args:
            stroke: catalogue index, legal in this state; not checked.
            draw: uniform integer in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.
            position: where the receiver waits, feasible in this state, which is not checked; None: as people do.

        Returns:
            The stroke and the receiver's state; after a fault or a winner, the state after the stroke with contact below and not
            hurried.
        """
        block, base = divmod(state, self._size)
        k = self._rank[(2 * self._incoming[base >> 2] + (base & 1)) * self._n + stroke]
        row = self._pair_start[base] + k
        entry = 3 * row
        limits, hurry = self._limits[player][block // self._levels], self._hurry[player]
        fault, winner, one = limits[entry], limits[entry + 1], self._one
        good, returned = (one - fault) / one, (one - winner) / (one - fault)
        if position is not None:
            row = self._first_row[base] + k * self._choices[base] + self._place[N_POSITIONS * base + position]
            entry = 3 * row
            limits, hurry = self._met[player][block // self._levels], self._late[player]
            fault, winner = limits[entry], limits[entry + 1]
        low = draw & one - 1
        outcome = (low >= fault) + (low >= winner) + (low >= limits[entry + 2])
        if outcome >= RETURNED_BELOW and draw >> 16 < hurry[2 * row + outcome - RETURNED_BELOW]:
            outcome += HURRIED_BELOW - RETURNED_BELOW
        arrival = self._arrival[self._first_reply[base] + k]
        following = self._next_block[block][arrival & 1] + (arrival & ~1) + max(outcome - RETURNED_BELOW, 0)
        return Stroke(player, stroke, outcome, good, returned), following

    def _reply(self, state: int) -> int:
        """Row of the legal strokes: twice the incoming stroke plus the contact."""
        return 2 * self._incoming[state % self._size >> 2] + (state & 1)


_EFFORTS: Final = slice(EFFORT, EFFORT + 2)


def _view(table: npt.NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(table).ravel().data


@functools.lru_cache(maxsize=8)
def stepper_of(game: Game) -> Stepper:
    """The stepper of a game, built once."""
    return Stepper(game)


def waited_at(rally: Rally, game: Game, stroke: int, state: int) -> int | None:
    """Position that the receiver of a stroke chose, which is struck in a state; None: they had no choice, or it is not known."""
    return None if rally.waited is None or not stepper_of(game).chooses_position(state) else int(rally.waited[stroke])


def choose(
    policy: Policy,
    game: Game,
    state: int,
    draw: int,
    score: tuple[int, int, int, int] | None = None,
    strokes: Sequence[int] | None = None,
    *,
    waits: bool = False,
) -> int:
    """What a policy plays in one state: catalogue index of a stroke, or n plus the position in which it waits.

    Args:
        policy: a :class:`~shuttle_marl.game.tabulated.TabulatedPolicy` of this game, or any other policy.
        draw: uniform integer in [0, 65535); see :func:`shuttle_marl.game.draws.choice_draw`, and for positions
            :func:`~shuttle_marl.game.draws.position_draw`.
        score: points of the striker, of the receiver, games of the striker, of the receiver; None outside of matches.
        strokes: catalogue indices of the rally so far; None: not known.
        waits: whether the policy chooses a position, as the receiver, in the game with recovery.

    Raises:
        PolicyError: the policy raised or returned no distribution over the legal strokes or feasible positions.
    """
    first = game.n_strokes if waits else 0
    if isinstance(policy, TabulatedPolicy):
        if waits:
            return first + bisect.bisect_right(policy.waiting_table[state].tolist(), draw)
        pairs = game.pairs_of(state)
        return int(game.stroke_at(state, bisect.bisect_right(policy.cumulative, draw, pairs.start, pairs.stop) - pairs.start))
    scores = None if score is None else np.array([score], np.int16)
    history = None if strokes is None else np.array([[*strokes[: -LAGS - 1 : -1], *LAGS * [game.n_strokes]][:LAGS]], np.int32)
    number = None if strokes is None else np.array([len(strokes) + 1], np.int32)
    states = States(game=game, state=np.array([state], np.int32), score=scores, history=history, number=number)
    p = checked_positions(policy, states) if waits else checked_probabilities(policy, states)
    return first + int(drawn_strokes(p, np.array([draw]))[0])


_RALLIES: Final = 32
_STROKES: Final = 32


class RallyDraws:
    """Draws of rallies 0, 1, 2, … of one stream, computed in blocks.

    Stroke k of rally r uses ``draw(stream(seed, *numbers, r), k)``: ``outcome_draw`` of it decides the outcome, ``choice_draw``
    chooses the stroke where a policy plays, ``position_draw`` where the receiver waits, and ``first_server`` at k = 0 decides who
    serves where that is random.
    """

    def __init__(self, seed: int, *numbers: int) -> None:
        self._name = (seed, *numbers)
        self._block = -1
        self._bits: U64 = np.empty(0, np.uint64)
        self._outcomes = array("I")
        self._choices, self._positions = array("H"), array("H")
        self._first_servers = b""

    def __reduce__(self) -> tuple[Any, ...]:
        return RallyDraws, self._name

    def first_server(self, rally: int) -> int:
        """Random seat that serves in a rally: 0 or 1."""
        if rally // _RALLIES != self._block:
            self._prepare(rally // _RALLIES)
        return self._first_servers[rally % _RALLIES]

    def outcome(self, rally: int, stroke: int) -> int:
        """Number in [0, 2^24) that decides the outcome of a stroke."""
        if stroke >= _STROKES:
            return self._single(rally, stroke)[0]
        if rally // _RALLIES != self._block:
            self._prepare(rally // _RALLIES)
        return self._outcomes[rally % _RALLIES * _STROKES + stroke]

    def choice(self, rally: int, stroke: int) -> int:
        """Number in [0, 65535) by which a policy chooses a stroke."""
        if stroke >= _STROKES:
            return self._single(rally, stroke)[1]
        if rally // _RALLIES != self._block:
            self._prepare(rally // _RALLIES)
        if not self._choices:
            self._choices = array("H", choice_draw(self._bits).astype(np.uint16).tobytes())
        return self._choices[rally % _RALLIES * _STROKES + stroke]

    def position(self, rally: int, stroke: int) -> int:
        """Number in [0, 65535) by which a policy chooses where it waits for a stroke."""
        if stroke >= _STROKES:
            return self._single(rally, stroke)[2]
        if rally // _RALLIES != self._block:
            self._prepare(rally // _RALLIES)
        if not self._positions:
            self._positions = array("H", position_draw(self._bits).astype(np.uint16).tobytes())
        return self._positions[rally % _RALLIES * _STROKES + stroke]

    def _single(self, rally: int, stroke: int) -> tuple[int, int, int]:
        """Outcome, choice and position of a stroke beyond the block."""
        bits = draw(stream(*self._name, rally), stroke)
        return int(outcome_draw(bits)[0]), int(choice_draw(bits)[0]), int(position_draw(bits)[0])

    def _prepare(self, block: int) -> None:
        rallies = np.arange(block * _RALLIES, (block + 1) * _RALLIES)
        bits = draw(stream(*self._name, rallies)[:, None], np.arange(_STROKES))
        self._outcomes = array("I", outcome_draw(bits).astype(np.uint32).tobytes())
        self._bits, self._choices, self._positions = bits, array("H"), array("H")
        self._first_servers = first_server(bits[:, 0]).astype(np.uint8).tobytes()
        self._block = block
