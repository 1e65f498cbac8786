"""Inference of missing values of a sheet, warnings of improbable ones, and names of matches and players."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

import numpy as np

from shuttle_marl.base.arrays import F64, I64, Array, Bools
from shuttle_marl.data.cleaning import FIXED_HEIGHT
from shuttle_marl.data.schema import DISCIPLINES, REACH_OVER, REASONS, Outcome, shown
from shuttle_marl.data.sheet import Sheet
from shuttle_marl.data.upstream import discipline, player_id
from shuttle_marl.data.words import PLAYERS, Words, bare, nfc, plain, whole
from shuttle_marl.game import court
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.scoring import RULES, RulesName
from shuttle_marl.game.stroke import HEIGHTS, N_SERVES, SHOTS

MET: Final[dict[str, tuple[tuple[str, float], ...]]] = {
    "clear": (("back-left", 0.24), ("back-right", 0.37), ("back-left", 0.42), ("back-left", 0.39)),
    "lift": (("front-centre", 0.30), ("front-right", 0.48), ("front-left", 0.48), ("front-centre", 0.30)),
    "drop": (("back-right", 0.29), ("back-right", 0.39), ("back-left", 0.43), ("back-left", 0.40)),
    "smash": (("back-centre", 0.25), ("back-centre", 0.28), ("middle-left", 0.33), ("back-left", 0.28)),
    "half-smash": (("back-centre", 0.21), ("back-right", 0.25), ("middle-left", 0.47), ("back-left", 0.31)),
    "drive": (("middle-centre", 0.38), ("middle-centre", 0.30), ("middle-centre", 0.51), ("middle-centre", 0.65)),
    "push": (("front-centre", 0.33), ("front-right", 0.37), ("front-left", 0.41), ("front-centre", 0.33)),
    "net-kill": (("front-centre", 0.37), ("front-centre", 0.41), ("front-left", 0.47), ("front-centre", 0.37)),
    "net-shot": (("front-centre", 0.34), ("front-centre", 0.38), ("front-left", 0.40), ("front-centre", 0.34)),
    "block": (("middle-left", 0.37), ("middle-right", 0.64), ("middle-left", 0.57), ("middle-left", 0.37)),
    "cross-court-net-shot": (("front-left", 0.21), ("front-right", 0.36), ("front-left", 0.39), ("front-left", 0.21)),
}
"""Where a stroke was met whose reply is of a shot type: the most frequent area and its share in the published train matches, by
technique of the reply: not known, forehand, backhand, around the head (that of all where these are fewer than 30)."""
_AREA: Final = np.full((len(SHOTS), 4), -1)
_SHARE: Final = np.full((len(SHOTS), 4), np.nan)
for _shot, _entries in MET.items():
    _AREA[SHOTS.index(_shot)] = [AREAS.index(area) for area, _ in _entries]
    _SHARE[SHOTS.index(_shot)] = [share for _, share in _entries]
LONG_REPLIES: Final = tuple(SHOTS.index(name) for name in ("clear", "drop", "smash", "half-smash"))
"""Shot types of replies to long serves: 99 % of these in the published matches, and 1 % of the others."""
_LATEST: Final = 4 * 3600  # probable begin of a match in its video [s]
PAUSE: Final = 4.0  # time between two strokes that ends a rally [s]
_LATIN: Final = re.compile(r"LATIN SMALL (?:LETTER|LIGATURE) (?:DOTLESS )?(THORN|ETH|[A-Z]{1,2})(?: WITH .*)?")
_LETTERS: Final = {"THORN": "th", "ETH": "d"}
_LOOKS_LIKE: Final = str.maketrans("авекмнорстухіјѕαβεζηικμνορτυχ", "abekmhopctyxijsabezhikmnoptyx")
_DIGRAPH: Final = re.compile("([aou])e|(?<=a)a")
_BESIDE: Final = re.compile(r"\s*(?:\[[^]]*\]|\([^)]*\))|['\u2019\u02bc`]")  # a seed or a country in brackets, and apostrophes
_SCORE: Final = re.compile(r"\s*(\d{1,2})\s*[-:/\N{EN DASH}\N{EM DASH} ]\s*(\d{1,2})\s*")

POINTS: Final = ("landing", "contact", "striker", "receiver")
OTHER_SCORE: Final = "the score is not that of the last stroke of its rally, which is used"
_APART: Final = 0.5  # largest distance of a contact point from the landing of the stroke before, which is the same point [m]
_REACH: Final = 4.0  # largest distance of a player from a contact point [m]; 3.5 in 999 of 1,000 published strokes
_SHALLOW, _TINY = 3.0, 1.05  # points all so close to the middle of the net [m] are improbable, or fractions of a court
_FEW: Final = 10  # fewer points tell nothing for certain
_TEMPO: Final = (0.3, 5.0)  # probable median time between two strokes [s]; 0.9 in published matches
_SHORTEST: Final = 0.1  # a shorter median is no time in seconds; 0 is one of whole rallies

Points = tuple[int, int]


def areas_met(reply: I64, technique: I64) -> tuple[I64, F64]:
    """``[n]`` areas where strokes were met, -1 not known, and their shares; ``reply``: ``[n]`` shot type of the next stroke, -1
    without one; ``technique``: ``[n]`` its technique, -1 not known."""
    known = (reply >= 0) & (reply < len(SHOTS))
    shot = np.where(known, reply, 0)
    area = np.where(known, _AREA[shot, technique + 1], -1)
    return area, np.where(area >= 0, _SHARE[shot, technique + 1], np.nan)


def read_score(text: str) -> Points | None:
    """Two numbers such as ``5-3``; None for other text."""
    found = _SCORE.fullmatch(unicodedata.normalize("NFKC", text))
    return None if found is None else (int(found[1]), int(found[2]))


def winners_by_score(scores: F64, fresh: Bools, server: I64, told: I64, began: I64, match: I64) -> tuple[F64, I64, str]:
    """Scores after each rally and winners, in the reading of the scores that agrees best with what else is known.

    The first number may be of a role in the game or of a player, who then is one in all games of a match.

    Args:
        scores: ``[R, 2]`` of each of the R rallies, in an unknown order, before or after it; NaN not known.
        fresh: ``[R]`` whether a rally is the first of its game.
        server, told, began: ``[R]`` who serves, who won where another value tells it (else -1), and who struck first in the
            match: 0 for who struck first in the game, 1 for the other player.

    Returns:
        ``[R, 2]`` points of 0 and 1 after each rally; ``[R]`` winners, -1 not known; and the reading in words, empty if several
        fit.
    """
    zero = np.zeros_like(server)
    orders = {"the first striker's": zero, "the other player's": 1 - zero, "the server's": server}
    readings = []
    for before in (False, True):
        for whose, first in orders.items():
            readings.append((*_read(scores, fresh, told, first, before=before), whose, before, False))
        other, tied = zero.copy(), False  # whether the first number is of who did not begin the match
        for number in np.unique(match):
            rows = match == number
            one, two = (_read(scores[rows], fresh[rows], told[rows], began[rows] ^ who, before=before) for who in (0, 1))
            other[rows] = two[:2] < one[:2]
            tied |= two[:2] == one[:2] and not np.array_equal(one[3], two[3])
        readings.append((*_read(scores, fresh, told, began ^ other, before=before), "one player's in each match", before, tied))
    best = min(reading[:2] for reading in readings)
    equal = [reading for reading in readings if reading[:2] == best]
    _, _, after, won, whose, before, tied = equal[0]
    tied |= any((np.abs(after - reading[2]) > 0).any() or (won != reading[3]).any() for reading in equal)
    words = f"the score is that {'before' if before else 'after'} the rally; the first number is {whose}"
    return after, won, "" if tied else words


def _read(scores: F64, fresh: Bools, told: I64, first: I64, *, before: bool) -> tuple[int, int, F64, I64]:
    """A reading of scores: what contradicts it and, negative, what agrees with it; points after each rally, and winners."""
    here = np.where(first[:, None] == 0, scores, scores[:, ::-1])
    if before:
        start, end = here, np.where(np.r_[~fresh[1:], False][:, None], np.roll(here, -1, axis=0), np.nan)
    else:
        start, end = np.where(fresh[:, None], 0, np.roll(here, 1, axis=0)), here
    gained = end - start
    won = np.select([(gained == [1, 0]).all(axis=1), (gained == [0, 1]).all(axis=1)], [0, 1], -1)
    wrong = (~np.isnan(gained).any(axis=1) & (won < 0)).sum() + (before & fresh & (here.max(axis=1) > 0)).sum()
    if before:
        end = np.where(np.isnan(end) & (told >= 0)[:, None], here + (told[:, None] == [0, 1]), end)
    known = (won >= 0) & (told >= 0)
    return int(wrong + (known & (won != told)).sum()), -int((known & (won == told)).sum()), end, won


def changes(*columns: Array) -> Bools:
    """``[n]`` rows, the first among them, in which one of the columns differs from the row before."""
    return np.r_[True, np.any([column[1:] != column[:-1] for column in columns], axis=0)]


def _folded(name: str) -> str:
    """A name in the letters from A to Z that are written for others: o for \u00f8, oe and \u00f6, or that look like them."""
    folded = ""
    for c in unicodedata.normalize("NFKD", name).casefold().translate(_LOOKS_LIKE):
        latin = _LATIN.fullmatch(unicodedata.name(c, ""))
        folded += _LETTERS.get(latin[1], latin[1].lower()) if latin else "" if unicodedata.combining(c) else c
    return _DIGRAPH.sub(r"\1", folded)


def _forms(name: str) -> tuple[list[str], list[str], bool]:
    """Keys of a player's name: of all its words, of these with one cut to its initial, and whether it has an initial."""
    words = player_id(_BESIDE.sub("", _folded(name))).split("-")
    cut = range(len(words) if len(words) > 1 else 0)
    short = [f"player {sorted([*words[:k], words[k][:1], *words[k + 1 :]])}" for k in cut]
    return [f"player {sorted(words)}", f"player {''.join(words)}"], short, any(len(word) == 1 for word in words)


