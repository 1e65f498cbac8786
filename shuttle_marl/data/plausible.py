"""Warnings of improbable values of an imported table, and comparison of columns that repeat each other."""

import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Array, Bools
from shuttle_marl.data.cleaning import FIXED_HEIGHT
from shuttle_marl.data.schema import REACH_OVER, REASONS, Outcome
from shuttle_marl.data.strict_csv import Problem, Sheet, shown
from shuttle_marl.data.upstream import player_id
from shuttle_marl.game import court
from shuttle_marl.game.stroke import N_SERVES, SHOTS

POINTS: Final = ("landing", "contact", "striker", "receiver")
OTHER_SCORE: Final = "the score is not that of the last stroke of its rally, which is used"
_APART: Final = 0.5
"""Largest distance of a contact point from the landing of the stroke before, which is the same point [m]."""
_REACH: Final = 4.0
"""Largest distance of a player from a contact point [m]; 3.5 in 999 of 1,000 published strokes."""
_SHALLOW: Final = 3.0
"""Points all within this distance of the middle of the net are improbable [m]."""
_TINY: Final = 1.05
"""Points all within this distance of the middle of the net are no metres [m], but fractions of a court."""
_FEW: Final = 10
"""Fewer points tell nothing for certain."""
_TEMPO: Final = (0.3, 5.0)
"""Probable median time between two strokes [s]; 0.9 in published matches."""


def changes(*columns: Array) -> Bools:
    """``[n]`` rows, the first among them, in which one of the columns differs from the row before."""
    return np.r_[True, np.any([column[1:] != column[:-1] for column in columns], axis=0)]


def warn_alike(sheet: Sheet, seen: dict[str, str], names: Sequence[str], what: str) -> None:
    """Warn of names that differ only in capitals, accents, width, or the order of words, or mix alphabets.

    Args:
        seen: names so far; the new ones are added.
        what: ``match`` or ``player``.
    """
    for row in sorted({name: row for row, name in reversed(list(enumerate(names)))}.values()):
        name = str(names[row])
        words = player_id("".join(c for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))).split("-")
        other = seen.setdefault(f"{what} {words if what == 'match' else sorted(words)}", name)
        if other != name and (what == "match" or player_id(other) != player_id(name)):
            sheet.warn([row], f"{shown(name)} and {shown(other)} are alike: are they one {what}?")
        mixed = {unicodedata.name(c, "").partition(" ")[0] for c in name if c.isalpha()} & {"LATIN", "CYRILLIC", "GREEK"}
        if len(mixed) > 1:
            sheet.warn([row], f"{what} {shown(name)} mixes letters of {' and '.join(sorted(mixed)).lower()}")


def check_scale(sheet: Sheet, name: str, points: F64) -> None:
    """Record a problem, or with few points a warning, if all points lie so close to the net that they are no metres."""
    furthest = np.nanmax(np.abs(points), axis=1, initial=0)[~np.isnan(points).all(axis=1)]
    limit = _SHALLOW if len(furthest) > _FEW / 2 else _TINY
    if len(furthest) > 2 and furthest.max() <= limit:
        text = f"all {len(furthest)} {name} points lie within {limit:g} m of the middle of the net: are these metres?"
        certain = len(furthest) >= _FEW and furthest.max() <= _TINY
        (sheet.problems if certain else sheet.warnings).append(Problem(sheet.path, text))


def compare(
    sheet: Sheet, headers: Mapping[str, str], strokes: Mapping[str, Any], points: Mapping[str, F64], side: I64
) -> None:  # fmt: skip
    """Compare the rows with those before them, and points and heights with other columns.

    Args:
        headers: header by name of :data:`shuttle_marl.data.column_map.COLUMNS`.
        strokes: ``[n]`` values by column of the schema, NaN where there are none.
        points: ``[n, 2]`` :data:`POINTS`.
        side: ``[n]`` half of the striker, 1 for the far one.
    """
    fresh = changes(strokes["match"], strokes["game"])
    first = fresh | changes(strokes["rally"])
    number = strokes["stroke"]
    if "stroke" in headers:
        missing = number != np.where(first, 1, np.r_[0, number[:-1]] + 1)
        sheet.warn(np.flatnonzero(missing), "strokes of the rally are missing before this one")
    _compare_order(sheet, strokes, fresh, first)
    if "side" in headers:
        end = (side == 1) ^ (strokes["player"] < strokes["opponent"])
        moved = ~fresh & changes(end)
        sheet.mark(np.flatnonzero(moved & ~first), "the players are not on the sides of the stroke before")
        sheet.warn(np.flatnonzero(moved & first & (strokes["game"] < 3)), "the players change sides during the game")
    if "seconds" in headers:
        passed = np.diff(sheet.numbers(headers["seconds"]), prepend=np.nan)
        sheet.warn(np.flatnonzero(~fresh & first & (passed < 0)), "the time is before that of the rally before")
        sheet.mark(np.flatnonzero(~first & (passed < 0)), "the time is before that of the stroke before")
        inside = passed[~first & ~np.isnan(passed)]
        if len(inside) and not _TEMPO[0] <= np.median(inside) <= _TEMPO[1]:
            text = f"half of the strokes follow the one before after {np.median(inside):g} s or less: are these seconds?"
            sheet.warnings.append(Problem(sheet.path, text))
    _compare_scores(sheet, strokes, fresh, first)
    _compare_points(sheet, strokes, points, first)
    for name, usual in FIXED_HEIGHT.items():
        where, other = ("below", "above")[1 - usual], strokes["height"] == 1 - usual
        sheet.warn(np.flatnonzero((strokes["shot"] == SHOTS.index(name)) & other), f"a {name} struck {where} the net")


