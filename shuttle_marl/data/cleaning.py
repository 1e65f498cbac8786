"""Cleaning of the raw rows of ShuttleSet and ShuttleSet22: order, sides, outcomes, areas, contact heights and times.

``docs/datasheet.md`` lists the known errors of the files with their frequencies. Every dropped row is counted by its reason
(:data:`shuttle_marl.data.schema.DROP_REASONS`).
"""

import collections
import dataclasses
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.arrays import I8, I64, Bools
from shuttle_marl.data.schema import DROP_REASONS, REACH_OVER, REASONS, STROKES, Account, Cleaned, Outcome
from shuttle_marl.data.shuttleset import RawGame, list_matches, read_game
from shuttle_marl.data.strict_csv import DataError
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_COORDINATES: Final = {"landing": "landing", "contact": "hit", "striker": "player_location", "receiver": "opponent_location"}
HEIGHTS_AGREE: Final = 0.7
"""The contact heights of a game mean nothing where its two records of them agree less often than this."""
HEIGHTS_PLAUSIBLE: Final = 0.9
"""Nor where a smaller share of the strokes of :data:`FIXED_HEIGHT` types is struck from the height of the type."""
FIXED_HEIGHT: Final = {"drop": 1, "smash": 1, "half-smash": 1, "lift": 0, "net-shot": 0}
"""Shot types that are nearly always struck from one height: 0 below, 1 above the net."""
FEW_ODD: Final = 0.2
"""Letters are exchanged in a game where at most this share of rallies contradicts the others."""
MIRRORED: Final = ("ShuttleSet", range(9, 21))
"""Matches whose area labels are mirrored left-right in the lower half."""

# Area labels of the files (as the player of that half sees them) to indices of court.AREAS; labels above 9 lie outside.
_LABEL_AREA: Final = np.array([-1, 0, 2, 6, 8, 3, 5, 1, 4, 7] + [-1] * 7, dtype=np.int8)
_OUT, _NET, _SHORT, _FOUL = (REASONS.index(name) for name in ("out", "net", "short", "foul"))
_RETURNED, _UNKNOWN = REASONS.index("returned"), REASONS.index("unknown")


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


def arrange(raw: RawGame) -> tuple[RawGame, int]:
    """Put the rallies in order and leave out repeated rows.

    Two games of the data have one rally at the end of the file that was played early; one stroke stands there twice.

    Returns:
        The rows in playing order, and how many were left out.
    """
    raw = raw.take(np.argsort(raw.rally, kind="stable"))
    same = (np.diff(raw.rally) == 0) & (np.diff(raw.stroke) == 0) & (raw.by_a[1:] == raw.by_a[:-1]) & (raw.stroke[1:] > 1)
    repeated = np.r_[False, same]
    return raw.take(np.flatnonzero(~repeated)), int(repeated.sum())


def rally_starts(raw: RawGame) -> Bools:
    """``[n]`` first row of each rally, also of one that bears the number of the rally before it."""
    return np.r_[True, (np.diff(raw.rally) != 0) | (raw.stroke[1:] == 1)]


