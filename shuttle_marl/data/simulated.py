"""Strokes of played rallies in the form of annotated matches, and simulated matches.

Positions, times and reasons, which rallies do not have, are drawn so that their distributions are those of ShuttleSet.
"""

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64, I64, Bools
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.data import schema
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.data.upstream import discipline
from shuttle_marl.game import court, draws
from shuttle_marl.game.pairs import Looks, looks_of
from shuttle_marl.game.policy import Policy, TabulatedPolicy
from shuttle_marl.game.rally import Rallies
from shuttle_marl.game.rules import FAULT
from shuttle_marl.game.stroke import N_SERVES, Catalogue
from shuttle_marl.game.tables import Game

FLIGHT: Final = np.array([0.73, 1.90, 1.17, 1.27, 0.80, 0.47, 0.53, 0.53, 1.00, 0.37, 0.87, 0.90, 0.92])
"""Median time from a stroke to the next [s], by shot type."""
FAULT_MIX: Final = np.array([  # [13, 3] probabilities of out, net and short, by shot type of the fault
    [0.25, 0.67, 0.08], [1.00, 0.00, 0.00], [1.00, 0.00, 0.00], [0.88, 0.10, 0.02], [0.33, 0.58, 0.09],
    [0.63, 0.37, 0.00], [0.57, 0.40, 0.03], [0.49, 0.35, 0.16], [0.84, 0.16, 0.00], [0.40, 0.59, 0.01],
    [0.09, 0.59, 0.32], [0.14, 0.43, 0.43], [0.28, 0.43, 0.29],
])  # fmt: skip
FRAME_RATE: Final = 30
BREAK: Final = 23.0  # median time between two rallies [s]
INTERVAL: Final = 120.0  # time between two games [s]

_BASE, _BASE_SPREAD = np.array([0.0, -3.7]), 0.35  # mean and deviation of the base position of a player in the own frame [m]
_RECOVERY: Final = 1.5  # speed of recovery to the base position [m/s]
_NEAR_NET: Final = 0.3  # minimum distance of players and of the landings of good strokes from the net [m]
_OUT, _NET, _SHORT, _LANDED = (REASONS.index(name) for name in ("out", "net", "short", "landed"))


@dataclasses.dataclass(frozen=True, kw_only=True)
class SimulatedStrokes:
    """n strokes of simulated rallies, in playing order, without coordinates and times; all fields are ``[n]``."""

    shot: I64
    area: I64  # target as the receiver sees it
    outcome: I64  # index into `schema.OUTCOMES`
    stroke: I64  # number of the stroke in its rally; the strokes of a rally are consecutive
    new_game: Bools  # whether the stroke is the first of a game
    right: Bools  # whether the server of the rally serves from the right service court (an even score)


def sample_positions(strokes: SimulatedStrokes, rng: np.random.Generator) -> tuple[dict[str, F64], I64, I64]:
    """Sample coordinates and times of strokes.

    A good stroke lands in its target area, an out fault just beyond the line next to it, a net or short fault on the
    striker's side of the net. The contact point of a returned stroke is the landing of the stroke before.

    Returns:
        ``[n, 2]`` points in the striker's frame [m] by their name in the schema, NaN for none; ``[n]`` indices into
        ``schema.REASONS``; ``[n]`` video frames, at :data:`FRAME_RATE` per second.
    """
    n = len(strokes.stroke)
    flight = np.maximum(FLIGHT[strokes.shot] * rng.lognormal(0.0, 0.15, n), 0.2)
    reason = _reasons(strokes, rng)
    landing = _inside(strokes, rng)
    out = reason == _OUT
    landing[out] = _beyond_the_line(strokes.area[out], landing[out], rng)
    contact = np.full((n, 2), np.nan)
    replies = np.flatnonzero(strokes.stroke > 1)
    contact[replies] = -landing[replies - 1]
    striker, receiver = _positions(strokes, contact, flight, rng)
    _fall_short(landing, np.where(np.isnan(contact), striker, contact), reason, rng)
    pause = np.where(strokes.new_game, INTERVAL, BREAK) * rng.lognormal(0.0, 0.3, n)
    step = np.where(strokes.stroke == 1, pause, np.r_[0.0, flight[:-1]])
    places = {"landing": landing, "contact": contact, "striker": striker, "receiver": receiver}
    return places, reason, np.rint(np.cumsum(step) * FRAME_RATE).astype(np.int64)


