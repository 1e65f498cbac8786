"""Whole matches between tabulated policies, side by side, compiled.

Bit for bit what :func:`shuttle_marl.kernel.lockstep.play` does with the same tables and keys; there the policies may also
read the score, here they may not, and a stroke costs a small part of it.
"""

import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final, NamedTuple

import numpy as np

from shuttle_marl.arrays import I8, I32, U8, U64, UInts
from shuttle_marl.game.scoring import BWF, Numbers, Rules, count_rally
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import checked_array, checked_number
from shuttle_marl.kernel.compiling import compiled, inlined
from shuttle_marl.kernel.core import (
    BLOCK,
    Players,
    Tables,
    check_players,
    draw_strokes,
    extend,
    find_pair,
    first_pair,
    list_where,
    new_block,
    pack,
    play,
    read_limits,
    table_choice,
    tables_of,
)
from shuttle_marl.kernel.lockstep import Matches, MatchResults
from shuttle_marl.kernel.rows import Rows, new_rows, part_of
from shuttle_marl.rally.record import Rallies, stroke_dtype

_STROKES_A_MATCH: Final = 1600
"""First guess of the most strokes of a match; a block that needs more gets more room. No power of two, so that the strokes of
different matches do not compete for the same places of the first cache."""


_count_rally = inlined(count_rally)


class _Log(NamedTuple):
    """Room for the rallies and the strokes of M matches; rally r of match m stands at ``[m, r]``.

    Attributes:
        begun: ``[M]`` int32 rallies begun.
        length: ``[M]`` int32 strokes.
        points: ``[M, 2]`` int32 points of the seats in the current game.
        games: ``[M, 2]`` int32 games of the seats.
        server: ``[M, R]`` uint8 seat that served each rally.
        winner: ``[M, R]`` uint8 seat that won it.
        reason: ``[M, R]`` uint8 how it ended.
        score: ``[M, R, 4]`` uint8 points of the seats and games of the seats before it.
        strokes: ``[M, R]`` int32 its strokes.
        stroke: ``[M, N]`` catalogue index of every stroke; no columns where strokes are not kept.
    """

    begun: I32
    length: I32
    points: I32
    games: I32
    server: U8
    winner: U8
    reason: U8
    score: U8
    strokes: I32
    stroke: UInts


@inlined
def _begin_rally(lanes: Any, lane: Any, log: Any, match: Any, key: Any, server: Any) -> None:
    """Serve the next rally of a match that is played in a lane."""
    r = log.begun[match]
    log.server[match, r] = server
    log.score[match, r, 0], log.score[match, r, 1] = log.points[match, 0], log.points[match, 1]
    log.score[match, r, 2], log.score[match, r, 3] = log.games[match, 0], log.games[match, 1]
    lanes.key[lane] = extend(key, 2 * r + server)
    lanes.state[lane] = 0
    lanes.stroke[lane] = 0
    lanes.striker[lane] = server
    log.begun[match] += 1


@compiled
def _begin(lanes: Rows, log: _Log, match_key: U64, first_server: I8) -> None:
    for m in range(match_key.size):
        lanes.rally[m] = m
        _begin_rally(lanes, m, log, m, match_key[m], np.int64(first_server[m]))


@compiled
def _play(
    tables: Tables,
    players: Players,
    entrant: I32,
    match_key: U64,
    rules: Numbers,
    keep: bool,
    lanes: Rows,
    live: int,
    log: _Log,
    step: int,
) -> tuple[int, int]:
    """Play one stroke after the other in the first ``live`` lanes, until all matches are over or the room for strokes is full.

    The number of its match is the ``rally`` of a lane. All matches begin together and never wait, so stroke n of each is
    played in step n. Returns how many lanes are live, and the next step.
    """
    block = new_block()
    while live > 0 and (not keep or step < log.stroke.shape[1]):
        part = part_of(lanes, 0, live)
        draw_strokes(part, block.bits)
        for j in range(live):
            s = part.state[j]
            player = entrant[np.uint64(part.rally[j]), np.uint64(part.striker[j])]
            k = table_choice(players, player, s, first_pair(tables, s), block.bits[j])
            find_pair(tables, block, j, s, k)
        read_limits(tables, block, live)
        play(part, block)
        if keep:
            for j in range(live):
                log.stroke[np.uint64(part.rally[j]), step] = tables.stroke[np.uint64(block.reply[j])]
        step += 1
        # From the last to the first, because a lane whose match is over is filled with the last one.
        for i in range(list_where(block, live, over=True) - 1, -1, -1):
            j = block.listed[i]
            m = lanes.rally[j]
            r = log.begun[m] - 1
            outcome = block.outcome[j]
            winner = 1 - lanes.striker[j] if outcome == 1 else np.int64(lanes.striker[j])
            log.winner[m, r], log.reason[m, r], log.strokes[m, r] = winner, outcome, lanes.stroke[j]
            counted = _count_rally(log.points[m, winner], log.points[m, 1 - winner], log.games[m, winner], rules)
            log.points[m, winner], log.games[m, winner] = counted.points, counted.games
            if counted.game_won:
                log.points[m, 0] = log.points[m, 1] = 0
            if not counted.match_won:
                _begin_rally(lanes, j, log, m, match_key[m], winner)
                continue
            log.length[m] = step
            live -= 1
            lanes.rally[j], lanes.key[j], lanes.state[j] = lanes.rally[live], lanes.key[live], lanes.state[live]
            lanes.stroke[j], lanes.striker[j] = lanes.stroke[live], lanes.striker[live]
    return live, step


