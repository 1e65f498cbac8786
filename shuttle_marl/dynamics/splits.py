"""Splits of the matches: for training and for validation, those that are enough for a fit, and resamples of them."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import content_hash
from shuttle_marl.data.upstream import Split, matches_of, split_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS

MIN_MATCHES_FOR_REFITS: Final = 6
"""Training matches of refits: most resamples of fewer contain only half of them."""
MIN_STROKES: Final = 1000
"""Training strokes of a fit without prior: some nine for each shot type and area."""
MIN_STROKES_WITH_PRIOR: Final = 300
"""Training strokes of a fit with prior: some twenty faults."""
MIN_MATCHES: Final = 2
"""Training matches: members of an ensemble leave one out."""


def rows_of(rows: Rows, split: Split) -> Rows:
    """Strokes of a split of the published matches.

    Raises:
        ShuttleError: the data contain none of its matches.
    """
    chosen = rows.in_matches(matches_of(split))
    if not len(chosen):
        raise ShuttleError(f"no match of the split {split!r} in the data; is the download complete?")
    return chosen


def train_and_validation(rows: Rows, share: float | None) -> tuple[Rows, Rows]:
    """Split rows by match into training and validation.

    Args:
        share: fraction of the unpublished matches for validation, at least one and not all, in the order of the SHA-256 of their
            names; None: all matches are published ones, whose split is fixed.

    Raises:
        ShuttleError: an invalid share, a share without unpublished matches or vice versa, or an empty split.
    """
    names = [rows.matches[i] for i in np.unique(rows.match)]
    own = sorted((name for name in names if split_of(name) is None), key=lambda name: content_hash(name.encode()))
    if share is None:
        if own:
            raise ShuttleError(
                f"{own[0]!r} is no published match, so it has no fixed split: "
                "--validation-share 0.2 takes a fifth of your matches to check the fit"
            )
        return rows_of(rows, "train"), rows_of(rows, "validation")
    if not 0 < share < 1:
        raise ShuttleError(f"--validation-share {share:g}: expected a number between 0 and 1, such as 0.2")
    if not own:
        raise ShuttleError("--validation-share: all matches are published ones, whose split is fixed; omit it")
    aside = min(max(1, math.ceil(round(share * len(own), 9))), len(own) - 1)
    validation = rows.in_matches([*own[:aside], *matches_of("validation")])
    train = rows.in_matches([*own[aside:], *matches_of("train")])
    return train, validation


def require_enough(train: Rows, validation: Rows, *, prior: bool) -> None:
    """Refuse too little data.

    Args:
        prior: whether the fit corrects a model.

    Raises:
        ShuttleError: too few matches or strokes; with the required number and the reason.
    """
    matches, needed = len(np.unique(train.match)), 1 if prior else MIN_MATCHES
    if matches < needed or not len(validation):
        raise ShuttleError(
            f"number of matches: {matches + len(np.unique(validation.match))}; a model needs {needed + 1} or more, one of them "
            f"to check the fit{'' if prior else ' and one that parts of the models leave out'}; reports need one, and no model"
        )
    least = MIN_STROKES_WITH_PRIOR if prior else MIN_STROKES
    if len(train) < least:
        kinds = N_SHOTS * N_AREAS
        reason = (
            "fewer contain less than twenty faults to correct the model by"
            if prior
            else f"fewer are less than nine for each of the {kinds} kinds of stroke (shot type and area), too few to "
            f"estimate rates; --prior default needs {MIN_STROKES_WITH_PRIOR}, because it corrects the shipped models instead"
        )
        raise ShuttleError(f"{len(train)} strokes in {matches} train matches, at least {least} needed: {reason}")


def resampled(rows: Rows, seed: Sequence[int]) -> Rows:
    """Bootstrap resample of the matches, by discipline.

    Copies of a match have the same number, so networks that leave it out leave out all copies.
    """
    rng = np.random.default_rng(seed)
    matches, first = np.unique(rows.match, return_index=True)
    discipline = rows.codes["discipline"][first]
    names = [rng.choice(matches[discipline == kind], (discipline == kind).sum()) for kind in np.unique(discipline)]
    return rows.take(np.concatenate([np.flatnonzero(rows.match == match) for match in np.sort(np.concatenate(names))]))
