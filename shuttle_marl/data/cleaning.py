"""Cleaning of the raw rows of ShuttleSet and ShuttleSet22: order, sides, outcomes, areas, contact heights and times.

``docs/datasheet.md`` lists the known errors of the files with their frequencies. Every dropped row is counted by its reason
(:data:`shuttle_marl.data.schema.DROP_REASONS`).
"""

import collections
import dataclasses
import math
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.arrays import I8, I64, Array, Bools
from shuttle_marl.base.errors import command
from shuttle_marl.data import schema
from shuttle_marl.data.hands import unknown_hands, with_hands
from shuttle_marl.data.schema import DROP_REASONS, REACH_OVER, REASONS, Account, Cleaned, DataError, Outcome
from shuttle_marl.data.shuttleset import AREA_OF_LABEL, NEAREST_OF_LABEL, RawGame, list_matches, read_game
from shuttle_marl.data.upstream import split_of
from shuttle_marl.game import court
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS

# Limits of conventions, see with_common_labels.
_LEAST: Final = 10
_EXCESS: Final = 0.25
_RARE: Final = 0.2
_FAR: Final = 8.0

_COORDINATES: Final = {"landing": "landing", "contact": "hit", "striker": "player_location", "receiver": "opponent_location"}
_HEIGHTS_AGREE: Final = 0.7  # minimum agreement of the two records of the contact heights of a game
_HEIGHTS_PLAUSIBLE: Final = 0.9  # minimum fraction of the strokes of `FIXED_HEIGHT` types at the height of the type
FIXED_HEIGHT: Final = {"drop": 1, "smash": 1, "half-smash": 1, "lift": 0, "net-shot": 0}
"""Shot types that are nearly always struck at one height: 0 below, 1 above the net."""
_MAX_EXCHANGED: Final = 0.2  # maximum fraction of the rallies of a game in which letters are exchanged

_LABEL_AREA: Final = np.array([-1, *AREA_OF_LABEL, *(-1 for _ in NEAREST_OF_LABEL)], dtype=np.int8)
"""Index into court.AREAS by area label of the files; -1 outside."""
_OUT, _NET, _SHORT, _FOUL = (REASONS.index(name) for name in ("out", "net", "short", "foul"))
_RETURNED, _UNKNOWN = REASONS.index("returned"), REASONS.index("unknown")


def clean_matches(root: Path) -> Cleaned:
    """Read and clean the matches below ``root`` whose files are present. Raises DataError: unreadable input, or no match is
    present."""
    matches = [match for match in list_matches(root) if match.present]
    if not matches:
        raise DataError(root, f"no files of any match; get them with `{command('data', 'download')}`")
    games = []
    for match in matches:
        for path in match.games():
            games.append(game := read_game(match, path))
            if game.problems and not game.published:
                raise DataError.of(game.problems)
    cleaned = [_clean_game(game) for game in games]
    strokes, inferred = with_hands(pa.concat_tables([table for table, _ in cleaned]), root)
    strokes, conventions = with_common_labels(strokes)
    dropped = sum((collections.Counter(counts) for _, counts in cleaned), collections.Counter[str]())
    agrees = pc.equal(strokes["area"].fill_null(-1), strokes["label_area"]).drop_null().to_numpy()
    before = {
        "matches": len(matches),
        "rallies": sum(len(np.unique(game["rally"])) for game in games),
        "strokes": sum(len(game) + game.empty for game in games),
        "dropped": {reason: dropped[reason] for reason in DROP_REASONS},
        "area_agreement": float(agrees.mean()) if len(agrees) else None,
    }
    told = {"inferred": inferred, "lost": unknown_hands(strokes), "conventions": list(map(dataclasses.asdict, conventions))}
    files = tuple(game.path for game in games)
    return Cleaned(strokes=strokes, account=Account.of(strokes, **before), files=files, provenance=told)


