"""Features of the models: strokes in context, as integer codes.

A stroke has attributes (shot type, area, contact height, technique). Its context consists of those of the striker's previous and
of the incoming stroke, the contact height, whether the striker is hurried (:class:`Hurry`), and the discipline; a longer history
improves no model on unseen matches. Strokes of left-handed strikers are mirrored. Target areas mean the same for every outcome:
where the shuttle fell to the floor, they are moved along the line of flight (``docs/models.md``); simulated strokes record the
target.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Final, Self

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.base.arrays import F32, F64, I8, I16, I32, I64, Bools, Ints
from shuttle_marl.base.compiling import compiled
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import parsed, replace_file
from shuttle_marl.base.tensor_files import Tensors, checked, tensor_bytes
from shuttle_marl.data.hands import receiver_hands
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.game.court import N_AREAS, area_of, mirrored
from shuttle_marl.game.shipped import HURRY, folder_of, readable
from shuttle_marl.game.stroke import ATTACKS, N_SHOTS, N_TECHNIQUES, NET_SHOTS, SHOTS
from shuttle_marl.game.tables import Game

DISCIPLINES: Final = ("MS", "WS")
_RATES: Final = (10.0, 130.0)  # frames per second of a video
_SHORTEST: Final = 0.2  # minimum time between two strokes in a speed [s]


# Two more codes of a previous stroke: "none" (before the serve) and "unknown" (the row was dropped).
_BEFORE: Final = {"shot": N_SHOTS + 2, "area": N_AREAS + 2, "height": 4, "technique": N_TECHNIQUES + 2}


SLOTS: Final[dict[str, int]] = {  # number of values of each attribute
    **{f"{stroke}_{attribute}": size for stroke in ("own", "incoming") for attribute, size in _BEFORE.items()},
    "contact": 2,
    "hurried": 2,
    "hands": 2,
    "discipline": len(DISCIPLINES),
    "shot": N_SHOTS,
    "technique": N_TECHNIQUES,
    "area": N_AREAS,
}
STATE: Final = tuple(name for name in SLOTS if name not in ("shot", "technique", "area"))  # what the striker knows
ATTACK: Final = np.isin(SHOTS, ATTACKS)
NET_SHOT: Final = np.isin(SHOTS, NET_SHOTS)
MIN_LANDINGS: Final = 20  # winners, and returns, of a shot type and height; with fewer both heights count, or none move
MOVEMENT: Final = (
    "contact_x", "contact_y", "striker_x", "striker_y", "reach", "moved", "forward", "sideways", "speed", "since", "before",
    "own_x", "own_y", "opponent_x", "opponent_y",
)  # fmt: skip
"""Positions and times before a stroke, in the striker's frame [m, s].

