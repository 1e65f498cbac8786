"""Figures of play: shot mix, tempo, endings, landings, transitions, length of rallies; and the strokes to count them from."""

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.arrays import F64, I64
from shuttle_marl.data import load_strokes
from shuttle_marl.data.schema import REASONS, STROKES, Outcome
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.recording import Rallies, RallyLog
from shuttle_marl.recording.log_file import SUFFIX
from shuttle_marl.recording.simulate import stroke_table

ENDINGS: Final = ("winner", "out", "net", "short", "foul", "not known")
"""Endings of rallies: one more is a winner, all others are faults of the last striker."""
LONGEST: Final = 60
"""Rallies of more strokes are counted with those of so many."""


class AnalysisError(ShuttleError):
    """Nothing to analyse, or a picture that cannot be drawn."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Summary:
    """Figures of the play of one player, or of all together.

    Attributes:
        strokes, rallies, matches: how many there are: strokes of the player, rallies that the player was in.
        shots: ``[13]`` share of each shot type.
        areas: ``[9]`` share of each area among the landings in court.
        points: ``[M, 2]`` landing points of good strokes [m], the striker's frame.
        marked: whether the points were marked in matches; else they were drawn within the areas.
        transitions: ``[13, 13]`` how often a shot type (row) was answered by the player with another (column).
        endings: ``[6]`` share of each of :data:`ENDINGS` among the rallies that the player's strokes ended.
        lengths: ``[61]`` how many rallies had so many strokes.
        length: mean number of strokes of a rally.
        seconds: mean time from the opponent's stroke to the player's [s], NaN where no times are known.
        wins: share of the rallies won; for all together, by the server.
        value: mean value added by a stroke, NaN where no values were added.
    """

    strokes: int
    rallies: int
    matches: int
    shots: F64
    areas: F64
    points: F64
    marked: bool
    transitions: I64
    endings: F64
    lengths: I64
    length: float
    seconds: float
    wins: float
    value: float


def rally_table(strokes: pa.Table) -> pa.Table:
    """One row a rally of a stroke table.

    Returns:
        Columns ``match``, ``discipline`` (text), ``game`` (int8), ``rally`` (int16), ``first`` (int64, row of the first stroke
        kept), ``length`` (int16, number of the last stroke), ``server``, ``receiver`` (text), ``winner`` (text, null if not
        known), ``ending`` (dictionary of :data:`ENDINGS`), ``last_shot`` (int8), and ``seconds`` (float64, from the first stroke
        kept to the last, null where a time is not known).
    """
    frame = _Frame(strokes)
    first, last = frame.first, frame.last
    taken = {name: strokes[name].take(pa.array(first)) for name in ("match", "discipline", "game", "rally")}
    names = [strokes[name].to_numpy(zero_copy_only=False).astype(object) for name in ("player", "opponent")]
    struck = frame.stroke[first] % 2 == 1  # who struck the first stroke kept served if its number is odd
    ended = frame.outcome[last]
    won = np.where(ended == Outcome.WINNER, names[0][last], np.where(ended == Outcome.FAULT, names[1][last], None))
    clock = frame.clock[last] - frame.clock[first]
    return pa.table(
        {
            **taken,
            "first": first,
            "length": frame.stroke[last].astype(np.int16),
            "server": pa.array(np.where(struck, names[0][first], names[1][first]), pa.string()),
            "receiver": pa.array(np.where(struck, names[1][first], names[0][first]), pa.string()),
            "winner": pa.array(won, pa.string()),
            "ending": pa.DictionaryArray.from_arrays(pa.array(frame.ending[last], pa.int8()), pa.array(ENDINGS)),
            "last_shot": frame.shot[last].astype(np.int8),
            "seconds": pa.array(clock, pa.float64(), from_pandas=True),
        }
    )


def summarise(strokes: pa.Table, player: str | None = None) -> Summary:
    """Figures of one player, or of all.

    Args:
        strokes: of schema :data:`shuttle_marl.data.schema.STROKES`, rallies in order.
        player: whose strokes and rallies; None: everyone's.

    Raises:
        AnalysisError: the player has no stroke.
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
            f"no stroke of {player or 'anyone'}; players are {', '.join(sorted(set(strokes['player'].to_pylist()))[:20])}"
        )
    decided = present & rallies["winner"].is_valid().to_numpy()
    good = mine & (frame.outcome != Outcome.FAULT) & np.isfinite(frame.landing).all(axis=1) & frame.in_court
    ends = mine & np.isin(np.arange(len(mine)), frame.last) & (frame.outcome != Outcome.UNKNOWN)
    timed = np.flatnonzero(mine[1:] & frame.follows[1:] & np.isfinite(frame.clock[1:] - frame.clock[:-1])) + 1
    after = np.flatnonzero(mine[1:] & frame.follows[1:]) + 1
    length = rallies["length"].to_numpy()[present].astype(np.int64)
    transitions = np.zeros((N_SHOTS, N_SHOTS), np.int64)
    np.add.at(transitions, (frame.shot[after - 1], frame.shot[after]), 1)
    value = (
        strokes["value_added"].to_numpy(zero_copy_only=False)[mine]
        if "value_added" in strokes.column_names
        else np.array([np.nan])
    )
    return Summary(
        strokes=int(mine.sum()),
        rallies=int(present.sum()),
        matches=len(rallies.filter(pa.array(present))["match"].unique()),
        shots=_shares(frame.shot[mine], N_SHOTS),
        areas=_shares(frame.area[good], N_AREAS),
        points=frame.landing[good],
        marked="simulated" not in strokes["source"].unique().to_pylist(),
        transitions=transitions,
        endings=_shares(frame.ending[ends], len(ENDINGS)),
        lengths=np.bincount(np.minimum(length, LONGEST), minlength=LONGEST + 1),
        length=float(length.mean()),
        seconds=float((frame.clock[timed] - frame.clock[timed - 1]).mean()) if len(timed) else float("nan"),
        wins=float(won[decided].mean()) if decided.any() else float("nan"),
        value=float(np.nanmean(value)) if np.isfinite(value).any() else float("nan"),
    )


