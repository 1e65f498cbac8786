"""Whole matches, compiled: all matches of a block play their next stroke together.

Between tabulated policies, :func:`play_matches` runs nothing but machine code. Policies that read the score or the rally so far
are asked for every stroke; :func:`play` plays the same matches by the same engine, bit for bit. The draws of a rally depend on
the key of its match, its number and its server alone, never on the other matches.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, I64, U8, U16, U64, Bools, Intp
from shuttle_marl.base.cluster import in_threads
from shuttle_marl.base.compiling import compiled, inlined
from shuttle_marl.base.errors import whole_number
from shuttle_marl.game import draws
from shuttle_marl.game.policy import (
    LAGS,
    Policy,
    PolicyError,
    States,
    TabulatedPolicy,
    called,
    checked_positions,
    checked_probabilities,
    drawn_strokes,
)
from shuttle_marl.game.rally import Rallies, stroke_dtype
from shuttle_marl.game.scoring import BWF, Rules, RulesTuple
from shuttle_marl.game.tables import Game
from shuttle_marl.kernel import core
from shuttle_marl.kernel.core import BLOCK, Tables, checked_array, count_rally, int64
from shuttle_marl.kernel.players import Players, check_players, choose, empty_players, pack
from shuttle_marl.kernel.rows import Rows, draw_strokes, move, new_rows, part_of
from shuttle_marl.kernel.rows import play as strike

_STROKES_A_MATCH: Final = 1600  # room at first; not a power of two, so that matches do not compete for the same cache lines
_NOT_GIVEN: Final = np.empty((2, 0), np.int64)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Matches:
    """M matches to be played.

    Raises:
        KernelError: wrong shapes or kinds of numbers, a negative entrant, or a server that is neither 0 nor 1.
    """

    entrant: I32  # [M, 2] int32 policy at each seat, an index into the list of policies
    first_server: I8  # [M] int8 seat that serves first
    key: U64  # [M] uint64 key of the draws of each match; matches with the same key share their draws

    def __post_init__(self) -> None:
        size = len(self.key)
        for name, type_, shape, high in (
            ("entrant", np.int32, (size, 2), None), ("first_server", np.int8, (size,), 1), ("key", np.uint64, (size,), None),
        ):  # fmt: skip
            object.__setattr__(self, name, checked_array(name, getattr(self, name), type_, shape, 0, high))

    def __len__(self) -> int:
        return len(self.key)


class MatchResults(NamedTuple):
    """Results of M matches.

    Attributes:
        rallies: all rallies in the order of match, rally. ``match`` is the index of the match, ``policy`` the entrants,
            ``pairing`` 0. ``stroke`` is empty if strokes were not recorded.
    """

    games: I32  # [M, 2] int32 games won by each seat
    rallies: Rallies


Choose = Callable[[I32, I32, I32, I32, I32, I32, I32], Intp]
"""``(entrant [B], state [B], draw [B], striker [B], score [4, B], history [4, B], number [B]) -> [B]``: index of the chosen
stroke among the legal strokes.

``striker`` is the seat; ``score`` holds points of seats 0 and 1 and games of seats 0 and 1, ``history`` the last strokes of the
rally and ``number`` that of the stroke as :class:`~shuttle_marl.game.policy.States` do.
"""

Wait = Callable[[I32, I32, I32, I32, I32, I32, I32], Intp]
"""The same of receivers, of whom entrant and seat are: ``[B]`` position of each. All that follows the seat is the striker's."""

_HURRIED_BIT: Final = 15  # bit of a noted stroke that says whether its striker was hurried
_POSITION_BIT: Final = 11  # first of four bits of a noted stroke for the receiver's position; the lower ones are the stroke


class _Log(NamedTuple):
    """M matches: what is constant, the score, and the rallies and strokes so far."""

    entrant: I32  # [M, 2] players of the seats
    key: U64  # [M] keys of the draws
    rules: RulesTuple  # when a game and a match are won
    begun: I32  # [M] number of rallies that have started
    points: I32  # [M, 2] points of the seats in the current game
    games: I32  # [M, 2] their games
    server: U8  # [M, R] seat that served each rally
    winner: U8  # [M, R] seat that won it
    reason: U8  # [M, R] outcome of its last stroke
    score: U8  # [M, R, 4] points of the seats and games of the seats before it
    length: I32  # [M, R] its number of strokes; 0 if it was not played
    stroke: U16  # [M, N] every stroke, `_POSITION_BIT` and `_HURRIED_BIT`; N = 0 if strokes are not recorded


