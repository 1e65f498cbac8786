"""From the raw rows of a match to clean strokes: sides, areas, outcomes; every dropped row is counted by its reason.

What is known to be wrong in the files, and what is done about it:

* The side of a player swaps between games and in mid game 3: it is inferred for every rally from all coordinates.
* Area labels of ShuttleSet's matches 9 to 20 are mirrored for strokes that land in the lower half: areas are computed
  from the coordinates; the corrected label is kept beside them only for comparison.
* A row of unknown shot type (nearly always a serve that the camera missed) is dropped, the rest of its rally is kept.
* A game whose homography is broken puts both players in one half: it is dropped as a whole.
* The contact heights of ShuttleSet's match 1 are wrong: they agree with the height at which the receiver of the stroke
  before met the shuttle in 49 % of rows (elsewhere in 95 % or more, where both are known). That height is taken instead.
* The winner of a rally is missing in 4 % of rallies: it follows from the score.
"""

import collections
import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl import court
from shuttle_marl.data.errors import DataError
from shuttle_marl.data.schema import FAULT, REASONS, RETURNED, STROKES, UNKNOWN, WINNER
from shuttle_marl.data.shuttleset import RawGame, list_matches, read_game
from shuttle_marl.stroke import SHOTS

MIRRORED: Final = ("ShuttleSet", range(9, 21))
"""Matches whose area labels are mirrored left-right in the lower half."""
BAD_HOMOGRAPHY: Final = 0.2
"""A game is dropped when more than this share of its rows puts both players in one half."""

# Area labels of the files (as the player of that half sees them) to indices of court.AREAS; labels above 9 lie outside.
_LABEL_AREA: Final = np.array([-1, 0, 2, 6, 8, 3, 5, 1, 4, 7] + [-1] * 7, dtype=np.int8)
WRONG_HEIGHTS: Final = 0.7
"""Contact heights are replaced in a game where they agree less often with those at which the receiver met the shuttle."""

_LOSING: Final = ("out", "net", "short", "foul")

