"""Tables of clean strokes: made from the raw rows of a match, written with their account and provenance, read back strictly.

Cleaning infers sides, areas and outcomes; every dropped row is counted by its reason.

What is known to be wrong in the files, and what is done about it (measured on the 82 public matches; ``docs/datasheet.md``
tells more):

* Eight matches stand in both data sets; the second copy is not read.
* Ends swap between games and in mid game 3: the side is inferred for every rally from all coordinates. In two rallies of
  games 2 the letters A and B are exchanged: the ends tell, and the outcome makes sense once they are put right.
* Area labels of ShuttleSet's matches 9 to 20 are mirrored for strokes that land in the lower half (39 % agree with the
  coordinates there, 98.7 % once flipped): areas are computed from the coordinates; the corrected label is kept beside them
  only for comparison. In game 1 of ShuttleSet's match 3 only 86 % agree: 91 % of the others are labels mirrored by slips of
  the annotators, the coordinates are sound.
* A row of unknown shot type (2,345 of 77,653, nearly always a serve that the camera missed) is dropped, the rest of its
  rally is kept. The column ``flaw`` says nearly the same; its 44 rows with a known shot type are judged like all others.
* A game whose homography is broken puts both players in one half: it is dropped as a whole.
* Contact heights are noise in some games. In ShuttleSet's match 1 they agree with the height at which the receiver of the
  stroke before met the shuttle in 49 % of rows (elsewhere in 95 % or more, where both are known). In three more games over
  a tenth of the drops, smashes, half smashes, lifts and net shots is struck from the wrong height (median of all games
  2 %). Those games are dropped.
* The winner of a rally is missing in 245 rallies (3.6 %): it follows from the score in all but two. One annotated winner
  contradicts score and reason: the score decides.
* Two games hold a rally at the end of the file that was played early, one stroke stands there twice, and one rally bears the
  number of the one before: rows are put in order, the repeated row is dropped, and the second rally counts as broken.
* Frames run backwards or stand still between 0.7 % of consecutive strokes: times that do not fit are null.
* The contact point of a few strokes lies far in the opponent's half (nearly always the reply to a missed serve): it is null.
"""

import collections
import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from shuttle_marl import __version__, table_files
from shuttle_marl.data import upstream
from shuttle_marl.data.inference import (
    arrange,
    broken_rallies,
    corrected_label,
    heights_unreliable,
    outcomes,
    rally_starts,
    sides,
    timed,
    with_letters_fixed,
)
from shuttle_marl.data.schema import REACH_OVER, STROKES, Outcome
from shuttle_marl.data.shuttleset import RawGame, list_matches, read_game
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.files import problem
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES

_COORDINATES: Final = {"landing": "landing", "contact": "hit", "striker": "player_location", "receiver": "opponent_location"}