def warn_alike(sheet: Sheet, seen: dict[str, str], names: Sequence[str], what: str) -> None:
    """Warn of names that differ only in capitals, accents, width, or the order of words, or mix alphabets.

    Names of players are alike too with a seed or a country in brackets, an initial, other apostrophes, or without a space.

    Args:
        seen: names so far; the new ones are added.
        what: ``match`` or ``player``.
    """
    for row in sorted({name: row for row, name in reversed(list(enumerate(names)))}.values()):
        name = str(names[row])
        if what == "match":
            other = seen.setdefault(f"match {player_id(_folded(name)).split('-')}", name)
        else:
            whole_names, short, initials = _forms(name)
            looked_up = [*whole_names, *([f"initials of {whole_names[0]}"] if initials else short)]
            other = next((seen[key] for key in looked_up if key in seen), name)
            for key in (*whole_names, *(f"initials of {key}" for key in short)):
                seen.setdefault(key, name)
            if _ROLE.fullmatch(_PLACE.sub("", bare(name))) and sum(key.startswith("match ") for key in seen) > 1:
                sheet.warn([row], f"{shown(name)} is the name of a player in several matches: is it one person in all of them?")
        if other != name and (what == "match" or player_id(other) != player_id(name)):
            sheet.warn([row], f"{shown(name)} and {shown(other)} are alike: are they one {what}?")
            continue
        mixed = {unicodedata.name(c, "").partition(" ")[0] for c in name if c.isalpha()} & {"LATIN", "CYRILLIC", "GREEK"}
        if len(mixed) > 1:
            sheet.warn([row], f"{what} {shown(name)} mixes letters of {' and '.join(sorted(mixed)).lower()}")