def _reasons(strokes: SimulatedStrokes, rng: np.random.Generator) -> I64:
    mix = FAULT_MIX[strokes.shot]
    no_line = np.isin(strokes.area, (1, 4))  # front and middle centre are not next to a line
    mix = np.where(no_line[:, None] & (np.arange(3) == 0), 0.0, mix)
    mix[mix.sum(axis=1) == 0] = [0.0, 1.0, 0.0]
    cumulative = np.cumsum(mix / mix.sum(axis=1, keepdims=True), axis=1)
    index = (rng.random(len(mix))[:, None] >= cumulative[:, :2]).sum(axis=1)
    fault = np.array([_OUT, _NET, _SHORT])[index]
    ended = np.where(strokes.outcome == Outcome.FAULT, fault, _LANDED)
    return np.where(strokes.outcome == Outcome.RETURNED, REASONS.index("returned"), ended)


def _inside(strokes: SimulatedStrokes, rng: np.random.Generator) -> F64:
    """Points in the target areas, denser towards their centre, at least 5 cm from the lines."""
    side, depth = strokes.area % 3, strokes.area // 3
    x_cuts = np.array([-court.HALF_WIDTH, -court.SIDE_CUT, court.SIDE_CUT, court.HALF_WIDTH])
    y_cuts = np.array([_NEAR_NET, court.MIDDLE_CUT, court.BACK_CUT, court.HALF_LENGTH])
    low = np.stack([x_cuts[side], y_cuts[depth]], axis=1) + 0.05
    high = np.stack([x_cuts[side + 1], y_cuts[depth + 1]], axis=1) - 0.05
    is_serve = strokes.shot < N_SERVES
    low[is_serve, 1] = np.maximum(low[is_serve, 1], court.SHORT_SERVICE)
    return low + (high - low) * rng.random((2, len(side), 2)).mean(axis=0)


def _beyond_the_line(area: I64, inside: F64, rng: np.random.Generator) -> F64:
    """Points moved across the line next to the target area; for a corner, across one of its two lines."""
    side, depth = area % 3, area // 3
    by = np.minimum(0.03 + rng.exponential(0.2, len(area)), 1.0)
    behind = (depth == 2) & ((side == 1) | (rng.random(len(area)) < 0.5))
    outwards = np.where(side == 0, -1.0, 1.0)
    x = np.where(behind, inside[:, 0], outwards * (court.HALF_WIDTH + by))
    y = np.where(behind, court.HALF_LENGTH + by, inside[:, 1])
    return np.stack([x, y], axis=1)


def _fall_short(landing: F64, start: F64, reason: I64, rng: np.random.Generator) -> None:
    """Move net and short faults to the striker's side, on the line from the contact to the target."""
    share = start[:, 1] / (start[:, 1] - landing[:, 1])
    across = start[:, 0] + share * (landing[:, 0] - start[:, 0])
    for kind, mean in ((_NET, 0.25), (_SHORT, 0.6)):
        rows = reason == kind
        fallen = np.minimum(0.02 + rng.exponential(mean, len(landing)), 3.0)
        landing[rows] = np.stack([across, -fallen], axis=1)[rows]


def _positions(strokes: SimulatedStrokes, contact: F64, flight: F64, rng: np.random.Generator) -> tuple[F64, F64]:
    n = len(flight)
    striker, receiver = np.empty((n, 2)), np.empty((n, 2))
    serves = np.flatnonzero(strokes.stroke == 1)
    from_right = np.where(strokes.area[serves] % 3 == 1, strokes.right[serves], strokes.area[serves] % 3 == 0)
    right = np.where(from_right, 1.0, -1.0)[:, None]
    noise = rng.normal(0.0, 0.12, (2, len(serves), 2))
    striker[serves] = right * [0.3, 0.0] + [0.0, -3.1] + noise[0]
    receiver[serves] = right * [-0.95, 0.0] + [0.0, 4.0] + noise[1]
    reach = np.clip(rng.normal(0.7, 0.15, n), 0.3, 1.1)
    base = _BASE + rng.normal(0.0, _BASE_SPREAD, (n, 2))
    for number in range(2, int(strokes.stroke.max(initial=1)) + 1):
        rows = np.flatnonzero(strokes.stroke == number)
        striker[rows] = _towards(contact[rows], base[rows], reach[rows])
        # The previous striker is the receiver, on the way back to the base; coordinates change to the other frame.
        receiver[rows] = -_towards(striker[rows - 1], base[rows - 1], _RECOVERY * flight[rows - 1])
    striker[:, 1] = np.minimum(striker[:, 1], -_NEAR_NET)
    return striker, receiver


