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
import math
from typing import Final

import numpy as np
import pyarrow as pa

from shuttle_marl.base.arrays import I64, Bools
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
    row, *codes = _replies(strokes, encoded.indices.to_numpy().astype(np.int64))
    shape = (len(names), N_SHOTS, 2 * N_AREAS, N_AREAS + 1, N_SHOTS)
    count = np.bincount(np.ravel_multi_index(codes, shape), minlength=math.prod(shape)).reshape(shape)
    meaning = np.broadcast_to(np.arange(N_SHOTS, dtype=np.int8), (len(names), N_SHOTS, N_SHOTS)).copy()
    found: list[Convention] = []
    for incoming in range(N_SHOTS):
        replies = count[:, incoming]
        while farthest := _farthest(replies, training):
            at, given, meant, labelled, both, expected, distance = farthest
            found.append(
                Convention(
                    match=names[at], incoming=SHOTS[incoming], given=SHOTS[given], meant=SHOTS[meant],
                    strokes=labelled, of=both, expected=expected, distance=distance,
                )
            )  # fmt: skip
            replies[at, ..., meant] += replies[at, ..., given]
            replies[at, ..., given] = 0
            meaning[at, incoming][meaning[at, incoming] == given] = meant
    shot = strokes["shot"].to_numpy().copy()
    shot[row] = meaning[codes[0], codes[1], codes[-1]]
    position = strokes.schema.get_field_index("shot")
    return strokes.set_column(position, strokes.schema.field(position), pa.array(shot)), found


def _replies(strokes: pa.Table, match: I64) -> tuple[I64, ...]:
    """Row, match, incoming shot type, area and height of the contact, landing area (9: not recorded) and label of each reply."""
    game, rally, number, shot, height = (strokes[name].to_numpy() for name in ("game", "rally", "stroke", "shot", "height"))
    area = strokes["area"].fill_null(N_AREAS).to_numpy().astype(np.int64)
    same = np.diff(np.stack([match, game, rally]), axis=1) == 0
    row = np.flatnonzero(same.all(axis=0) & (np.diff(number) == 1)) + 1
    row = row[area[row - 1] < N_AREAS]
    return row, match[row], shot[row - 1], area[row - 1] * 2 + height[row], area[row], shot[row]


def _farthest(count: I64, training: Bools) -> tuple[int, int, int, int, int, float, float] | None:
    """The convention of the largest distance in the replies to a shot type; None without one.

    Args:
        count: ``[matches, contacts, landings, labels]`` replies.

    Returns:
        Match, label in it and that of the others, strokes of the one and of both, expected share, and distance.
    """
    count = count[..., N_SERVES:]
    at = np.moveaxis(count.sum(axis=2), 1, 2)
    labelled, both = at[:, :, None], at[:, :, None] + at[:, None]  # [matches, given, meant, contacts]
    strokes, of = np.broadcast_to(labelled.sum(axis=3), both.shape[:3]), both.sum(axis=3)
    usual = training[:, None, None] & (of >= LEAST)
    comparable = (usual.sum(axis=0) >= LEAST_MATCHES) & ~np.eye(count.shape[3], dtype=bool)
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
    fits = fits & (of >= LEAST) & (distance >= FAR) & (expected <= RARE) & (strokes / np.maximum(of, 1) - expected >= EXCESS)
    if not fits.any():
        return None
    given, match = np.unravel_index(np.where(fits, distance, -np.inf).argmax(), fits.shape)
    share, far = float(expected[given, match]), float(distance[given, match])
    label = N_SERVES + int(given), N_SERVES + int(best[match, given, 0])
    return int(match), *label, int(strokes[given, match]), int(of[given, match]), share, far