def check_scale(sheet: Sheet, name: str, points: F64) -> None:
    """Record a problem, or with few points a warning, if all points lie so close to the net that they are no metres."""
    furthest = np.nanmax(np.abs(points), axis=1, initial=0)[~np.isnan(points).all(axis=1)]
    limit = _SHALLOW if len(furthest) > _FEW / 2 else _TINY
    if len(furthest) > 2 and furthest.max() <= limit:
        certain = len(furthest) >= _FEW and furthest.max() <= _TINY
        text = f"all {len(furthest)} {name} points lie within {limit:g} m of the middle of the net: are these metres?"
        (sheet.add if certain else sheet.doubt)(text)


def check_tempo(sheet: Sheet, passed: F64) -> None:
    """Record a problem, or where it is not certain a warning, if times between strokes are improbable for seconds."""
    passed = passed[~np.isnan(passed)]
    middle = float(np.median(passed)) if len(passed) else 1.0
    if not _TEMPO[0] <= middle <= _TEMPO[1]:
        certain = middle > _TEMPO[1] or 0 < middle < _SHORTEST
        advice = "; write seconds, or leave the times out" if certain else ""
        text = f"half of the strokes follow the one before after {middle:g} s: are these seconds?{advice}"
        (sheet.add if certain else sheet.doubt)(text)


