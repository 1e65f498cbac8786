"""Matches in lock-step, without a compiler: every match plays its own rally, and all play their next stroke in one numpy step.

For policies that read the score or the rally so far and therefore are evaluated at every stroke. Between tabulated policies
:func:`shuttle_marl.kernel.play_matches` plays the same matches, bit for bit and much faster. The draws of a rally depend on the
key of its match, its number and its server alone, never on the other matches of the batch. Slots are not refilled: after t steps
every match that still runs has seen exactly t strokes.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import I8, I32, U8, U16, U64, Bools, Intp
from shuttle_marl.game import draws
from shuttle_marl.game.policy import (
    LAGS,
    Policy,
    PolicyError,
    States,
    called,
    checked_positions,
    checked_probabilities,
    drawn_strokes,
)
from shuttle_marl.game.rally.record import Rallies, stroke_dtype
from shuttle_marl.game.rules import WINNER, strike
from shuttle_marl.game.scoring import BWF, Rules, count_rally
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.kernel.core import checked_array


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Matches:
    """M matches to be played.

    Attributes:
        entrant: ``[M, 2]`` int32 policy at each seat, an index into the list of policies.
        first_server: ``[M]`` int8 seat that serves first.
        key: ``[M]`` uint64 key of the draws of each match; matches with the same key share their draws.

    Raises:
        KernelError: wrong shapes or kinds of numbers, a negative entrant, or a server that is neither 0 nor 1.
    """

    entrant: I32
    first_server: I8
    key: U64

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
        games: ``[M, 2]`` int32 games won by each seat.
        rallies: all rallies in the order of match, rally. ``match`` is the index of the match, ``policy`` the entrants,
            ``pairing`` 0. ``stroke`` is empty if strokes were not recorded.
    """

    games: I32
    rallies: Rallies


Choose = Callable[[I32, I32, I32, I32, I32, I32, I32], Intp]
"""``(entrant [B], state [B], draw [B], striker [B], score [4, B], history [4, B], number [B]) -> [B]``: index of the chosen
stroke among the legal strokes.

``striker`` is the seat; ``score`` holds points of seats 0 and 1 and games of seats 0 and 1, ``history`` the last strokes of the
rally and ``number`` that of the stroke as :class:`~shuttle_marl.game.policy.States` do.
"""

Wait = Callable[[I32, I32, I32, I32, I32, I32, I32], Intp]
"""The same of receivers, of whom entrant and seat are: ``[B]`` position of each. All that follows the seat is the striker's."""

_MATCH, _STATE, _STRIKER, _STROKE, _RALLY, _SERVER, _POINTS, _GAMES, _HISTORY = 0, 1, 2, 3, 4, 5, 6, 8, 10
_ROWS: Final = _HISTORY + LAGS
_REPORT_EVERY: Final = 64
HURRIED_BIT: Final = 15
"""Bit of a noted stroke that says whether its striker was hurried."""
POSITION_BIT: Final = 11
"""First of the four bits of a noted stroke that are the position of the receiver; the lower ones are the stroke."""


class Log(NamedTuple):
    """Rallies and strokes of M matches; rally r of match m is stored at ``[m, r]``.

    Attributes:
        server: ``[M, R]`` uint8 seat that served each rally.
        winner: ``[M, R]`` uint8 seat that won it.
        reason: ``[M, R]`` uint8 outcome of its last stroke.
        score: ``[M, R, 4]`` uint8 points of the seats and games of the seats before it.
        length: ``[M, R]`` int32 its number of strokes; 0 if it was not played.
        stroke: ``[M, N]`` uint16 every stroke, :data:`POSITION_BIT` and :data:`HURRIED_BIT`; N = 0 if strokes are not recorded.
    """

    server: U8
    winner: U8
    reason: U8
    score: U8
    length: I32
    stroke: U16


def new_log(matches: int, rules: Rules, strokes: int) -> Log:
    """A log without rallies, with room for a number of strokes of each match."""
    shape = matches, rules.max_rallies
    server, winner, reason = (np.empty(shape, np.uint8) for _ in range(3))
    stroke = np.empty((matches, strokes), np.uint16)
    return Log(server, winner, reason, np.empty((*shape, 4), np.uint8), np.zeros(shape, np.int32), stroke)


def rallies_of(log: Log, entrant: I32, n_strokes: int, recovery: bool) -> Rallies:
    """The rallies of a log in the order of match, rally."""
    played = log.length > 0
    match, rally = np.nonzero(played)
    of_matches = (row[:count] for row, count in zip(log.stroke, log.length.sum(axis=1), strict=True))
    noted = np.concatenate([log.stroke[:0].ravel(), *of_matches])
    return Rallies(
        pairing=np.zeros(len(match), np.uint32),
        match=match.astype(np.uint32),
        rally=rally.astype(np.uint16),
        policy=entrant[match].astype(np.uint16),
        **{name: getattr(log, name)[played] for name in ("server", "winner", "reason", "score", "length")},
        stroke=(noted & np.uint16((1 << POSITION_BIT) - 1)).astype(stroke_dtype(n_strokes)),
        hurried=(noted >> HURRIED_BIT).astype(np.uint8),
        waited=(noted >> POSITION_BIT & np.uint16(15)).astype(np.int8) if recovery else None,
    )


