"""Whole matches between tabulated policies, compiled.

Same results, bit for bit, as :func:`shuttle_marl.kernel.lockstep.play` with the same tables and keys; there policies may read the
score.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, U64
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.game.rally.record import Rallies
from shuttle_marl.game.scoring import BWF, Rules, RulesTuple, count_rally
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.kernel.core import (
    BLOCK,
    Tables,
    checked_array,
    checked_number,
    choose_stroke,
    extend,
    hurried_in,
    int64,
    legal_strokes,
    list_where,
    new_block,
    position_at,
    read_limits,
    tables_of,
    with_recovery,
)
from shuttle_marl.kernel.lockstep import HURRIED_BIT, POSITION_BIT, Log, Matches, MatchResults, new_log, rallies_of
from shuttle_marl.kernel.players import Players, check_players, pack, place_choice, table_choice
from shuttle_marl.kernel.rows import Rows, draw_strokes, new_rows, part_of, play

_STROKES_A_MATCH: Final = 1600
"""Initial capacity for the strokes of a match, doubled as needed. Not a power of two, so that the strokes of different matches do
not compete for the same cache lines."""


_count_rally = inlined(count_rally)


class _Counts(NamedTuple):
    """``[M]`` number of rallies that have started, ``[M, 2]`` points of the seats in the current game, and their games."""

    begun: I32
    points: I32
    games: I32


class _Setup(NamedTuple):
    """Constants of M matches: policies, ``[M, 2]`` entrants, ``[M]`` keys of the draws, and rules."""

    players: Players
    entrant: I32
    key: U64
    rules: RulesTuple


@inlined
def _begin_rally(lanes: Rows, lane: int, log: Log, counts: _Counts, match: int, key: np.uint64, server: int) -> None:
    """Start the next rally of the match in a lane."""
    r = counts.begun[match]
    log.server[match, r] = server
    log.score[match, r, 0], log.score[match, r, 1] = counts.points[match, 0], counts.points[match, 1]
    log.score[match, r, 2], log.score[match, r, 3] = counts.games[match, 0], counts.games[match, 1]
    lanes.key[lane] = extend(key, 2 * r + server)
    lanes.state[lane] = 0
    lanes.stroke[lane] = 0
    lanes.striker[lane] = server
    counts.begun[match] += 1


@compiled
def _begin(lanes: Rows, log: Log, counts: _Counts, match_key: U64, first_server: I8) -> None:
    for m in range(match_key.size):
        lanes.rally[m] = m
        _begin_rally(lanes, m, log, counts, m, match_key[m], int64(first_server[m]))


@compiled
def _play(tables: Tables, setup: _Setup, lanes: Rows, live: int, log: Log, counts: _Counts, step: int) -> tuple[int, int]:
    """Play in the first ``live`` lanes until all matches are over or the capacity for strokes is reached.

    ``lanes.rally`` is the index of the match. All matches start together and never wait, so stroke n of each match is played in
    step n. Returns the number of lanes that are still live, and the next step.
    """
    players, entrant, keep = setup.players, setup.entrant, log.stroke.shape[1] > 0
    block, place = new_block(), np.empty(BLOCK, np.int64)
    while live > 0 and (not keep or step < log.stroke.shape[1]):
        part = part_of(lanes, 0, live)
        draw_strokes(part, block.bits)
        for j in range(live):
            s = part.state[j]
            player = entrant[np.uint64(part.rally[j]), np.uint64(part.striker[j])]
            legal = legal_strokes(tables, s)
            choose_stroke(tables, block, j, legal, table_choice(players, player, s, legal.pair, block.bits[j]), part.striker[j])
        if with_recovery(tables):
            for j in range(live):
                receiver = entrant[np.uint64(part.rally[j]), np.uint64(1 - part.striker[j])]
                place[j] = place_choice(players, receiver, part.state[j], block.bits[j])
                block.limit[j] += place[j]
        read_limits(tables, block, live)
        if keep:
            for j in range(live):
                noted = tables.stroke[np.uint64(block.reply[j])] | hurried_in(part.state[j]) << HURRIED_BIT
                if with_recovery(tables):
                    noted |= position_at(tables, part.state[j], place[j]) << POSITION_BIT
                log.stroke[np.uint64(part.rally[j]), step] = noted
        play(part, block)
        step += 1
        # From the last to the first, because a lane whose match is over is refilled with the last lane.
        for i in range(list_where(block, live, over=True) - 1, -1, -1):
            j = block.listed[i]
            m = lanes.rally[j]
            r = counts.begun[m] - 1
            outcome = block.outcome[j]
            winner = 1 - lanes.striker[j] if outcome == 1 else int64(lanes.striker[j])
            log.winner[m, r], log.reason[m, r], log.length[m, r] = winner, outcome, lanes.stroke[j]
            counted = _count_rally(counts.points[m, winner], counts.points[m, 1 - winner], counts.games[m, winner], setup.rules)
            counts.points[m, winner], counts.games[m, winner] = counted.points, counted.games
            if counted.game_won:
                counts.points[m, 0] = counts.points[m, 1] = 0
            if not counted.match_won:
                _begin_rally(lanes, j, log, counts, m, setup.key[m], winner)
                continue
            live -= 1
            lanes.rally[j], lanes.key[j], lanes.state[j] = lanes.rally[live], lanes.key[live], lanes.state[live]
            lanes.stroke[j], lanes.striker[j] = lanes.stroke[live], lanes.striker[live]
    return live, step


def _play_block(tables: Tables, players: Players, matches: Matches, rules: Rules, *, keep: bool) -> MatchResults:
    size = len(matches)
    setup = _Setup(players, matches.entrant, matches.key, rules.as_tuple)
    log, games = new_log(size, rules, _STROKES_A_MATCH if keep else 0), np.zeros((size, 2), np.int32)
    counts = _Counts(np.zeros(size, np.int32), np.zeros((size, 2), np.int32), games)
    lanes, live, step = new_rows(max(1, size)), size, 0
    _begin(lanes, log, counts, matches.key, matches.first_server)
    while True:
        live, step = _play(tables, setup, lanes, live, log, counts, step)
        if live == 0:
            return MatchResults(games, rallies_of(log, matches.entrant, tables.rank.shape[1], tables.recovery is not None))
        log = log._replace(stroke=np.concatenate([log.stroke, np.empty_like(log.stroke)], axis=1))


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
        policies: the entrants, tabulated for this game, or for either seat of the game of a pair. Packing them once with
            :func:`~shuttle_marl.kernel.pack` saves time if the same policies play several times.
        keep_strokes: whether to return the strokes, or only their number.
        threads: number of threads; does not change results. None: number of processors.
        progress: called from time to time with the number of strokes played since the last call.

    Raises:
        KernelError: a policy of another game, or a match between entrants that do not exist.
    """
    players = policies if isinstance(policies, Players) else pack(policies, game)
    check_players(players, game)
    checked_array("entrant", matches.entrant, np.int32, (len(matches), 2), 0, len(players.cumulative) - 1)
    workers = None if threads is None else checked_number("threads", threads, 1)
    tables = tables_of(game)

    def play_from(first: int) -> MatchResults:
        part = Matches(**{f.name: getattr(matches, f.name)[first : first + BLOCK] for f in dataclasses.fields(Matches)})
        return _play_block(tables, players, part, rules, keep=keep_strokes)

    games, rallies = list[I32](), list[Rallies]()
    starts = range(0, max(1, len(matches)), BLOCK)
    for first, results in zip(starts, in_threads(play_from, starts, workers), strict=True):
        games.append(results.games)
        rallies.append(dataclasses.replace(results.rallies, match=results.rallies.match + np.uint32(first)))
        if progress is not None:
            progress(int(results.rallies.length.sum()))
    return MatchResults(np.concatenate(games), Rallies.concatenate(rallies))