def _play_block(
    tables: Tables,
    players: Players,
    matches: Matches,
    rules: Rules,
    keep: bool,
) -> MatchResults:
    size, rallies = len(matches), rules.max_rallies
    log = _Log(
        begun=np.zeros(size, np.int32),
        length=np.zeros(size, np.int32),
        points=np.zeros((size, 2), np.int32),
        games=np.zeros((size, 2), np.int32),
        server=np.empty((size, rallies), np.uint8),
        winner=np.empty((size, rallies), np.uint8),
        reason=np.empty((size, rallies), np.uint8),
        score=np.empty((size, rallies, 4), np.uint8),
        strokes=np.empty((size, rallies), np.int32),
        stroke=np.empty((size, _STROKES_A_MATCH if keep else 0), stroke_dtype(tables.rank.shape[1])),
    )
    lanes, live, step = new_rows(max(1, size)), size, 0
    _begin(lanes, log, matches.key, matches.first_server)
    while True:
        live, step = _play(tables, players, matches.entrant, matches.key, rules.numbers, keep, lanes, live, log, step)
        if live == 0:
            break
        log = log._replace(stroke=np.concatenate([log.stroke, np.empty_like(log.stroke)], axis=1))
    was_played = np.arange(rallies) < log.begun[:, None]
    match, rally = np.nonzero(was_played)
    played = Rallies(
        pairing=np.zeros(len(match), np.uint32),
        match=match.astype(np.uint32),
        rally=rally.astype(np.uint16),
        policy=matches.entrant[match].astype(np.uint16),
        server=log.server[was_played],
        winner=log.winner[was_played],
        reason=log.reason[was_played],
        score=log.score[was_played],
        length=log.strokes[was_played],
        stroke=np.concatenate([log.stroke[:0].ravel(), *(row[:n] for row, n in zip(log.stroke, log.length, strict=True))]),
    )
    return MatchResults(log.games, played)


def play_matches(
    game: Game,
    matches: Matches,
    policies: Sequence[TabulatedPolicy] | Players,
    *,
    rules: Rules = BWF,
    keep_strokes: bool = True,
    threads: int | None = None,
    progress: Callable[[int], None] | None = None,
) -> MatchResults:
    """Play all matches to their end.

    Args:
        game: the tables.
        matches: entrants, first servers and draws.
        policies: the entrants, tabulated for this game. Packing them once with :func:`~shuttle_marl.kernel.pack` saves time if
            the same policies play several times.
        rules: when a game and a match are won.
        keep_strokes: whether to return the strokes, or only their number.
        threads: number of threads; does not change results. None: number of processors.
        progress: called from time to time with the number of strokes played since the last call.

    Raises:
        KernelError: a policy of another game, or a match between entrants that do not exist.
    """
    players = policies if isinstance(policies, Players) else pack(policies, game)
    check_players(players, game)
    checked_array("entrant", matches.entrant, np.int32, (len(matches), 2), 0, len(players.cumulative) - 1)
    workers = os.cpu_count() if threads is None else checked_number("threads", threads, 1)
    tables = tables_of(game)

    def play_from(first: int) -> MatchResults:
        part = Matches(**{f.name: getattr(matches, f.name)[first : first + BLOCK] for f in dataclasses.fields(Matches)})
        return _play_block(tables, players, part, rules, keep_strokes)

    games: list[I32] = []
    rallies: list[Rallies] = []
    starts = range(0, max(1, len(matches)), BLOCK)
    with ThreadPoolExecutor(workers) as pool:
        for first, results in zip(starts, _in_order(pool, play_from, starts), strict=True):
            games.append(results.games)
            rallies.append(dataclasses.replace(results.rallies, match=results.rallies.match + np.uint32(first)))
            if progress is not None:
                progress(int(results.rallies.length.sum()))
    return MatchResults(np.concatenate(games), Rallies.concatenate(rallies))


def _in_order(pool: ThreadPoolExecutor, work: Callable[[int], MatchResults], starts: Sequence[int]) -> Iterator[MatchResults]:
    try:
        yield from pool.map(work, starts)
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise
