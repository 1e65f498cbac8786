"""Rallies played by PyTorch on any device: one stroke of all rallies at a time, from tables on the device.

The draws, thresholds and table entries are those of the compiled kernel, so the strokes are equal bit for bit, which tests check;
the kernel replays rallies for the log. The kernel also writes the table entries, and changed ones are copied to the device.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import torch

from shuttle_marl.base.arrays import I32, I64, Floats, Ints
from shuttle_marl.game.draws import CHOICE_ONE, GOLDEN, MIX_1, MIX_2
from shuttle_marl.game.rules import RETURNED_BELOW
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.game.thresholds import ONE
from shuttle_marl.kernel import Assess, Distinct, RallySampler
from shuttle_marl.kernel.core import KernelError, tables_of
from shuttle_marl.kernel.table_play import START, StrokeList, new_stroke_list

_WAITS: Final = 0
"""Value of ``turn`` of a rally that waits for a table entry."""
_RANKS: Final = 256
"""Maximum number of legal strokes in a state."""


class _Rallies(NamedTuple):
    """Rallies that are played together.

    Attributes:
        key: ``[R]`` key of the draws.
        opponent: ``[R]`` opponent of the learner, who has seat 0; -1: the learner itself.
        both: ``[R]`` whether both players are the learner.
        server: ``[R]`` seat that serves.
        state: ``[R]`` state of the last stroke, or of a missing table entry.
        outcome: ``[R]`` outcome of the last stroke.
        length: ``[R]`` number of strokes of both players.
        turn: ``[R]`` turn in which it ended (the network is evaluated between turns), or _WAITS.
    """

    key: torch.Tensor
    opponent: torch.Tensor
    both: torch.Tensor
    server: torch.Tensor
    state: torch.Tensor
    outcome: torch.Tensor
    length: torch.Tensor
    turn: torch.Tensor


class _Struck(NamedTuple):
    """Strokes of both players.

    Attributes:
        row: ``[N]`` rally.
        t: ``[N]`` number within the rally.
        state: ``[N]`` state of the striker.
        pair: ``[N]`` legal pair.
        counts: ``[N]`` whether it is the learner's, played from a valid table entry.
    """

    row: torch.Tensor
    t: torch.Tensor
    state: torch.Tensor
    pair: torch.Tensor
    counts: torch.Tensor


class _Learners(NamedTuple):
    """Strokes of the learner, rally after rally.

    Attributes:
        state: ``[N]`` state of the striker.
        pair: ``[N]`` legal pair.
        advantage: ``[N]`` float64 generalised advantage.
        credited: ``[N]`` position in the order of the kernel: rally after rally, each from its last stroke.
        following: ``[N]`` next state of the learner (in self-play: of the opponent), -1 at the end of the rally.
        gain: ``[N]`` float64 reward, including shaping.
    """

    state: torch.Tensor
    pair: torch.Tensor
    advantage: torch.Tensor
    credited: torch.Tensor
    following: torch.Tensor
    gain: torch.Tensor


def _here(tensor: torch.Tensor, kind: npt.DTypeLike) -> npt.NDArray[Any]:
    return tensor.cpu().numpy().astype(kind)


class TorchSampler(RallySampler):
    """:class:`~shuttle_marl.kernel.RallySampler` on a PyTorch device.

    Strokes, states and outcomes are equal to the kernel's; sums of advantages are equal up to rounding. The order of transitions
    is equal unless the kernel's buffer has to grow.

    Args:
        opponents: tabulated opponents; none: self-play.
        gae_lambda: lambda of the advantages, from 0 to 1.
        cache_iterations: iterations for which cached network outputs are reused.
        shaping: ``[L * base pairs]`` what a stroke adds to the learner's reward, by own effort and base pair; None: nothing.

    Raises:
        KernelError: an opponent of another game, a number out of range, or the game with recovery.
    """

    def __init__(
        self,
        game: Game,
        opponents: Sequence[TabulatedPolicy] = (),
        *,
        device: torch.device | str,
        gae_lambda: float = 1.0,
        cache_iterations: int = 1,
        shaping: Floats | None = None,
    ) -> None:
        if game.recovery is not None:
            raise KernelError("the sampler torch does not play the game with recovery; choose kernel (--sampler kernel) or auto")
        self._device = torch.device(device)
        self._limits = self._there(tables_of(game).limits.view(np.int64))
        self._limit_row = torch.empty(game.n_pairs, dtype=torch.int32, device=self._device)
        self._arrival = torch.empty(game.n_pairs, dtype=torch.int32, device=self._device)
        for block in range(game.n_blocks):  # block by block, to limit the size of temporary arrays
            part = game.block_pairs(block)
            self._limit_row[part] = self._there(game.limit_row(part))
            self._arrival[part] = self._there(game.arrivals(part)[:, 0])
        self._first_pair = self._there(game.pair_start[:-1])
        self._value = torch.zeros(game.n_states, device=self._device)
        self._written = torch.zeros(game.n_states, dtype=torch.int32, device=self._device)
        self._parts: list[_Learners] = []
        self._collected = _Learners(*(torch.zeros(0, dtype=torch.int64, device=self._device) for _ in _Learners._fields))
        super().__init__(game, opponents, gae_lambda=gae_lambda, cache_iterations=cache_iterations, shaping=shaping)
        self._added = self._there(self._shaping)
        # States without a table entry need a legal stroke too, although it does not count.
        self._learned.players.cumulative[0, game.last_pairs] = CHOICE_ONE
        self._choices = torch.empty((len(opponents) + 1) * game.n_pairs, dtype=torch.int64, device=self._device)
        for player in range(len(opponents) + 1):
            self._copy_all(player)

    def _there(self, array: npt.NDArray[np.generic]) -> torch.Tensor:
        return torch.tensor(array, device=self._device)

    def reset(self, seed: int, known: Ints | None = None) -> None:
        """Restart with rally 0 of a seed, see :meth:`shuttle_marl.kernel.RallySampler.reset`."""
        super().reset(seed, known)
        self._written.zero_()

    def replace_opponent(self, number: int, policy: TabulatedPolicy) -> None:
        """Replace an opponent, see :meth:`shuttle_marl.kernel.RallySampler.replace_opponent`."""
        super().replace_opponent(number, policy)
        self._copy_all(number + 1)

    def _refresh(self, states: I32, assess: Assess) -> None:
        try:
            super()._refresh(states, assess)
        finally:
            self._copy(0, states)
            where = self._there(states).long()
            self._value[where] = self._there(self._learned.value[states])
            self._written[where] = self._there(self._learned.written[states])

    def _copy(self, player: int, states: Ints) -> None:
        """Copy a player's table entries of some states to the device."""
        row, pairs = self.game.pairs(states)
        first = (player * self.game.n_states + states.astype(np.int64)) * ONE
        entries = first[row] + self._learned.players.cumulative[player, pairs]
        self._choices[self._there(player * self.game.n_pairs + pairs)] = self._there(entries)

    def _copy_all(self, player: int) -> None:
        states = np.arange(self.game.n_states)
        for block in range(self.game.n_blocks):
            self._copy(player, states[self.game.block_states(block)])

    # Play.

    def _discard(self) -> None:
        """Do nothing: sums are computed in :meth:`take`."""

    def note_next(self) -> None:
        """Do nothing: the kernel replays rallies for a log."""

    def _begin(self, count: int, *, keep: bool) -> None:
        super()._begin(count, keep=False)
        self._keep, self._parts = keep, []

    def _finish(self, numbers: I64, assess: Assess) -> None:
        number = self._there(numbers)
        key = extend(signed(int(self._seed_key)), number)
        opponent = self._there(self._opponents)[number % len(self._opponents)]
        server = (draw(key, 0) >> 24) & 1
        rallies = _Rallies(key, opponent, opponent < 0, server, *(torch.zeros_like(number) for _ in range(4)))
        row = torch.arange(len(numbers), device=self._device)
        t, state, struck = torch.zeros_like(number), self._start(key, opponent), list[_Struck]()
        # Rallies that wait for table entries stop until no rally can continue; then the network is evaluated for all of them.
        for turn in itertools.count(1):
            struck += self._advance(rallies, turn, row, t, state)
            row = (rallies.turn == _WAITS).nonzero().squeeze(1)
            if not len(row):
                break
            t, state = rallies.length[row], rallies.state[row]
            asked = _here(state, np.int32)
            self._refresh(asked[np.sort(np.unique(asked, return_index=True)[1])], assess)
        self._credit(rallies, _Struck(*(torch.cat(parts) for parts in zip(*struck, strict=True))))

    def _advance(
        self, rallies: _Rallies, turn: int, row: torch.Tensor, t: torch.Tensor, state: torch.Tensor
    ) -> Iterator[_Struck]:
        """Play rallies until each has ended or waits for a table entry.

        Args:
            rallies: all rallies, changed in place.
            row: ``[A]`` rallies to play.
            t: ``[A]`` number of the next stroke.
            state: ``[A]`` state of its striker.

        Yields:
            One stroke of each active rally.
        """
        while len(row):
            bits, mine = draw(rallies.key[row], t), rallies.both[row] | ((rallies.server[row] + t) % 2 == 0)
            waits = mine & (self._written[state] < self._oldest)
            pair = self._chosen(state, torch.where(mine, 0, rallies.opponent[row]), bits)
            outcome = _outcome(self._limits[self._limit_row[pair].long()], bits)
            yield _Struck(row, t, state, pair, mine & ~waits)
            rallies.state[row], rallies.outcome[row] = state, outcome
            rallies.length[row], rallies.turn[row] = t + (~waits).long(), torch.where(waits, _WAITS, turn)
            # The only synchronisation with the device per stroke: the number of rallies that continue.
            on = (~waits & (outcome >= RETURNED_BELOW)).nonzero().squeeze(1)
            row, t, state = row[on], t[on] + 1, self._arrival[pair[on]] + outcome[on] - RETURNED_BELOW

    def _start(self, key: torch.Tensor, opponent: torch.Tensor) -> torch.Tensor:
        """``[R]`` initial states: the serve, or a drawn state in some rallies of self-play."""
        serve, states = torch.zeros_like(key), self._starts.states
        if not len(states):
            return serve
        bits = draw(key, START)
        drawn = self._there(states)[(shifted(bits, 32) * len(states)) >> 32].long()
        return torch.where((opponent < 0) & ((bits & (ONE - 1)) < int(self._starts.fraction[0])), drawn, serve)

    def _chosen(self, state: torch.Tensor, player: torch.Tensor, bits: torch.Tensor) -> torch.Tensor:
        """``[R]`` chosen legal pairs: the first table entry above the draw.

        Each state of each player has its own range of numbers, so the entries of all players are sorted.
        """
        numbers = (player * self.game.n_states + state) * ONE + ((shifted(bits, 32) * CHOICE_ONE) >> 32)
        return torch.searchsorted(self._choices, numbers, right=True) - player * self.game.n_pairs

    # Credit.

    def _credit(self, rallies: _Rallies, struck: _Struck) -> None:
        """Compute rewards and advantages of finished rallies."""
        both, server, outcome, length = rallies.both, rallies.server, rallies.outcome, rallies.length
        reward = torch.where(both | ((server + length) % 2 == 1), 2 * outcome - 1, 1 - 2 * outcome)
        own = torch.where(both, length, (length - server + 1) // 2)
        counts = (own.sum(), len(own), (~both & (reward > 0)).sum(), length.sum())
        self._sums.total[[0, 1, 2, 5]] += [int(count) for count in counts]
        # The learner's strokes, rally after rally, in the order of the turns in which the rallies ended.
        order = rallies.turn.argsort(stable=True)
        first = torch.empty_like(own).scatter_(0, order, own[order].cumsum(0) - own[order])
        row, t, state, pair, _ = (part[struck.counts.nonzero().squeeze(1)] for part in struck)
        place = torch.where(both[row], t, (t - server[row]) // 2)
        in_order = (first[row] + place).argsort()
        row, t, state, pair, place = (part[in_order] for part in (row, t, state, pair, place))
        last = place == own[row] - 1
        gain = torch.where(last, reward[row], 0).double()
        if len(self._added):
            gain = torch.where(both[row], gain, gain + self._added[pair.long()].double())
        # gamma = -1 in self-play, where the next state belongs to the opponent, and 0 at the end of a rally.
        sign = torch.where(last, 0.0, torch.where(both[row], -1.0, 1.0)).double()
        advantage = self._advantages(gain, sign, state, t)
        following = torch.where(last, -1, state.roll(-1))
        credited = (first + own)[row] - 1 - place
        self._parts.append(_Learners(state, pair, advantage, credited, following, gain))

    def _advantages(self, gain: torch.Tensor, sign: torch.Tensor, state: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        """``[N]`` generalised advantages, A_t = r_t + gamma V(s_{t+1}) - V(s_t) + gamma lambda A_{t+1}.

        Args:
            gain: ``[N]`` reward r of each stroke of the learner, rally after rally.
            sign: ``[N]`` gamma.
            state: ``[N]`` state s.
            t: ``[N]`` number within the rally.
        """
        value, weight = self._value[state].double(), sign * self._gae_lambda
        advantage = torch.zeros(len(t) + 1, dtype=torch.float64, device=self._device)
        advantage[:-1] = gain + sign * value.roll(-1) - value
        # All strokes with the same number at once, backwards from the last number.
        for now in reversed(torch.split(t.argsort(), t.bincount().tolist())):
            advantage[now] += weight[now] * advantage[now + 1]
        return advantage[:-1]

    def _end(self) -> None:
        offsets = itertools.accumulate((len(part.state) for part in self._parts[:-1]), initial=0)
        credited = torch.cat([part.credited + offset for part, offset in zip(self._parts, offsets, strict=True)])
        played = self._collected = _Learners(*(torch.cat(parts) for parts in zip(*self._parts, strict=True)))
        for place, amounts in ((3, played.advantage), (4, played.advantage.square())):
            numbers, unit = whole(amounts)
            self._sums.total[place] = int(numbers.sum()) * unit
        # States in the order in which the kernel visits them.
        seen, of = played.state[credited.argsort()].sort(stable=True)
        visited, count = torch.unique_consecutive(seen, return_counts=True)
        self._known = _here(visited[of[count.cumsum(0) - count].argsort()], np.int32)
        self._sums.total[6] = len(self._known)
        if self._keep:
            columns = (played.state, played.pair, played.following, played.gain, played.advantage)
            kinds = (column.dtype for column in new_stroke_list())
            self.strokes = StrokeList(*(_here(column, kind) for column, kind in zip(columns, kinds, strict=True)))

    def take(self, order: Ints | None = None) -> Distinct:
        """Take the collected strokes as distinct states, see :meth:`shuttle_marl.kernel.RallySampler.take`."""
        states = np.sort(self._known) if order is None else self._known[np.asarray(order)]
        played, size = self._collected, len(states)
        self._collected = _Learners(*(part[:0] for part in played))
        number = torch.zeros(self.game.n_states, dtype=torch.int64, device=self._device)
        number[self._there(states).long()] = torch.arange(size, device=self._device)
        at, negative = number[played.state], (played.advantage <= 0).long()
        keys = (at * _RANKS + played.pair - self._first_pair[played.state]) * 2 + negative
        rows, group = torch.unique(keys, return_inverse=True)
        advantage = sums(group, played.advantage, len(rows))
        rows, advantage = rows[advantage != 0], advantage[advantage != 0]
        row = rows // (2 * _RANKS)
        pair = self._first_pair[self._there(states).long()[row]] + rows // 2 % _RANKS
        visits = at.bincount(minlength=size)
        returns = self._value[self._there(states).long()] + sums(at, played.advantage, size) / visits
        pairs = _here(pair, np.int64)
        return Distinct(
            state=states,
            visits=_here(visits, np.float32),
            returns=_here(returns, np.float32),
            start=_here(torch.searchsorted(row, torch.arange(size + 1, device=self._device)), np.int64),
            row=_here(row, np.int64),
            stroke=self.game.pair_stroke[pairs].astype(np.int64),
            log_probability=self._learned.log_probability[pairs],
            advantage=_here(advantage, np.float32),
            **self._counted(),
        )


def _outcome(limits: torch.Tensor, bits: torch.Tensor) -> torch.Tensor:
    """:func:`shuttle_marl.kernel.core.outcome_of` of ``[R]`` packed thresholds and chances, and draws."""
    low = bits & (ONE - 1)
    fault, returned, above = (low >= (limits >> place & (ONE - 1)) for place in (0, 16, 32))
    hurried = (bits >> 16 & 0xFF) < (limits >> (48 + 8 * above.long()) & 0xFF)
    return fault.long() + returned.long() + above.long() + 2 * (returned & hurried).long()


def signed(number: int) -> int:
    """An unsigned 64-bit number as int64 with the same bits."""
    return number - (1 << 64) if number >> 63 else number


_GOLDEN, _MIX_1, _MIX_2 = (signed(int(number)) for number in (GOLDEN, MIX_1, MIX_2))


def shifted(x: torch.Tensor, bits: int) -> torch.Tensor:
    """Logical right shift."""
    return (x >> bits) & ((1 << (64 - bits)) - 1)


def mix(x: torch.Tensor) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.mix` of int64 numbers; any shape."""
    x = (x ^ shifted(x, 30)) * _MIX_1
    x = (x ^ shifted(x, 27)) * _MIX_2
    return x ^ shifted(x, 31)


def extend(key: int, number: torch.Tensor) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.extend` of one key."""
    return mix((number ^ key) + _GOLDEN)


def draw(key: torch.Tensor, counter: torch.Tensor | int) -> torch.Tensor:
    """:func:`shuttle_marl.game.draws.draw` of int64 keys."""
    return mix(mix(torch.as_tensor(counter, device=key.device) * _GOLDEN + key) + _GOLDEN)


def whole(amounts: torch.Tensor) -> tuple[torch.Tensor, float]:
    """Fixed-point representation of ``[N]`` finite float64 amounts whose sum does not overflow.

    Returns:
        ``[N]`` int64 multiples of a unit, and the unit, a power of two.
    """
    if not len(amounts):
        return amounts.long(), 1.0
    highest = math.frexp(float(amounts.abs().max()))[1]
    unit = 2.0 ** max(highest + len(amounts).bit_length() - 62, -1000)
    return (amounts / unit).round().long(), unit


def sums(group: torch.Tensor, amounts: torch.Tensor, groups: int) -> torch.Tensor:
    """``[groups]`` float64 sums of ``[N]`` amounts by group, independent of the order of summation."""
    numbers, unit = whole(amounts)
    return numbers.new_zeros(groups).index_add_(0, group, numbers).double() * unit
