"""Whole rallies of a learner that acts from a table, summed up by state and stroke: millions of strokes a second.

Few states make up most of the play, so the network is evaluated once for each of them, and its outputs are stored in a table. A
rally that reaches a state whose entry is missing or stale waits there until the network is evaluated in all such states together.
Advantages (Schulman et al. 2016) are summed for each state and stroke, positive and negative ones apart: the clipped objective
of PPO is linear in each of the two, so its gradient over distinct pairs is that over all strokes.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from shuttle_marl.base.arrays import F32, I32, I64, Floats, Ints
from shuttle_marl.base.errors import whole_number
from shuttle_marl.game import draws
from shuttle_marl.game.policy import TabulatedPolicy
from shuttle_marl.game.rally import Rallies, stroke_dtype
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import WINNER
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import table_play
from shuttle_marl.kernel.core import BLOCK, KernelError, checked_array, tables_of
from shuttle_marl.kernel.players import empty_players, pack, put_player
from shuttle_marl.kernel.rows import new_rows
from shuttle_marl.kernel.table_play import Distinct, Learned, Played, StrokeList, Tape

Assess = Callable[[I32], tuple[F32, F32]]
"""Maps states ``[U]`` to logits of all strokes ``[U, n]`` and values to the striker ``[U]``.

With recovery it maps decisions, states or S plus the state in which the opponent strikes, to logits of all strokes and positions
``[U, n + 9]`` and values to the player who decides.
"""

_ROOM: Final = 8  # strokes on the tape for each stroke that is asked for; memory that is not written costs nothing
_WHOLE: Final = 1 << 16
_GUESS: Final = 4.0  # initial guess of the learner's strokes per rally


class RallySampler:
    """Plays a learner's rallies against tabulated opponents, or against itself.

    Rally k of a seed has the draws of rally k in :class:`~shuttle_marl.kernel.RallyBatch`; the learner plays at seat 0.

    Args:
        opponents: tabulated opponents; none: self-play.
        gae_lambda: lambda of the advantages, from 0 to 1.
        cache_iterations: iterations for which cached network outputs are reused.
        shaping: ``[L * base pairs]`` addition to the learner's reward, by own effort and base pair; None: no shaping.

    Raises:
        KernelError: an opponent of another game, or a number out of range.
    """

    def __init__(
        self,
        game: Game,
        opponents: Sequence[TabulatedPolicy] = (),
        *,
        gae_lambda: float = 1.0,
        cache_iterations: int = 1,
        shaping: Floats | None = None,
    ) -> None:
        if not 0 <= gae_lambda <= 1 or cache_iterations < 1:
            given = f"gae_lambda {gae_lambda}, cache_iterations {cache_iterations}"
            raise KernelError(f"{given}: expected 0 to 1, and 1 iteration or more")
        self.game, self._gae_lambda, self._cache_iterations = game, float(gae_lambda), cache_iterations
        self._tables = tables_of(game)
        players = empty_players(game, 1 + len(opponents))
        for number, policy in enumerate(opponents, start=1):
            put_player(players, number, policy, game)
        # Numbers of decisions and of their options, see table_play.
        states = game.n_decisions
        pairs = game.n_pairs + N_POSITIONS * (states - game.n_states)
        self._learned = Learned(players, np.zeros(pairs, np.float32), np.zeros(states, np.float32), np.zeros(states, np.int32))
        self._sums = table_play.Sums(
            np.zeros((pairs, 3), np.float32), np.zeros((states, 2), np.float32), np.zeros(states, np.int32), np.zeros(7)
        )
        self._shaping = np.zeros(0, np.float32)
        if shaping is not None:
            self._shaping = checked_array("shaping", shaping, np.float32, (game.limits[..., 0].size,))[game.limit_row()]
        self._opponents = np.arange(1, len(opponents) + 1, dtype=np.int32) if opponents else np.full(1, -1, np.int32)
        self._starts, self._fraction = np.zeros(0, np.int32), 0
        self._now = 0
        self._known = np.zeros(0, np.int32)
        self._untaken = False
        self.strokes, self._listed = table_play.new_stroke_list(), np.zeros(1, np.int64)
        self._played, self._tape = table_play.new_played(0), table_play.new_tape(0)
        self.reset(0)

    @property
    def known(self) -> I32:
        """States of the last iteration, whose entries are refreshed at the start of the next one."""
        return self._known

    def reset(self, seed: int, known: Ints | None = None) -> None:
        """Restart with rally 0 of a seed. All later rallies depend on the seed, ``known`` and the network alone.

        Args:
            known: ``[U]`` earlier value of :attr:`known`; None: the present value.

        Raises:
            KernelError: a state that does not exist or has no legal strokes.
        """
        self._discard()
        self._seed_key = draws.stream(seed)[0]
        self._first, self._next, self._seen, self._rallies = 0, 0, 0.0, 0
        self._learned.written[:] = 0
        self._now = 0
        if known is not None:
            self._known = self._playable(known, len(self._learned.written) - 1)

    def assign(self, opponents: Ints) -> None:
        """Set the opponents of the rallies.

        Args:
            opponents: ``[K]`` opponent of rally r is entry r modulo K: an index into the opponents, or -1: the learner itself.

        Raises:
            KernelError: an invalid index.
        """
        number = checked_array("opponents", opponents, np.int32, (len(opponents),), -1, len(self._learned.players.guide) - 2)
        self._opponents = np.where(number < 0, -1, number + 1).astype(np.int32)

    def restart(self, states: Ints, fraction: float) -> None:
        """Let some rallies of self-play start in other states than the serve.

        Args:
            states: ``[M]`` initial states, drawn with equal probabilities.
            fraction: fraction of the rallies, from 0 to 1.

        Raises:
            KernelError: a state that does not exist or has no legal strokes, or a fraction out of range.
        """
        if not 0 <= fraction <= 1:
            raise KernelError(f"fraction {fraction}: expected 0 to 1")
        self._starts, self._fraction = self._playable(states, self.game.n_states - 1), round(fraction * _WHOLE)

    def _playable(self, states: Ints, highest: int) -> I32:
        checked = checked_array("states", states, np.int32, (len(states),), 0, highest)
        if not self.game.playable[checked % self.game.n_states].all():
            raise KernelError("states: one has no legal strokes")
        return checked

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Replace an opponent. Raises KernelError: a policy of another game, or an invalid number."""
        if number < 0:
            raise KernelError(f"opponent number {number}: expected 0 or more")
        put_player(self._learned.players, number + 1, policy, self.game)

    def collect(self, count: int, assess: Assess, *, keep: bool = False) -> None:
        """Play whole rallies until the learner has played a number of strokes; strokes that were not taken are dropped.

        Args:
            count: least number of strokes.
            keep: whether to list the strokes one by one in :attr:`strokes`.

        Raises:
            KernelError: the outputs of the network are not finite.
        """
        self._discard()
        self._now += 1
        self._untaken = True
        if len(self._tape.state) < _ROOM * count:
            self._tape = table_play.new_tape(_ROOM * count)
        self._sums.total[:] = self._listed[:] = self._tape.used[:] = 0
        self.strokes = table_play.new_stroke_list(2 * len(self._tape.state) * keep)
        self._played, self._first = table_play.new_played(0), self._next
        self._refresh(self._known, assess)
        while self._sums.total[0] < count:
            length = self._seen / self._rallies if self._rallies else _GUESS
            wanted = max(1, math.ceil((count - self._sums.total[0]) / max(length, 0.5)))
            before = self._sums.total[:2].copy()
            self._finish(wanted, assess)
            self._seen += self._sums.total[0] - before[0]
            self._rallies += self._sums.total[1] - before[1]
        self.strokes = StrokeList._make([column[: self._listed[0]] for column in self.strokes])
        self._known = self._sums.visited[: int(self._sums.total[6])].copy()

    def _discard(self) -> None:
        """Drop strokes that were collected but not taken, also after an error of the network."""
        if self._untaken:
            self._sums.state[:] = self._sums.pair[:] = 0
            self._untaken = False

    def _finish(self, rallies: int, assess: Assess) -> None:
        """Play the next rallies to their end and add them up."""
        schedule = table_play.Schedule(self._opponents, self._starts, self._fraction, self._seed_key, self._oldest)
        new = table_play.new_played(rallies)
        table_play.begin(schedule, self._next, new)
        waiting = len(self._played.key) + np.arange(rallies)
        self._played = Played._make([np.r_[getattr(self._played, name), getattr(new, name)] for name in Played._fields])
        self._next += rallies
        missing, lanes = np.empty(2 * rallies, np.int32), new_rows(BLOCK)
        while len(waiting):
            collected = table_play.Collected(self._sums, self.strokes, self._listed, self._gae_lambda, self._shaping)
            args = (self._tables, self._learned, schedule, self._played, waiting, lanes, self._tape, missing, collected)
            left, wanted = table_play.advance(*args)
            waiting = waiting[:left]
            if left and not wanted:
                self._tape = doubled(self._tape)
                self.strokes = StrokeList._make([np.resize(column, 2 * len(column)) for column in self.strokes])
            self._refresh(missing[:wanted], assess)

    @property
    def _oldest(self) -> int:
        """First iteration whose entries may be used."""
        return max(1, self._now - self._cache_iterations + 1)

    def _refresh(self, states: I32, assess: Assess) -> None:
        self._learned.written[states] = 0  # requested again if the network fails
        for first in range(0, len(states), 1 << 13):
            part = np.ascontiguousarray(states[first : first + (1 << 13)])
            logits, value = assess(part)
            logits = checked_array("logits", logits, np.float32, (len(part), self.game.n_actions))
            value = checked_array("values", value, np.float32, (len(part),))
            wrong = table_play.write(self._tables, self._learned, part, logits, value, self._now)
            if wrong >= 0:
                where = self.game.describe(int(part[wrong]) % self.game.n_states)
                raise KernelError(f"outputs of the network are not finite in state: {where}")

    def take(self, order: Ints | None = None) -> Distinct:
        """Return the strokes as distinct states, and reset the sums; ``order``: ``[U]`` permutation of :attr:`known`."""
        known, self._untaken = self._known, False
        states = np.sort(known) if order is None else known[np.asarray(order)]
        count, rallies, won, total, squares, played = self._sums.total[:6].tolist()
        room = 2 * int(count)  # of which only what is written takes memory
        out = Distinct(
            state=states,
            visits=np.empty(len(states), np.float32),
            returns=np.empty(len(states), np.float32),
            start=np.empty(len(states) + 1, np.int64),
            row=np.empty(room, np.int64),
            stroke=np.empty(room, np.int64),
            log_probability=np.empty(room, np.float32),
            advantage=np.empty(room, np.float32),
            strokes=int(count),
            deviation=math.sqrt(max(squares / count - (total / count) ** 2, 0.0)),
            rallies=int(rallies),
            won=int(won),
            played=int(played),
        )
        rows = table_play.take(self._tables, self._learned, self._sums, out)
        return out._replace(**{name: getattr(out, name)[:rows] for name in ("row", "stroke", "log_probability", "advantage")})

    @property
    def count(self) -> int:
        """Strokes of the learner in the last iteration."""
        return int(self._sums.total[0])

    @property
    def numbers(self) -> I64:
        """``[R]`` numbers of the rallies of the last iteration that begin with a serve."""
        return self._first + np.flatnonzero(self._played.served)

    def record(self, numbers: Ints, *, figures: bool = False) -> Rallies:
        """Rallies of the last iteration, for a log; to be called before the next iteration.

        Args:
            numbers: ``[R]`` of :attr:`numbers`.
            figures: whether to return ``log_probability`` and ``value`` of the learner's strokes.

        Returns:
            The rallies; ``match`` is their number, policy 0 is the learner, policy 1 + k opponent k.

        Raises:
            KernelError: a rally that was not played in the last iteration.
        """
        number = checked_array("rallies", numbers, np.int64, (len(numbers),), self._first, self._next - 1)
        return _rallies_of(self.game, self._learned, self._played, self._tape, number, self._first, figures=figures)


