"""Simulated stroke tables: whole matches played on the tables of a game, in the schema of the annotated ones."""

import itertools
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.data import placing
from shuttle_marl.data.account import Account
from shuttle_marl.data.players import discipline
from shuttle_marl.data.schema import FAULT, RETURNED, STROKES, WINNER
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game import court, draws, rally, scoring
from shuttle_marl.game.rally import Game

Floats = npt.NDArray[np.floating]
Ints = npt.NDArray[np.int64]
Sums = npt.NDArray[np.float64]

_OUTCOME: Final = np.array([FAULT, WINNER, RETURNED, RETURNED])  # by outcome of the rules
_NO_DISCIPLINE: Final = "MS"


class SimulationError(ShuttleError):
    """Players or chances with which no match can be simulated."""


def simulate(game: Game, players: Mapping[str, Floats], *, matches: int, seed: int) -> pa.Table:
    """Play matches (best of three games to 21) and write every stroke down.

    Pairs of players of one discipline meet in turn; a player who is in neither list of :mod:`shuttle_marl.data.players`
    meets everybody, and a match between two such players is filed under men's singles.

    Args:
        game: the tables.
        players: ``[P]`` chance of each legal pair given its state, by player; as
            ``TabulatedPolicy.pair_probabilities`` gives them.
        matches: how many matches.
        seed: of all draws; the same arguments give the same table.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``, matches
        ``simulated-1-PLAYER-PLAYER`` and so on. ``area`` of a fault is that of its landing, as in the annotated data.

    Raises:
        SimulationError: no two players of one discipline, or chances that do not fit the game.
    """
    if matches < 1:
        raise SimulationError(f"{matches} matches: expected at least one")
    pairs = _pairs(list(players))
    totals = {name: _cumulative(game, name, p) for name, p in players.items()}
    seats = [pairs[i % len(pairs)] for i in range(matches)]
    rows = _play(game, [(totals[a], totals[b]) for a, b in seats], seed)
    return _table(game, seats, rows, np.random.default_rng([seed, matches]))


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


def _cumulative(game: Game, name: str, p: Floats) -> Sums:
    """``[P + 1]`` chances of all pairs before each one, added up; each state adds 1."""
    if np.shape(p) != (game.n_pairs,) or not (np.asarray(p) >= 0).all():
        raise SimulationError(f"player {name!r}: expected {game.n_pairs} chances, one for each legal pair, none negative")
    sums = np.bincount(game.pair_state, weights=p, minlength=game.n_states)
    playable = np.diff(game.pair_start) > 0
    if (np.abs(sums[playable] - 1) > 1e-4).any():
        state = int(np.flatnonzero(playable)[np.abs(sums[playable] - 1).argmax()])
        raise SimulationError(f"player {name!r}: chances sum to {sums[state]:g}, not 1, in state: {game.describe(state)}")
    return np.r_[0.0, np.cumsum(p, dtype=np.float64)]


def _choose(game: Game, total: Sums, state: int, draw: int) -> int:
    """Which legal stroke of a state a draw chooses."""
    start, end = game.pair_start[state], game.pair_start[state + 1]
    point = total[start] + draw / draws.CHOICE_ONE * (total[end] - total[start])
    point = min(point, np.nextafter(total[end], 0))
    return int(np.searchsorted(total[start : end + 1], point, side="right")) - 1


def _play(game: Game, seats: list[tuple[Sums, Sums]], seed: int) -> dict[str, Ints]:
    """Play all matches in lock-step; returns the columns of their strokes, match by match in playing order."""
    number = np.arange(len(seats))
    score = scoring.new(number % 2)
    records: list[Ints] = []
    while not score.over.all():
        key = draws.stream(seed, number, len(records))
        rows, winner = _play_rally(game, seats, score, key)
        before, score = score, scoring.step(score, winner)
        match, server = rows[0], before.server[rows[0]]
        context = (
            before.game[match],
            before.points[match].sum(axis=1) + 1,
            before.points[match, server] % 2 == 0,
            *score.by_game[match, before.game[match]].T,
        )
        records.append(np.concatenate([rows, np.stack(context).astype(np.int64)]))
    columns = np.concatenate(records, axis=1)
    names = ("match", "stroke", "striker", "played", "outcome", "game", "rally", "even", "points_0", "points_1")
    table = dict(zip(names, columns, strict=True))
    order = np.lexsort((table["stroke"], table["rally"], table["game"], table["match"]))
    return {name: column[order] for name, column in table.items()}


