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
import pyarrow.compute as pc

from shuttle_marl.base.arrays import I8, I64, Bools
from shuttle_marl.base.errors import command
from shuttle_marl.data.conventions import with_common_labels
from shuttle_marl.data.hands import unknown_hands, with_hands
from shuttle_marl.data.problems import DataError
from shuttle_marl.data.schema import DROP_REASONS, REACH_OVER, REASONS, Account, Cleaned, Outcome, stroke_table
from shuttle_marl.data.shuttleset import AREA_OF_LABEL, NEAREST_OF_LABEL, RawGame, list_matches, read_game
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

_COORDINATES: Final = {"landing": "landing", "contact": "hit", "striker": "player_location", "receiver": "opponent_location"}
HEIGHTS_AGREE: Final = 0.7
"""Minimum agreement of the two records of the contact heights of a game."""
HEIGHTS_PLAUSIBLE: Final = 0.9
"""Minimum fraction of the strokes of :data:`FIXED_HEIGHT` types at the height of the type."""
FIXED_HEIGHT: Final = {"drop": 1, "smash": 1, "half-smash": 1, "lift": 0, "net-shot": 0}
"""Shot types that are nearly always struck at one height: 0 below, 1 above the net."""
MAX_EXCHANGED: Final = 0.2
"""Maximum fraction of the rallies of a game in which letters are exchanged."""
MIRRORED: Final = ("ShuttleSet", range(9, 21))
"""Matches with mirrored area labels in the lower half."""

_LABEL_AREA: Final = np.array([-1, *AREA_OF_LABEL, *(-1 for _ in NEAREST_OF_LABEL)], dtype=np.int8)
"""Index into court.AREAS by area label of the files; -1 outside."""
_OUT, _NET, _SHORT, _FOUL = (REASONS.index(name) for name in ("out", "net", "short", "foul"))
_RETURNED, _UNKNOWN = REASONS.index("returned"), REASONS.index("unknown")


def clean_matches(root: Path, names: Iterable[str] | None = None) -> Cleaned:
    """Read and clean the matches below ``root`` whose files are present.

    Args:
        names: names of the matches; None: all that are present.

    Raises:
        DataError: unreadable input, or a named match is missing.
    """
    wanted = None if names is None else set(names)
    matches = [m for m in list_matches(root) if m.present and (wanted is None or m.name in wanted)]
    absent = (wanted or set()) - {m.name for m in matches}
    if absent or not matches:
        missing = ", ".join(sorted(absent)) or "any match"
        raise DataError(root, f"no files of {missing}; get them with `{command('data', 'download')}`")
    games = []
    for match in matches:
        for path in match.games():
            games.append(game := read_game(match, path))
            if game.problems and not game.published:
                raise DataError.of(game.problems)
    cleaned = [clean_game(game) for game in games]
    strokes, inferred = with_hands(pa.concat_tables([table for table, _ in cleaned]), root)
    strokes, conventions = with_common_labels(strokes)
    dropped = sum((collections.Counter(counts) for _, counts in cleaned), collections.Counter[str]())
    agrees = pc.equal(strokes["area"].fill_null(-1), strokes["label_area"]).drop_null().to_numpy()
    account = Account.of(
        strokes,
        matches=len(matches),
        total=sum(len(game) + game.empty for game in games),
        rallies=sum(len(np.unique(game["rally"])) for game in games),
        dropped={reason: dropped[reason] for reason in DROP_REASONS},
        area_agreement=float(agrees.mean()) if len(agrees) else None,
    )
    return Cleaned(
        strokes=strokes,
        account=account,
        files=tuple(game.path for game in games),
        provenance={
            "inferred": inferred,
            "lost": unknown_hands(strokes),
            "conventions": [dataclasses.asdict(convention) for convention in conventions],
        },
    )