DROP_REASONS: Final = {
    "repeated row": "The same stroke of the same player stands there twice.",
    "unreadable value": "A value that cannot be what it should be, in a published file.",
    "broken homography": "More than a fifth of the rows of the game put both players in one half.",
    "contact heights unreliable": "Those of the whole game contradict each other, or the shot types.",
    "broken rally": "Strokes are not numbered 1, 2, …, players do not alternate, or the rally's number is taken.",
    "unknown shot type": "Nearly always a serve that the camera missed; the rest of the rally is kept.",
    "serve type inside a rally": "A serve that is not the first stroke.",
    "first stroke is no serve": "A rally that starts with another shot type.",
    "contact height missing": "Above or below the net is not known.",
    "side of the court unknown": "No coordinate tells the striker's half, or they contradict the rest of the rally.",
    "landing missing": "No landing point, of a stroke that is no fault.",
    "landing on the striker's side": "A returned or winning stroke that seems to have landed in the striker's own half.",
}
"""Reasons to drop a row, in the order in which they are tried."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Account:
    """Counts of a stroke table, totals after deduplication of matches.

    Attributes:
        matches: matches read.
        rallies, strokes: numbers before dropping.
        rallies_kept: rallies of which at least one stroke was kept.
        strokes_kept: rows of the table.
        dropped: rows dropped by reason, keys of :data:`DROP_REASONS`; reasons that never applied are left out.
        area_agreement: share of kept strokes with an in-court label whose label is the area computed from the
            coordinates; None where there are no labels.
    """

    matches: int
    rallies: int
    rallies_kept: int
    strokes: int
    strokes_kept: int
    dropped: dict[str, int]
    area_agreement: float | None

    def as_json(self) -> dict[str, Any]:
        """The account as plain values."""
        return {
            "matches": self.matches,
            "rallies": {"total": self.rallies, "kept": self.rallies_kept},
            "strokes": {"total": self.strokes, "kept": self.strokes_kept},
            "dropped": self.dropped,
            "area_agreement": self.area_agreement,
        }

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "Account":
        """Read what :meth:`as_json` gave.

        Raises:
            KeyError, TypeError: it is something else.
        """
        return cls(
            matches=values["matches"],
            rallies=values["rallies"]["total"],
            rallies_kept=values["rallies"]["kept"],
            strokes=values["strokes"]["total"],
            strokes_kept=values["strokes"]["kept"],
            dropped=dict(values["dropped"]),
            area_agreement=values["area_agreement"],
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cleaned:
    """Clean strokes and the account of what was left out.

    Attributes:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, in playing order.
        account: what was read and what was dropped.
        files: the files of games that were read, in order.
    """

    strokes: pa.Table
    account: Account
    files: tuple[Path, ...]


def clean_matches(root: Path, names: Iterable[str] | None = None) -> Cleaned:
    """Read and clean the matches below ``root`` whose files are there.

    Args:
        root: folder of the download.
        names: only these matches; default all that are there.

    Raises:
        DataError: unreadable input, or a named match that is not there.
    """
    wanted = None if names is None else set(names)
    matches = [m for m in list_matches(root) if m.present and (wanted is None or m.name in wanted)]
    absent = (wanted or set()) - {m.name for m in matches}
    if absent or not matches:
        missing = ", ".join(sorted(absent)) or "any match"
        raise DataError(root, f"no files of {missing}; get them with `python -m shuttle_marl.data download`")
    games = [read_game(match, path) for match in matches for path in match.games()]
    cleaned = [clean_game(game) for game in games]
    strokes = pa.concat_tables([table for table, _ in cleaned])
    dropped = sum((collections.Counter(counts) for _, counts in cleaned), collections.Counter[str]())
    account = Account(
        matches=len(matches),
        rallies=sum(len(np.unique(game.rally)) for game in games),
        rallies_kept=strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows,
        strokes=sum(len(game.line) for game in games),
        strokes_kept=strokes.num_rows,
        dropped={reason: dropped[reason] for reason in DROP_REASONS if dropped[reason]},
        area_agreement=_area_agreement(strokes),
    )
    return Cleaned(strokes=strokes, account=account, files=tuple(game.path for game in games))


def clean_game(raw: RawGame) -> tuple[pa.Table, dict[str, int]]:
    """Clean the rows of one game.

    Returns:
        The strokes kept, and the number of rows dropped by reason.
    """
    raw, repeated = arrange(raw)
    first = rally_starts(raw)
    raw = with_letters_fixed(raw, first)
    side, contradicted = sides(raw, first)
    outcome, reason = outcomes(raw, first)
    # In the image x points right and y down: the lower player's right is +x and the upper player's right is -x.
    facing = np.where(side[:, None] > 0, [1.0, -1.0], [-1.0, 1.0])
    ego = {name: (raw.point[column] * facing).astype(np.float32) for name, column in _COORDINATES.items()}
    is_serve = (raw.shot >= 0) & (raw.shot < N_SERVES)
    # The receiver meets a serve, not the server; and no one reaches far over the net or stands beyond it.
    ego["contact"][is_serve | (ego["contact"][:, 1] > REACH_OVER)] = np.nan
    ego["striker"][ego["striker"][:, 1] > 0] = np.nan
    ego["receiver"][ego["receiver"][:, 1] < 0] = np.nan
    landing_x, landing_y = ego["landing"].T
    area = court.area_of(landing_x, landing_y)
    label = corrected_label(raw, own_half=landing_y < 0)
    tests = {
        "unreadable value": raw.unreadable,
        "broken homography": np.full(len(first), raw.broken_homography),
        "contact heights unreliable": np.full(len(first), heights_unreliable(raw, first)),
        "broken rally": broken_rallies(raw, first),
        "unknown shot type": raw.shot < 0,
        "serve type inside a rally": is_serve & (raw.stroke > 1),
        "first stroke is no serve": ~is_serve & (raw.stroke == 1),
        "contact height missing": (raw.height < 0) & ~is_serve,
        "side of the court unknown": (side == 0) | contradicted,
        "landing missing": (area < 0) & (outcome != Outcome.FAULT),
        "landing on the striker's side": (landing_y < -REACH_OVER) & (outcome != Outcome.FAULT),
    }
    keep = np.ones(len(first), dtype=bool)
    counts = {"repeated row": repeated}
    for name, test in tests.items():
        counts[name] = int((keep & test).sum())
        keep &= ~test
    rows = np.flatnonzero(keep)
    score = raw.score[np.flatnonzero(np.r_[first[1:], True])][np.cumsum(first) - 1]  # of a rally: that of its last row
    n = len(first)
    players = pa.array(raw.match.players)
    texts = {
        "match": pa.repeat(raw.match.name, len(rows)),
        "source": pa.repeat(raw.match.source, len(rows)),
        "discipline": pa.repeat(raw.match.discipline, len(rows)),
        "player": players.take(pa.array(np.where(raw.by_a, 0, 1)[rows])),
        "opponent": players.take(pa.array(np.where(raw.by_a, 1, 0)[rows])),
    }
    columns: dict[str, npt.NDArray[Any]] = {
        "game": np.full(n, raw.game),
        "rally": raw.rally,
        "stroke": raw.stroke,
        "shot": raw.shot,
        "height": np.where(is_serve, 0, raw.height),  # the laws demand it; two serves are annotated as above the net
        "technique": np.where(raw.backhand, 1, np.where(raw.around_head, 2, 0)),
        "area": area,
        "in_court": court.in_court(landing_x, landing_y),
        **{f"{name}_{axis}": xy[:, i] for name, xy in ego.items() for i, axis in enumerate("xy")},
        "clock": raw.clock,
        "frame": raw.frame,
        "outcome": outcome,
        "reason": reason,
        "points": np.where(raw.by_a, score[:, 0], score[:, 1]),
        "points_opponent": np.where(raw.by_a, score[:, 1], score[:, 0]),
        "label_area": label,
    }
    untimed = ~timed(raw, first)
    missing = {
        "area": area < 0,
        "in_court": area < 0,
        "label_area": label < 0,
        "clock": untimed,
        "frame": untimed,
        **{name: columns[name] < 0 for name in ("points", "points_opponent")},
        **{name: np.isnan(values) for name, values in columns.items() if values.dtype == np.float32},
    }
    arrays = dict(texts)
    for name, values in columns.items():
        mask = missing.get(name)
        arrays[name] = pa.array(values[rows], STROKES.field(name).type, mask=None if mask is None else mask[rows])
    return pa.table([arrays[name] for name in STROKES.names], schema=STROKES), counts


def _area_agreement(strokes: pa.Table) -> float | None:
    labelled = strokes["label_area"].is_valid().to_numpy()
    if not labelled.any():
        return None
    agrees = strokes["area"].to_numpy() == strokes["label_area"].to_numpy()
    return float(agrees[labelled].mean())


_ACCOUNT: Final = b"shuttle_marl.account"
_PROVENANCE: Final = b"shuttle_marl.provenance"


def load_strokes(path: Path | str) -> pa.Table:
    """The strokes of a Parquet file made by ``convert``, or of a folder with the raw files, which are cleaned.

    Returns:
        A table of schema :data:`shuttle_marl.data.schema.STROKES`.

    Raises:
        DataError: no such file or folder, an unreadable one, or another schema.
    """
    path = Path(path)
    return clean_matches(path).strokes if path.is_dir() else read_parquet(path)


def load_account(path: Path | str) -> Account:
    """The account of a Parquet file, or of a folder with the raw files.

    Raises:
        DataError: as :func:`load_strokes`; or the file holds no account.
    """
    path = Path(path)
    if path.is_dir():
        return clean_matches(path).account
    metadata = _open(path).schema_arrow.metadata or {}
    try:
        return Account.from_json(json.loads(metadata[_ACCOUNT]))
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise DataError(path, "holds no account of its strokes; make it with `python -m shuttle_marl.data convert`") from error


def write_parquet(strokes: pa.Table, path: Path, *, account: Account, provenance: dict[str, Any]) -> None:
    """Write a stroke table (zstd, with checksums), whole or not at all. The same arguments give the same bytes.

    Raises:
        FileWriteError: the file cannot be written.
    """
    extra = {
        _ACCOUNT: json.dumps(account.as_json()).encode(),
        _PROVENANCE: json.dumps(provenance, ensure_ascii=False).encode(),
    }
    table = strokes.cast(STROKES).combine_chunks().replace_schema_metadata({**STROKES.metadata, **extra})
    table_files.write_parquet(path, table, compression_level=9)


def read_parquet(path: Path) -> pa.Table:
    """Read a stroke table.

    Raises:
        DataError: no such file, no Parquet, or another schema; says which column.
    """
    file = _open(path)
    check_schema(path, file.schema_arrow)
    try:
        return file.read()
    except (OSError, pa.ArrowException) as error:
        raise DataError(path, f"a damaged Parquet file ({error}); make it again") from error


def check_schema(path: Path, schema: pa.Schema) -> None:
    """Compare a schema with the one of strokes.

    Raises:
        DataError: a column is missing, has another type, or is in another place; or the version differs.
    """
    advice = "make it again with `python -m shuttle_marl.data convert`"
    version = (schema.metadata or {}).get(b"version")
    expected = STROKES.metadata[b"version"]
    if version != expected:
        raise DataError(path, f"schema version {version!r}, expected {expected!r}; {advice}")
    for field in STROKES:
        if field.name not in schema.names:
            raise DataError(path, f"column {field.name!r} is missing; {advice}")
        found = schema.field(field.name)
        if found.type != field.type or found.nullable != field.nullable:
            raise DataError(path, f"column {field.name!r} is {_kind(found)}, expected {_kind(field)}; {advice}")
    if schema.names != STROKES.names:
        raise DataError(path, f"columns {', '.join(schema.names)}; expected {', '.join(STROKES.names)} in this order")


def provenance_of(root: Path, cleaned: Cleaned) -> dict[str, Any]:
    """Provenance of a cleaned table: a JSON object with the same values for the same input."""
    digest = hashlib.sha256()
    for path in cleaned.files:
        digest.update(f"{path.relative_to(root).as_posix()}\n".encode() + hashlib.sha256(path.read_bytes()).digest())
    return {
        "repository": upstream.REPOSITORY,
        "commit": upstream.COMMIT,
        "files": len(cleaned.files),
        "sha256": digest.hexdigest(),
        "cleaned_by": f"shuttle_marl {__version__}",
        "licence": upstream.LICENCE_NOTE,
        "citations": list(upstream.CITATIONS),
    }


def _open(path: Path) -> pq.ParquetFile:
    try:
        return table_files.open_parquet(path)
    except FileNotFoundError as error:
        raise DataError(path, "no such file or folder; give a folder with the data or a Parquet file") from error
    except pa.ArrowException as error:
        own = "; `python -m shuttle_marl.data import` makes one of a CSV file" if path.suffix.lower() in (".csv", ".txt") else ""
        raise DataError(path, f"no readable Parquet file ({error}){own}") from error
    except (OSError, ValueError) as error:
        raise DataError(path, f"cannot be read ({problem(error)})") from error


def _kind(field: pa.Field) -> str:
    return f"{field.type}{'' if field.nullable else ' not null'}"
