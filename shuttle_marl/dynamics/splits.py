"""Train and validation matches: the fixed split of the published ones, a share of one's own; and whether they are enough."""

import hashlib
import math
from typing import Final

import numpy as np

from shuttle_marl.data.upstream import Split, matches_of, split_of
from shuttle_marl.dynamics.features import Rows
from shuttle_marl.errors import ShuttleError
from shuttle_marl.game.court import N_AREAS
from shuttle_marl.game.stroke import N_SHOTS

LEAST_STROKES: Final = 1000
"""Train strokes of a fit from nothing: some nine for each shot type and area."""
LEAST_WITH_PRIOR: Final = 300
"""Train strokes of a fit that starts from a model: some twenty faults."""
LEAST_MATCHES: Final = 2
"""Train matches: members of an ensemble leave one out."""
LEAST_FOR_REFITS: Final = 6
"""Train matches that can be resampled: of fewer, most resamples hold only a half."""


def rows_of(rows: Rows, split: Split) -> Rows:
    """The strokes of a split of the published matches.

    Raises:
        ShuttleError: there are none of its matches.
    """
    chosen = rows.in_matches(matches_of(split))
    if not len(chosen):
        raise ShuttleError(f"no match of the split {split!r} in the data; is the download complete?")
    return chosen


def train_and_validation(rows: Rows, share: float | None) -> tuple[Rows, Rows]:
    """The rows to fit on and those to choose on, by match.

    Args:
        rows: all strokes.
        share: of the matches of no published data set that are for validation: at least one, and not all. They are taken in the
            order of the SHA-256 of their names, so the same names give the same split. None: there are only published matches.

    Raises:
        ShuttleError: a share without such matches or the other way round, a share that is none, or no rows of either kind.
    """
    names = [rows.matches[i] for i in np.unique(rows.match)]
    own = sorted((name for name in names if split_of(name) is None), key=lambda name: hashlib.sha256(name.encode()).hexdigest())
    if share is None:
        if own:
            raise ShuttleError(
                f"{len(own)} matches of no published data set, such as {own[0]!r}, have no fixed split; --validation-share 0.2 "
                "sets a fifth of them aside to choose on"
            )
        return rows_of(rows, "train"), rows_of(rows, "validation")
    if not 0 < share < 1:
        raise ShuttleError(f"--validation-share {share:g}: expected a number between 0 and 1, such as 0.2")
    if not own:
        raise ShuttleError("--validation-share: all matches are published ones, whose split is fixed; leave it out")
    aside = min(max(1, math.ceil(round(share * len(own), 9))), len(own) - 1)
    validation = rows.in_matches([*own[:aside], *matches_of("validation")])
    train = rows.in_matches([*own[aside:], *matches_of("train")])
    return train, validation


def require_enough(train: Rows, validation: Rows, *, prior: bool) -> None:
    """Refuse data that are too few to mean anything.

    Args:
        train: rows to fit on.
        validation: rows to choose on.
        prior: whether the fit starts from a model.

    Raises:
        ShuttleError: says how many are needed, and why.
    """
    matches, needed = len(np.unique(train.match)), 1 if prior else LEAST_MATCHES
    if matches < needed or not len(validation):
        raise ShuttleError(
            f"{matches + len(np.unique(validation.match))} matches: at least {needed + 1} needed, of which one is set aside to "
            "choose on" + ("" if prior else " and parts of the models leave one out")
        )
    least = LEAST_WITH_PRIOR if prior else LEAST_STROKES
    if len(train) < least:
        kinds = N_SHOTS * N_AREAS
        reason = (
            "with fewer there are not twenty faults to correct the model by"
            if prior
            else f"with fewer there are not nine for each of the {kinds} kinds of stroke (shot type and area), and their rates "
            f"are noise; --prior default needs {LEAST_WITH_PRIOR}, because it corrects the shipped models instead"
        )
        raise ShuttleError(f"{len(train)} strokes in {matches} train matches, at least {least} needed: {reason}")