@inlined
def _begin_rally(lanes: Rows, lane: int, log: _Log, match: int, server: int) -> None:
    """Start the next rally of the match in a lane."""
    r = log.begun[match]
    log.server[match, r] = server
    log.score[match, r, 0], log.score[match, r, 1] = log.points[match, 0], log.points[match, 1]
    log.score[match, r, 2], log.score[match, r, 3] = log.games[match, 0], log.games[match, 1]
    lanes.key[lane] = core.extend(log.key[match], 2 * r + server)
    lanes.state[lane] = 0
    lanes.stroke[lane] = 0
    lanes.striker[lane] = server
    log.begun[match] += 1


@compiled
def _begin(lanes: Rows, log: _Log, first_server: I8) -> None:
    for m in range(log.key.size):
        lanes.rally[m] = m
        _begin_rally(lanes, m, log, m, int64(first_server[m]))


@compiled
def _play(tables: Tables, players: Players, lanes: Rows, live: int, log: _Log, step: int, given: I64) -> tuple[int, int]:
    """Play in the first ``live`` lanes while there is room, or one stroke of ``given`` ranks and positions ``[2, live]``."""
    # All matches start together and never wait, so stroke n of each is played in step n; `lanes.rally` is the index of a match.
    entrant, keep, asked = log.entrant, log.stroke.shape[1] > 0, given.shape[1] > 0
    block = core.new_block(live)
    while live > 0 and (not keep or step < log.stroke.shape[1]):
        part = part_of(lanes, 0, live)
        draw_strokes(part, block.bits)
        if asked:
            for j in range(live):
                legal = core.legal_strokes(tables, part.state[j])
                core.put_stroke(tables, block, j, legal, given[0, j], part.striker[j])
                block.reply[j] = legal.reply + given[0, j]
                block.place[j] = core.place_of(tables, part.state[j], given[1, j])
        else:
            for j in range(live):
                match, seat = np.uint64(part.rally[j]), part.striker[j]
                block.player[j], block.other[j] = entrant[match, np.uint64(seat)], entrant[match, np.uint64(1 - seat)]
            choose(tables, players, part.state, part.striker, block, live)
        if keep:
            for j in range(live):
                noted = tables.stroke[np.uint64(block.reply[j])] | core.hurried_in(part.state[j]) << _HURRIED_BIT
                noted |= core.position_at(tables, part.state[j], block.place[j]) << _POSITION_BIT
                log.stroke[np.uint64(part.rally[j]), step] = noted
        strike(tables, part, block)
        step += 1
        # From the last to the first, because a lane whose match is over is refilled with the last lane.
        for i in range(core.list_where(block, live, over=True) - 1, -1, -1):
            j = block.listed[i]
            m = lanes.rally[j]
            r = log.begun[m] - 1
            outcome = block.outcome[j]
            winner = 1 - lanes.striker[j] if outcome == 1 else int64(lanes.striker[j])
            log.winner[m, r], log.reason[m, r], log.length[m, r] = winner, outcome, lanes.stroke[j]
            counted = count_rally(log.points[m, winner], log.points[m, 1 - winner], log.games[m, winner], log.rules)
            log.points[m, winner], log.games[m, winner] = counted.points, counted.games
            if counted.game_won:
                log.points[m, 0] = log.points[m, 1] = 0
            if counted.match_won:
                live -= 1
                move(lanes, live, j)
            else:
                _begin_rally(lanes, j, log, m, winner)
        if asked:
            break
    return live, step


