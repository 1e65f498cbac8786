"""Whole matches between tabulated policies, compiled.

Same results, bit for bit, as :func:`shuttle_marl.kernel.lockstep.play` with the same tables and keys; there policies may read the
score.
"""

import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, U8, U16, U64
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.game.scoring import BWF, Rules, RulesTuple, count_rally
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.checks import checked_array, checked_number
from shuttle_marl.kernel.core import (
    BLOCK,
    Tables,
    choose_stroke,
    extend,
    hurried_in,
    int64,
    legal_strokes,
    list_where,
    new_block,
    read_limits,
    tables_of,
)
from shuttle_marl.kernel.lockstep import HURRIED_BIT, Matches, MatchResults, stroke_columns
from shuttle_marl.kernel.players import Players, check_players, pack, table_choice
from shuttle_marl.kernel.rows import Rows, draw_strokes, new_rows, part_of, play

_STROKES_A_MATCH: Final = 1600
"""Initial capacity for the strokes of a match, doubled as needed. Not a power of two, so that the strokes of different matches do
not compete for the same cache lines."""


_count_rally = inlined(count_rally)


class _Log(NamedTuple):
    """Rallies and strokes of M matches; rally r of match m is stored at ``[m, r]``.

    Attributes:
        begun: ``[M]`` int32 number of rallies that have started.
        length: ``[M]`` int32 strokes.
        points: ``[M, 2]`` int32 points of the seats in the current game.
        games: ``[M, 2]`` int32 games of the seats.
        server: ``[M, R]`` uint8 seat that served each rally.
        winner: ``[M, R]`` uint8 seat that won it.
        reason: ``[M, R]`` uint8 outcome of its last stroke.
        score: ``[M, R, 4]`` uint8 points of the seats and games of the seats before it.
        strokes: ``[M, R]`` int32 its number of strokes.
        stroke: ``[M, N]`` uint16 every stroke, as :func:`~shuttle_marl.kernel.lockstep.stroke_columns` reads them; N = 0 if
            strokes are not recorded.
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
    stroke: U16


class _Setup(NamedTuple):
    """Constants of M matches: policies, ``[M, 2]`` entrants, ``[M]`` keys of the draws, and rules."""

    players: Players
    entrant: I32
    key: U64
    rules: RulesTuple


@inlined
def _begin_rally(lanes: Rows, lane: int, log: _Log, match: int, key: np.uint64, server: int) -> None:
    """Start the next rally of the match in a lane."""
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
        _begin_rally(lanes, m, log, m, match_key[m], int64(first_server[m]))


@compiled
def _play(tables: Tables, setup: _Setup, lanes: Rows, live: int, log: _Log, step: int) -> tuple[int, int]:
    """Play in the first ``live`` lanes until all matches are over or the capacity for strokes is reached.

    ``lanes.rally`` is the index of the match. All matches start together and never wait, so stroke n of each match is played in
    step n. Returns the number of lanes that are still live, and the next step.
    """
    players, entrant, keep = setup.players, setup.entrant, log.stroke.shape[1] > 0
    block = new_block()
    while live > 0 and (not keep or step < log.stroke.shape[1]):
        part = part_of(lanes, 0, live)
        draw_strokes(part, block.bits)
        for j in range(live):
            s = part.state[j]
            player = entrant[np.uint64(part.rally[j]), np.uint64(part.striker[j])]
            legal = legal_strokes(tables, s)
            choose_stroke(tables, block, j, legal, table_choice(players, player, s, legal.pair, block.bits[j]), part.striker[j])
        read_limits(tables, block, live)
        if keep:
            for j in range(live):
                noted = tables.stroke[np.uint64(block.reply[j])] | hurried_in(part.state[j]) << HURRIED_BIT
                log.stroke[np.uint64(part.rally[j]), step] = noted
        play(part, block)
        step += 1
        # From the last to the first, because a lane whose match is over is refilled with the last lane.
        for i in range(list_where(block, live, over=True) - 1, -1, -1):
            j = block.listed[i]
            m = lanes.rally[j]
            r = log.begun[m] - 1
            outcome = block.outcome[j]
            winner = 1 - lanes.striker[j] if outcome == 1 else int64(lanes.striker[j])
            log.winner[m, r], log.reason[m, r], log.strokes[m, r] = winner, outcome, lanes.stroke[j]
            counted = _count_rally(log.points[m, winner], log.points[m, 1 - winner], log.games[m, winner], setup.rules)
            log.points[m, winner], log.games[m, winner] = counted.points, counted.games
            if counted.game_won:
                log.points[m, 0] = log.points[m, 1] = 0
            if not counted.match_won:
                _begin_rally(lanes, j, log, m, setup.key[m], winner)
                continue
            log.length[m] = step
            live -= 1
            lanes.rally[j], lanes.key[j], lanes.state[j] = lanes.rally[live], lanes.key[live], lanes.state[live]
            lanes.stroke[j], lanes.striker[j] = lanes.stroke[live], lanes.striker[live]
    return live, step


def _play_block(tables: Tables, players: Players, matches: Matches, rules: Rules, *, keep: bool) -> MatchResults:
    size, rallies = len(matches), rules.max_rallies
    setup = _Setup(players, matches.entrant, matches.key, rules.as_tuple)
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
        stroke=np.empty((size, _STROKES_A_MATCH if keep else 0), np.uint16),
    )
    lanes, live, step = new_rows(max(1, size)), size, 0
    _begin(lanes, log, matches.key, matches.first_server)
    while True:
        live, step = _play(tables, setup, lanes, live, log, step)
        if live == 0:
            break
        log = log._replace(stroke=np.concatenate([log.stroke, np.empty_like(log.stroke)], axis=1))
    was_played = np.arange(rallies) < log.begun[:, None]
    match, rally = np.nonzero(was_played)
    noted = np.concatenate([log.stroke[:0].ravel(), *(row[:n] for row, n in zip(log.stroke, log.length, strict=True))])
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
        **stroke_columns(noted, tables.rank.shape[1]),
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
        policies: the entrants, tabulated for this game, or for either seat of the game of a pair. Packing them once with
            :func:`~shuttle_marl.kernel.pack` saves time if the same policies play several times.
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
        return _play_block(tables, players, part, rules, keep=keep_strokes)

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
