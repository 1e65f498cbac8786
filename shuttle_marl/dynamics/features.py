"""Strokes in context, as integer codes: what every model of the game reads.

A stroke is described by its attributes (shot type, area, contact height, technique), and its context by the attributes of
the striker's own last stroke and of the incoming stroke, the contact offered, and the discipline. Two strokes back are
enough for these: more history improves no model on unseen matches. What the rally adds up to beside them, the attacking
strokes that either player has struck and the length of a net duel, moves the probability of a fault alone.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from shuttle_marl.arrays import I8, I16, I32, I64, Ints
from shuttle_marl.data.schema import REASONS, Outcome
from shuttle_marl.dynamics.landings import met_points
from shuttle_marl.game.court import N_AREAS, area_of
from shuttle_marl.game.stroke import ATTACKS, N_SHOTS, N_TECHNIQUES, NET_SHOTS, SHOTS
from shuttle_marl.game.tables import LONGEST_DUEL, Game

DISCIPLINES: Final = ("MS", "WS")

# Of a stroke before: the attribute, "none" (the rally has just begun), or "unknown" (the row was dropped).
_BEFORE: Final = {"shot": N_SHOTS + 2, "area": N_AREAS + 2, "height": 4, "technique": N_TECHNIQUES + 2}
SLOTS: Final[dict[str, int]] = {
    **{f"{stroke}_{attribute}": size for stroke in ("own", "incoming") for attribute, size in _BEFORE.items()},
    "contact": 2,
    "discipline": len(DISCIPLINES),
    "shot": N_SHOTS,
    "technique": N_TECHNIQUES,
    "area": N_AREAS,
}
"""Attributes that a model can read, and how many values each has."""

STATE: Final = tuple(name for name in SLOTS if name not in ("shot", "technique", "area"))
"""The context of a stroke: what the striker knows before choosing."""

ATTACK: Final = np.isin(SHOTS, ATTACKS)
"""``[13]`` whether a shot type is an attack."""
NET_SHOT: Final = np.isin(SHOTS, NET_SHOTS)
"""``[13]`` whether a shot type is a net shot."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Rows:
    """N strokes in context.

    Attributes:
        codes: for each of :data:`SLOTS`, ``[N]`` its code; ``area`` is the one in which a receiver met the
            shuttle or would have met it, -1 where no landing was recorded.
        outcome, reason: ``[N]`` indices into the schema's OUTCOMES and REASONS.
        next_contact: ``[N]`` height from which the next stroke was struck, -1 where there is none.
        match: ``[N]`` index into ``matches``.
        matches: names.
        striker, receiver: ``[N]`` identifiers of the players.
        stroke: ``[N]`` number of the stroke in its rally, from 1.
        attacks, opponent_attacks: ``[N]`` attacks (smashes, half-smashes) of the striker and of the receiver so far in the rally.
        net_run: ``[N]`` net shots in a row that end with the incoming stroke.

    The last three are -1 where a dropped row could have counted: an attack of that player, or a net shot at the head of the
    run. The first stroke of a rally is a serve, so it counts as neither even where its row was dropped.
    """

    codes: dict[str, I16]
    outcome: I8
    reason: I8
    next_contact: I8
    match: I32
    matches: tuple[str, ...]
    striker: npt.NDArray[np.str_]
    receiver: npt.NDArray[np.str_]
    stroke: I16
    attacks: I16
    opponent_attacks: I16
    net_run: I16

    def __len__(self) -> int:
        return len(self.outcome)

    def take(self, which: npt.NDArray[np.integer | np.bool_]) -> "Rows":
        """The rows chosen by an index or a mask."""
        arrays = {f.name: getattr(self, f.name)[which] for f in dataclasses.fields(self) if f.name not in ("codes", "matches")}
        return Rows(codes={name: code[which] for name, code in self.codes.items()}, matches=self.matches, **arrays)

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """The rows of several tables, one after the other; each has matches of its own, whatever their names."""
        starts = np.cumsum([0, *(len(part.matches) for part in parts)])
        names = [f.name for f in dataclasses.fields(cls) if f.name not in ("codes", "match", "matches")]
        return cls(
            codes={name: np.concatenate([part.codes[name] for part in parts]) for name in parts[0].codes},
            match=np.concatenate([part.match + np.int32(first) for part, first in zip(parts, starts, strict=False)]),
            matches=tuple(name for part in parts for name in part.matches),
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in names},
        )

    def in_matches(self, names: Sequence[str]) -> "Rows":
        """The rows of some matches."""
        wanted = np.isin(np.array(self.matches), np.array(list(names)))
        return self.take(wanted[self.match])

    def with_area(self, area: int | Ints) -> dict[str, I16]:
        """The codes, with another intended target."""
        return {**self.codes, "area": np.broadcast_to(np.asarray(area, dtype=np.int16), (len(self),))}

    @functools.cached_property
    def cells(self) -> I64:
        """``[N]`` index of (shot, area, height, technique) of the stroke itself; negative without area."""
        c = {k: v.astype(np.int64) for k, v in self.codes.items()}
        index = ((c["shot"] * N_AREAS + c["area"]) * 2 + c["contact"]) * N_TECHNIQUES + c["technique"]
        return np.where(c["area"] < 0, -1, index)