def clean_game(raw: RawGame) -> tuple[pa.Table, dict[str, int]]:
    """Clean the rows of one game.

    Returns:
        The remaining strokes, and the number of dropped rows by reason.
    """
    raw, repeated = arrange(raw)
    first = rally_starts(raw)
    raw = with_corrected_letters(raw, first)
    side, contradicted = sides(raw, first)
    outcome, reason = outcomes(raw, first)
    # In the image x points right and y down: the lower player's right is +x and the upper player's right is -x.
    facing = np.where(side[:, None] > 0, [1.0, -1.0], [-1.0, 1.0])
    ego = {name: (raw[column] * facing).astype(np.float32) for name, column in _COORDINATES.items()}
    is_serve = (raw["shot"] >= 0) & (raw["shot"] < N_SERVES)
    # A serve has no contact point, and players neither reach far over the net nor stand beyond it.
    ego["contact"][is_serve | (ego["contact"][:, 1] > REACH_OVER)] = np.nan
    ego["striker"][ego["striker"][:, 1] > 0] = np.nan
    ego["receiver"][ego["receiver"][:, 1] < 0] = np.nan
    landing_x, landing_y = ego["landing"].T
    area = court.area_of(landing_x, landing_y)
    label = corrected_label(raw, own_half=landing_y < 0)
    tests = {
        "unreadable value": raw["unreadable"],
        "broken homography": np.full(len(first), raw.broken_homography),
        "contact heights unreliable": np.full(len(first), heights_unreliable(raw, first)),
        "broken rally": broken_rallies(raw, first),
        "unknown shot type": raw["shot"] < 0,
        "serve type inside a rally": is_serve & (raw["stroke"] > 1),
        "first stroke is no serve": ~is_serve & (raw["stroke"] == 1),
        "contact height missing": (raw["height"] < 0) & ~is_serve,
        "side of the court unknown": (side == 0) | contradicted,
        "landing missing": (area < 0) & (outcome != Outcome.FAULT),
        "landing on the striker's side": (landing_y < -REACH_OVER) & (outcome != Outcome.FAULT),
    }
    valid = np.ones(len(first), dtype=bool)
    counts = {"empty row": raw.empty, "repeated row": repeated}
    for name, test in tests.items():
        counts[name] = int((valid & test).sum())
        valid &= ~test
    rows = np.flatnonzero(valid)
    score = raw["score"][np.flatnonzero(np.r_[first[1:], True])][np.cumsum(first) - 1]  # that of the last row of the rally
    players = pa.array(raw.match.players)
    texts = {
        "match": pa.repeat(raw.match.name, len(rows)),
        **{name: pa.repeat(getattr(raw.match, name), len(rows)) for name in ("source", "discipline")},
        "player": players.take(pa.array(np.where(raw["by_a"], 0, 1)[rows])),
        "opponent": players.take(pa.array(np.where(raw["by_a"], 1, 0)[rows])),
    }
    untimed = ~timed(raw, first)
    columns: dict[str, npt.NDArray[Any]] = {
        "game": np.full(len(first), raw.game),
        **{name: raw[name] for name in ("rally", "stroke", "shot")},
        "height": np.where(is_serve, 0, raw["height"]),  # by the laws; two serves are annotated as above the net
        "technique": np.where(raw["backhand"], 1, np.where(raw["around_head"], 2, 0)),
        "area": np.ma.masked_where(area < 0, area),
        "in_court": np.ma.masked_where(area < 0, court.in_court(landing_x, landing_y)),
        **{name: np.ma.masked_where(untimed, raw[name]) for name in ("clock", "frame")},
        "outcome": outcome,
        "reason": reason,
        "points": np.ma.masked_less(np.where(raw["by_a"], score[:, 0], score[:, 1]), 0),
        "points_opponent": np.ma.masked_less(np.where(raw["by_a"], score[:, 1], score[:, 0]), 0),
        "label_area": np.ma.masked_less(label, 0),
    }
    kept = {name: values[rows] for name, values in columns.items()}
    return stroke_table({**texts, **kept}, {name: xy[rows] for name, xy in ego.items()}), counts


def arrange(raw: RawGame) -> tuple[RawGame, int]:
    """Sort the rallies and drop repeated rows.

    Two games of the data have an early rally at the end of the file; one stroke is repeated.

    Returns:
        The rows in playing order, and the number of dropped rows.
    """
    raw = raw.take(np.argsort(raw["rally"], kind="stable"))
    same = [raw[name][1:] == raw[name][:-1] for name in ("rally", "stroke", "by_a")]
    repeated = np.r_[False, np.all(same, axis=0) & (raw["stroke"][1:] > 1)]
    return raw.take(np.flatnonzero(~repeated)), int(repeated.sum())


def rally_starts(raw: RawGame) -> Bools:
    """``[n]`` whether a row is the first of a rally; a rally may have the number of the previous one."""
    return np.r_[True, (np.diff(raw["rally"]) != 0) | (raw["stroke"][1:] == 1)]