DROP_REASONS: Final = (
    "broken homography",
    "broken rally",
    "unknown shot type",
    "serve type inside a rally",
    "first stroke is no serve",
    "contact height missing",
    "side of the court unknown",
    "landing missing",
)
"""Why a row can be dropped, in the order in which the reasons are tried."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cleaned:
    """Clean strokes and the account of what was left out.

    Attributes:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, in playing order.
        matches: number of matches read.
        rallies, strokes_total: before dropping, after deduplication.
        dropped: rows dropped, by reason.
    """

    strokes: pa.Table
    matches: int
    rallies: int
    strokes_total: int
    dropped: dict[str, int]

    @property
    def rallies_kept(self) -> int:
        """Rallies of which at least one stroke was kept."""
        return self.strokes.group_by(["match", "game", "rally"]).aggregate([]).num_rows

    @property
    def area_agreement(self) -> float:
        """Share of kept strokes with an in-court label whose label is the recomputed area."""
        area = self.strokes["area"].to_numpy()
        label = np.nan_to_num(self.strokes["label_area"].to_numpy().astype(float), nan=-1)
        labelled = label >= 0
        return float((area == label)[labelled].mean()) if labelled.any() else float("nan")


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
        missing = ", ".join(sorted(absent)) or "every match"
        raise DataError(root, f"no files of {missing}; get them with `python -m shuttle_marl.data download`")
    tables, dropped, rallies, total = [], collections.Counter[str](), 0, 0
    for match in matches:
        for path in match.games():
            game = read_game(match, path)
            table, counts = clean_game(game)
            tables.append(table)
            dropped.update(counts)
            rallies += len(np.unique(game.rally))
            total += len(game.line)
    return Cleaned(
        strokes=pa.concat_tables(tables),
        matches=len(matches),
        rallies=rallies,
        strokes_total=total,
        dropped={reason: dropped[reason] for reason in DROP_REASONS if dropped[reason]},
    )


def clean_game(raw: RawGame) -> tuple[pa.Table, dict[str, int]]:
    """Clean the rows of one game.

    Returns:
        The strokes kept, and the number of rows dropped by reason.
    """
    _, rally_index = np.unique(raw.rally, return_inverse=True)
    first = np.r_[True, rally_index[1:] != rally_index[:-1]]
    last = np.r_[first[1:], True]
    side, contradicted = _sides(raw, rally_index)
    outcome, reason = _outcomes(raw, first, last)
    # In the image x points right and y down: the lower player's right is +x and the upper player's right is -x.
    facing = np.where(side[:, None] > 0, [1.0, -1.0], [-1.0, 1.0])
    ego = {name: xy * facing for name, xy in raw.point.items()}
    landing_x, landing_y = ego["landing"].T
    area = court.area_of(landing_x, landing_y)
    label = _corrected_label(raw, own_half=landing_y < 0)
    is_serve = np.isin(raw.shot, SHOTS[:2])
    height = _contact_heights(raw, first)
    tests = {
        "broken homography": np.full(len(first), _both_in_one_half(raw).mean() > BAD_HOMOGRAPHY),
        "broken rally": _broken_rallies(raw, rally_index, first),
        "unknown shot type": raw.shot == "",
        "serve type inside a rally": is_serve & (raw.stroke > 1),
        "first stroke is no serve": ~is_serve & (raw.stroke == 1),
        "contact height missing": (height < 0) & ~is_serve,
        "side of the court unknown": (side == 0) | contradicted,
        "landing missing": (area < 0) & (outcome != FAULT),
    }
    keep = np.ones(len(first), dtype=bool)
    counts = {}
    for name in DROP_REASONS:
        counts[name] = int((keep & tests[name]).sum())
        keep &= ~tests[name]
    players = np.array(raw.match.players)
    n = len(first)
    columns: dict[str, npt.NDArray[np.generic]] = {
        "match": np.full(n, raw.match.name),
        "source": np.full(n, raw.match.source),
        "discipline": np.full(n, raw.match.discipline),
        "game": np.full(n, raw.game),
        "rally": raw.rally,
        "stroke": raw.stroke,
        "player": players[np.where(raw.by_a, 0, 1)],
        "opponent": players[np.where(raw.by_a, 1, 0)],
        "shot": np.array([SHOTS.index(name) if name else -1 for name in raw.shot]),
        "height": np.where(is_serve, 0, height),  # the laws demand it; five rows say otherwise
        "technique": np.where(raw.backhand, 1, np.where(raw.around_head, 2, 0)),
        "area": area,
        "in_court": court.in_court(landing_x, landing_y),
        "landing_x": landing_x,
        "landing_y": landing_y,
        "contact_x": ego["hit"][:, 0],
        "contact_y": ego["hit"][:, 1],
        "striker_x": ego["player_location"][:, 0],
        "striker_y": ego["player_location"][:, 1],
        "receiver_x": ego["opponent_location"][:, 0],
        "receiver_y": ego["opponent_location"][:, 1],
        "clock": raw.clock,
        "frame": raw.frame,
        "outcome": outcome,
        "reason": reason,
        "points": np.where(raw.by_a, raw.score[:, 0], raw.score[:, 1]),
        "points_opponent": np.where(raw.by_a, raw.score[:, 1], raw.score[:, 0]),
        "label_area": label,
    }
    missing = {
        "area": area < 0,
        "in_court": area < 0,
        "label_area": label < 0,
        **{name: np.isnan(values) for name, values in columns.items() if values.dtype == np.float64},
    }
    arrays = []
    for field in STROKES:
        mask = missing.get(field.name)
        arrays.append(pa.array(columns[field.name][keep], field.type, mask=None if mask is None else mask[keep]))
    return pa.table(arrays, schema=STROKES), counts


def _both_in_one_half(raw: RawGame) -> npt.NDArray[np.bool_]:
    striker, receiver = raw.point["player_location"][:, 1], raw.point["opponent_location"][:, 1]
    return np.asarray(striker * receiver > 0)


def _sides(raw: RawGame, rally: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.bool_]]:
    """Sign of the striker's half by vote within the rally, 0 without evidence; and rows whose own evidence contradicts it.

    Player A stays in one half during a rally; every stroke votes with the positions of both players, the contact point
    and (unless the shuttle fell short) the landing point.
    """
    own = [np.sign(raw.point[name][:, 1]) for name in ("player_location", "hit")]
    other = [-np.sign(raw.point["opponent_location"][:, 1])]
    over = ~np.isin(raw.reason, ("net", "short"))
    other.append(np.where(over, -np.sign(raw.point["landing"][:, 1]), np.nan))
    vote = np.nansum(np.stack(own + other), axis=0)
    sign_a = np.sign(np.bincount(rally, weights=np.where(raw.by_a, vote, -vote)))
    side = np.where(raw.by_a, sign_a[rally], -sign_a[rally]).astype(np.int64)
    return side, vote * side < 0


def _outcomes(
    raw: RawGame, first: npt.NDArray[np.bool_], last: npt.NDArray[np.bool_]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Outcome and reason of every stroke, indices into OUTCOMES and REASONS."""
    ends = np.flatnonzero(last)
    before = np.vstack([[0, 0], raw.score[ends[:-1]]])
    gained = raw.score[ends] - before
    by_score = np.where((gained == [1, 0]).all(1), "A", np.where((gained == [0, 1]).all(1), "B", ""))
    winner = np.where(raw.winner[ends] == "", by_score, raw.winner[ends])
    striker = np.where(raw.by_a[ends], "A", "B")
    won = winner == striker
    given = raw.reason[ends]
    # A reason that contradicts the winner means that the annotators missed the last stroke: the outcome is not known.
    losing = np.isin(given, _LOSING)
    contradiction = (given != "") & (losing == won)
    unknown = (winner == "") | contradiction
    outcome = np.full(len(first), RETURNED)
    outcome[ends] = np.where(unknown, UNKNOWN, np.where(won, WINNER, FAULT))
    reason = np.full(len(first), REASONS.index("returned"))
    reason[ends] = [REASONS.index(r if r and not u else "unknown") for r, u in zip(given, unknown, strict=True)]
    return outcome, reason