def _towards(points: F64, goal: F64, distance: F64) -> F64:
    offset = goal - points
    length = np.linalg.norm(offset, axis=1)
    return points + offset * np.minimum(1.0, distance / np.maximum(length, 1e-9))[:, None]


def stroke_table(
    rallies: Rallies,
    catalogue: Catalogue,
    players: Sequence[str],
    matches: Sequence[str],
    rng: np.random.Generator,
    *,
    looks: Callable[[tuple[int, int]], Looks],
) -> pa.Table:
    """Strokes of rallies in the schema of the annotated matches.

    Decisions, outcomes and scores are those of the rallies. Points on the court and times are drawn (:func:`sample_positions`).
    A match is filed under the discipline of its first player who has one (:mod:`shuttle_marl.data.upstream`), or under men's
    singles; its time begins with the first of its rallies that is there.

    Args:
        rallies: R rallies, those of a match one after the other.
        players: names by index, as ``rallies.policy`` counts them.
        matches: ``[R]`` name of each rally's match.
        looks: hands of the players at seats 0 and 1, by their numbers.

    Raises:
        ShuttleError: numbers of games, points or strokes are outside the schema.
    """
    if (longest := int(rallies.length.max(initial=0))) > schema.RANGES["stroke"][1]:
        raise ShuttleError(f"a rally of {longest:,} strokes, which no match has; the log is damaged")
    row, position, seat = rallies.row_of_stroke, rallies.position, rallies.striker
    stroke = rallies.stroke.astype(np.int64)
    outcome = np.full(len(stroke), Outcome.RETURNED)
    outcome[rallies.first_stroke[1:] - 1] = np.where(rallies.reason == FAULT, Outcome.FAULT, Outcome.WINNER)
    number = np.arange(len(rallies))
    points = rallies.score[:, :2].astype(np.int64)
    game = rallies.score[:, 2:].sum(axis=1, dtype=np.int64)
    pairs, which = np.unique(rallies.policy, axis=0, return_inverse=True)
    left = np.array([looks((a, b)).left for a, b in pairs.tolist()])[which.ravel()][row]
    area = catalogue.area[stroke].astype(np.int64)
    new_match = np.diff(rallies.pairing.astype(np.int64) << 32 | rallies.match, prepend=-1) != 0
    new_game = new_match | (np.diff(game, prepend=-1) != 0)
    places, reason, frame = sample_positions(
        SimulatedStrokes(
            shot=catalogue.shot[stroke].astype(np.int64),
            area=np.where(left[np.arange(len(stroke)), 1 - seat], court.mirrored(area), area),
            outcome=outcome,
            stroke=position + 1,
            new_game=new_game[row] & (position == 0),
            right=(points[number, rallies.server] % 2 == 0)[row],
        ),
        rng,
    )
    frame = frame - frame[rallies.first_stroke[:-1][new_match]][np.cumsum(new_match) - 1][row]  # from the first of the match
    after = points.copy()
    after[number, rallies.winner] += 1
    names, kinds = pa.array(players, pa.string()), [discipline(name) for name in players]
    filed = pa.array([kinds[a] or kinds[b] or "MS" for a, b in rallies.policy.tolist()], pa.string())
    landing_x, landing_y = places["landing"].astype(np.float32).T
    columns = {
        "match": pa.array(matches, pa.string()).take(row),
        "source": pa.repeat("simulated", len(stroke)),
        "discipline": filed.take(row),
        "game": game[row] + 1,
        "rally": points.sum(axis=1)[row] + 1,
        "stroke": position + 1,
        "player": names.take(rallies.policy[row, seat]),
        "opponent": names.take(rallies.policy[row, 1 - seat]),
        "hand": left[np.arange(len(stroke)), seat],
        **{name: getattr(catalogue, name)[stroke] for name in ("shot", "height", "technique")},
        "hurried": rallies.hurried.astype(np.bool_),
        "area": court.area_of(landing_x, landing_y),
        "in_court": court.in_court(landing_x, landing_y),
        "clock": frame // FRAME_RATE,
        "frame": frame,
        "outcome": outcome,
        "reason": reason,
        "points": after[row, seat],
        "points_opponent": after[row, 1 - seat],
    }
    try:
        return schema.stroke_table(columns, places)
    except pa.ArrowInvalid as error:
        raise ShuttleError(f"a score or a length of a rally that no match has ({error}); the log is damaged") from error