class _Running:
    """Matches that are being played."""

    def __init__(self, game: Game, matches: Matches, players: Players, rules: Rules, *, keep: bool) -> None:
        size, shape, room = len(matches), (len(matches), rules.max_rallies), _STROKES_A_MATCH * keep
        self.game, self.tables, self.players = game, core.tables_of(game), players
        self.lanes, self.live, self.step = new_rows(max(1, size)), size, 0
        points, games = np.zeros((2, size, 2), np.int32)
        server, winner, reason = np.empty((3, *shape), np.uint8)
        score, length, stroke = np.empty((*shape, 4), np.uint8), np.zeros(shape, np.int32), np.empty((size, room), np.uint16)
        begun, entrant, key = np.zeros(size, np.int32), matches.entrant, matches.key
        self.log = _Log(entrant, key, rules.as_tuple, begun, points, games, server, winner, reason, score, length, stroke)
        _begin(self.lanes, self.log, matches.first_server)

    def play(self, given: I64 = _NOT_GIVEN) -> None:
        """Play one stroke in each lane that is given, or by tables as many as there is room for."""
        if self.step == self.log.stroke.shape[1] > 0:
            self.log = self.log._replace(stroke=np.concatenate([self.log.stroke, np.empty_like(self.log.stroke)], axis=1))
        self.live, self.step = _play(self.tables, self.players, self.lanes, self.live, self.log, self.step, given)

    def results(self) -> MatchResults:
        """Games and rallies in the order of match, rally, after the end of all matches."""
        log, played = self.log, self.log.length > 0
        match, rally = np.nonzero(played)
        of_matches = (row[:count] for row, count in zip(log.stroke, log.length.sum(axis=1), strict=True))
        noted = np.concatenate([log.stroke[:0].ravel(), *of_matches])
        rallies = Rallies.of(
            self.game,
            match=match.astype(np.uint32),
            rally=rally.astype(np.uint16),
            policy=log.entrant[match].astype(np.uint16),
            **{name: getattr(log, name)[played] for name in ("server", "winner", "reason", "score", "length")},
            stroke=(noted & np.uint16((1 << _POSITION_BIT) - 1)).astype(stroke_dtype(self.game.n_strokes)),
            hurried=(noted >> _HURRIED_BIT).astype(np.uint8),
            waited=(noted >> _POSITION_BIT & np.uint16(15)).astype(np.int8),
        )
        return MatchResults(log.games, rallies)


def play(
    game: Game, matches: Matches, choose: Choose, wait: Wait | None = None, *, rules: Rules = BWF, keep_strokes: bool = True
) -> MatchResults:
    """Play all matches to their end between players who are asked for every stroke.

    Args:
        wait: positions of receivers in the game with recovery; None: those of people.
        keep_strokes: whether to return the strokes, or only their number.
    """
    run = _Running(game, matches, empty_players(game, 0), rules, keep=keep_strokes)
    history, log = np.full((len(matches), LAGS), game.n_strokes, np.int32), run.log
    while run.live:
        part = part_of(run.lanes, 0, run.live)
        match, state, seat, bits = part.rally, part.state.copy(), part.striker.astype(np.int32), draws.draw(part.key, part.stroke)
        history[match[part.stroke == 0]] = game.n_strokes
        score = np.concatenate([log.points[match].T, log.games[match].T])
        situation = (score, history[match].T, part.stroke + np.int32(1))
        k = choose(matches.entrant[match, seat], state, draws.choice_draw(bits), seat, *situation)
        drawn = draws.position_draw(bits)
        position = drawn_strokes(game.people_positions(state), drawn)
        if wait is not None and (asked := np.flatnonzero(game.chooses(state))).size:
            seen = matches.entrant[match, 1 - seat], state, drawn, 1 - seat, *situation
            position[asked] = wait(*(part[..., asked] for part in seen))
        history[match] = np.column_stack([game.stroke_at(state, k), history[match, :-1]])
        run.play(np.stack([k, position]).astype(np.int64))
    return run.results()


