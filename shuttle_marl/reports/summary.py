"""Stroke tables as reports read them: strokes of files and logs, rallies, results, hands, and summaries of play."""

import dataclasses
import itertools
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.arrays import F64, I64
from shuttle_marl.base.errors import ShuttleError, whole_number
from shuttle_marl.data import read_matches
from shuttle_marl.data.hands import receiver_hands
from shuttle_marl.data.matches import game_ends, real_rallies, winner_of
from shuttle_marl.data.schema import REASONS, STROKES, Outcome, rally_starts
from shuttle_marl.data.simulated import stroke_table
from shuttle_marl.game.court import HANDS, N_AREAS, mirrored
from shuttle_marl.game.pairs import Skill
from shuttle_marl.game.scoring import wins_game
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.recording import Rallies, RallyLog
from shuttle_marl.recording.reader import is_log

ENDINGS: Final = ("winner", "out", "net", "short", "foul", "not known")  # a winner, or a fault by its kind
LONGEST: Final = 60  # largest counted length of a rally; longer rallies count as this long


class AnalysisError(ShuttleError):
    """No strokes to analyse, or none of a player or a match."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Summary:
    """Summary of the play of one player, or of all players together.

    Attributes:
        strokes, rallies, matches: number of strokes by the player, and of rallies and matches with the player.
        shots: ``[13]`` share of each shot type.
        areas: ``[9]`` share of each target area among the landings in court; right is the receiver's forehand side.
        transitions: ``[13, 13]`` number of replies of the player by incoming shot type (row) and own shot type (column).
        endings: ``[6]`` share of each of :data:`ENDINGS` among the rallies that ended with the player's stroke.
        lengths: ``[61]`` number of rallies by number of strokes.
        length: mean number of strokes of a rally.
        seconds: mean time from the opponent's stroke to the player's [s]; NaN without times.
        wins: share of the rallies won; for all players together, won by the server.
        value: mean value added by a stroke; NaN without values.
    """

    strokes: int
    rallies: int
    matches: int
    shots: F64
    areas: F64
    transitions: I64
    endings: F64
    lengths: I64
    length: float
    seconds: float
    wins: float
    value: float


def rally_table(strokes: pa.Table) -> pa.Table:
    """Table with one row per rally of a stroke table.

    Returns:
        Columns ``match``, ``discipline`` (text), ``game`` (int8), ``rally`` (int16), ``first`` (int64, row of the first recorded
        stroke), ``length`` (int16, number of the last stroke), ``server``, ``receiver`` (text), ``winner`` (text, null if
        unknown), ``ending`` (dictionary of :data:`ENDINGS`), ``last_shot`` (int8), and ``seconds`` (float64, from the first
        recorded stroke to the last, null if a time is unknown).
    """
    frame = _Frame(strokes)
    first, last = frame.first, frame.last
    columns = {name: strokes[name].take(pa.array(first)) for name in ("match", "discipline", "game", "rally")}
    names = [strokes[name].to_numpy(zero_copy_only=False).astype(object) for name in ("player", "opponent")]
    served = frame.stroke[first] % 2 == 1  # strokes with odd numbers are the server's
    ended = frame.outcome[last]
    won = np.where(ended == Outcome.WINNER, names[0][last], np.where(ended == Outcome.FAULT, names[1][last], None))
    clock = frame.clock[last] - frame.clock[first]
    return pa.table(
        {
            **columns,
            "first": first,
            "length": frame.stroke[last].astype(np.int16),
            "server": pa.array(np.where(served, names[0][first], names[1][first]), pa.string()),
            "receiver": pa.array(np.where(served, names[1][first], names[0][first]), pa.string()),
            "winner": pa.array(won, pa.string()),
            "ending": pa.DictionaryArray.from_arrays(pa.array(frame.ending[last], pa.int8()), pa.array(ENDINGS)),
            "last_shot": frame.shot[last].astype(np.int8),
            "seconds": pa.array(clock, pa.float64(), from_pandas=True),
        }
    )


def won_or_lost(strokes: pa.Table) -> F64:
    """``[N]`` whether the striker won the rally of each stroke, 1 or 0; NaN where that is not known."""
    rallies = rally_table(strokes)
    won, player = (
        table[name].to_numpy(zero_copy_only=False).astype(object) for table, name in ((rallies, "winner"), (strokes, "player"))
    )
    winner = np.repeat(won, np.diff(rallies["first"].to_numpy(), append=len(strokes)))
    return np.where(winner == None, np.nan, (winner == player).astype(np.float64))  # noqa: E711  an array of objects


class Met(NamedTuple):
    """Real results of a player against another: points, games and matches of both, and those that the first one won."""

    points: int
    points_won: int
    games: int
    games_won: int
    matches: int
    matches_won: int


def met(strokes: pa.Table, first: str, second: str) -> Met:
    """Results of two players in a table of strokes, by its points, or by the winners of rallies where it has none. The last rally
    of a game that the rules tell counts. Games and matches that were not finished count for neither."""
    both = pa.array([first, second])
    rows = pc.and_(*(pc.is_in(strokes[name], value_set=both) for name in ("player", "opponent")))
    rallies = [*real_rallies(strokes.filter(rows))]
    points, games, winners = list[tuple[int, int]](), list[bool](), list[bool]()
    for _, part in itertools.groupby(rallies, key=lambda rally: rally.match):
        played = [*part]
        mine = played[0].players.index(first)
        for game, *_ in game_ends(played).values():
            points.append((game[mine], game[1 - mine]))
            if wins_game(max(game), min(game), played[0].score.rules):
                games.append(game[mine] > game[1 - mine])
        if (winner := winner_of(played)) is not None:
            winners.append(winner == mine)
    won, lost = np.sum(points, axis=0, dtype=int).tolist() if points else (0, 0)
    return Met(won + lost, won, len(games), sum(games), len(winners), sum(winners))


def with_hands_of_model(strokes: pa.Table, skill: Skill) -> pa.Table:
    """Strokes of schema :data:`shuttle_marl.data.schema.STROKES` with the hands that a model knows where the table knows none."""
    known = {name: HANDS.index(hand) for name in skill.players if (hand := skill.hand_of(name)) is not None}
    told = pa.array([known.get(name) for name in strokes["player"].to_pylist()], pa.int8())
    place = strokes.schema.get_field_index("hand")
    return strokes.set_column(place, strokes.schema.field(place), pa.compute.coalesce(strokes["hand"], told))


def hand_of(strokes: pa.Table, player: str) -> str | None:
    """Hand of a player in a table of strokes, one of :data:`~shuttle_marl.game.court.HANDS`; None: not known."""
    hands = strokes["hand"].filter(pa.compute.equal(strokes["player"], player)).drop_null()
    return HANDS[hands[0].as_py()] if len(hands) else None


def summarise(strokes: pa.Table, player: str | None = None) -> Summary:
    """Summarise the play of one player, or of all players.

    Args:
        strokes: of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.
        player: name of the player; None: all players.

    Raises:
        AnalysisError: the table has no stroke of the player.
    """
    frame = _Frame(strokes)
    rallies = rally_table(strokes)
    server, winner = (rallies[name].to_numpy(zero_copy_only=False).astype(object) for name in ("server", "winner"))
    if player is None:
        mine, present, won = np.ones(len(frame.shot), np.bool_), np.ones(len(rallies), np.bool_), winner == server
    else:
        mine = strokes["player"].to_numpy(zero_copy_only=False).astype(object) == player
        present = (server == player) | (rallies["receiver"].to_numpy(zero_copy_only=False).astype(object) == player)
        won = winner == player
    if not mine.any():
        raise AnalysisError(
            f"no strokes of {player or 'any player'}; players are {', '.join(sorted(set(strokes['player'].to_pylist()))[:20])}"
        )
    decided = present & rallies["winner"].is_valid().to_numpy()
    left = receiver_hands(strokes) == HANDS.index("left")
    good = mine & (frame.outcome != Outcome.FAULT) & np.isfinite(frame.landing).all(axis=1) & frame.in_court
    ends = mine & np.isin(np.arange(len(mine)), frame.last) & (frame.outcome != Outcome.UNKNOWN)
    timed = np.flatnonzero(mine[1:] & frame.follows[1:] & np.isfinite(frame.clock[1:] - frame.clock[:-1])) + 1
    after = np.flatnonzero(mine[1:] & frame.follows[1:]) + 1
    length = rallies["length"].to_numpy()[present].astype(np.int64)
    transitions = np.zeros((N_SHOTS, N_SHOTS), np.int64)
    np.add.at(transitions, (frame.shot[after - 1], frame.shot[after]), 1)
    valued = "value_added" in strokes.column_names
    value = strokes["value_added"].to_numpy(zero_copy_only=False)[mine] if valued else np.array([np.nan])
    return Summary(
        strokes=int(mine.sum()),
        rallies=int(present.sum()),
        matches=len(rallies.filter(pa.array(present))["match"].unique()),
        shots=_shares(frame.shot[mine], N_SHOTS),
        areas=_shares(np.where(left, mirrored(frame.area), frame.area)[good], N_AREAS),
        transitions=transitions,
        endings=_shares(frame.ending[ends], len(ENDINGS)),
        lengths=np.bincount(np.minimum(length, LONGEST), minlength=LONGEST + 1),
        length=float(length.mean()),
        seconds=float((frame.clock[timed] - frame.clock[timed - 1]).mean()) if len(timed) else float("nan"),
        wins=float(won[decided].mean()) if decided.any() else float("nan"),
        value=float(np.nanmean(value)) if np.isfinite(value).any() else float("nan"),
    )


def players_of(strokes: pa.Table) -> list[str]:
    """Names of the players, most strokes first."""
    counted = strokes["player"].value_counts().to_pylist()
    return [entry["values"] for entry in sorted(counted, key=lambda entry: (-entry["counts"], entry["values"]))]


class _Frame:
    """Columns of a stroke table as arrays, with the first and last row of each rally."""

    def __init__(self, strokes: pa.Table) -> None:
        def column(name: str) -> F64:
            return strokes[name].cast(pa.float64()).to_numpy(zero_copy_only=False)

        self.shot, self.outcome, self.stroke = (column(name).astype(np.int64) for name in ("shot", "outcome", "stroke"))
        self.area = strokes["area"].fill_null(-1).to_numpy().astype(np.int64)
        self.in_court = strokes["in_court"].fill_null(False).to_numpy(zero_copy_only=False)
        self.clock = column("clock")
        self.landing = np.stack([column("landing_x"), column("landing_y")], axis=1)
        starts = rally_starts(strokes)
        self.first, self.last = starts[:-1], starts[1:] - 1
        self.follows = np.diff(self.stroke, prepend=0) == 1
        self.follows[self.first] = False
        reasons = np.array([ENDINGS.index(name) if name in ENDINGS else len(ENDINGS) - 1 for name in REASONS])
        reason = column("reason").astype(np.int64)
        self.ending = np.where(self.outcome == Outcome.WINNER, 0, reasons[reason])


def _shares(numbers: I64, size: int) -> F64:
    counts = np.bincount(numbers, minlength=size).astype(np.float64)
    return counts / max(1.0, counts.sum())


RALLIES = 20_000


def strokes_of(path: Path | str, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """Strokes of a rally log (a file or a folder of logs), of a Parquet file, or of a folder with annotated matches.

    Args:
        path: the log, file or folder.
        rallies: approximate number of rallies sampled from a log.
        seed: random seed of points and times, which logs do not hold.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`.

    Raises:
        RecordingError: the log cannot be read.
        DataError: the file is missing or cannot be read.
        AnalysisError: there are no strokes.
        OptionError: ``rallies`` is less than 1.
    """
    path, rallies = Path(path), whole_number("rallies", rallies, 1)
    if is_log(path):
        with RallyLog(path) as log:
            strokes = strokes_of_log(log, rallies=rallies, seed=seed)
    else:
        strokes = read_matches(path)
    if not strokes.num_rows:
        raise AnalysisError(f"{path}: no strokes; record or convert some first")
    return strokes


def strokes_of_log(log: RallyLog, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """Strokes of a rally log in the schema of annotated matches, with about the same number of rallies from each pairing.

    A log holds decisions and outcomes; points on the court and times are sampled as in simulated tables
    (:func:`shuttle_marl.data.simulated.stroke_table`). Matches are named by pairing and number; a single rally counts as a
    match. Matches are complete, except those that span two batches of the log.

    Args:
        rallies: approximate number of rallies; all if the log has no more.
        seed: random seed of points and times.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``.
    """
    rng = np.random.default_rng([seed, min(rallies, log.n_rallies)])
    if not log.n_rallies:
        return STROKES.empty_table()
    if rallies >= log.n_rallies:
        return pa.concat_tables([_table(log, batch, rng) for _, batch in log.batches()])
    each = -(-rallies // len(log.pairings))
    parts = [part for pairing in range(len(log.pairings)) for part in _sample(log, pairing, each)]
    return pa.concat_tables([_table(log, part, rng) for part in parts])


def _sample(log: RallyLog, pairing: int, wanted: int) -> list[Rallies]:
    """About ``wanted`` rallies of a pairing, from batches spread over the log."""
    batches = log.batches_of_pairing(pairing)
    # A golden-ratio sequence: any number of its first terms is spread evenly.
    spread = batches[np.argsort(np.arange(len(batches)) * 0.6180339887498949 % 1, kind="stable")]
    parts: list[Rallies] = []
    for batch in spread.tolist():
        rallies = log.batch(batch)[1]
        rallies = rallies.select(rallies.pairing == pairing)
        _, first, place = np.unique(rallies.match, return_index=True, return_inverse=True)
        # Matches that begin within the first `wanted` rallies.
        rallies = rallies.select(first[place] < wanted)
        if len(rallies):
            parts.append(rallies)
            wanted -= len(rallies)
        if wanted <= 0:
            break
    return parts


def _table(log: RallyLog, rallies: Rallies, rng: np.random.Generator) -> pa.Table:
    matches = [f"{pairing}-{number}" for pairing, number in zip(rallies.pairing, rallies.match, strict=True)]
    return stroke_table(rallies, log.catalogue, [player.name for player in log.policies], matches, rng, looks=log.header.looks)