def compare(sheet: Sheet, strokes: Mapping[str, Any], points: Mapping[str, F64], fresh: Bools, first: Bools) -> None:
    """Compare the rows with those before them, and points and heights with other columns; ``strokes``: ``[n]`` values by column
    of the schema, NaN where there are none; ``points``: ``[n, 2]`` :data:`POINTS`; ``fresh``, ``first``: ``[n]`` whether a row
    begins a game, and a rally."""
    game, rally, number, player, outcome = (strokes[name] for name in ("game", "rally", "stroke", "player", "outcome"))
    if "stroke" in sheet:
        missing = number != np.where(first, 1, np.r_[0, number[:-1]] + 1)
        sheet.warn(missing, "strokes of the rally are missing before this one")
    gap = rally - np.where(fresh, 0, np.r_[0, rally[:-1]])
    sheet.warn(first & (gap > 1), "rallies of the game are missing before this one")
    leap = game - np.where(changes(strokes["match"]), 0, np.r_[0, game[:-1]])
    sheet.warn(leap > 1, "games of the match are missing before this one")
    won = np.select([outcome == Outcome.WINNER, outcome == Outcome.FAULT], [player, strokes["opponent"]], "")
    served = first & (number == 1) & (strokes["shot"] < N_SERVES) & ~fresh & (gap == 1)
    others = served & np.r_[False, (won[:-1] != "") & (won[:-1] != player[1:])]
    sheet.warn(others, "the server did not win the rally before")
    if "side" in sheet:
        at_near = (sheet.words("side", 0) == 1) ^ (player < strokes["opponent"])
        moved = ~fresh & changes(at_near)
        sheet.mark(np.flatnonzero(moved & ~first), "the players are not on the sides of the stroke before")
        decider = 2 * RULES[cast("RulesName", sheet.map.rules or "21")].games - 1
        sheet.warn(moved & first & (game < decider), "the players change sides during the game")
        stayed = (leap == 1) & ~changes(strokes["match"]) & ~changes(at_near)
        sheet.warn(stayed, "the players do not change sides after the game before")
    if "seconds" in sheet:
        passed = np.diff(sheet.numbers("seconds"), prepend=np.nan)
        sheet.warn(first & ~changes(strokes["match"]) & (passed < 0), "the time is before that of the rally before")
        sheet.mark(np.flatnonzero(~first & (passed < 0)), "the time is before that of the stroke before")
        check_tempo(sheet, passed[~first])
        if (begin := float(np.nanmin(sheet.numbers("seconds"), initial=np.inf))) > _LATEST and begin < np.inf:
            sheet.doubt(f"the first stroke is {begin / 3600:.1f} hours after the begin of the video: are these times of the day?")
    _compare_scores(sheet, strokes, fresh, first)
    _compare_points(sheet, strokes, points, first)
    for name, usual in FIXED_HEIGHT.items():
        other = (strokes["shot"] == SHOTS.index(name)) & (strokes["height"] == 1 - usual)
        sheet.warn(other, f"a {name} struck {HEIGHTS[1 - usual]} the net")


def _compare_scores(sheet: Sheet, strokes: Mapping[str, Any], fresh: Bools, first: Bools) -> None:
    player, opponent, rally, outcome = (strokes[name] for name in ("player", "opponent", "rally", "outcome"))
    points = np.stack([strokes["points"], strokes["points_opponent"]], axis=1)
    ends = np.flatnonzero(np.r_[first[1:], True])
    end = ends[np.cumsum(first) - 1]  # of the rally of each row
    told = np.where((player == player[end])[:, None], points, points[:, ::-1])
    sheet.warn(np.abs(told - told[end]).max(axis=1, initial=0) > 0, OTHER_SCORE)
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
    outcome, reason, landing, contact = strokes["outcome"], strokes["reason"], points["landing"], points["contact"]
    met = np.r_[[[np.nan] * 2], -landing[:-1]]  # seen by the player who met the shuttle there
    met[first] = np.nan
    for other, limit, text in ((met, _APART, "where the stroke before was met"), (points["striker"], _REACH, "the striker")):
        far = np.hypot(*(contact - other).T) > limit
        sheet.warn(far, f"the contact point is more than {limit:g} m from {text}")
    inside, over = court.in_court(*landing.astype(np.float32).T), landing[:, 1] > REACH_OVER
    known = ~np.isnan(landing[:, 1])
    out, short = reason == REASONS.index("out"), np.isin(reason, [REASONS.index("net"), REASONS.index("short")])
    for wrong, text in (
        (out & inside, "out, and the landing point lies in court"),
        (short & over, "net or short, and the landing point lies beyond the net"),
        ((outcome == Outcome.WINNER) & ~inside, "a winner, and the landing point lies outside the court"),
    ):
        sheet.warn(known & wrong, text)
    returned = known & (outcome == Outcome.RETURNED)
    if returned.sum() > 2 and (returned & ~inside).sum() > returned.sum() / 3:
        sheet.doubt("a third of the returned strokes were met outside the court: are x and y metres from the middle of the net?")