def play_matches(
    game: Game,
    matches: Matches,
    policies: Sequence[TabulatedPolicy] | Players,
    *,
    rules: Rules = BWF,
    keep_strokes: bool = True,
    threads: int | None = None,
) -> MatchResults:
    """Play all matches to their end.

    Args:
        policies: the entrants, tabulated for this game, or for either seat of the game of a pair. Packing them once with
            :func:`~shuttle_marl.kernel.pack` saves time if the same policies play several times.
        keep_strokes: whether to return the strokes, or only their number.
        threads: number of threads; does not change results. None: number of processors.

    Raises:
        KernelError: a policy of another game, or a match between entrants that do not exist.
    """
    players = policies if isinstance(policies, Players) else pack(policies, game)
    check_players(players, game)
    checked_array("entrant", matches.entrant, np.int32, (len(matches), 2), 0, len(players.cumulative) - 1)
    workers = None if threads is None else whole_number("threads", threads, 1)

    def play_from(first: int) -> MatchResults:
        part = Matches(**{f.name: getattr(matches, f.name)[first : first + BLOCK] for f in dataclasses.fields(Matches)})
        run = _Running(game, part, players, rules, keep=keep_strokes)
        while run.live:
            run.play()
        return run.results()

    games, rallies = list[I32](), list[Rallies]()
    starts = range(0, max(1, len(matches)), BLOCK)
    for first, results in zip(starts, in_threads(play_from, starts, workers), strict=True):
        games.append(results.games)
        rallies.append(dataclasses.replace(results.rallies, match=results.rallies.match + np.uint32(first)))
    return MatchResults(np.concatenate(games), Rallies.concatenate(rallies))


def wrong_outcomes(rallies: Rallies, game: Game, key: U64) -> Bools:
    """``[N]`` whether a stroke is illegal, is met at a position that is not feasible, or has another outcome than its draw gives.

    Args:
        key: ``[R]`` uint64 key of the draws of each rally.
    """
    (state, k), position = rallies.legal(game), rallies.places.astype(np.int64)
    feasible = game.seats[0].waiting.mask(game.base(np.maximum(state, 0)))
    wrong: Bools = (state < 0) | ~feasible[np.arange(len(state)), position]
    at = np.flatnonzero(~wrong)
    drawn = draws.outcome_draw(draws.draw(key[rallies.row_of_stroke[at]], rallies.position[at]))
    outcome, _ = core.struck(game, state[at], k[at], drawn, rallies.striker[at], position[at])
    wrong[at] = outcome != rallies.outcome(game.catalogue)[at]
    return wrong


def ask(policy: Policy, game: Game, state: I32, draw: I32, striker: I32, score: I32, *rally: I32) -> Intp:
    """Strokes of a policy that is evaluated at every stroke, as :data:`Choose` returns them.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the legal strokes.
    """
    rank = game.rank(state, drawn_strokes(checked_probabilities(policy, _decisions(game, state, striker, score, *rally)), draw))
    if (rank < 0).any():
        raise PolicyError(f"{called(policy)}: no legal stroke was drawn")
    return rank.astype(np.intp)


def ask_position(policy: Policy, game: Game, state: I32, draw: I32, receiver: I32, score: I32, *rally: I32) -> Intp:
    """Positions of a policy that is evaluated at every stroke, as :data:`Wait` returns them.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the feasible positions.
    """
    return drawn_strokes(checked_positions(policy, _decisions(game, state, 1 - receiver, score, *rally)), draw)


def _decisions(game: Game, state: I32, striker: I32, score: I32, history: I32 | None = None, number: I32 | None = None) -> States:
    # Points and games from the striker's view: own first.
    seats, column = np.stack([striker, 1 - striker]), np.arange(len(striker))
    seen = np.concatenate([score[seats, column], score[2 + seats, column]]).T.astype(np.int16)
    return States(game=game, state=state, score=seen, history=None if history is None else history.T, number=number)


def asking(game: Game, policies: Sequence[Policy], *, positions: bool = False) -> Choose:
    """Strokes, or positions, of policies by their index: tables are read, others are asked at every stroke, see :func:`ask`."""
    read, evaluate = (TabulatedPolicy.choose_position, ask_position) if positions else (TabulatedPolicy.choose, ask)

    def choose(entrant: I32, *situation: I32) -> Intp:
        k = np.empty(len(entrant), np.intp)
        for i in np.unique(entrant).tolist():
            policy, seen = policies[i], [part[..., entrant == i] for part in situation]
            k[entrant == i] = read(policy, *seen[:2]) if isinstance(policy, TabulatedPolicy) else evaluate(policy, game, *seen)
        return k

    return choose