def rows_from_strokes(strokes: pa.Table) -> Rows:
    """Strokes of a cleaned table in context, in its order (schema: :mod:`shuttle_marl.data.schema`).

    The areas are those in which a receiver met the shuttle or would have met it (:mod:`shuttle_marl.dynamics.landings`), so
    those of annotated winners and out strokes depend on the other strokes of the table.
    """
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
        before = _shift(np.arange(len(match)), lag)
        known = (before >= 0) & (key[:, before] == key).all(axis=0) & (number - number[before] == lag)
        for attribute, size in _BEFORE.items():
            values = area if attribute == "area" else column[attribute]
            unknown, none = size - 1, size - 2
            code = np.where(known, values[before], np.where(number <= lag, none, unknown))
            codes[f"{name}_{attribute}"] = np.where(code < 0, unknown, code).astype(np.int16)
    after = _shift(np.arange(len(match)), -1)
    follows = (after >= 0) & (key[:, after] == key).all(axis=0) & (number[after] - number == 1)
    attacks, opponent_attacks, net_run = _counts(key, number, column["shot"])
    returned = column["outcome"] == Outcome.RETURNED
    codes["contact"] = column["height"].astype(np.int16)
    codes["discipline"] = (strokes["discipline"].to_numpy(zero_copy_only=False) == "WS").astype(np.int16)
    codes["shot"] = column["shot"].astype(np.int16)
    codes["technique"] = column["technique"].astype(np.int16)
    codes["area"] = area
    return Rows(
        codes=codes,
        outcome=column["outcome"].astype(np.int8),
        reason=column["reason"].astype(np.int8),
        next_contact=np.where(follows & returned, column["height"][after], -1).astype(np.int8),
        match=match,
        matches=tuple(encoded.dictionary.to_pylist()),
        striker=strokes["player"].to_numpy(zero_copy_only=False).astype(str),
        receiver=strokes["opponent"].to_numpy(zero_copy_only=False).astype(str),
        stroke=number,
        attacks=attacks,
        opponent_attacks=opponent_attacks,
        net_run=net_run,
    )


def _target_areas(strokes: pa.Table) -> I16:
    """``[N]`` area of each stroke that means the same for every outcome; -1 where no landing was recorded."""
    recorded = strokes["area"].fill_null(-1).to_numpy().astype(np.int16)
    outcome, reason, shot, height = (strokes[name].to_numpy() for name in ("outcome", "reason", "shot", "height"))
    x = {name: strokes[f"{name}_x"].to_numpy().astype(np.float64) for name in ("landing", "contact", "striker")}
    y = {name: strokes[f"{name}_y"].to_numpy().astype(np.float64) for name in x}
    winner = outcome == Outcome.WINNER
    out = (outcome == Outcome.FAULT) & (reason == REASONS.index("out"))
    annotated = strokes["source"].to_numpy(zero_copy_only=False) != "simulated"
    # The other faults fell short, wherever they were aimed.
    told = annotated & (winner | out | (outcome == Outcome.RETURNED))
    landing = np.where(told[:, None], np.stack([x["landing"], y["landing"]], axis=1), np.nan)
    begun = ~np.isnan(x["contact"])
    start = np.stack([np.where(begun, at["contact"], at["striker"]) for at in (x, y)], axis=1)
    fell = ~np.isnan(landing).any(axis=1)
    met = met_points(landing, start, shot, height, winner & fell, out & fell)
    moved = (winner | out) & ~np.isnan(met[:, 1])
    return np.where(moved, area_of(*met.T), recorded).astype(np.int16)


