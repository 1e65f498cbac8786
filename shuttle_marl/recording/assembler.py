"""Puts rallies together from the strokes of many that are played side by side, as environments and collectors give them."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.recording.schema import OF_STROKES, Rallies, RecordingError

_KEPT: Final = ("stroke", *OF_STROKES)


class RallyAssembler:
    """Collects the strokes of B rows and hands over the rallies that end.

    Args:
        batch: number of rows B.
        n_strokes: number of strokes in the game.
        columns: those of ``log_probability``, ``value`` and ``update`` that are recorded.
    """

    def __init__(self, batch: int, n_strokes: int, columns: tuple[str, ...] = ()) -> None:
        self._columns = tuple(name for name in _KEPT if name == "stroke" or name in columns)
        self._update = "update" in columns
        kinds = {"stroke": np.uint8 if n_strokes <= 256 else np.uint16}
        self._rest: dict[str, npt.NDArray[Any]] = {n: np.empty(0, kinds.get(n, np.float32)) for n in self._columns}
        """Strokes of rallies that go on, row after row, and their number in each row."""
        self._length = np.zeros(batch, dtype=np.int64)

    def add(
        self,
        *,
        stroke: npt.NDArray[np.integer],
        striker: npt.NDArray[np.integer],
        reward: npt.NDArray[np.number],
        match: npt.NDArray[np.integer],
        rally: npt.NDArray[np.integer] | int = 0,
        score: npt.NDArray[np.integer] | int = 0,
        policy: npt.NDArray[np.integer] | int = 0,
        pairing: npt.NDArray[np.integer] | int = 0,
        update: int = 0,
        played: npt.NDArray[np.bool_] | None = None,
        **recorded: npt.NDArray[np.floating],
    ) -> Rallies:
        """Add T strokes of every row, in the order of time, and take away the rallies that ended.

        Everything but the strokes is read where a rally ends, as it was before the next one began.

        Args:
            stroke: ``[B, T]`` catalogue index of the strokes.
            striker: ``[B, T]`` seat that struck, 0 or 1.
            reward: ``[B, T]`` of the striker: above 0 for a winner, below for a fault, 0 where the rally goes on.
            match: ``[B, T]`` number of the match, or of the rally where each stands for itself.
            rally: ``[B, T]`` number of the rally in its match.
            score: ``[B, T, 4]`` points of both seats and games of both seats before the rally.
            policy: ``[B, 2]`` who sits at each seat, an index into the policies of the log.
            pairing: ``[B]`` index into the pairings of the log.
            update: how many updates the learner has made.
            played: ``[B, T]`` where there is a stroke at all; None: everywhere.
            **recorded: ``[B, T]`` each, ``log_probability`` and ``value``.

        Returns:
            The rallies that ended, row after row.

        Raises:
            RecordingError: a shape that does not fit, or a column that was not asked for, or one that is missing.
        """
        shape = (len(self._length), np.shape(stroke)[-1])
        if set(recorded) != set(self._columns) - {"stroke"}:
            raise RecordingError(f"columns {tuple(recorded)}: expected {self._columns[1:]}")
        named = {"stroke": stroke, "striker": striker, "reward": reward, "match": match, **recorded}
        for name, array in named.items():
            if np.shape(array) != shape:
                raise RecordingError(f"{name} of shape {np.shape(array)}: expected {shape}")
        there = np.ones(shape, dtype=np.bool_) if played is None else played
        row, time = np.nonzero((reward != 0) & there)
        count = there.sum(axis=1)
        # Row after row: first what the row has kept, then the new strokes.
        end = np.cumsum(self._length + count)
        start = end - self._length - count
        at_rest, at_new = _ranges(start, self._length), _ranges(start + self._length, count)
        last = start[row] + self._length[row] + np.cumsum(there, axis=1)[row, time] - 1
        begin = np.maximum(start[row], np.r_[0, last[:-1] + 1])
        # What stands behind the last rally of a row that ended stays.
        stays = start.copy()
        stays[row] = last + 1  # of several ends in a row, the last assignment holds
        self._length = end - stays
        stay = _ranges(stays, self._length)
        gone = np.ones(int(end[-1]) if len(end) else 0, dtype=np.bool_)
        gone[stay] = False
        ended: dict[str, npt.NDArray[Any]] = {}
        for name in self._columns:
            kind = self._rest[name].dtype
            all_of_it = np.empty(len(gone), dtype=kind)
            all_of_it[at_rest] = self._rest[name]
            all_of_it[at_new] = np.asarray(named[name])[there]
            ended[name], self._rest[name] = all_of_it[gone], all_of_it[stay]
        if self._update:
            ended["update"] = np.full(len(row), update, dtype=np.uint32)
        length = last - begin + 1
        seat, won = striker[row, time].astype(np.int64), reward[row, time] > 0
        return Rallies(
            pairing=np.broadcast_to(pairing, shape[0])[row].astype(np.uint32),
            match=match[row, time].astype(np.uint32),
            rally=np.broadcast_to(rally, shape)[row, time].astype(np.uint16),
            policy=np.broadcast_to(policy, (shape[0], 2))[row].astype(np.uint16),
            server=((seat + length - 1) & 1).astype(np.uint8),
            winner=np.where(won, seat, 1 - seat).astype(np.uint8),
            reason=won.astype(np.uint8),
            score=np.broadcast_to(score, (*shape, 4))[row, time].astype(np.uint8),
            length=length.astype(np.int32),
            **ended,
        )

    def forget(self, rows: npt.NDArray[np.bool_] | None = None) -> None:
        """Drop the strokes of rallies that were broken off by a reset.

        Args:
            rows: ``[B]`` where; None: everywhere.
        """
        dropped = np.ones(len(self._length), dtype=np.bool_) if rows is None else rows
        kept = np.repeat(~dropped, self._length)
        self._rest = {name: column[kept] for name, column in self._rest.items()}
        self._length = np.where(dropped, 0, self._length)


def _ranges(start: npt.NDArray[np.int64], count: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """start[0], …, start[0] + count[0] - 1, start[1], …"""
    before = np.cumsum(count) - count
    return np.arange(int(count.sum())) + np.repeat(start - before, count)
