"""The rallies that a batch has played, from the notes of its strokes."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, I64, U8, U16, U32
from shuttle_marl.base.compiling import compiled
from shuttle_marl.base.errors import OptionError
from shuttle_marl.game.rally import Rallies, stroke_dtype
from shuttle_marl.game.rules import ABANDONED, ILLEGAL_POSITION, NOBODY, RETURNED_BELOW, WINNER
from shuttle_marl.kernel.core import KernelError, int64
from shuttle_marl.kernel.rally import RallyBatch
from shuttle_marl.kernel.rows import CUT, Tape

_MOST_OPPONENTS: Final = 256


class _Numbers(NamedTuple):
    """Of each row: episodes begun since the seed, the next rally of the match, and the match."""

    episodes: I64
    rally: I64
    match: I64


class _Read(NamedTuple):
    """Columns of :class:`~shuttle_marl.game.rally.Rallies`, with room to spare; ``opponent`` is their number."""

    match: U32
    rally: U16
    learner: U8
    opponent: U8
    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    episode: U32
    ending: U8
    stroke: U16
    hurried: U8
    waited: I8


@compiled
def _read(tape: Tape, learners: I8, numbers: _Numbers, matches: int, out: _Read) -> tuple[int, int, int]:
    """Write the rallies that have ended, and keep the notes after them; returns the numbers of rallies, strokes and matches.

    Args:
        learners: ``[B]`` seats of the learners; -1: both seats are theirs.
        matches: number of matches so far.
    """
    rallies = strokes = 0
    for i in range(tape.used.size):
        code, first, begin, own = tape.code[i], 0, strokes, False
        for j in range(tape.used[i]):
            note = code[j]
            outcome, seat, cut = (note >> np.uint64(16)) & np.uint64(7), (note >> np.uint64(19)) & np.uint64(1), note & CUT
            if not cut:
                out.stroke[strokes] = note & np.uint64(2047)
                out.waited[strokes] = (note >> np.uint64(11)) & np.uint64(15)
                out.hurried[strokes] = (note >> np.uint64(15)) & np.uint64(1)
                strokes += 1
                own |= (learners[i] < 0) | (int64(seat) == learners[i])
                if outcome >= RETURNED_BELOW:
                    continue
            reason = int64((note >> np.uint64(20)) & np.uint64(7)) if cut else int64(outcome)
            score = note >> np.uint64(32)
            if score == 0:
                numbers.episodes[i] += 1
                numbers.rally[i] = 0
                numbers.match[i] = matches
                matches += 1
            loser = max(learners[i], 0) if cut else int64(seat) ^ (reason == WINNER)
            r = rallies
            out.match[r], out.rally[r] = numbers.match[i], numbers.rally[i]
            out.learner[r], out.opponent[r] = max(learners[i], 0), (note >> np.uint64(24)) & np.uint64(255)
            out.server[r] = (code[first] >> np.uint64(19)) & np.uint64(1)
            out.winner[r] = NOBODY if reason > ILLEGAL_POSITION else 1 - loser
            out.reason[r] = reason
            for k in range(4):
                out.score[r, k] = (score >> np.uint64(8 * k)) & np.uint64(255)
            out.length[r] = strokes - begin
            out.episode[r] = i + tape.used.size * (numbers.episodes[i] - 1)
            before = code[j - 1] if strokes > begin else np.uint64(0)
            out.ending[r] = ((before if cut else note) >> np.uint64(16)) & np.uint64(7)
            numbers.rally[i] += 1
            if own or reason != ABANDONED:
                rallies += 1
            else:
                strokes = begin
            first, begin, own = j + 1, strokes, False
        strokes = begin
        left = tape.used[i] - first
        for j in range(left):
            code[j] = code[first + j]
        tape.used[i] = left
    return rallies, strokes, matches


class TapeReader:
    """Hands on the rallies of a batch that was made with ``record=True``, as they end.

    Policy 0 is the learner, 1 + k opponent k; without opponents policy 0 is seat 0. ``match`` numbers the matches in the order in
    which they are read. A rally that was abandoned before the learner had struck is left out.

    Args:
        add: is given the rallies.
        finish: is called at the end.

    Raises:
        OptionError: more than 256 opponents.
    """

    def __init__(self, batch: RallyBatch, add: Callable[[Rallies], None], finish: Callable[[], None] = lambda: None) -> None:
        if batch.n_opponents > _MOST_OPPONENTS:
            raise OptionError(f"{batch.n_opponents} opponents: up to {_MOST_OPPONENTS} can be recorded")
        self._batch, self._add, self._finish, self._matches = batch, add, finish, 0
        self._begin(0)

    def _begin(self, seed: int) -> None:
        self._seed, self._numbers = seed, _Numbers(*np.zeros((3, len(self._batch)), np.int64))
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
        self._finish()

    def step(self) -> None:
        """Read the tape if it is half full; it becomes longer if that is of rallies that continue."""
        tape = self._batch.tape
        assert tape is not None
        if 2 * int(tape.used.max()) >= tape.code.shape[1]:
            self.read()
            if 4 * int(tape.used.max()) >= tape.code.shape[1]:
                longer = np.empty((len(tape.used), 2 * tape.code.shape[1]), np.uint64)
                longer[:, : tape.code.shape[1]] = tape.code
                self._batch.tape = tape._replace(code=longer)

    def read(self) -> None:
        """Hand on the rallies that have ended.

        Raises:
            KernelError: a row played more strokes in one step than the tape has room for.
        """
        batch, tape, game = self._batch, self._batch.tape, self._batch.game
        assert tape is not None
        if tape.used.max() > tape.code.shape[1]:
            raise KernelError(f"{tape.used.max()} strokes of a row between two readings, and room for {tape.code.shape[1]}")
        most = int(tape.used.sum())
        room = {
            **dict.fromkeys(("match", "episode"), np.uint32),
            **dict.fromkeys(("rally", "stroke"), np.uint16),
            **dict.fromkeys(("learner", "opponent", "server", "winner", "reason", "ending", "hurried"), np.uint8),
        }
        columns: dict[str, Any] = {name: np.empty(most, kind) for name, kind in room.items()}
        columns |= {"score": np.empty((most, 4), np.uint8), "length": np.empty(most, np.int32), "waited": np.empty(most, np.int8)}
        out = _Read(**columns)
        learners = batch.opponents.seat if batch.n_opponents else np.full(len(batch), -1, np.int8)
        rallies, strokes, self._matches = _read(tape, learners, self._numbers, self._matches, out)
        if not rallies:
            return
        columns = {name: column[:rallies] for name, column in columns.items()}
        others, learner = 1 + columns.pop("opponent").astype(np.uint16), columns.pop("learner")
        columns |= {"stroke": out.stroke[:strokes].astype(stroke_dtype(game.n_strokes)), "hurried": out.hurried[:strokes]}
        columns |= {"waited": out.waited[:strokes], "seed": np.full(rallies, self._seed, np.uint64)}
        self._add(
            Rallies.of(
                game,
                pairing=np.zeros(rallies, np.uint32),
                policy=np.where(learner[:, None] == [0, 1], np.uint16(0), others[:, None]),
                **columns,
            )
        )