def _counts(key: Ints, number: I16, shot: Ints) -> tuple[I16, I16, I16]:
    """``[N]`` each: attacks of the striker, attacks of the receiver, and net shots in a row, before each stroke.

    Args:
        key: ``[K, N]`` names the rally of each stroke; the strokes of a rally lie next to each other, in playing order.
        number: ``[N]`` number of the stroke in its rally, from 1.
        shot: ``[N]`` shot type.
    """
    own, other, run = (np.zeros(len(number), dtype=np.int16) for _ in range(3))
    begins = np.r_[True, (np.diff(key, axis=1) != 0).any(axis=0)]
    attack, net = ATTACK[shot], NET_SHOT[shot]
    # Attacks of the two players by the parity of their strokes' numbers; -1 from the first dropped stroke on.
    attacks, in_a_row, last = [0, 0], 0, 0
    for row in range(len(number)):
        if begins[row]:
            attacks, in_a_row, last = [0, 0], 0, 0
        for missing in range(max(last + 1, 2), number[row]):
            attacks[missing % 2], in_a_row = -1, -1
        side, last = number[row] % 2, int(number[row])
        own[row], other[row], run[row] = attacks[side], attacks[1 - side], in_a_row
        if attacks[side] >= 0:
            attacks[side] += int(attack[row])
        # A stroke that is no net shot ends the run, whatever was dropped before it.
        in_a_row = in_a_row + 1 if net[row] and in_a_row >= 0 else (in_a_row if net[row] else 0)
    return own, other, run


def strokes_before(rows: Rows, name: str, strokes: Ints, n_strokes: int) -> I64:
    """``[N]`` catalogue index of the stroke before each: n for none yet, -1 where it is not known or not in the catalogue.

    Args:
        rows: N strokes in context.
        name: ``own`` or ``incoming``.
        strokes: ``[13, 9, 2, 3]`` catalogue index by shot type, area, height and technique.
        n_strokes: n, the number of strokes in the catalogue.
    """
    shot, area, height, technique = (
        rows.codes[f"{name}_{part}"].astype(np.int64) for part in ("shot", "area", "height", "technique")
    )
    known = (shot < N_SHOTS) & (area < N_AREAS) & (height < 2) & (technique < N_TECHNIQUES)
    found = np.where(shot == N_SHOTS, n_strokes, -1)
    found[known] = strokes[shot[known], area[known], height[known], technique[known]]
    return found


def states_of(game: Game, rows: Rows, own: Ints, incoming: Ints) -> I64:
    """``[N]`` state in which each stroke was struck, -1 where the game has no such state or what decides it is not known.

    Args:
        game: the tables.
        rows: N strokes in context.
        own, incoming: ``[N]`` catalogue indices of the strokes before each (:func:`strokes_before`).
    """
    duel = np.minimum(rows.net_run, LONGEST_DUEL) if game.counts_duels else 0
    efforts = [np.minimum(count, game.levels - 1) if game.levels > 1 else 0 for count in (rows.attacks, rows.opponent_attacks)]
    return game.state_of(own, incoming, rows.codes["contact"], duel, *efforts).astype(np.int64)


def codes_of_states(game: Game, state: Ints) -> dict[str, I16]:
    """I16 of the context of states, ``[N]`` each; without discipline."""
    catalogue = game.catalogue
    codes: dict[str, I16] = {}
    for name, stroke in (("own", game.own(state)), ("incoming", game.incoming(state))):
        for attribute, size in _BEFORE.items():
            values = np.append(getattr(catalogue, attribute), size - 2)
            codes[f"{name}_{attribute}"] = values[stroke].astype(np.int16)
    codes["contact"] = game.contact(state).astype(np.int16)
    return codes


def codes_of_pairs(game: Game) -> dict[str, I16]:
    """I16 of every base pair of a game, ``[base pairs]`` each; without discipline."""
    codes = codes_of_states(game, game.base_pair_state)
    for attribute in ("shot", "technique", "area"):
        codes[attribute] = getattr(game.catalogue, attribute)[game.base_pair_stroke].astype(np.int16)
    return codes


def _shift(index: I64, lag: int) -> I64:
    """Row ``lag`` rows before each row, -1 where that is outside the table."""
    moved = index - lag
    return np.where((moved >= 0) & (moved < len(index)), moved, -1)