def broken_rallies(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows of rallies with strokes not numbered 1, 2, …, players who do not alternate, or a number that is taken."""
    rally = np.cumsum(first) - 1
    inside = ~first[1:]
    wrong = np.r_[False, inside & ((np.diff(raw.stroke) != 1) | (raw.by_a[1:] == raw.by_a[:-1]))]
    wrong |= first & ((raw.stroke != 1) | (raw.rally < 1))
    wrong |= first & np.r_[False, np.diff(raw.rally) == 0]
    return np.asarray(np.bincount(rally, weights=wrong)[rally] > 0)


def sides(raw: RawGame, first: Bools) -> tuple[I64, Bools]:
    """``[n]`` sign of the striker's half by vote within the rally, 0 without evidence; and rows that contradict it.

    Ends swap between games and in the middle of a third game, so nothing is assumed about them. Player A stays in one half
    during a rally; every stroke votes with the positions of both players, the contact point and (unless the shuttle fell
    short) the landing point. Rows of unknown shot type hold placeholders for points and have no vote.
    """
    rally = np.cumsum(first) - 1
    own = [np.sign(raw.point[name][:, 1]) for name in ("player_location", "hit")]
    other = [-np.sign(raw.point["opponent_location"][:, 1])]
    over = ~np.isin(raw.reason, (_NET, _SHORT))
    other.append(np.where(over, -np.sign(raw.point["landing"][:, 1]), np.nan))
    vote = np.where(raw.shot < 0, 0.0, np.nansum(np.stack(own + other), axis=0))
    sign_a = np.sign(np.bincount(rally, weights=np.where(raw.by_a, vote, -vote)))
    side = np.where(raw.by_a, sign_a[rally], -sign_a[rally]).astype(np.int64)
    return side, vote * side < 0


def with_letters_fixed(raw: RawGame, first: Bools) -> RawGame:
    """The rows, players exchanged in rallies whose letters A and B contradict the ends of the game.

    No one changes ends within games 1 and 2. In two rallies of the data one player stands where the other one does in the
    rest of the game, and the last hitter's fault wins the rally: both are fixed by exchanging the letters.
    """
    if raw.game > 2:
        return raw
    side, _ = sides(raw, first)
    side_a = np.where(raw.by_a, side, -side)[first]
    usual = np.sign(side_a.sum())
    odd = side_a == -usual
    if usual == 0 or odd.sum() > FEW_ODD * len(odd):
        return raw
    return dataclasses.replace(raw, by_a=raw.by_a ^ odd[np.cumsum(first) - 1])


def outcomes(raw: RawGame, first: Bools) -> tuple[I64, I64]:
    """``[n]`` outcome and reason of every stroke, indices into OUTCOMES and REASONS.

    The winner of a rally is who scored; the annotated winner is asked where the score does not tell because a rally before
    it is missing. A reason that contradicts the winner means that the annotators missed the last stroke.
    """
    ends = np.flatnonzero(np.r_[first[1:], True])
    before = np.vstack([[0, 0], raw.score[ends[:-1]]])
    gained = raw.score[ends] - before
    by_score = np.where((gained == [1, 0]).all(1), 0, np.where((gained == [0, 1]).all(1), 1, -1))
    winner = np.where(by_score < 0, raw.winner[ends], by_score)
    won = winner == np.where(raw.by_a[ends], 0, 1)
    given = raw.reason[ends]
    contradiction = (given >= 0) & (np.isin(given, (_OUT, _NET, _SHORT, _FOUL)) == won)
    unknown = (winner < 0) | contradiction
    outcome = np.full(len(first), Outcome.RETURNED)
    outcome[ends] = np.where(unknown, Outcome.UNKNOWN, np.where(won, Outcome.WINNER, Outcome.FAULT))
    reason = np.full(len(first), _RETURNED)
    reason[ends] = np.where(unknown | (given < 0), _UNKNOWN, given)
    return outcome, reason


def heights_unreliable(raw: RawGame, first: Bools) -> bool:
    """Test whether the contact heights of a game contradict each other, or the shot types, too often to mean anything."""
    met = np.where(first, -1, np.r_[np.int8(-1), raw.met_height[:-1]])
    both = (met >= 0) & (raw.height >= 0)
    if both.mean() > 0.5 and (met == raw.height)[both].mean() < HEIGHTS_AGREE:
        return True
    expected = np.array([FIXED_HEIGHT.get(name, -1) for name in SHOTS] + [-1])[raw.shot]
    fixed = (expected >= 0) & (raw.height >= 0)
    return bool(fixed.any() and (expected == raw.height)[fixed].mean() < HEIGHTS_PLAUSIBLE)


def timed(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows whose time is given and fits: the longest chain of a rally whose frames rise and clocks never fall.

    Rows of unknown shot type, which are not kept, hold placeholders for times too.
    """
    fits = np.zeros(len(first), dtype=bool)
    given = (raw.frame >= 0) & (raw.clock >= 0) & (raw.shot >= 0)
    for rally in np.split(np.arange(len(first)), np.flatnonzero(first)[1:]):
        rows = rally[given[rally]]
        frame, clock = raw.frame[rows], raw.clock[rows]
        in_order = (np.diff(frame) > 0).all() and (np.diff(clock) >= 0).all()
        fits[rows if in_order else rows[_longest_chain(frame, clock)]] = True
    return fits


def _longest_chain(frame: I64, clock: I64) -> list[int]:
    """Indices of a longest subsequence in which frames rise and clocks never fall; quadratic in its few dozen values."""
    length: list[int] = []
    before: list[int] = []
    for i in range(len(frame)):
        earlier = [j for j in range(i) if frame[j] < frame[i] and clock[j] <= clock[i]]
        best = max(earlier, key=lambda j: length[j], default=-1)
        before.append(best)
        length.append(1 + (length[best] if best >= 0 else 0))
    chain = []
    i = int(np.argmax(length)) if length else -1
    while i >= 0:
        chain.append(i)
        i = before[i]
    return chain[::-1]


def corrected_label(raw: RawGame, own_half: Bools) -> I8:
    """``[n]`` area labels as the receiver sees them, -1 outside the court.

    The annotators name right and left as the player of the half sees them in which the shuttle came down: of a stroke
    that fell back into the striker's own half that is the striker.
    """
    label = _LABEL_AREA[raw.label_area]
    source, numbers = MIRRORED
    mirror = own_half.copy()
    if raw.match.source == source and raw.match.number in numbers:
        mirror ^= raw.point["landing"][:, 1] > 0
    return np.where(mirror & (label >= 0), 3 * (label // 3) + 2 - label % 3, label).astype(np.int8)
