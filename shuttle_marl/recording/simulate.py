"""Rallies as strokes in the schema of the annotated matches, and simulated matches."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.arrays import I64, Bools, Floats
from shuttle_marl.data import positions
from shuttle_marl.data.schema import STROKES, Account, Outcome, outcome_of
from shuttle_marl.data.upstream import discipline
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game import court, draws
from shuttle_marl.game.stroke import Catalogue
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.rally.record import Rallies
from shuttle_marl.recording.header import LogHeader, Player

_NO_DISCIPLINE: Final = "MS"


def stroke_table(
    rallies: Rallies, catalogue: Catalogue, players: Sequence[str], matches: Sequence[str], rng: np.random.Generator
) -> pa.Table:
    """Strokes of rallies in the schema of the annotated matches.

    Decisions, outcomes and scores are those of the rallies. Points on the court and times are drawn
    (:mod:`shuttle_marl.data.positions`): a good stroke lands in its target area, and flight times are medians of the annotated
    matches. A match is filed under the discipline of its first player who has one (:mod:`shuttle_marl.data.upstream`), or
    under men's singles; its time begins with the first of its rallies that is there.

    Args:
        rallies: R rallies, those of a match one after the other.
        catalogue: the strokes of the game.
        players: names by index, as ``rallies.policy`` counts them.
        matches: ``[R]`` name of each rally's match.
        rng: draws points and times.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``. ``area`` of a fault is that of its
        landing, as in the annotated data.
    """
    row, position, seat = rallies.row_of_stroke, rallies.position, rallies.striker
    stroke = rallies.stroke.astype(np.int64)
    outcome = np.full(len(stroke), Outcome.RETURNED)
    outcome[rallies.first_stroke[1:] - 1] = outcome_of(rallies.reason)
    number = np.arange(len(rallies))
    points = rallies.score[:, :2].astype(np.int64)
    game = rallies.score[:, 2:].sum(axis=1, dtype=np.int64)
    new_match = np.diff(rallies.pairing.astype(np.int64) << 32 | rallies.match, prepend=-1) != 0
    new_game = new_match | (np.diff(game, prepend=-1) != 0)
    placed = positions.sample_positions(
        positions.SimulatedStrokes(
            shot=catalogue.shot[stroke].astype(np.int64),
            area=catalogue.area[stroke].astype(np.int64),
            outcome=outcome,
            stroke=position + 1,
            new_game=new_game[row] & (position == 0),
            right=(points[number, rallies.server] % 2 == 0)[row],
        ),
        rng,
    )
    frame = placed.frame - _first_frame(rallies, placed.frame, new_match)[row]
    after = points.copy()
    after[number, rallies.winner] += 1
    names, kinds = pa.array(players, pa.string()), [discipline(name) for name in players]
    filed = pa.array([kinds[a] or kinds[b] or _NO_DISCIPLINE for a, b in rallies.policy.tolist()], pa.string())
    places = {"landing": placed.landing, "contact": placed.contact, "striker": placed.striker, "receiver": placed.receiver}
    landing_x, landing_y = placed.landing.astype(np.float32).T
    columns = {
        "match": pa.array(matches, pa.string()).take(row),
        "source": pa.repeat("simulated", len(stroke)),
        "discipline": filed.take(row),
        "game": game[row] + 1,
        "rally": points.sum(axis=1)[row] + 1,
        "stroke": position + 1,
        "player": names.take(rallies.policy[row, seat]),
        "opponent": names.take(rallies.policy[row, 1 - seat]),
        "shot": catalogue.shot[stroke],
        "height": catalogue.height[stroke],
        "technique": catalogue.technique[stroke],
        "area": court.area_of(landing_x, landing_y),
        "in_court": court.in_court(landing_x, landing_y),
        **{f"{name}_{axis}": xy[:, i].astype(np.float32) for name, xy in places.items() for i, axis in enumerate("xy")},
        "clock": frame // positions.FRAME_RATE,
        "frame": frame,
        "outcome": outcome,
        "reason": placed.reason,
        "points": after[row, seat],
        "points_opponent": after[row, 1 - seat],
        "label_area": pa.nulls(len(stroke), pa.int8()),
    }
    return pa.table([_array(columns[field.name], field.type) for field in STROKES], schema=STROKES)


def _first_frame(rallies: Rallies, frame: I64, new_match: Bools) -> I64:
    """``[R]`` frame of the first stroke of each rally's match."""
    return frame[rallies.first_stroke[:-1][new_match]][np.cumsum(new_match) - 1]