_MISSING: Final = frozenset((  # words that programs write for a missing value, as `bare` gives them
    "nan", "none", "null", "nil", "nat", "na", "<na>", "undefined", "missing", "ref!", "value!", "name?", "div0!", "num!", "inf",
    "tbd", "tba", "bye",
))  # fmt: skip
_ROLES: Final = frozenset(
    {"server", "receiver", "striker", "hitter", "winner", "loser", "发球方", "接发球方", "发球者", "接发球者"}
)
_ROLE: Final = re.compile(r"[pt]?\d|.|home|away|opponent|rival")  # of another person in another match, without `_PLACE`
_IF_ONE: Final = "; map it in [values.player] if it is one"
_TWO: Final = re.compile(r"[/&+;|\\\u3001\uff06\uff0f]|\s[-\u2013\u2014]\s|\s(and|und|og|et|dan|vs|v|और)\.?\s", re.IGNORECASE)
"""Separators of two names in one cell."""
_HYPHEN: Final = re.compile(r"(?<=[^\W\d_])[-\u2010-\u2015](?=[^\W\d_])")
_PLACE: Final = re.compile("player|court|side|half|end")


def _is_end(name: str) -> bool:
    """Whether a name is that of an end of the court, such as *top* or *player_near*."""
    word = _PLACE.sub("", bare(name))
    return bool(Words("side", ()).meaning(word)) or Words("side_of_area", ()).meaning(word) in ("left", "right")


def names_of_matches(sheet: Sheet) -> Array:
    """``[n]`` names of matches; without a column that of the file."""
    if "match" in sheet:
        return np.array(_checked(sheet, "match", spelled(sheet, "match")))
    return np.full(len(sheet), "".join(c if c.isprintable() else "_" for c in sheet.path.stem).strip() or "match")


def players_of(sheet: Sheet, match: Array) -> tuple[Array, Array]:
    """``[n]`` identifiers of the players and of their opponents."""
    if all(map(_is_end, {*sheet.text("player")})):
        sheet.add("the players are named by the ends of the court, which they change; write the name of the player in each row")
    known: dict[str, str] = {}
    alike: dict[str, str] = {}
    warn_alike(sheet, alike, match.tolist(), "match")

    def identifiers(name: str) -> Array:
        names = _checked(sheet, name, spelled(sheet, name))
        for row, value in enumerate(names):
            if (other := known.setdefault(player_id(value), value)) != value:
                one = f"{shown(value)} and {shown(other)} would be one player, {player_id(value)}"
                sheet.mark(row, f"{one}; write one name, or map one in [values.player]")
        warn_alike(sheet, alike, names, "player")
        if comma := next((value for value in names if "," in value), None):
            told = f"names with a comma are of one person each, surname first, such as {shown(comma)}"
            sheet.notes += [told] if told not in sheet.notes else []
        for pair in sorted({*names} - {*sheet.map.values.get("player", {}).values()}):
            if _of_two(pair):
                sheet.doubt(f"{shown(pair)} is read as one person: are these two, of a game of doubles{_IF_ONE}")
        return np.array([player_id(value) for value in names], dtype=object)

    player = identifiers("player")
    return player, identifiers("opponent") if "opponent" in sheet else _others(sheet, match, player)


