"""The rules of the game, for one stroke at a time in plain Python: read this first.

A rally alternates between two players: one strikes, the other receives and is the next to strike. What a striker may play and
what becomes of it depends on their :class:`State` alone, and chance decides by probabilities that real matches gave
(:mod:`shuttle_marl.game.tables`). The winner of a rally scores a point and serves next (:mod:`shuttle_marl.game.scoring`).

Nothing plays by these functions: they are slow. Tests compare everything that plays with them, stroke by stroke.
"""

from typing import Final, NamedTuple

import numpy as np

from shuttle_marl.base.errors import ActionError as ActionError  # noqa: PLC0414  exported too
from shuttle_marl.game.layout import LONGEST_DUEL
from shuttle_marl.game.scoring import BWF, Rules
from shuttle_marl.game.tables import Game

OUTCOMES: Final = (  # ends of a stroke. That of a return names the receiver's contact and whether they are hurried
    "fault",
    "winner",
    "returned from below",
    "returned from above",
    "returned from below, hurried",
    "returned from above, hurried",
)
FAULT, WINNER, RETURNED_BELOW, RETURNED_ABOVE, HURRIED_BELOW, HURRIED_ABOVE = range(6)

REASONS: Final = ("fault", "winner", "illegal stroke", "illegal position", "too many strokes", "abandoned")
"""Ends of a rally: by the outcome of its last stroke, or cut off, the last two without a winner."""
ILLEGAL, ILLEGAL_POSITION, TOO_LONG, ABANDONED = range(2, 6)
NOBODY: Final = 2  # winner of a rally that nobody won


class IllegalStrokeError(ActionError):
    """A stroke of the catalogue that is not legal in the state, or in the kernel a stroke in a rally that is over.

    Attributes:
        stroke: its catalogue index.
        row: row of a batch; None outside of batches.
    """

    def __init__(self, message: str, stroke: int, row: int | None = None) -> None:
        super().__init__(message)
        self.stroke, self.row = stroke, row


class State(NamedTuple):
    """What the striker knows of the rally, in the order of :meth:`~shuttle_marl.game.layout.Layout.observation`."""

    own: int  # catalogue index of their own last stroke, n if they have not struck
    incoming: int  # catalogue index of the stroke that comes to them, n if they serve
    contact: int  # where they meet the shuttle: 0 below, 1 above the net
    duel: int  # net shots in a row up to the incoming stroke, 3 for three or more
    effort: int  # attacks that they have played in this rally, up to the game's last level; adds to faults
    opponent_effort: int  # the same of the receiver
    hurried: int  # 1 if they are late or stretched


def serve(game: Game) -> State:
    """The state of the server, in which every rally starts."""
    return State(game.n_strokes, game.n_strokes, 0, 0, 0, 0, 0)


def legal_strokes(game: Game, state: State) -> list[int]:
    """Catalogue indices of the strokes that people play to the incoming stroke from this contact."""
    return [stroke for stroke in range(game.n_strokes) if game.reply_mask[state.incoming, state.contact, stroke]]


def legal_positions(game: Game, state: State) -> list[int]:
    """Positions in which people wait for a stroke from this state; only one where the receiver has no choice."""
    return np.flatnonzero(game.people_positions(game.state_of(*state))).tolist()


def outcome(game: Game, striker: int, state: State, stroke: int, position: int, draw: int) -> int:
    """What becomes of a legal stroke, an index into :data:`OUTCOMES`.

    Args:
        striker: their seat, 0 or 1: in the game of a pair each has skill of their own.
        position: where the receiver waits.
        draw: uniform integer in [0, 2^24), see :func:`shuttle_marl.game.draws.outcome_draw`.
    """
    limits, hurry = game.seats[striker].chances(int(game.state_of(*state)), stroke, position)
    late, low = divmod(draw, 1 << 16)
    result = sum(low >= limit for limit in limits)
    if result >= RETURNED_BELOW and late < hurry[result - RETURNED_BELOW]:
        result += HURRIED_BELOW - RETURNED_BELOW
    return result


def next_state(game: Game, state: State, stroke: int, result: int) -> State:
    """State of the receiver, who strikes next, after a stroke that they return."""
    strokes, longer = game.catalogue, game.counts_duels and game.catalogue.is_net_shot[stroke]
    return State(
        own=state.incoming,
        incoming=stroke,
        contact=(result - RETURNED_BELOW) % 2,
        duel=min(state.duel + 1, LONGEST_DUEL) if longer else 0,
        effort=state.opponent_effort,
        opponent_effort=min(state.effort + int(strokes.is_attack[stroke]), game.levels - 1),
        hurried=int(result >= HURRIED_BELOW),
    )


def winner(striker: int, result: int) -> int:
    """Seat that wins the rally by a winner or a fault of the striker."""
    return striker if result == WINNER else 1 - striker


def next_score(score: tuple[int, int, int, int], won_by: int, rules: Rules = BWF) -> tuple[int, int, int, int]:
    """Points and games of seats 0 and 1 after a rally: a game takes 21 points and a lead of two, or 30; a match two games."""
    points, games = [*score[:2]], [*score[2:]]
    points[won_by] += 1
    lead = points[won_by] - points[1 - won_by]
    if points[won_by] == rules.cap or (points[won_by] >= rules.points and lead >= rules.clear):
        games[won_by] += 1
        points = [0, 0]
    return points[0], points[1], games[0], games[1]