def _compare_order(sheet: Sheet, strokes: Mapping[str, Any], fresh: Bools, first: Bools) -> None:
    """Compare numbers of rallies and games, and who serves, with the rows before them."""
    rally, game, player, outcome = (strokes[name] for name in ("rally", "game", "player", "outcome"))
    gap = rally - np.where(fresh, 0, np.r_[0, rally[:-1]])
    sheet.warn(np.flatnonzero(first & (gap > 1)), "rallies of the game are missing before this one")
    leap = game - np.where(changes(strokes["match"]), 0, np.r_[0, game[:-1]])
    sheet.warn(np.flatnonzero(leap > 1), "games of the match are missing before this one")
    won = np.select([outcome == Outcome.WINNER, outcome == Outcome.FAULT], [player, strokes["opponent"]], "")
    served = first & (strokes["stroke"] == 1) & (strokes["shot"] < N_SERVES) & ~fresh & (gap == 1)
    others = served & np.r_[False, (won[:-1] != "") & (won[:-1] != player[1:])]
    sheet.warn(np.flatnonzero(others), "the server did not win the rally before")


def _compare_scores(sheet: Sheet, strokes: Mapping[str, Any], fresh: Bools, first: Bools) -> None:
    """Compare the scores of a rally with each other, with that of the rally before, and with who won."""
    player, opponent, rally, outcome = (strokes[name] for name in ("player", "opponent", "rally", "outcome"))
    points = np.stack([strokes["points"], strokes["points_opponent"]], axis=1)
    ends = np.flatnonzero(np.r_[first[1:], True])
    end = ends[np.cumsum(first) - 1]  # of the rally of each row
    told = np.where((player == player[end])[:, None], points, points[:, ::-1])
    sheet.warn(np.flatnonzero(np.abs(told - told[end]).max(axis=1, initial=0) > 0), OTHER_SCORE)
    current, of_game = 0, np.cumsum(fresh)
    for row in ends:
        if of_game[row] != current:
            current, number, score = of_game[row], 0, dict[str, float]()
        both, after = (player[row], opponent[row]), points[row]
        if np.isnan(after).any():
            continue
        rallies, before = int(rally[row]) - number, [score.get(who, 0) for who in both]
        gained = after - before
        winner = {Outcome.WINNER: gained[0], Outcome.FAULT: gained[1]}.get(outcome[row], 1)
        text = f"score {after[0]:g}:{after[1]:g} after {before[0]:g}:{before[1]:g}, {rallies} rallies before"
        if gained.min() < 0 or gained.sum() > rallies or winner < 1:
            sheet.mark(row, f"{text}: it does not follow from who won; games need the column game")
        elif gained.sum() < rallies:
            sheet.warn([row], f"{text}: fewer points than rallies")
        number, score = int(rally[row]), dict(zip(both, after, strict=True))


def _compare_points(sheet: Sheet, strokes: Mapping[str, Any], points: Mapping[str, F64], first: Bools) -> None:
    """Compare points with each other, and landings with the endings."""
    outcome, reason, landing, contact = strokes["outcome"], strokes["reason"], points["landing"], points["contact"]
    met = np.r_[[[np.nan] * 2], -landing[:-1]]  # seen by the player who met the shuttle there
    met[first] = np.nan
    for other, limit, text in ((met, _APART, "where the stroke before was met"), (points["striker"], _REACH, "the striker")):
        far = np.hypot(*(contact - other).T) > limit
        sheet.warn(np.flatnonzero(far), f"the contact point is more than {limit:g} m from {text}")
    inside, over = court.in_court(*landing.astype(np.float32).T), landing[:, 1] > REACH_OVER
    known = ~np.isnan(landing[:, 1])
    out, short = reason == REASONS.index("out"), np.isin(reason, [REASONS.index("net"), REASONS.index("short")])
    for wrong, text in (
        (out & inside, "out, and the landing point lies in court"),
        (short & over, "net or short, and the landing point lies beyond the net"),
        ((outcome == Outcome.WINNER) & ~inside, "a winner, and the landing point lies outside the court"),
    ):
        sheet.warn(np.flatnonzero(known & wrong), text)
    returned = known & (outcome == Outcome.RETURNED)
    if returned.sum() > 2 and (returned & ~inside).sum() > returned.sum() / 3:
        text = "a third of the returned strokes were met outside the court: are x and y metres from the middle of the net?"
        sheet.warnings.append(Problem(sheet.path, text))