def players_of(strokes: pa.Table) -> list[str]:
    """Everyone who strikes, most strokes first."""
    counted = strokes["player"].value_counts().to_pylist()
    return [entry["values"] for entry in sorted(counted, key=lambda entry: (-entry["counts"], entry["values"]))]


class _Frame:
    """Columns of a stroke table as arrays, and where its rallies begin and end."""

    def __init__(self, strokes: pa.Table) -> None:
        def column(name: str) -> F64:
            return strokes[name].cast(pa.float64()).to_numpy(zero_copy_only=False)

        self.shot, self.outcome, self.stroke = (column(name).astype(np.int64) for name in ("shot", "outcome", "stroke"))
        self.area = strokes["area"].fill_null(-1).to_numpy().astype(np.int64)
        self.in_court = strokes["in_court"].fill_null(False).to_numpy(zero_copy_only=False)
        self.clock = column("clock")
        self.landing = np.stack([column("landing_x"), column("landing_y")], axis=1)
        match = strokes["match"].combine_chunks().dictionary_encode().indices.to_numpy()
        key = np.stack([match, column("game"), column("rally")])
        new = np.ones(len(match), np.bool_)
        new[1:] = (key[:, 1:] != key[:, :-1]).any(axis=0)
        self.first = np.flatnonzero(new)
        self.last = np.r_[self.first[1:], len(match)][: len(self.first)] - 1
        self.follows = ~new & (np.diff(self.stroke, prepend=0) == 1)
        reasons = np.array([ENDINGS.index(name) if name in ENDINGS else len(ENDINGS) - 1 for name in REASONS])
        reason = column("reason").astype(np.int64)
        self.ending = np.where(self.outcome == Outcome.WINNER, 0, reasons[reason])


def _shares(numbers: I64, size: int) -> F64:
    counts = np.bincount(numbers, minlength=size).astype(np.float64)
    return counts / max(1.0, counts.sum())


RALLIES = 20_000
"""About so many rallies of a log are looked at, unless more are asked for."""


def strokes_of(path: Path, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """The strokes of a rally log (a file or a folder of logs), of a Parquet file, or of a folder with annotated matches.

    Args:
        path: where they are.
        rallies: about how many rallies of a log are taken.
        seed: of the points and times that a log does not hold.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`.

    Raises:
        RecordingError: a log that cannot be read.
        DataError: no such file, or an unreadable one.
        AnalysisError: there is no stroke in it.
    """
    if path.suffix == SUFFIX or (path.is_dir() and any(path.glob(f"*{SUFFIX}"))):
        with RallyLog(path) as log:
            strokes = strokes_of_log(log, rallies=rallies, seed=seed)
    else:
        strokes = load_strokes(path)
    if not strokes.num_rows:
        raise AnalysisError(f"{path}: holds no stroke; play or convert some first")
    return strokes


def strokes_of_log(log: RallyLog, *, rallies: int = RALLIES, seed: int = 0) -> pa.Table:
    """Strokes of a rally log in the schema of annotated matches, of all its pairings about equally many rallies.

    A log holds decisions and outcomes; points on the court and times are drawn as in simulated tables
    (:func:`shuttle_marl.recording.simulate.stroke_table`). A match is named by its pairing and its number; where every
    rally stands for itself, it is a match of its own. Matches are whole but for those that two batches of the log share.

    Args:
        log: the log.
        rallies: about how many rallies are taken; all if the log has no more.
        seed: of points and times.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`, source ``simulated``.
    """
    rng = np.random.default_rng([seed, min(rallies, log.n_rallies)])
    if not log.n_rallies:
        return STROKES.empty_table()
    if rallies >= log.n_rallies:
        return pa.concat_tables([_table(log, found, rng) for _, found in log.batches()])
    each = -(-rallies // len(log.pairings))
    parts = [part for pairing in range(len(log.pairings)) for part in _sample(log, pairing, each)]
    return pa.concat_tables([_table(log, part, rng) for part in parts])


def _sample(log: RallyLog, pairing: int, wanted: int) -> list[Rallies]:
    """About so many rallies of a pairing, from batches spread over the log."""
    batches = log.batches_of_pairing(pairing)
    # Multiples of the golden ratio: however many are taken, they are spread evenly.
    spread = batches[np.argsort(np.arange(len(batches)) * 0.6180339887498949 % 1, kind="stable")]
    found: list[Rallies] = []
    for batch in spread.tolist():
        rallies = log.batch(batch)[1]
        rallies = rallies.select(rallies.pairing == pairing)
        _, first, place = np.unique(rallies.match, return_index=True, return_inverse=True)
        # The matches that begin before enough rallies have come.
        rallies = rallies.select(first[place] < wanted)
        if len(rallies):
            found.append(rallies)
            wanted -= len(rallies)
        if wanted <= 0:
            break
    return found


def _table(log: RallyLog, rallies: Rallies, rng: np.random.Generator) -> pa.Table:
    matches = [f"{pairing}-{number}" for pairing, number in zip(rallies.pairing, rallies.match, strict=True)]
    return stroke_table(rallies, log.catalogue, [player.name for player in log.policies], matches, rng)