def play(
    game: Game,
    matches: Matches,
    choose: Choose,
    wait: Wait | None = None,
    *,
    rules: Rules = BWF,
    keep_strokes: bool = True,
    progress: Callable[[int], None] | None = None,
) -> MatchResults:
    """Play all matches to their end.

    Args:
        wait: positions of receivers in the game with recovery; None: those of people.
        keep_strokes: whether to return the strokes, or only their number.
        progress: called from time to time with the number of strokes played since the last call.
    """
    log, steps = new_log(len(matches), rules, 0), list[U16]()
    games = np.zeros((len(matches), 2), dtype=np.int32)
    entrant = matches.entrant.ravel()
    keys, key_row = np.unique(matches.key, return_inverse=True)
    names = 2 * (rules.max_rallies + 1)
    rally_key = draws.extend(keys[:, None], np.arange(names)).ravel()  # by 2 * rally + server
    key_row = key_row * names

    slots = np.zeros((_ROWS, len(matches)), dtype=np.int32)
    slots[_MATCH] = np.arange(len(matches))
    slots[_STATE], slots[_HISTORY:] = ROOT, game.n_strokes
    slots[_STRIKER] = slots[_SERVER] = matches.first_server
    key = rally_key[key_row + slots[_SERVER]]
    unreported = 0
    while alive := slots.shape[1]:
        match, state, striker, stroke = slots[: _STROKE + 1]
        bits = draws.draw(key, stroke)
        history, number = slots[_HISTORY:], stroke + 1
        score, position = slots[_POINTS:_HISTORY], None
        k = choose(entrant[2 * match + striker], state, draws.choice_draw(bits), striker, score, history, number)
        if game.recovery is not None:
            seat, drawn = 1 - striker, draws.position_draw(bits)
            if wait is None:
                position = drawn_strokes(game.people_positions(state), drawn)
            else:
                position = wait(entrant[2 * match + seat], state, drawn, seat, score, history, number)
        history[1:], history[0] = history[:-1].copy(), game.stroke_at(state, k)
        if keep_strokes:
            steps.append(np.empty(len(matches), np.uint16))
            noted = history[0] | game.hurried(state) << HURRIED_BIT
            steps[-1][match] = noted if position is None else noted | position << POSITION_BIT
        outcome, following = strike(game, state, k, draws.outcome_draw(bits), striker, position)
        stroke += 1
        ended = np.flatnonzero(following < 0)
        if len(ended):
            now = slots[:, ended]
            won_by = np.where(outcome[ended] == WINNER, now[_STRIKER], 1 - now[_STRIKER])
            rally = now[_MATCH], now[_RALLY]
            log.server[rally], log.winner[rally], log.reason[rally] = now[_SERVER], won_by, outcome[ended]
            log.score[rally], log.length[rally] = now[_POINTS:_HISTORY].T, now[_STROKE]
            over = _count_rally(now, won_by, rules)
            now[_HISTORY:] = game.n_strokes
            slots[:, ended] = now
            key[ended] = rally_key[key_row[now[_MATCH]] + 2 * now[_RALLY] + now[_SERVER]]
        continues = following >= 0
        np.copyto(state, following, where=continues)
        striker ^= continues
        if len(ended) and over.any():
            games[now[_MATCH, over]] = now[_GAMES:_HISTORY, over].T
            slots, key = _without(ended[over], slots, key)
        unreported += alive
        if progress is not None and (unreported > _REPORT_EVERY * len(matches) or not slots.shape[1]):
            progress(unreported)
            unreported = 0
    if steps:
        log = log._replace(stroke=np.stack(steps, axis=1))
    return MatchResults(games, rallies_of(log, matches.entrant, game.n_strokes, game.recovery is not None))


def ask(policy: Policy, game: Game, state: I32, draw: I32, striker: I32, score: I32, *rally: I32) -> Intp:
    """Strokes of a policy that is evaluated at every stroke, as :data:`Choose` returns them.

    Raises:
        PolicyError: the policy raised, or returned no distribution over the legal strokes.
    """
    states = _decisions(game, state, striker, score, *rally)
    rank = game.rank(state, drawn_strokes(checked_probabilities(policy, states), draw))
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
    """Strokes, or positions, of policies that are evaluated at every stroke, see :func:`ask`; entrants are indices into them."""
    one = ask_position if positions else ask

    def choose(entrant: I32, *situation: I32) -> Intp:
        k = np.empty(len(entrant), np.intp)
        for i in np.unique(entrant).tolist():
            k[entrant == i] = one(policies[i], game, *(part[..., entrant == i] for part in situation))
        return k

    return choose


def _count_rally(now: I32, won_by: Intp, rules: Rules) -> Bools:
    """Count a rally in each column of ``now`` and start the next one; returns whether each match is over."""
    column = np.arange(now.shape[1])
    own, other, games = _POINTS + won_by, _POINTS + 1 - won_by, _GAMES + won_by
    counted = count_rally(now[own, column], now[other, column], now[games, column], rules)
    now[own, column], now[games, column] = counted.points, counted.games
    now[_POINTS:_GAMES, counted.game_won] = 0
    now[_STATE], now[_STROKE] = ROOT, 0
    now[_STRIKER] = now[_SERVER] = won_by
    now[_RALLY] += 1
    over: Bools = counted.match_won
    return over


def _without(gone: Intp, slots: I32, key: U64) -> tuple[I32, U64]:
    """Remove columns from slots and keys; the last columns move into the gaps."""
    alive = len(key) - len(gone)
    moved = np.setdiff1d(np.arange(alive, len(key)), gone, assume_unique=True)
    gaps = gone[gone < alive]
    slots[:, gaps], key[gaps] = slots[:, moved], key[moved]
    return slots[:, :alive], key[:alive]