def spelled(sheet: Sheet, name: str) -> list[str]:
    """``[n]`` names of a column as ``[values.player]`` spells them."""
    spellings = sheet.map.values.get("player", {}) if name in PLAYERS else {}
    return [nfc(spellings.get(plain(text), whole(text))) for text in sheet.text(name)]


def _checked(sheet: Sheet, name: str, values: list[str]) -> list[str]:
    """The names; what is no name of one match or one person is a problem."""
    wrong = {value: told for value in set(values) if (told := _no_name(value, of_player=name in PLAYERS))}
    for row, value in enumerate(values) if wrong else ():
        if value in wrong:
            sheet.mark(row, f"{sheet.named(name)} {shown(value)}; {wrong[value]}")
    return values


def _of_two(value: str) -> bool:
    """Whether a name may be of two persons: with a hyphen between as many words, one or two, with capitals."""
    sides = [side.split() for side in _HYPHEN.split(value)]
    return (
        len(sides) == 2 and len(sides[0]) == len(sides[1]) < 3 and not any(word[0].islower() for side in sides for word in side)
    )


def _no_name(value: str, *, of_player: bool) -> str:
    """Text that is expected instead of a value; empty if the value may be a name."""
    if not value or not value.isprintable():
        return "expected a name"
    if of_player and not any(map(str.isalnum, value)):
        return "expected a name with letters or digits"
    if bare(value) in _MISSING or Words("shot", ()).meaning(value) == "unknown":
        return f"expected a name: this stands for a missing one{_IF_ONE if of_player else ''}"
    if of_player and bare(value) in _ROLES:
        return f"expected a name: this is another player in another rally{_IF_ONE}"
    if of_player and _TWO.search(value):
        return f"expected the name of one person, because the game is of singles{_IF_ONE}"
    return ""


def _others(sheet: Sheet, match: Array, player: Array) -> Array:
    """``[n]`` the other player of the match."""
    opponent = player.copy()
    of_match, begins = np.argsort(match, kind="stable"), np.unique(np.sort(match), return_index=True)[1]
    for rows in np.split(of_match, begins[1:]):
        names, first, count = np.unique(player[rows], return_index=True, return_counts=True)
        if len(names) == 2:
            opponent[rows] = np.where(player[rows] == names[0], names[1], names[0])
            continue
        if not sheet.unreadable[rows].any():  # else reported already
            has = f"match {str(match[rows[0]])!r} has {len(names)} players ({', '.join(names[:5])})"
            rarest = rows[first[np.lexsort((-first, count))[0]]]
            sheet.mark(rarest, f"{has}; expected two, or a column opponent")
        sheet.unreadable[rows] = True
    return opponent


def hands_given(sheet: Sheet, player: Array) -> I64:
    """``[n]`` hands of the column, -1 not given; a player has one."""
    hand, of_player = sheet.words("hand"), dict[str, int]()
    for row in np.flatnonzero(hand >= 0):
        if of_player.setdefault(player[row], hand[row]) != hand[row]:
            sheet.mark(row, f"{player[row]} is {court.HANDS[hand[row]]}-handed here, and not above; expected one hand")
    return np.array([of_player.get(name, -1) for name in player])


def disciplines(sheet: Sheet, player: Array, opponent: Array) -> Array:
    """``[n]`` disciplines: of the column, of the map, or of known players."""
    known = [{discipline(a), discipline(b)} - {None} for a, b in zip(player, opponent, strict=True)]
    first, second = DISCIPLINES
    if "discipline" in sheet:
        given = np.array(DISCIPLINES)[np.maximum(sheet.words("discipline"), 0)]
    elif sheet.map.discipline:
        given = np.full(len(sheet), sheet.map.discipline)
    elif sheet.map.guessed and not any(known):
        sheet.notes.append(f'the discipline: {first}; if it is another, set discipline = "{second}" in a map')
        return np.full(len(sheet), first)
    else:
        told = f'set discipline = "{first}" or "{second}" in the map, or map a column'
        sheet.mark(
            np.flatnonzero([len(kinds) != 1 for kinds in known])[:1], f"unknown discipline, or players of different ones; {told}"
        )
        return np.array([min((kind for kind in kinds if kind), default=first) for kinds in known])
    others = np.array([bool(kinds - {told}) for kinds, told in zip(known, given.tolist(), strict=True)])
    sheet.warn(others, "a player of the published matches, who plays another discipline there")
    return given