Where they meet the shuttle and where they stand, distance of the two, how far they moved since the opponent's hit (of it
forwards, and to the right) and how fast, time since that hit, time between it and the one before it (0 without one), and where
striker and opponent were at it.
"""
MAX_DEPTH_QUANTILE: Final = 0.9  # quantile of the depth of returned strokes that bounds the target of an out stroke
_ACROSS: Final = [MOVEMENT.index(name) for name in MOVEMENT if name.endswith("_x") or name == "sideways"]


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rows:
    """N strokes in context, in the frame of a right-handed striker.

    ``codes`` has ``[N]`` codes of each of :data:`SLOTS`; ``area`` is the target area (see the module), -1 where no landing was
    recorded; ``hands`` is 1 where the receiver has the other hand. The first stroke of a rally is a serve, so it is neither an
    attack nor a net shot even where its row was dropped.
    """

    codes: dict[str, I16]
    outcome: I8  # [N] index into the schema's OUTCOMES
    reason: I8  # [N] index into REASONS
    landed: I16  # [N] recorded area as a right-handed receiver sees it, -1 where none was recorded
    next_contact: I8  # [N] contact height of the next stroke, -1 without one
    match: I32  # [N] index into `matches`
    matches: tuple[str, ...]  # names of the matches
    striker: npt.NDArray[np.str_]  # [N] identifier
    receiver: npt.NDArray[np.str_]  # [N] identifier
    stroke: I16  # [N] number of the stroke in its rally, from 1
    points: I8  # [N, 2] points of striker and receiver before the rally, -1 where they are not known
    attacks: I16  # [N] previous attacks (smashes, half-smashes) of the striker in the rally; -1 where a dropped row may be one
    opponent_attacks: I16  # [N] those of the receiver
    net_run: I16  # [N] consecutive net shots up to the incoming stroke; -1 where a dropped row may have been the first
    movement: F32  # [N, 15] `MOVEMENT`; NaN where a part is unknown, and for serves
    hurried: I8  # [N] whether the striker was hurried, -1 where that is not known; `codes` then have 0
    next_hurried: I8  # [N] that of the next stroke, -1 without one
    waiting: F32  # [N, 2] where the receiver stood [m]: to the forehand side of the middle line, and from the net; NaN: unknown
    meeting: F32  # [N, 2] where they met the shuttle [m], likewise
    hand: I8  # [N] index into `HANDS`, -1 unknown, which counts as right
    receiver_hand: I8  # [N] likewise

    def __len__(self) -> int:
        return len(self.outcome)

    def take(self, which: npt.NDArray[np.integer | np.bool_]) -> "Rows":
        """Rows by index or mask."""
        arrays = {f.name: getattr(self, f.name)[which] for f in dataclasses.fields(self) if f.name not in ("codes", "matches")}
        return Rows(codes={name: code[which] for name, code in self.codes.items()}, matches=self.matches, **arrays)

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """Concatenation of several tables, whose matches are different even if their names are equal."""
        starts = np.cumsum([0, *(len(part.matches) for part in parts)])
        names = [f.name for f in dataclasses.fields(cls) if f.name not in ("codes", "match", "matches")]
        return cls(
            codes={name: np.concatenate([part.codes[name] for part in parts]) for name in parts[0].codes},
            match=np.concatenate([part.match + np.int32(first) for part, first in zip(parts, starts, strict=False)]),
            matches=tuple(name for part in parts for name in part.matches),
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        )

    def in_matches(self, names: Sequence[str]) -> "Rows":
        """Rows of the named matches."""
        wanted = np.isin(np.array(self.matches), np.array(list(names)))
        return self.take(wanted[self.match])

    def count(self, *names: str) -> I64:
        """Number of rows with each combination of codes, a dimension for each name."""
        sizes = [SLOTS[name] for name in names]
        cell = np.ravel_multi_index([self.codes[name] for name in names], sizes)
        return np.bincount(cell, minlength=math.prod(sizes)).reshape(sizes)

    def with_area(self, area: int | Ints) -> dict[str, I16]:
        """The codes with another target area."""
        return {**self.codes, "area": np.broadcast_to(np.asarray(area, dtype=np.int16), (len(self),))}

    def marked(self, bits: I8) -> "Rows":
        """Rows in playing order, with whether the striker was hurried where the table does not know it; ``bits``: ``[N]`` 1 where
        they were, 0 where not, -1 where that is not known."""
        hurried = np.where(self.hurried < 0, bits, self.hurried).astype(np.int8)
        following = np.where(self.next_contact >= 0, np.append(hurried[1:], np.int8(-1)), -1).astype(np.int8)
        codes = {**self.codes, "hurried": np.maximum(hurried, 0).astype(np.int16)}
        return dataclasses.replace(self, codes=codes, hurried=hurried, next_hurried=following)

    @property
    def tracked(self) -> Bools:
        """``[N]`` whether positions and times are known."""
        return np.asarray(np.isfinite(self.movement).all(axis=1))

    @functools.cached_property
    def game_codes(self) -> dict[str, I16]:
        """The codes with areas as a game names them: as a right-handed receiver sees them."""
        of_receiver = {name: mirrored_where(self.codes["hands"] == 1, self.codes[name]) for name in ("own_area", "area")}
        return {**self.codes, **of_receiver}


def mirrored_where(left: Bools, area: I16) -> I16:
    """``[N]`` areas with right and left exchanged in some rows; other codes than those of areas stay."""
    return np.where(left & (area >= 0) & (area < N_AREAS), mirrored(area), area).astype(np.int16)


def rows_from_strokes(strokes: pa.Table) -> Rows:
    """Rows of a cleaned table, in its order (schema: :mod:`shuttle_marl.data.schema`). The target areas of annotated winners and
    out strokes depend on the other strokes of the table. Whether strikers were hurried stays unknown where the table does not
    know it; see :func:`shuttle_marl.dynamics.features.marked_rows`."""
    column = {
        name: strokes[name].to_numpy(zero_copy_only=False)
        for name in ("game", "rally", "stroke", "shot", "height", "technique", "outcome", "reason")
    }
    area = _target_areas(strokes)
    encoded = strokes["match"].combine_chunks().dictionary_encode()
    match = encoded.indices.to_numpy().astype(np.int32)
    key = np.stack([match, column["game"], column["rally"]])
    number = column["stroke"].astype(np.int16)
    codes: dict[str, I16] = {}
    for lag, name in ((1, "incoming"), (2, "own")):
        before, known = _lagged(key, number, lag)
        for attribute, size in _BEFORE.items():
            values = area if attribute == "area" else column[attribute]
            unknown, none = size - 1, size - 2
            code = np.where(known, values[before], np.where(number <= lag, none, unknown))
            codes[f"{name}_{attribute}"] = np.where(code < 0, unknown, code).astype(np.int16)
    after, follows = _lagged(key, number, -1)
    attacks, opponent_attacks, net_run = _counts(key, number, column["shot"])
    returned = column["outcome"] == Outcome.RETURNED
    codes["contact"] = column["height"].astype(np.int16)
    codes["discipline"] = (strokes["discipline"].to_numpy(zero_copy_only=False) == "WS").astype(np.int16)
    codes["shot"] = column["shot"].astype(np.int16)
    codes["technique"] = column["technique"].astype(np.int16)
    codes["area"] = area
    codes["hurried"] = np.zeros(len(match), dtype=np.int16)
    unmarked = np.full(len(match), -1, dtype=np.int8)
    striker, receiver = (strokes[name].to_numpy(zero_copy_only=False).astype(str) for name in ("player", "opponent"))
    hand = strokes["hand"].fill_null(-1).to_numpy().astype(np.int8)
    receiver_hand = receiver_hands(strokes)
    left, movement = hand == 1, _movement(strokes, key, number)
    codes["hands"] = (left != (receiver_hand == 1)).astype(np.int16)
    for name in ("own_area", "incoming_area", "area"):
        codes[name] = mirrored_where(left, codes[name])
    movement[np.ix_(left, _ACROSS)] *= -1
    waiting, meeting = _receiver_places(strokes, receiver_hand == 1, after, follows & returned)
    return Rows(
        codes=codes,
        outcome=column["outcome"].astype(np.int8),
        reason=column["reason"].astype(np.int8),
        landed=mirrored_where(receiver_hand == 1, strokes["area"].fill_null(-1).to_numpy().astype(np.int16)),
        next_contact=np.where(follows & returned, column["height"][after], -1).astype(np.int8),
        match=match,
        matches=tuple(encoded.dictionary.to_pylist()),
        striker=striker,
        receiver=receiver,
        stroke=number,
        points=_points(strokes, key, number),
        attacks=attacks,
        opponent_attacks=opponent_attacks,
        net_run=net_run,
        movement=movement,
        hurried=strokes["hurried"].cast(pa.int8()).fill_null(-1).to_numpy(),
        next_hurried=unmarked,
        waiting=waiting,
        meeting=meeting,
        hand=hand,
        receiver_hand=receiver_hand,
    ).marked(np.where(number == 1, 0, unmarked).astype(np.int8))


def _points(strokes: pa.Table, key: Ints, number: I16) -> I8:
    after = np.stack([strokes[name].fill_null(-1).to_numpy() for name in ("points", "points_opponent")], axis=1)
    ends = np.flatnonzero(np.r_[(np.diff(key, axis=1) != 0).any(axis=0), True])
    last = ends[np.searchsorted(ends, np.arange(len(number)))]
    outcome = strokes["outcome"].to_numpy()[last]
    won = (outcome == Outcome.WINNER) ^ ((number[last] - number) % 2 == 1)
    known = np.isin(outcome, (Outcome.WINNER, Outcome.FAULT)) & (after >= 0).all(axis=1)
    return np.where(known[:, None], after - np.stack([won, ~won], axis=1), -1).astype(np.int8)


def _movement(strokes: pa.Table, key: Ints, number: I16) -> F32:
    names = [f"{who}_{axis}" for who in ("contact", "striker", "receiver") for axis in "xy"]
    x = {name: strokes[name].to_numpy().astype(np.float64) for name in names}
    frame, clock = (strokes[name].cast(pa.float64()).to_numpy(zero_copy_only=False) for name in ("frame", "clock"))
    rate = _frame_rates(key[0], frame, clock)[key[0]]
    time = np.where(np.isnan(rate), clock, frame / rate)
    (last, answers), (first, earlier) = (_lagged(key, number, lag) for lag in (1, 2))
    own_x, own_y = (np.where(answers, -x[f"receiver_{axis}"][last], np.nan) for axis in "xy")
    served = np.isnan(x["contact_x"])
    struck = {axis: np.where(served, x[f"striker_{axis}"], x[f"contact_{axis}"]) for axis in "xy"}
    forward, sideways = x["striker_y"] - own_y, x["striker_x"] - own_x
    moved, since = np.hypot(forward, sideways), np.where(answers, time - time[last], np.nan)
    before = np.where(number == 2, 0.0, np.where(earlier, time[last] - time[first], np.nan))
    parts = {
        **{name: x[name] for name in names[:4]},
        "reach": np.hypot(x["contact_x"] - x["striker_x"], x["contact_y"] - x["striker_y"]),
        "moved": moved,
        "forward": forward,
        "sideways": sideways,
        "speed": moved / np.maximum(since, _SHORTEST),
        "since": since,
        "before": before,
        "own_x": own_x,
        "own_y": own_y,
        **{f"opponent_{axis}": np.where(answers, -struck[axis][last], np.nan) for axis in "xy"},
    }
    return np.stack([parts[name] for name in MOVEMENT], axis=1).astype(np.float32)


def _receiver_places(strokes: pa.Table, left: Bools, after: Ints, returned: Bools) -> tuple[F32, F32]:
    """:attr:`Rows.waiting` and :attr:`Rows.meeting` of each stroke; ``left``: ``[N]`` whether the receiver is left-handed;
    ``after``: ``[N]`` row of the next stroke, of those that were ``returned``."""
    at = {f"{who}_{axis}": strokes[f"{who}_{axis}"].to_numpy() for who in ("contact", "receiver") for axis in "xy"}
    # The receiver looks the other way: the striker's right is their left.
    waiting = np.stack([-at["receiver_x"], at["receiver_y"]], axis=1)
    meeting = np.where(returned[:, None], np.stack([at["contact_x"], -at["contact_y"]], axis=1)[after], np.float32("nan"))
    for places in (waiting, meeting):
        places[left, 0] *= -1
    return waiting, meeting


def _frame_rates(match: Ints, frame: F64, clock: F64) -> F64:
    """``[matches]`` frames per second: the slope of frames over seconds; NaN where that is no rate of a video."""
    size, known = int(match.max(initial=-1)) + 1, ~np.isnan(frame) & ~np.isnan(clock)
    of, x, y = match[known], clock[known], frame[known]
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = (part - (np.bincount(of, part, size) / np.bincount(of, minlength=size))[of] for part in (x, y))
        rates = np.bincount(of, x * y, size) / np.bincount(of, x * x, size)
        return np.where((rates >= _RATES[0]) & (rates <= _RATES[1]), rates, np.nan)


def _target_areas(strokes: pa.Table) -> I16:
    recorded = strokes["area"].fill_null(-1).to_numpy().astype(np.int16)
    outcome, reason, shot, height = (strokes[name].to_numpy() for name in ("outcome", "reason", "shot", "height"))
    x = {name: strokes[f"{name}_x"].to_numpy().astype(np.float64) for name in ("landing", "contact", "striker")}
    y = {name: strokes[f"{name}_y"].to_numpy().astype(np.float64) for name in x}
    winner = outcome == Outcome.WINNER
    out = (outcome == Outcome.FAULT) & (reason == REASONS.index("out"))
    annotated = strokes["source"].to_numpy(zero_copy_only=False) != "simulated"
    # The other faults fell short of any target.
    usable = annotated & (winner | out | (outcome == Outcome.RETURNED))
    landing = np.where(usable[:, None], np.stack([x["landing"], y["landing"]], axis=1), np.nan)
    has_contact = ~np.isnan(x["contact"])
    start = np.stack([np.where(has_contact, at["contact"], at["striker"]) for at in (x, y)], axis=1)
    has_landing = ~np.isnan(landing).any(axis=1)
    target = target_points(landing, start, shot, height, winner & has_landing, out & has_landing)
    moved = (winner | out) & ~np.isnan(target[:, 1])
    return np.where(moved, area_of(*target.T), recorded).astype(np.int16)


def target_points(landing: F64, start: F64, shot: Ints, height: Ints, winner: Bools, out: Bools) -> F64:
    """Points ``[N, 2]`` [m] at which a receiver met the shuttle, or would have met that of winners and out strokes.

    Args:
        landing: ``[N, 2]`` recorded landing points [m] in the striker's frame; NaN where there is none, or where it is
            unrelated to the target.
        start: ``[N, 2]`` start of the flight [m]; landings of flights with NaN move straight ahead.
        shot, height: ``[N]`` shot type and contact height.
        winner: ``[N]`` strokes that fell to the floor in court.
        out: ``[N]`` strokes that fell to the floor out of court. All others with a landing were returned.
    """
    depth = landing[:, 1]
    moved = depth.copy()
    returned = ~winner & ~out & ~np.isnan(depth)
    for shot_type in range(N_SHOTS):
        for level in (0, 1):
            here = (shot == shot_type) & (height == level)
            for group in (here, shot == shot_type):
                winners, returns = np.sort(depth[group & winner]), np.sort(depth[group & returned])
                if min(len(winners), len(returns)) >= MIN_LANDINGS:
                    moved[here & winner] = np.quantile(returns, _ranks(winners, depth[here & winner]))
                    break
            returns = depth[here & returned]
            if len(returns) >= MIN_LANDINGS:
                moved[here & out] = np.minimum(depth[here & out], np.quantile(returns, MAX_DEPTH_QUANTILE))
    along = (moved - start[:, 1]) / (depth - start[:, 1])
    sideways = np.where(np.isnan(along), landing[:, 0], start[:, 0] + along * (landing[:, 0] - start[:, 0]))
    return np.stack([np.where(moved == depth, landing[:, 0], sideways), moved], axis=1)


def _ranks(ordered: F64, values: F64) -> F64:
    """Relative mid-ranks of values in a sorted sample, never 0 or 1."""
    rank = 0.5 * (np.searchsorted(ordered, values) + np.searchsorted(ordered, values, side="right")) / len(ordered)
    return np.clip(rank, 0.5 / len(ordered), 1 - 0.5 / len(ordered))


def _counts(key: Ints, number: I16, shot: Ints) -> tuple[I16, I16, I16]:
    """``[N]`` each: previous attacks of the striker, of the receiver, and consecutive net shots before each stroke; ``key``:
    ``[K, N]`` match, game and rally of each stroke, in playing order; ``number``: ``[N]`` its number in the rally, from 1."""
    own, other, run = (np.zeros(len(number), dtype=np.int16) for _ in range(3))
    is_first = np.r_[True, (np.diff(key, axis=1) != 0).any(axis=0)]
    attack, net = ATTACK[shot], NET_SHOT[shot]
    # Attacks of each player by the parity of the stroke number; -1 after a dropped stroke.
    attacks, in_a_row, last = [0, 0], 0, 0
    for row in range(len(number)):
        if is_first[row]:
            attacks, in_a_row, last = [0, 0], 0, 0
        for missing in range(max(last + 1, 2), number[row]):
            attacks[missing % 2], in_a_row = -1, -1
        side, last = number[row] % 2, int(number[row])
        own[row], other[row], run[row] = attacks[side], attacks[1 - side], in_a_row
        if attacks[side] >= 0:
            attacks[side] += int(attack[row])
        # Any other stroke resets the count, even after a dropped one.
        in_a_row = in_a_row + 1 if net[row] and in_a_row >= 0 else (in_a_row if net[row] else 0)
    return own, other, run


def _lagged(key: Ints, number: I16, lag: int) -> tuple[I64, Bools]:
    """``[N]`` row ``lag`` rows before (negative: after) each row, -1 outside the table, and whether it is the stroke so much
    earlier in the rally; ``key``: ``[3, N]`` match, game and rally of each stroke; ``number``: ``[N]`` its number in the
    rally."""
    row = np.arange(len(number)) - lag
    row = np.where((row >= 0) & (row < len(number)), row, -1)
    return row, np.asarray((row >= 0) & (key[:, row] == key).all(axis=0) & (number - number[row] == lag))


_CODES: Final = ("incoming_shot", "incoming_technique", "contact")


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Hurry:
    """Index of hurried strikers: K forests of T trees with M nodes each, and the thresholds. Node m of a tree tests one input of
    a row (:meth:`inputs`), and sends the row to its first child where that is at most the cut: to a later node, or to leaf -1 -
    child."""

    matches: tuple[str, ...]  # names of the matches of the fit; the k-th belongs to fold `fold[k]`
    fold: I32  # [matches] forest that was not fitted to each match; the last forest was fitted to all
    attribute: I32  # [K, T, M] input that a node tests
    cut: F64  # [K, T, M] its threshold
    child: I32  # [K, T, M, 2] children
    value: F64  # [K, T, M + 1] leaves
    threshold: F64  # [15, 2] index below which a striker is hurried, by code of the incoming shot type and contact height

    def index(self, rows: Rows) -> F64:
        """``[N]`` index of each stroke, the lower the more hurried; NaN where a position or time is unknown."""
        known, inputs, index = rows.tracked, self.inputs(rows), np.full(len(rows), np.nan)
        of_name = dict(zip(self.matches, self.fold.tolist(), strict=True))
        forest = np.array([of_name.get(name, len(self.value) - 1) for name in rows.matches], dtype=np.int64)[rows.match]
        for k in np.unique(forest[known]).tolist():
            those = known & (forest == k)
            index[those] = _sums(inputs[those], self.attribute[k], self.cut[k], self.child[k], self.value[k])
        return index

    @staticmethod
    def inputs(rows: Rows) -> F64:
        """``[N, 18]`` inputs of the trees: incoming shot type and technique, contact, :data:`MOVEMENT`."""
        codes = [rows.codes[name][:, None] for name in _CODES]
        return np.concatenate([*codes, rows.movement], axis=1).astype(np.float64)

    def bits(self, rows: Rows) -> I8:
        """``[N]`` 1 where the striker is hurried, 0 where not, -1 where a position or time is unknown."""
        index = self.index(rows)
        late = index < self.threshold[rows.codes["incoming_shot"], rows.codes["contact"]]
        return np.where(np.isnan(index), -1, late).astype(np.int8)

    def marked(self, rows: Rows) -> Rows:
        """Rows in playing order, with whether the striker was hurried where the table does not know it."""
        return rows.marked(self.bits(rows))

    def save(self, path: Path) -> None:
        """Write the index to a file, in a model folder :data:`~shuttle_marl.game.shipped.HURRY`."""
        arrays = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "matches"}
        replace_file(path, tensor_bytes(arrays, {"matches": json.dumps(self.matches)}, pack=True))

    @classmethod
    def checked(cls, tensors: Tensors) -> Self:
        """An index from the content of a file. Raises KeyError, TypeError, ValueError: a part is missing or invalid."""
        header, arrays = tensors
        forests, trees, nodes = arrays["attribute"].shape
        matches = tuple(map(str, parsed(header["matches"])))
        found = cls(
            matches=matches,
            fold=checked(arrays["fold"], np.int32, (len(matches),)),
            attribute=checked(arrays["attribute"], np.int32, (forests, trees, nodes)),
            cut=checked(arrays["cut"], np.float64, (forests, trees, nodes)),
            child=checked(arrays["child"], np.int32, (forests, trees, nodes, 2)),
            value=checked(arrays["value"], np.float64, (forests, trees, nodes + 1)),
            threshold=checked(arrays["threshold"], np.float64, (SLOTS["incoming_shot"], SLOTS["contact"])),
        )
        check_nodes(found.attribute, found.child, len(_CODES) + len(MOVEMENT))
        if not ((found.fold >= 0) & (found.fold < forests)).all():
            raise ValueError("an unknown fold")
        return found


def load_hurry(folder: Path) -> Hurry | None:
    """Read the index of a model folder; None if the model has none. Raises ShuttleError: the file differs from the model card, or
    is invalid. Raises GameError: the model card cannot be read."""
    if not (folder / HURRY).is_file():
        return None
    with readable(folder, HURRY, "index of hurried strikers", ShuttleError) as tensors:
        return Hurry.checked(tensors)


def hurry_of(game: Game) -> Hurry | None:
    """The index of the model that a game belongs to, read by :func:`load_hurry`; None if there is none."""
    folder = folder_of(game)
    return None if folder is None else load_hurry(folder)


def marked_rows(strokes: pa.Table, hurry: Hurry | None) -> Rows:
    """As :func:`rows_from_strokes`; the index decides who was hurried where the table does not know it (None: nothing does)."""
    rows = rows_from_strokes(strokes)
    return rows if hurry is None else hurry.marked(rows)


@compiled
def _sums(inputs: F64, attribute: I32, cut: F64, child: I32, value: F64) -> F64:
    out = np.zeros(len(inputs))
    for row in range(len(inputs)):
        for tree in range(len(attribute)):
            node = 0
            while node >= 0:
                first = inputs[row, attribute[tree, node]] <= cut[tree, node]
                node = child[tree, node, 0 if first else 1]
            out[row] += value[tree, -1 - node]
    return out


def check_nodes(attribute: I32, child: I32, inputs: int) -> None:
    """Check that nodes ``[..., M]`` test one of the inputs, and have later nodes or leaves as children. Raises ValueError: one
    does not."""
    nodes = attribute.shape[-1]
    if not attribute.size:
        raise ValueError("trees without a node")
    later, leaf = (child > np.arange(nodes)[:, None]) & (child < nodes), (child < 0) & (child >= -1 - nodes)
    if not (((attribute >= 0) & (attribute < inputs)).all() and (later | leaf).all()):
        raise ValueError("a node of a tree has an unknown attribute, or an unknown or earlier child")