def play_rallies(game: Game, policies: tuple[TabulatedPolicy, TabulatedPolicy], n: int, *, seed: int = 0) -> Rallies:
    """Play the first n rallies of a seed, with the draws of the first n episodes of ``rally_v0``.

    Args:
        policies: policies at seats 0 and 1.

    Returns:
        The rallies; ``match`` is their number, ``policy`` 0 and 1.

    Raises:
        KernelError: a policy of another game.
    """
    numbers = np.arange(whole_number("rallies", n, 1), dtype=np.int64)
    none, tables = np.empty(0, np.float32), tables_of(game)
    learned = Learned(pack(policies, game), none, none, np.ones(2 * game.n_states, np.int32))
    schedule = table_play.Schedule(np.ones(1, np.int32), np.zeros(0, np.int32), 0, draws.stream(seed)[0], 1)
    played, tape, waiting, lanes = table_play.new_played(n), table_play.new_tape(16 * n), numbers.copy(), new_rows(BLOCK)
    table_play.begin(schedule, 0, played)
    while len(waiting):
        left, _ = table_play.advance(tables, learned, schedule, played, waiting, lanes, tape, np.empty(0, np.int32), None)
        waiting, tape = waiting[:left], doubled(tape) if left else tape
    return _rallies_of(game, learned, played, tape, numbers, 0, figures=False)


