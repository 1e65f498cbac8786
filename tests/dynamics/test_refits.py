"""A whole model made by the command: profiles, refits, card; and resampled matches."""

import numpy as np

from shuttle_marl.data import load_strokes
from shuttle_marl.dynamics.features import rows_from_strokes
from shuttle_marl.dynamics.make import resampled
from shuttle_marl.dynamics.network import fold_of_match
from tests.dynamics.test_fitting import SAMPLE


def test_a_resample_has_as_many_matches_of_each_discipline_and_copies_share_a_fold() -> None:
    rows = rows_from_strokes(load_strokes(SAMPLE))
    again = resampled(rows, [0, 1])
    first = [np.unique(part.match, return_index=True)[1] for part in (rows, again)]
    number = len(first[0])
    drawn = np.unique(again.match)
    assert 0.4 * number < len(drawn) < 0.85 * number, "about 63 % of the matches, some of them more than once"
    lengths = np.bincount(rows.match)
    assert (np.bincount(again.match, minlength=len(lengths))[drawn] % lengths[drawn] == 0).all(), "matches are whole"
    women = [np.bincount(part.match[part.codes["discipline"] == 1]) for part in (rows, again)]
    copies = [count[count > 0] / lengths[np.flatnonzero(count)] for count in women]
    assert copies[0].sum() == copies[1].sum()
    fold = fold_of_match(again.match, 5)
    assert all(len(np.unique(fold[again.match == match])) == 1 for match in drawn)
    assert np.array_equal(resampled(rows, [0, 1]).match, again.match)
    assert not np.array_equal(np.unique(resampled(rows, [0, 2]).match), drawn)