def _play_rally(game: Game, seats: list[tuple[Sums, Sums]], score: scoring.Score, key: draws.UInt64s) -> tuple[Ints, Ints]:
    """Play the next rally of every match that is not over.

    Returns:
        ``[5, n]`` match, number of the stroke, seat of the striker, catalogue index and outcome of each stroke; ``[B]``
        seat of the winner of each match's rally, -1 where none was played.
    """
    alive = np.flatnonzero(~score.over)
    striker = score.server.astype(np.int64)
    state = np.full(len(seats), rally.ROOT)
    winner = np.full(len(seats), -1)
    records = []
    stroke = 0
    while len(alive):
        stroke += 1
        bits = draws.draw(key[alive], stroke)
        choices = zip(alive, draws.choice_draw(bits), strict=True)
        k = np.array([_choose(game, seats[m][striker[m]], state[m], int(draw)) for m, draw in choices])
        played = game.pair_stroke[game.pair_start[state[alive]] + k]
        outcome, following = rally.strike(game, state[alive], k, draws.outcome_draw(bits))
        records.append(np.stack([alive, np.full(len(alive), stroke), striker[alive], played, _OUTCOME[outcome]]))
        over = following < 0
        winner[alive[over]] = np.where(outcome == rally.WINNER, striker[alive], 1 - striker[alive])[over]
        state[alive] = following
        striker[alive] = 1 - striker[alive]
        alive = alive[~over]
    return np.concatenate(records, axis=1), winner


def _table(game: Game, seats: list[tuple[str, str]], rows: dict[str, Ints], rng: np.random.Generator) -> pa.Table:
    catalogue = game.catalogue
    shot, target = catalogue.shot[rows["played"]].astype(np.int64), catalogue.area[rows["played"]].astype(np.int64)
    new_match = np.diff(rows["match"], prepend=-1) != 0
    played = placing.Played(
        shot=shot,
        area=target,
        outcome=rows["outcome"],
        stroke=rows["stroke"],
        new_game=(np.diff(rows["game"], prepend=-1) != 0) | new_match,
        right=rows["even"].astype(bool),
    )
    placed = placing.place(played, rng)
    starts = np.flatnonzero(new_match)
    since = np.repeat(placed.frame[starts], np.diff(np.r_[starts, len(shot)]))
    frame = placed.frame - since
    points = {
        name: xy.astype(np.float32)
        for name, xy in (
            ("landing", placed.landing),
            ("contact", placed.contact),
            ("striker", placed.striker),
            ("receiver", placed.receiver),
        )
    }
    landing_x, landing_y = points["landing"].T
    names = pa.array([name for pair in seats for name in pair])
    kinds = [discipline(a) or discipline(b) or _NO_DISCIPLINE for a, b in seats]
    matches = pa.array([f"simulated-{i}-{a}-{b}" for i, (a, b) in enumerate(seats, start=1)])
    striker = rows["striker"]
    columns = {
        "match": matches.take(pa.array(rows["match"])),
        "source": pa.repeat("simulated", len(shot)),
        "discipline": pa.array(kinds).take(pa.array(rows["match"])),
        "game": rows["game"] + 1,
        "rally": rows["rally"],
        "stroke": rows["stroke"],
        "player": names.take(pa.array(2 * rows["match"] + striker)),
        "opponent": names.take(pa.array(2 * rows["match"] + 1 - striker)),
        "shot": shot,
        "height": catalogue.height[rows["played"]],
        "technique": catalogue.technique[rows["played"]],
        "area": court.area_of(landing_x, landing_y),
        "in_court": court.in_court(landing_x, landing_y),
        **{f"{name}_{axis}": xy[:, i] for name, xy in points.items() for i, axis in enumerate("xy")},
        "clock": frame // placing.FRAME_RATE,
        "frame": frame,
        "outcome": rows["outcome"],
        "reason": placed.reason,
        "points": np.where(striker == 0, rows["points_0"], rows["points_1"]),
        "points_opponent": np.where(striker == 0, rows["points_1"], rows["points_0"]),
        "label_area": pa.nulls(len(shot), pa.int8()),
    }
    arrays = [
        values if isinstance(values, pa.Array) else pa.array(values, field.type, from_pandas=True)
        for field, values in ((field, columns[field.name]) for field in STROKES)
    ]
    return pa.table(arrays, schema=STROKES)