def doubled(tape: Tape) -> Tape:
    """The same strokes with twice the capacity."""
    return Tape._make([*(np.concatenate([column, np.empty_like(column)]) for column in tape[:-1]), tape.used])


def _rallies_of(game: Game, learned: Learned, played: Played, tape: Tape, number: I64, first: int, *, figures: bool) -> Rallies:
    """Rallies by their numbers ``[R]``, of those that begin with number ``first``."""
    rows = number - first
    length, server, reason = played.length[rows], played.server[rows].astype(np.uint8), played.outcome[rows].astype(np.uint8)
    count = int(length.sum(dtype=np.int64))
    stroke = np.empty(count, stroke_dtype(game.n_strokes))
    hurried, waited, extra = np.empty(count, np.uint8), np.empty(count, np.int8), np.empty((2 * figures, count), np.float32)
    table_play.read_strokes(tables_of(game), learned, played, tape, rows, stroke, hurried, waited, extra)
    last = (server + length - 1) & 1
    policy = np.zeros((len(number), 2), np.uint16)
    policy[:, 1] = np.maximum(played.opponent[rows], 0)
    return Rallies.of(
        game,
        match=number.astype(np.uint32),
        rally=np.zeros(len(number), np.uint16),
        policy=policy,
        server=server,
        winner=np.where(reason == WINNER, last, 1 - last).astype(np.uint8),
        reason=reason,
        score=np.zeros((len(number), 4), np.uint8),
        length=length,
        stroke=stroke,
        hurried=hurried,
        waited=waited,
        log_probability=extra[0] if figures else None,
        value=extra[1] if figures else None,
    )