def broken_rallies(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows of rallies with misnumbered strokes, players who do not alternate, or a repeated number."""
    rally = np.cumsum(first) - 1
    inside = ~first[1:]
    wrong = np.r_[False, inside & ((np.diff(raw["stroke"]) != 1) | (raw["by_a"][1:] == raw["by_a"][:-1]))]
    wrong |= first & ((raw["stroke"] != 1) | (raw["rally"] < 1))
    wrong |= first & np.r_[False, np.diff(raw["rally"]) == 0]
    return np.asarray(np.bincount(rally, weights=wrong)[rally] > 0)


def sides(raw: RawGame, first: Bools) -> tuple[I64, Bools]:
    """``[n]`` sign of the striker's half by majority vote within the rally, 0 without evidence; and rows that contradict it.

    Ends change between games and in the middle of a third game, so the side is inferred per rally, from the positions of both
    players, contact points and landing points (unless the shuttle fell short). Rows of unknown shot type contain placeholders
    and are not used.
    """
    rally = np.cumsum(first) - 1
    own = [np.sign(raw[name][:, 1]) for name in ("player_location", "hit")]
    other = [-np.sign(raw["opponent_location"][:, 1])]
    crossed = ~np.isin(raw["reason"], (_NET, _SHORT))
    other.append(np.where(crossed, -np.sign(raw["landing"][:, 1]), np.nan))
    vote = np.where(raw["shot"] < 0, 0.0, np.nansum(np.stack(own + other), axis=0))
    sign_a = np.sign(np.bincount(rally, weights=np.where(raw["by_a"], vote, -vote)))
    side = np.where(raw["by_a"], sign_a[rally], -sign_a[rally]).astype(np.int64)
    return side, vote * side < 0


def with_corrected_letters(raw: RawGame, first: Bools) -> RawGame:
    """Exchange players A and B in rallies that contradict the ends of the game.

    Players do not change ends within games 1 and 2. In two rallies of the data they are on each other's side and the last
    striker's fault wins the rally; exchanged letters correct both.
    """
    if raw.game > 2:
        return raw
    side, _ = sides(raw, first)
    side_a = np.where(raw["by_a"], side, -side)[first]
    usual = np.sign(side_a.sum())
    odd = side_a == -usual
    if usual == 0 or odd.sum() > MAX_EXCHANGED * len(odd):
        return raw
    return dataclasses.replace(raw, columns={**raw.columns, "by_a": raw["by_a"] ^ odd[np.cumsum(first) - 1]})


def outcomes(raw: RawGame, first: Bools) -> tuple[I64, I64]:
    """``[n]`` outcome and reason of every stroke, indices into OUTCOMES and REASONS.

    The winner of a rally is the player who scored, or the annotated winner if the score of the previous rally is missing. If
    the reason contradicts the winner, the last stroke was not annotated and the outcome is unknown.
    """
    ends = np.flatnonzero(np.r_[first[1:], True])
    before = np.vstack([[0, 0], raw["score"][ends[:-1]]])
    gained = raw["score"][ends] - before
    by_score = np.where((gained == [1, 0]).all(1), 0, np.where((gained == [0, 1]).all(1), 1, -1))
    winner = np.where(by_score < 0, raw["winner"][ends], by_score)
    won = winner == np.where(raw["by_a"][ends], 0, 1)
    given = raw["reason"][ends]
    contradiction = (given >= 0) & (np.isin(given, (_OUT, _NET, _SHORT, _FOUL)) == won)
    unknown = (winner < 0) | contradiction
    outcome = np.full(len(first), Outcome.RETURNED)
    outcome[ends] = np.where(unknown, Outcome.UNKNOWN, np.where(won, Outcome.WINNER, Outcome.FAULT))
    reason = np.full(len(first), _RETURNED)
    reason[ends] = np.where(unknown | (given < 0), _UNKNOWN, given)
    return outcome, reason


def heights_unreliable(raw: RawGame, first: Bools) -> bool:
    """Whether the contact heights of a game contradict each other, or the shot types, too often."""
    met = np.where(first, -1, np.r_[np.int8(-1), raw["met_height"][:-1]])
    both = (met >= 0) & (raw["height"] >= 0)
    if both.mean() > 0.5 and (met == raw["height"])[both].mean() < HEIGHTS_AGREE:
        return True
    expected = np.array([FIXED_HEIGHT.get(name, -1) for name in SHOTS] + [-1])[raw["shot"]]
    fixed = (expected >= 0) & (raw["height"] >= 0)
    return bool(fixed.any() and (expected == raw["height"])[fixed].mean() < HEIGHTS_PLAUSIBLE)


def timed(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows with a consistent time: the longest subsequence of a rally with increasing frames and non-decreasing clocks.

    Rows of unknown shot type, which are dropped, contain placeholders for times.
    """
    fits = np.zeros(len(first), dtype=bool)
    given = (raw["frame"] >= 0) & (raw["clock"] >= 0) & (raw["shot"] >= 0)
    for rally in np.split(np.arange(len(first)), np.flatnonzero(first)[1:]):
        rows = rally[given[rally]]
        frame, clock = raw["frame"][rows], raw["clock"][rows]
        in_order = (np.diff(frame) > 0).all() and (np.diff(clock) >= 0).all()
        fits[rows if in_order else rows[_longest_chain(frame, clock)]] = True
    return fits


def _longest_chain(frame: I64, clock: I64) -> list[int]:
    """Indices of a longest subsequence with increasing frames and non-decreasing clocks, in quadratic time."""
    ending_at: list[list[int]] = []
    for i in range(len(frame)):
        earlier = [ending_at[j] for j in range(i) if frame[j] < frame[i] and clock[j] <= clock[i]]
        ending_at.append([*max(earlier, key=len, default=[]), i])
    return max(ending_at, key=len, default=[])


def corrected_label(raw: RawGame, own_half: Bools) -> I8:
    """``[n]`` area labels from the receiver's view, -1 outside the court.

    Annotators label right and left from the view of the player in whose half the shuttle landed, which is the striker for
    strokes that fell back into the own half.
    """
    label = _LABEL_AREA[raw["label_area"]]
    source, numbers = MIRRORED
    mirror = own_half.copy()
    if raw.match.source == source and raw.match.number in numbers:
        mirror ^= raw["landing"][:, 1] > 0
    return np.where(mirror & (label >= 0), 3 * (label // 3) + 2 - label % 3, label).astype(np.int8)