def _contact_heights(raw: RawGame, first: npt.NDArray[np.bool_]) -> npt.NDArray[np.int8]:
    """Contact heights, taken from the stroke before where those of the game are wrong as a whole."""
    met = np.where(first, -1, np.r_[np.int8(-1), raw.met_height[:-1]])
    both = (met >= 0) & (raw.height >= 0)
    wrong = both.mean() > 0.5 and (met == raw.height)[both].mean() < WRONG_HEIGHTS
    return np.where(met >= 0, met, raw.height).astype(np.int8) if wrong else raw.height


def _broken_rallies(raw: RawGame, rally: npt.NDArray[np.int64], first: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Rows of rallies whose strokes are not numbered 1, 2, … or whose players do not alternate."""
    inside = ~first[1:]
    wrong = np.r_[False, inside & ((np.diff(raw.stroke) != 1) | (raw.by_a[1:] == raw.by_a[:-1]))]
    wrong |= first & (raw.stroke != 1)
    return np.asarray(np.bincount(rally, weights=wrong)[rally] > 0)


def _corrected_label(raw: RawGame, own_half: npt.NDArray[np.bool_]) -> npt.NDArray[np.int8]:
    """Area labels as the receiver sees them.

    The annotators name right and left as the player of the half sees them in which the shuttle came down: of a stroke
    that fell back into the striker's own half that is the striker.
    """
    label = _LABEL_AREA[raw.label_area]
    source, numbers = MIRRORED
    mirror = own_half.copy()
    if raw.match.source == source and raw.match.number in numbers:
        mirror ^= raw.point["landing"][:, 1] > 0
    return np.where(mirror & (label >= 0), 3 * (label // 3) + 2 - label % 3, label).astype(np.int8)
