"""The rallies that a batch has played, from the notes of its strokes."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, I64, U8, U16, U32, U64, UInts
from shuttle_marl.base.compiling import compiled
from shuttle_marl.base.errors import OptionError
from shuttle_marl.game.rally import Rallies, stroke_dtype
from shuttle_marl.game.rules import ABANDONED, ILLEGAL_POSITION, NOBODY, RETURNED_BELOW, WINNER
from shuttle_marl.kernel import core
from shuttle_marl.kernel.core import LOW_8, KernelError, Tables, int64
from shuttle_marl.kernel.rally import RallyBatch
from shuttle_marl.kernel.rows import CUT, Tape, new_tape

_MOST_OPPONENTS: Final = 256
_LOW_3: Final = np.uint64(7)
_LOW_4: Final = np.uint64(15)
_LOW_32: Final = np.uint64(2**32 - 1)


class _Numbers(NamedTuple):
    """Of each row: episodes begun since the seed, the next rally of the match, and the match."""

    episodes: I64
    rally: I64
    match: I64


class _Read(NamedTuple):
    """Columns of :class:`~shuttle_marl.game.rally.Rallies`, with room to spare."""

    match: U32
    rally: U16
    policy: U16
    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    episode: U32
    ending: U8
    stroke: UInts
    hurried: U8
    waited: I8


@compiled
def _read(
    tables: Tables, tape: Tape, kept: U64, ahead: I32, learners: I8, numbers: _Numbers, matches: int, out: _Read
) -> tuple[int, int, int]:
    """Write the rallies that have ended, keep the notes after them, and empty the tape; numbers of rallies, strokes, matches."""
    # `kept` are `[B, m]` notes of rallies that had not ended before, `ahead` of each row; learners of both seats are at seat -1.
    rallies = strokes = 0
    for i in range(tape.used.size):
        seat, first, begin, own, s, ending = learners[i], 0, strokes, False, 0, 0
        for j in range(ahead[i] + tape.used[i]):
            note = np.uint64(kept[i, j] if j < ahead[i] else tape.code[i, j - ahead[i]])
            outcome, striker = int64((note >> np.uint64(32)) & _LOW_3), int64((note >> np.uint64(39)) & np.uint64(1))
            cut = note & CUT != 0
            if j == first:
                server = striker
            if not cut:
                arrival = int64(note & _LOW_32)
                out.stroke[strokes] = tables.incoming[core.base_of(tables, arrival) >> np.uint64(2)]
                out.waited[strokes] = core.position_at(tables, s, int64((note >> np.uint64(35)) & _LOW_4))
                out.hurried[strokes] = core.hurried_in(s)
                strokes += 1
                own |= (seat < 0) | (striker == seat)
                s, ending = core.next_state(arrival, outcome), outcome
                if outcome >= RETURNED_BELOW:
                    continue
            score = tape.score[i, j - ahead[i]] if tape.score.shape[1] else np.uint32(0)
            if score == 0:
                numbers.episodes[i] += 1
                numbers.rally[i] = 0
                numbers.match[i] = matches
                matches += 1
            loser = max(seat, 0) if cut else striker ^ (outcome == WINNER)
            r = rallies
            out.match[r], out.rally[r] = numbers.match[i], numbers.rally[i]
            out.policy[r, :] = 1 + ((note >> np.uint64(40)) & LOW_8)
            out.policy[r, max(seat, 0)] = 0
            out.server[r], out.reason[r] = server, outcome
            out.winner[r] = NOBODY if outcome > ILLEGAL_POSITION else 1 - loser
            for k in range(4):
                out.score[r, k] = (score >> np.uint32(8 * k)) & np.uint32(255)
            out.length[r] = strokes - begin
            out.episode[r] = i + tape.used.size * (numbers.episodes[i] - 1)
            out.ending[r] = ending
            numbers.rally[i] += 1
            if own or outcome != ABANDONED:
                rallies += 1
            else:
                strokes = begin
            first, begin, own, s, ending = j + 1, strokes, False, 0, 0
        strokes = begin
        left = ahead[i] + tape.used[i] - first
        for j in range(left):
            kept[i, j] = kept[i, first + j] if first + j < ahead[i] else tape.code[i, first + j - ahead[i]]
        ahead[i] = left
        tape.used[i] = 0
    return rallies, strokes, matches


class TapeReader:
    """Hands on the rallies of a batch that was made with ``record=True``, as they end.

    Policy 0 is the learner, 1 + k opponent k; without opponents policy 0 is seat 0. ``match`` numbers the matches in the order in
    which they are read. A rally that was abandoned before the learner had struck is left out.

    Args:
        add: is given the rallies.
        finish: is called at the end.
        thread: whether to read rallies in a background thread while the batch plays on.

    Raises:
        OptionError: more than 256 opponents.
    """

    def __init__(
        self,
        batch: RallyBatch,
        add: Callable[[Rallies], None],
        finish: Callable[[], None] = lambda: None,
        *,
        thread: bool = False,
    ) -> None:
        if batch.n_opponents > _MOST_OPPONENTS:
            raise OptionError(f"{batch.n_opponents} opponents: up to {_MOST_OPPONENTS} can be recorded")
        assert batch.tape is not None
        self._batch, self._add, self._finish, self._matches = batch, add, finish, 0
        self._thread = ThreadPoolExecutor(1, "reading a tape")
        self._reading: Future[None] | None = None
        # Swapped with the batch's, which the thread then reads.
        self._other = new_tape(len(batch), scored=batch.matches is not None) if thread else None
        self._begin(0)

    def _begin(self, seed: int) -> None:
        size = len(self._batch)
        self._seed, self._numbers = seed, _Numbers(*np.zeros((3, size), np.int64))
        self._kept, self._ahead = np.empty((size, 0), np.uint64), np.zeros(size, np.int32)
        assert self._batch.tape is not None
        self._batch.tape.used[:], self._batch.rows.live[:] = 0, False

    def reseed(self, seed: int) -> None:
        """Read the rest of a seed, before the batch is reset to another one."""
        self._batch.cut(np.flatnonzero(self._batch.rows.live), ABANDONED)
        self.read()
        self._begin(seed)

    def close(self) -> None:
        """Read the rest, and finish."""
        self.reseed(0)
        self._thread.shutdown()
        self._finish()

    def step(self) -> None:
        """Read the tape if it is half full. Raises KernelError: a row played more strokes in one step than there is room for."""
        tape = self._batch.tape
        assert tape is not None
        if 2 * int(tape.used.max()) < tape.code.shape[1]:
            return
        if self._other is None:
            self._read(tape)
            return
        self._wait()
        self._batch.tape, self._other = self._other, tape
        self._reading = self._thread.submit(self._read, tape)

    def read(self) -> None:
        """Hand on all rallies that have ended, before this returns."""
        self._wait()
        assert self._batch.tape is not None
        self._read(self._batch.tape)

    def _wait(self) -> None:
        reading, self._reading = self._reading, None
        if reading is not None:
            reading.result()

    def _read(self, tape: Tape) -> None:
        batch, game, most = self._batch, self._batch.game, int(tape.used.max())
        if most > tape.code.shape[1]:
            raise KernelError(f"{most} strokes of a row between two readings, and room for {tape.code.shape[1]}")
        longest = most + int(self._ahead.max())
        if longest > self._kept.shape[1]:
            self._kept = np.pad(self._kept, ((0, 0), (0, longest - self._kept.shape[1])))
        room = int(tape.used.sum()) + int(self._ahead.sum())
        kinds: dict[str, Any] = {
            **dict.fromkeys(("match", "episode"), np.uint32),
            **dict.fromkeys(("rally", "policy"), np.uint16),
            **dict.fromkeys(("server", "winner", "reason", "score", "ending", "hurried"), np.uint8),
            **{"length": np.int32, "stroke": stroke_dtype(game.n_strokes), "waited": np.int8},
        }
        width = {"policy": (2,), "score": (4,)}
        out = _Read(**{name: np.empty((room, *width.get(name, ())), kind) for name, kind in kinds.items()})
        learners = batch.opponents.seat if batch.n_opponents else np.full(len(batch), -1, np.int8)
        rest = self._kept, self._ahead, learners, self._numbers, self._matches, out
        rallies, strokes, self._matches = _read(core.tables_of(game), tape, *rest)
        if rallies:
            per_stroke = {"stroke", "hurried", "waited"}
            columns = {name: column[: strokes if name in per_stroke else rallies] for name, column in out._asdict().items()}
            self._add(Rallies.of(game, **columns, seed=np.full(rallies, self._seed, np.uint64)))
