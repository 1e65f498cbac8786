"""Matches whose annotators gave a stroke another name than all others do, such as "block" for the net reply to a drop.

A *convention* is a label that makes up much of the replies to an incoming shot type in one match, and hardly any of those replies
in the training matches, where another label has them. For every match, incoming shot type, and pair of labels ``given`` and
``meant``, the share of ``given`` among both is compared with the share that the training matches lead to expect in the same
areas and from the same contact heights. A convention has

- at least :data:`LEAST` strokes with one of both labels,
- a share at least :data:`EXCESS` above an expected share of at most :data:`RARE`, and
- a distance from it of :data:`FAR` standard deviations between matches (the scaled median absolute deviation of the training
  matches, and at least that of chance).

``meant`` is the label whose strokes are struck and land most like those of the match. Strokes of a convention count as ``meant``
in the search for the next one. A label that others use often in the same place is never renamed: that would be a guess. A smash
and a half smash, or a push and a lift, are such pairs, in which annotators differ gradually.
"""

import dataclasses
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import F64, I8, I64, Bools
from shuttle_marl.data.upstream import split_of
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SERVES, N_SHOTS, SHOTS

LEAST: Final = 10
EXCESS: Final = 0.25
RARE: Final = 0.2
FAR: Final = 8.0
LEAST_MATCHES: Final = 10
"""Training matches with :data:`LEAST` strokes of a pair, without which nothing is compared."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Convention:
    """Another name for the replies to a shot type in one match.

    Attributes:
        match: name of the match.
        incoming: shot type that is answered.
        given, meant: label in the match, and that of all others.
        strokes: number of strokes with the label ``given``.
        of: number of strokes with either label.
        expected: expected share of ``given`` in them.
        distance: from it, in standard deviations between matches.
    """

    match: str
    incoming: str
    given: str
    meant: str
    strokes: int
    of: int
    expected: float
    distance: float


class _Replies(NamedTuple):
    """N replies."""

    row: I64
    match: I64
    incoming: I8
    shot: I8
    place: I64
    """Area and height of the contact."""
    area: I64
    """Landing area; 9 where none was recorded."""


def with_common_labels(strokes: pa.Table) -> tuple[pa.Table, list[Convention]]:
    """Rename the strokes of all conventions.

    Args:
        strokes: table of schema :data:`shuttle_marl.data.schema.STROKES`, in playing order.

    Returns:
        The table, and the conventions, by incoming shot type and distance. Without enough training matches there are none.
    """
    encoded = strokes["match"].combine_chunks().dictionary_encode()
    names: list[str] = encoded.dictionary.to_pylist()
    training = np.array([split_of(name) == "train" for name in names], dtype=bool)
    replies, found = _replies(strokes, encoded.indices.to_numpy().astype(np.int64)), []
    shot = strokes["shot"].to_numpy().copy()
    for incoming in range(N_SHOTS):
        those = _Replies(*(column[replies.incoming == incoming] for column in replies))
        while here := list(_conventions(those, names, training)):
            found.append(farthest := max(here, key=lambda one: one.distance))
            given, meant = SHOTS.index(farthest.given), SHOTS.index(farthest.meant)
            those.shot[(those.match == names.index(farthest.match)) & (those.shot == given)] = meant
        shot[those.row] = those.shot
    position = strokes.schema.get_field_index("shot")
    return strokes.set_column(position, strokes.schema.field(position), pa.array(shot)), found


def _replies(strokes: pa.Table, match: I64) -> _Replies:
    game, rally, number, shot, height = (strokes[name].to_numpy() for name in ("game", "rally", "stroke", "shot", "height"))
    area = strokes["area"].fill_null(N_AREAS).to_numpy().astype(np.int64)
    same = np.diff(np.stack([match, game, rally]), axis=1) == 0
    row = np.flatnonzero(same.all(axis=0) & (np.diff(number) == 1)) + 1
    row = row[area[row - 1] < N_AREAS]
    return _Replies(row, match[row], shot[row - 1], shot[row], area[row - 1] * 2 + height[row], area[row])


def _conventions(replies: _Replies, matches: list[str], training: Bools) -> Iterator[Convention]:
    """The convention of each match and label that has one, in the replies to a shot type."""
    labels = range(N_SERVES, N_SHOTS)
    for given in labels:
        if np.bincount(replies.match[replies.shot == given], minlength=1).max() < EXCESS * LEAST:
            continue
        found, alike = {}, np.full((N_SHOTS, len(matches)), -np.inf)
        for meant in labels:
            compared = _compared(replies, given, meant, training)
            if given != meant and np.isfinite(compared[-1]).any():
                found[meant], alike[meant] = compared, _likeness(replies, given, meant, training)
        for match in np.flatnonzero(np.isfinite(alike).any(axis=0)).tolist():
            meant = int(alike[:, match].argmax())
            strokes, of, expected, distance = (float(part[match]) for part in found[meant])
            if of >= LEAST and distance >= FAR and expected <= RARE and strokes / of - expected >= EXCESS:
                yield Convention(
                    match=matches[match],
                    incoming=SHOTS[replies.incoming[0]],
                    given=SHOTS[given],
                    meant=SHOTS[meant],
                    strokes=int(strokes),
                    of=int(of),
                    expected=expected,
                    distance=distance,
                )


def _compared(replies: _Replies, given: int, meant: int, training: Bools) -> tuple[F64, F64, F64, F64]:
    """Strokes of one label and of both, expected share and distance from it of each match; NaN without enough to compare."""
    shape = len(training), 2 * N_AREAS
    cell = replies.match * shape[1] + replies.place
    labelled, other = (
        np.bincount(cell[replies.shot == shot], minlength=shape[0] * shape[1]).reshape(shape) for shot in (given, meant)
    )
    both = labelled + other
    strokes, of = labelled.sum(axis=1).astype(np.float64), both.sum(axis=1).astype(np.float64)
    usual = training & (of >= LEAST)
    if usual.sum() < LEAST_MATCHES:
        return strokes, of, *np.full((2, len(training)), np.nan)
    # Of the other training matches; at a place shrunk to the share at all places with the weight of one stroke.
    hits, total = (counts[training].sum(axis=0) - counts * training[:, None] for counts in (labelled, both))
    overall = hits.sum(axis=1, keepdims=True) / np.maximum(total.sum(axis=1, keepdims=True), 1)
    share = (hits + overall) / (total + 1)
    expected, variance = (both * share).sum(axis=1), (both * share * (1 - share)).sum(axis=1)
    error = (strokes - expected) / np.sqrt(np.maximum(variance, 1.0))
    error -= np.median(error[usual])
    spread = max(1.0, 1.4826 * float(np.median(np.abs(error[usual]))))
    return strokes, of, expected / np.maximum(of, 1.0), error / spread


def _likeness(replies: _Replies, given: int, meant: int, training: Bools) -> F64:
    """``[matches]`` log-likelihood of contacts and landings of a label under those of another one in the training matches."""
    place = replies.place * (N_AREAS + 1) + replies.area
    count = np.bincount(place[training[replies.match] & (replies.shot == meant)], minlength=2 * N_AREAS * (N_AREAS + 1)) + 0.1
    those = replies.shot == given
    return np.bincount(replies.match[those], np.log(count / count.sum())[place[those]], len(training)).astype(np.float64)
