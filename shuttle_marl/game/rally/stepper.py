"""A rally stroke by stroke, in plain Python: a draw, the stroke that a policy chooses, its outcome, and the next state.

    stepper, draws = stepper_of(game), RallyDraws(seed)
    state, player = ROOT, draws.first_server(rally)
    for i in itertools.count():
        stroke = choose(policies[player], game, state, draws.choice(rally, i))
        played, state = stepper.step(state, player, stroke, draws.outcome(rally, i))
        if played.outcome < RETURNED_BELOW:
            break
        player = 1 - player

The rule is that of :func:`shuttle_marl.game.rules.strike` and the draws are those of :mod:`shuttle_marl.game.draws`, without
the cost of numpy calls on single numbers; tests hold both equal.
"""

import bisect
import functools
from array import array
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.base.arrays import F32, I8, U64
from shuttle_marl.game.draws import choice_draw, draw, first_server, outcome_draw, stream
from shuttle_marl.game.observation import EFFORT, SWAP, features
from shuttle_marl.game.policy import LAGS, Policy, States, checked_probabilities, drawn_strokes
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
        p_ret: probability that a good stroke was returned.
    """

    player: int
    stroke: int
    outcome: int
    p_succ: float
    p_ret: float


class Stepper:
    """A game, or that of a pair, prepared for playing strokes one at a time; read-only. :func:`stepper_of` shares one per game.

    Attributes:
        game: the tables, or the game of a pair.
        observations: ``[base states, 60]`` float32 observation of the striker in each state, efforts zero.
    """

    def __init__(self, game: Game) -> None:
        self.game = game
        self.observations = features(game)
        self._masks = np.ascontiguousarray(game.reply_mask.reshape(-1, game.n_strokes).astype(np.int8))
        self._n, self._one, self._swap = game.n_strokes, ONE, SWAP
        # A memoryview yields Python integers four times as fast as an array, without the memory of a list.
        self._rank = _view(game.reply_rank)
        self._limits = [[_view(limits) for limits in tables.limits] for tables in game.seats]
        self._pair_start = _view(game.base_pair_start)
        self._first_reply = _view(game.first_reply)
        self._hurry = [_view(tables.hurry) for tables in game.seats]
        self._arrival = _view(4 * game.reply_edge + game.edge_attack[game.reply_edge])
        self._incoming = _view(game.edge_incoming)
        self._size, self._levels = game.n_base_states, game.levels
        self._next_block = [tuple(b * self._size for b in game.block_following(block)) for block in range(game.n_blocks)]
        highest = max(1, game.levels - 1)
        self._efforts = [(own / highest, other / highest) for own in range(game.levels) for other in range(game.levels)]

    def __deepcopy__(self, memo: dict[int, Any]) -> "Stepper":
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        return stepper_of, (self.game,)

    def observe(self, state: int, *, receiver: bool = False) -> F32:
        """``[60]`` observation of the striker in a state, or of the receiver; a new array."""
        block, base = divmod(state, self._size)
        row: F32 = self.observations[base].copy()
        if block:
            row[_EFFORTS] = self._efforts[block]
        return row[self._swap] if receiver else row

    def legal_action_mask(self, state: int) -> I8:
        """``[n]`` int8 legal strokes of a state, a new array."""
        mask: I8 = self._masks[self._reply(state)].copy()
        return mask

    def is_legal(self, state: int, stroke: int) -> bool:
        """Whether a stroke is in the catalogue and legal in a state."""
        return 0 <= stroke < self._n and self._rank[self._reply(state) * self._n + stroke] >= 0

    @staticmethod
    def is_hurried(state: int) -> bool:
        """Whether the striker is hurried in a state."""
        return bool(state & 2)

    def step(self, state: int, player: int, stroke: int, draw: int) -> tuple[Stroke, int]:
        """Play a legal stroke.

        Args:
            stroke: catalogue index, legal in this state; not checked.
            draw: uniform integer in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.

        Returns:
            The stroke and the receiver's state; after a fault or a winner, the state after the stroke with contact below and not
            hurried.
        """
        block, base = divmod(state, self._size)
        k = self._rank[(2 * self._incoming[base >> 2] + (base & 1)) * self._n + stroke]
        pair = self._pair_start[base] + k
        entry = 3 * pair
        limits = self._limits[player][block // self._levels]
        fault, winner, one = limits[entry], limits[entry + 1], self._one
        low = draw & one - 1
        outcome = (low >= fault) + (low >= winner) + (low >= limits[entry + 2])
        if outcome >= RETURNED_BELOW and draw >> 16 < self._hurry[player][2 * pair + outcome - RETURNED_BELOW]:
            outcome += HURRIED_BELOW - RETURNED_BELOW
        arrival = self._arrival[self._first_reply[base] + k]
        following = self._next_block[block][arrival & 1] + (arrival & ~1) + max(outcome - RETURNED_BELOW, 0)
        return Stroke(player, stroke, outcome, (one - fault) / one, (one - winner) / (one - fault)), following

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


def choose(
    policy: Policy,
    game: Game,
    state: int,
    draw: int,
    score: tuple[int, int, int, int] | None = None,
    strokes: Sequence[int] | None = None,
) -> int:
    """Catalogue index of the stroke that a policy plays in one state.

    Args:
        policy: a :class:`~shuttle_marl.game.tabulated.TabulatedPolicy` of this game, or any other policy.
        draw: uniform integer in [0, 65535); see :func:`shuttle_marl.game.draws.choice_draw`.
        score: points of the striker, of the receiver, games of the striker, of the receiver; None outside of matches.
        strokes: catalogue indices of the rally so far; None: not known.

    Raises:
        PolicyError: the policy raised or returned no distribution over the legal strokes.
    """
    if isinstance(policy, TabulatedPolicy):
        pairs = game.pairs_of(state)
        return int(game.stroke_at(state, bisect.bisect_right(policy.cumulative, draw, pairs.start, pairs.stop) - pairs.start))
    scores = None if score is None else np.array([score], np.int16)
    history = None if strokes is None else np.array([[*strokes[: -LAGS - 1 : -1], *LAGS * [game.n_strokes]][:LAGS]], np.int32)
    states = States(game=game, state=np.array([state], np.int32), score=scores, history=history)
    return int(drawn_strokes(checked_probabilities(policy, states), np.array([draw]))[0])


_RALLIES: Final = 32
_STROKES: Final = 32


class RallyDraws:
    """Draws of rallies 0, 1, 2, … of one stream, computed in blocks.

    Stroke k of rally r uses ``draw(stream(seed, *numbers, r), k)``: ``outcome_draw`` of it decides the outcome, ``choice_draw``
    chooses the stroke where a policy plays, and ``first_server`` at k = 0 decides who serves where that is random.
    """

    def __init__(self, seed: int, *numbers: int) -> None:
        self._name = (seed, *numbers)
        self._block = -1
        self._bits: U64 = np.empty(0, np.uint64)
        self._outcomes = array("I")
        self._choices = array("H")
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

    def _single(self, rally: int, stroke: int) -> tuple[int, int]:
        """Outcome and choice of a stroke beyond the block."""
        bits = draw(stream(*self._name, rally), stroke)
        return int(outcome_draw(bits)[0]), int(choice_draw(bits)[0])

    def _prepare(self, block: int) -> None:
        rallies = np.arange(block * _RALLIES, (block + 1) * _RALLIES)
        bits = draw(stream(*self._name, rallies)[:, None], np.arange(_STROKES))
        self._outcomes = array("I", outcome_draw(bits).astype(np.uint32).tobytes())
        self._bits, self._choices = bits, array("H")
        self._first_servers = first_server(bits[:, 0]).astype(np.uint8).tobytes()
        self._block = block
