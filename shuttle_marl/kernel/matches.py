"""Whole matches between tabulated policies, one after the other, compiled.

Bit for bit what :func:`shuttle_marl.league.lockstep.play` does with the same tables and keys; there the policies may also
read the score, here they may not, and a stroke costs a tenth.
"""

import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shuttle_marl.kernel.core import (
    KernelError,
    Players,
    Tables,
    compiled,
    draw,
    extend,
    outcome_of,
    pack,
    table_choice,
    tables_of,
)
from shuttle_marl.kernel.played import Matches, Played, longest_match, stroke_type
from shuttle_marl.policy.table import TabulatedPolicy
from shuttle_marl.rally import Game
from shuttle_marl.scoring import BWF, Rules

_BLOCK: Final = 256
"""Matches that a thread plays at a time."""
_STROKES_A_MATCH: Final = 1000
"""First guess of the room that the strokes of a match need; a block that needs more gets more."""


class _Buffers(NamedTuple):
    """Room for the rallies ``[R]`` and strokes ``[N]`` of a block, as in :class:`Played`."""

    games: npt.NDArray[np.int32]
    match: npt.NDArray[np.int32]
    rally: npt.NDArray[np.int32]
    server: npt.NDArray[np.uint8]
    winner: npt.NDArray[np.uint8]
    reason: npt.NDArray[np.uint8]
    score: npt.NDArray[np.uint8]
    length: npt.NDArray[np.int32]
    stroke: npt.NDArray[np.unsignedinteger]


@compiled
def _play(
    tables: Tables,
    players: Players,
    entrant: npt.NDArray[np.int32],
    first_server: npt.NDArray[np.int8],
    match_key: npt.NDArray[np.uint64],
    rules: tuple[int, int, int, int],
    keep: bool,
    log: _Buffers,
    at: tuple[int, int, int],
) -> tuple[int, int, int]:
    """Play matches from number ``at[0]`` on, as far as the room for strokes reaches.

    ``at`` and what is returned: next match, rallies written, strokes written. A match that does not fit is left out.
    """
    points_needed, clear, cap, games_needed = rules
    m, r, n = at
    points, games = np.zeros(2, np.int64), np.zeros(2, np.int64)
    room = log.stroke.size
    while m < match_key.size:
        r_begin, n_begin = r, n
        points[:] = 0
        games[:] = 0
        server = np.int64(first_server[m])
        rally = np.int64(0)
        while games[0] < games_needed and games[1] < games_needed:
            key = extend(match_key[m], 2 * rally + server)
            striker, s, n_rally = server, np.int64(0), n
            while True:
                bits = draw(key, n - n_rally)
                start = tables.head[s, 0]
                k = table_choice(players, entrant[m, striker], s, start, bits)
                edge = tables.head[s, 2] + k
                if keep:
                    if n >= room:
                        return m, r_begin, n_begin
                    log.stroke[n] = tables.incoming[edge]
                n += 1
                outcome = outcome_of(tables.limits[start + k], bits)
                if outcome < 2:
                    break
                s = 2 * edge + outcome - 2
                striker = 1 - striker
            winner = striker if outcome == 1 else 1 - striker
            log.match[r], log.rally[r], log.server[r], log.winner[r] = m, rally, server, winner
            log.reason[r], log.length[r] = outcome, n - n_rally
            log.score[r, 0], log.score[r, 1], log.score[r, 2], log.score[r, 3] = points[0], points[1], games[0], games[1]
            r += 1
            rally += 1
            points[winner] += 1
            own, other = points[winner], points[1 - winner]
            if (own >= points_needed and own - other >= clear) or own >= cap:
                games[winner] += 1
                points[:] = 0
            server = winner
        log.games[m, 0], log.games[m, 1] = games[0], games[1]
        m += 1
    return m, r, n


def _play_block(
    tables: Tables,
    players: Players,
    matches: Matches,
    rules: Rules,
    keep: bool,
    type_: np.dtype[np.unsignedinteger],
) -> Played:
    size = len(matches)
    rows = size * longest_match(rules)
    room = size * _STROKES_A_MATCH if keep else 0
    log = _Buffers(
        games=np.zeros((size, 2), np.int32),
        match=np.empty(rows, np.int32),
        rally=np.empty(rows, np.int32),
        server=np.empty(rows, np.uint8),
        winner=np.empty(rows, np.uint8),
        reason=np.empty(rows, np.uint8),
        score=np.empty((rows, 4), np.uint8),
        length=np.empty(rows, np.int32),
        stroke=np.empty(room, type_),
    )
    laws = (rules.points, rules.clear, rules.cap, rules.games)
    at = (0, 0, 0)
    while True:
        at = _play(tables, players, matches.entrant, matches.first_server, matches.key, laws, keep, log, at)
        if at[0] == size:
            break
        larger = np.empty(2 * len(log.stroke), type_)
        larger[: at[2]] = log.stroke[: at[2]]
        log = log._replace(stroke=larger)
    kept = {name: array[: at[1]] for name, array in log._asdict().items() if name not in ("games", "stroke")}
    return Played(games=log.games, stroke=log.stroke[: at[2] if keep else 0], **kept)


def play_matches(
    game: Game,
    matches: Matches,
    policies: Sequence[TabulatedPolicy] | Players,
    *,
    rules: Rules = BWF,
    keep_strokes: bool = True,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> Played:
    """Play all matches to their end.

    Args:
        game: the tables.
        matches: who plays whom, who serves first, and with which draws.
        policies: the entrants, tabulated for this game; packed already by :func:`~shuttle_marl.kernel.pack` saves time where
            the same ones play again.
        rules: when a game and a match are won.
        keep_strokes: whether to return the strokes, or only their number.
        threads: threads that share the matches, never changing a result; None: as many as there are processors.
        progress: called now and then with the number of strokes played since the last call.

    Raises:
        KernelError: a policy of another game, or a match between entrants that do not exist.
    """
    players = policies if isinstance(policies, Players) else pack(policies, game)
    count = len(players.cumulative)
    if len(matches) and not (matches.entrant.min() >= 0 and matches.entrant.max() < count):
        raise KernelError(f"entrants {matches.entrant.min()} to {matches.entrant.max()}: expected 0 to {count - 1}")
    tables = tables_of(game)
    type_ = stroke_type(game)

    def block(first: int) -> Played:
        part = Matches(**{f.name: getattr(matches, f.name)[first : first + _BLOCK] for f in dataclasses.fields(Matches)})
        return _play_block(tables, players, part, rules, keep_strokes, type_)

    parts = []
    starts = range(0, len(matches), _BLOCK)
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        for played in _in_order(pool, block, starts):
            parts.append(played)
            if progress is not None:
                progress(int(played.length.sum()))
    return _joined(parts, starts, type_)


def _in_order(pool: ThreadPoolExecutor, work: Callable[[int], Played], starts: Sequence[int]) -> Iterator[Played]:
    try:
        yield from pool.map(work, starts)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


def _joined(parts: Sequence[Played], starts: Sequence[int], type_: np.dtype[np.unsignedinteger]) -> Played:
    if not parts:
        none, few = np.empty(0, np.int32), np.empty(0, np.uint8)
        return Played(
            games=np.empty((0, 2), np.int32), match=none, rally=none, server=few, winner=few, reason=few,
            score=np.empty((0, 4), np.uint8), length=none, stroke=np.empty(0, type_),
        )  # fmt: skip
    joined = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in dataclasses.fields(Played)}
    joined["match"] += np.repeat(np.asarray(starts, np.int32), [len(part.match) for part in parts])
    return Played(**joined)