def _clean_game(raw: RawGame) -> tuple[pa.Table, dict[str, int]]:
    raw, repeated = _arrange(raw)
    first = _first_strokes(raw)
    raw = _with_corrected_letters(raw, first)
    side, contradicted = _sides(raw, first)
    outcome, reason = _outcomes(raw, first)
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
    label = _corrected_label(raw, own_half=landing_y < 0)
    tests = {
        "unreadable value": raw["unreadable"],
        "broken homography": np.full(len(first), raw.broken_homography),
        "contact heights unreliable": np.full(len(first), _heights_unreliable(raw, first)),
        "broken rally": _broken_rallies(raw, first),
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
    score = raw["score"][np.flatnonzero(np.r_[first[1:], True])][np.cumsum(first) - 1]  # that of the last row of the rally
    untimed, (a, b) = ~_timed(raw, first), raw.match.players
    of_match = {"match": raw.match.name, "source": raw.match.source, "discipline": raw.match.discipline, "game": raw.game}
    columns: dict[str, Array] = {
        **{name: np.full(len(first), value) for name, value in of_match.items()},
        "player": np.where(raw["by_a"], a, b),
        "opponent": np.where(raw["by_a"], b, a),
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
    return schema.stroke_table(columns, ego).take(np.flatnonzero(valid)), counts


def _arrange(raw: RawGame) -> tuple[RawGame, int]:
    """The rows in playing order without repeated ones, and their number. Two games of the data have an early rally at the end of
    the file; one stroke is repeated."""
    raw = raw.take(np.argsort(raw["rally"], kind="stable"))
    same = [raw[name][1:] == raw[name][:-1] for name in ("rally", "stroke", "by_a")]
    repeated = np.r_[False, np.all(same, axis=0) & (raw["stroke"][1:] > 1)]
    return raw.take(np.flatnonzero(~repeated)), int(repeated.sum())


def _first_strokes(raw: RawGame) -> Bools:
    """``[n]`` whether a row is the first of a rally; a rally may have the number of the previous one."""
    return np.r_[True, (np.diff(raw["rally"]) != 0) | (raw["stroke"][1:] == 1)]


def _broken_rallies(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows of rallies with misnumbered strokes, players who do not alternate, or a repeated number."""
    rally = np.cumsum(first) - 1
    inside = ~first[1:]
    wrong = np.r_[False, inside & ((np.diff(raw["stroke"]) != 1) | (raw["by_a"][1:] == raw["by_a"][:-1]))]
    wrong |= first & ((raw["stroke"] != 1) | (raw["rally"] < 1))
    wrong |= first & np.r_[False, np.diff(raw["rally"]) == 0]
    return np.asarray(np.bincount(rally, weights=wrong)[rally] > 0)


def _sides(raw: RawGame, first: Bools) -> tuple[I64, Bools]:
    """``[n]`` sign of the striker's half by majority vote within the rally, 0 without evidence; and rows that contradict it.

    Ends change within a match, so positions, contacts and landings (unless the shuttle fell short) vote in each rally; rows of
    unknown shot type contain placeholders and do not."""
    rally = np.cumsum(first) - 1
    own = [np.sign(raw[name][:, 1]) for name in ("player_location", "hit")]
    other = [-np.sign(raw["opponent_location"][:, 1])]
    crossed = ~np.isin(raw["reason"], (_NET, _SHORT))
    other.append(np.where(crossed, -np.sign(raw["landing"][:, 1]), np.nan))
    vote = np.where(raw["shot"] < 0, 0.0, np.nansum(np.stack(own + other), axis=0))
    sign_a = np.sign(np.bincount(rally, weights=np.where(raw["by_a"], vote, -vote)))
    side = np.where(raw["by_a"], sign_a[rally], -sign_a[rally]).astype(np.int64)
    return side, vote * side < 0


def _with_corrected_letters(raw: RawGame, first: Bools) -> RawGame:
    """Exchange players A and B in rallies that contradict the ends of the game, which do not change within games 1 and 2. In two
    rallies of the data they are on each other's side, and the last striker's fault wins; exchanged letters correct both."""
    if raw.game > 2:
        return raw
    side, _ = _sides(raw, first)
    side_a = np.where(raw["by_a"], side, -side)[first]
    usual = np.sign(side_a.sum())
    odd = side_a == -usual
    if usual == 0 or odd.sum() > _MAX_EXCHANGED * len(odd):
        return raw
    return dataclasses.replace(raw, columns={**raw.columns, "by_a": raw["by_a"] ^ odd[np.cumsum(first) - 1]})


def _outcomes(raw: RawGame, first: Bools) -> tuple[I64, I64]:
    """``[n]`` outcome and reason of every stroke, indices into OUTCOMES and REASONS. The winner of a rally is the player who
    scored, or the annotated winner if the score of the previous rally is missing. If the reason contradicts the winner, the last
    stroke was not annotated and the outcome is unknown."""
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


def _heights_unreliable(raw: RawGame, first: Bools) -> bool:
    """Whether the contact heights of a game contradict each other, or the shot types, too often."""
    met = np.where(first, -1, np.r_[np.int8(-1), raw["met_height"][:-1]])
    both = (met >= 0) & (raw["height"] >= 0)
    if both.mean() > 0.5 and (met == raw["height"])[both].mean() < _HEIGHTS_AGREE:
        return True
    expected = np.array([FIXED_HEIGHT.get(name, -1) for name in SHOTS] + [-1])[raw["shot"]]
    fixed = (expected >= 0) & (raw["height"] >= 0)
    return bool(fixed.any() and (expected == raw["height"])[fixed].mean() < _HEIGHTS_PLAUSIBLE)


def _timed(raw: RawGame, first: Bools) -> Bools:
    """``[n]`` rows with a consistent time: the longest sequence of a rally with increasing frames and non-decreasing clocks."""
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


def _corrected_label(raw: RawGame, own_half: Bools) -> I8:
    """``[n]`` area labels from the receiver's view, -1 outside the court. In the files left and right are those of the player in
    whose half the shuttle landed."""
    label = _LABEL_AREA[raw["label_area"]]
    mirror = own_half.copy()
    if raw.match.source == "ShuttleSet" and raw.match.number in range(9, 21):  # labels of the lower half are mirrored
        mirror ^= raw["landing"][:, 1] > 0
    return np.where(mirror & (label >= 0), 3 * (label // 3) + 2 - label % 3, label).astype(np.int8)


@dataclasses.dataclass(frozen=True)
class Convention:
    """Another name for the replies to a shot type in one match."""

    match: str
    incoming: str  # shot type that is answered
    given: str  # label in the match
    meant: str  # label of all other matches
    strokes: int  # with the label `given`
    of: int  # strokes with either label
    expected: float  # expected share of `given` in them
    distance: float  # from it, in standard deviations between matches


def with_common_labels(strokes: pa.Table) -> tuple[pa.Table, list[Convention]]:
    """Rename the strokes of matches whose annotators gave them another name than all others do: "block" for the reply to a drop.

    A *convention* is a label that makes up much of the replies to an incoming shot type in one match, and hardly any of those
    replies in the training matches, where another label has them. For every match, incoming shot type, and pair of labels
    ``given`` and ``meant``, the share of ``given`` among both is compared with the share that the training matches lead to expect
    in the same areas and from the same contact heights. A convention has

    - at least 10 strokes with one of both labels; 10 training matches have as many,
    - a share at least 0.25 above an expected share of at most 0.2, and
    - a distance from it of 8 standard deviations between matches (the scaled median absolute deviation of the training matches,
      and at least that of chance).

    ``meant`` is the label whose strokes are struck and land most like those of the match. Strokes of a convention count as
    ``meant`` in the search for the next one. A label that others use often in the same place is never renamed: that would be a
    guess. A smash and a half smash, or a push and a lift, are such pairs, in which annotators differ gradually.

    Args:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, in playing order.

    Returns:
        The table, and the conventions, by incoming shot type and distance. Without enough training matches there are none.
    """
    encoded = strokes["match"].combine_chunks().dictionary_encode()
    names: list[str] = encoded.dictionary.to_pylist()
    training = np.array([split_of(name) == "train" for name in names], dtype=bool)
    row, *codes = _replies(strokes, encoded.indices.to_numpy().astype(np.int64))
    shape = (len(names), N_SHOTS, 2 * N_AREAS, N_AREAS + 1, N_SHOTS)
    count = np.bincount(np.ravel_multi_index(codes, shape), minlength=math.prod(shape)).reshape(shape)
    meaning = np.broadcast_to(np.arange(N_SHOTS, dtype=np.int8), (len(names), N_SHOTS, N_SHOTS)).copy()
    found: list[Convention] = []
    for incoming in range(N_SHOTS):
        replies = count[:, incoming]
        while farthest := _farthest(replies, training):
            at, given, meant, about = farthest
            found.append(Convention(names[at], SHOTS[incoming], SHOTS[given], SHOTS[meant], **about))
            replies[at, ..., meant] += replies[at, ..., given]
            replies[at, ..., given] = 0
            meaning[at, incoming][meaning[at, incoming] == given] = meant
    shot = strokes["shot"].to_numpy().copy()
    shot[row] = meaning[codes[0], codes[1], codes[-1]]
    return schema.changed(strokes, "shot", pa.array(shot)), found


def _replies(strokes: pa.Table, match: I64) -> tuple[I64, ...]:
    """Row, match, incoming shot type, area and height of the contact, landing area (9: not recorded) and label of each reply."""
    number, shot, height = (strokes[name].to_numpy() for name in ("stroke", "shot", "height"))
    area = strokes["area"].fill_null(N_AREAS).to_numpy().astype(np.int64)
    replied = np.r_[False, np.diff(number) == 1][: len(number)]
    replied[schema.rally_starts(strokes)[:-1]] = False
    row = np.flatnonzero(replied)
    row = row[area[row - 1] < N_AREAS]
    return row, match[row], shot[row - 1], area[row - 1] * 2 + height[row], area[row], shot[row]


def _farthest(count: I64, training: Bools) -> tuple[int, int, int, dict[str, Any]] | None:
    """Match, label in it and that of the others, and what else :class:`Convention` tells, of the one with the largest distance;
    ``count``: ``[matches, contacts, landings, labels]`` replies to a shot type."""
    count = count[..., N_SERVES:]
    at = np.moveaxis(count.sum(axis=2), 1, 2)
    labelled, both = at[:, :, None], at[:, :, None] + at[:, None]  # [matches, given, meant, contacts]
    strokes, of = np.broadcast_to(labelled.sum(axis=3), both.shape[:3]), both.sum(axis=3)
    usual = training[:, None, None] & (of >= _LEAST)
    comparable = (usual.sum(axis=0) >= _LEAST) & ~np.eye(count.shape[3], dtype=bool)
    if not comparable.any():
        return None
    # Of the other training matches; at a place shrunk to the share at all places with the weight of one stroke.
    hits, total = (one[training].sum(axis=0) - one * training[:, None, None, None] for one in (labelled, both))
    share = (hits + hits.sum(axis=3, keepdims=True) / np.maximum(total.sum(axis=3, keepdims=True), 1)) / (total + 1)
    expected, variance = (both * share).sum(axis=3), (both * share * (1 - share)).sum(axis=3)
    error = np.where(comparable, (strokes - expected) / np.sqrt(np.maximum(variance, 1.0)), 0.0)
    error -= np.nanmedian(np.where(usual | ~comparable, error, np.nan), axis=0)
    spread = 1.4826 * np.nanmedian(np.where(usual | ~comparable, np.abs(error), np.nan), axis=0)
    distance, expected = error / np.maximum(spread, 1.0), expected / np.maximum(of, 1)
    # Log-likelihood of contacts and landings of a label under those of another one in the training matches.
    prior = count[training].sum(axis=0) + 0.1
    alike = np.einsum("mclg,clt->mgt", count, np.log(prior / prior.sum(axis=(0, 1))))
    best = np.where(comparable, alike, -np.inf).argmax(axis=2)[..., None]
    strokes, of, expected, distance, fits = (
        np.take_along_axis(one, best, axis=2)[..., 0].T
        for one in (strokes, of, expected, distance, np.broadcast_to(comparable, of.shape))
    )
    fits = fits & (of >= _LEAST) & (distance >= _FAR) & (expected <= _RARE) & (strokes / np.maximum(of, 1) - expected >= _EXCESS)
    if not fits.any():
        return None
    given, match = np.unravel_index(np.where(fits, distance, -np.inf).argmax(), fits.shape)
    about = {"strokes": strokes, "of": of, "expected": expected, "distance": distance}
    told = {name: values[given, match].item() for name, values in about.items()}
    return int(match), N_SERVES + int(given), N_SERVES + int(best[match, given, 0]), told