class SimulationError(ShuttleError):
    """Players with which no match can be simulated."""


def simulate(
    game: Game,
    players: Mapping[str, Policy],
    *,
    matches: int,
    seed: int,
    looks: Callable[[Game, tuple[str, str]], Looks] = looks_of,
) -> pa.Table:
    """Play matches (best of three games to 21) and write every stroke down.

    Pairs of players of one discipline meet in turn; a player who is in neither list of :mod:`shuttle_marl.data.upstream`
    meets all others.

    Args:
        players: the policy of each, which may read the score and the rally so far.
        seed: of all draws; the same arguments give the same table.
        looks: hands of two players by name.

    Returns:
        A table as of :func:`stroke_table`; matches are called ``simulated-1-PLAYER-PLAYER`` and so on.

    Raises:
        SimulationError: no two players of one discipline, or no match.
        PolicyError: a policy raised, or returned no distribution over the legal strokes.
    """
    rallies = simulated_rallies(game, players, matches=matches, seed=seed)
    names, pairs = list(players), _pairs(list(players))
    number = rallies.match.astype(np.int64) * len(pairs) + rallies.pairing
    titles = [f"simulated-{i + 1}-{a}-{b}" for i, (a, b) in zip(range(matches), itertools.cycle(pairs), strict=False)]
    rng = np.random.default_rng([seed, matches])
    titled = [titles[i] for i in number.tolist()]
    return stroke_table(
        rallies, game.catalogue, names, titled, rng, looks=lambda seats: looks(game, (names[seats[0]], names[seats[1]]))
    )


def simulated_rallies(game: Game, players: Mapping[str, Policy], *, matches: int, seed: int) -> Rallies:
    """The rallies of :func:`simulate`, as a log has them. Match m of a pair has the draws that a league with
    ``matches_per_draw=1`` would give it."""
    from shuttle_marl.kernel.matches import Matches, asking, play, play_matches  # noqa: PLC0415  numba is slow to import

    if matches < 1:
        raise SimulationError(f"{matches} matches: expected at least one")
    names = list(players)
    pairs = _pairs(names)
    policies = [*players.values()]
    tables = [policy for policy in policies if isinstance(policy, TabulatedPolicy)]
    keys = [draws.pairing_key(*pair) for pair in pairs]
    number = np.arange(matches)
    match, pairing = np.divmod(number, len(pairs))
    entrant = np.array([[names.index(a), names.index(b)] for a, b in pairs], np.int32)[pairing]
    key = draws.stream(seed, np.array(keys, np.uint64)[pairing], match)
    seated = Matches(entrant=entrant, first_server=(number % 2).astype(np.int8), key=key)
    if len(tables) == len(policies):
        played = play_matches(game, seated, tables).rallies
    else:
        wait = asking(game, policies, positions=True)
        played = play(game, seated, asking(game, policies), wait).rallies
    number_in_log, pairing_in_log = (column[played.match].astype(np.uint32) for column in (match, pairing))
    return dataclasses.replace(played, pairing=pairing_in_log, match=number_in_log)


def _pairs(players: list[str]) -> list[tuple[str, str]]:
    kinds = {name: discipline(name) for name in players}
    pairs = [(a, b) for a, b in itertools.combinations(players, 2) if len({kinds[a], kinds[b]} - {None}) < 2]
    if not pairs:
        raise SimulationError(f"players {', '.join(players) or 'none'}: expected at least two of one discipline")
    return pairs