def _array(values: pa.Array | npt.NDArray[np.generic], kind: pa.DataType) -> pa.Array:
    return values if isinstance(values, pa.Array) else pa.array(values, kind, from_pandas=True)


class SimulationError(ShuttleError):
    """Players or probabilities with which no match can be simulated."""


def simulate(game: Game, players: Mapping[str, Floats], *, matches: int, seed: int) -> pa.Table:
    """Play matches (best of three games to 21) and write every stroke down.

    Pairs of players of one discipline meet in turn; a player who is in neither list of :mod:`shuttle_marl.data.upstream`
    meets all others.

    Args:
        game: the tables.
        players: ``[P]`` probability of each legal pair given its state, by player; as
            ``TabulatedPolicy.pair_probabilities`` gives them.
        matches: number of matches.
        seed: of all draws; the same arguments give the same table.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, see :func:`~shuttle_marl.recording.simulate`; matches
        are called ``simulated-1-PLAYER-PLAYER`` and so on.

    Raises:
        SimulationError: no two players of one discipline, or probabilities that do not fit the game.
    """
    _, rallies = simulated_rallies(game, players, matches=matches, seed=seed)
    names, pairs = list(players), _pairs(list(players))
    number = rallies.match.astype(np.int64) * len(pairs) + rallies.pairing
    titles = [f"simulated-{i + 1}-{a}-{b}" for i, (a, b) in zip(range(matches), itertools.cycle(pairs), strict=False)]
    rng = np.random.default_rng([seed, matches])
    return stroke_table(rallies, game.catalogue, names, [titles[i] for i in number.tolist()], rng)


def simulated_rallies(game: Game, players: Mapping[str, Floats], *, matches: int, seed: int) -> tuple[LogHeader, Rallies]:
    """The rallies of :func:`simulate`, and the header with which a log of them can be played again.

    Match m of a pair has the draws that a league with ``matches_per_draw=1`` would give it.

    Raises:
        SimulationError: see :func:`simulate`.
    """
    from shuttle_marl.kernel import Matches, play_matches  # noqa: PLC0415  numba is slow to import

    if matches < 1:
        raise SimulationError(f"{matches} matches: expected at least one")
    names = list(players)
    pairs = _pairs(names)
    tables = [_table(game, name, p) for name, p in players.items()]
    keys = [draws.pairing_key(*pair) for pair in pairs]
    number = np.arange(matches)
    match, pairing = np.divmod(number, len(pairs))
    entrant = np.array([[names.index(a), names.index(b)] for a, b in pairs], np.int32)[pairing]
    key = draws.stream(seed, np.array(keys, np.uint64)[pairing], match)
    played = play_matches(game, Matches(entrant=entrant, first_server=(number % 2).astype(np.int8), key=key), tables).rallies
    header = LogHeader(
        seed=seed,
        game=game.hash,
        strokes=game.catalogue.names,
        policies=tuple(Player(name=name, hash=table.hash) for name, table in zip(names, tables, strict=True)),
        pairings=tuple(keys),
        matches_per_draw=1,
    )
    number_in_log, pairing_in_log = (column[played.match].astype(np.uint32) for column in (match, pairing))
    return header, dataclasses.replace(played, pairing=pairing_in_log, match=number_in_log)


def account_of(strokes: pa.Table) -> Account:
    """The account of a simulated table, of which nothing was dropped."""
    rallies = strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows
    return Account(
        matches=len(strokes["match"].unique()),
        rallies=rallies,
        rallies_kept=rallies,
        strokes=strokes.num_rows,
        strokes_kept=strokes.num_rows,
        dropped={},
        area_agreement=None,
    )


def _pairs(players: list[str]) -> list[tuple[str, str]]:
    kinds = {name: discipline(name) for name in players}
    pairs = [
        (a, b) for a, b in itertools.combinations(players, 2) if kinds[a] is None or kinds[b] is None or kinds[a] == kinds[b]
    ]
    if not pairs:
        raise SimulationError(f"players {', '.join(players) or 'none'}: expected at least two of one discipline")
    return pairs


def _table(game: Game, name: str, p: Floats) -> TabulatedPolicy:
    if np.shape(p) != (game.n_pairs,) or not (np.asarray(p) >= 0).all():
        raise SimulationError(f"player {name!r}: expected {game.n_pairs} probabilities, one for each legal pair, none negative")
    sums = game.sum_by_state(p)
    off = np.where(game.playable, np.abs(sums - 1), 0)
    if (off > 1e-4).any():
        state = int(off.argmax())
        raise SimulationError(f"player {name!r}: probabilities sum to {sums[state]:g}, not 1, in state: {game.describe(state)}")
    return from_pair_probabilities(game, p)
