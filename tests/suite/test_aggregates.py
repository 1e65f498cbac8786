"""Aggregates of the suite: means over cases, interquartile means over seeds, worst cases, and intervals that cover."""

import numpy as np
import pytest

from shuttle_marl.base.intervals import combined, estimate
from shuttle_marl.suite.results import Bounds, aggregate


@pytest.mark.parametrize(("cases", "seeds", "trimmed"), [(1, 3, False), (1, 5, True), (5, 5, True), (11, 5, False)])
def test_intervals_cover_in_95_percent(cases: int, seeds: int, trimmed: bool) -> None:
    rng = np.random.default_rng(cases * seeds + trimmed)
    runs = rng.normal(size=(3000, cases, seeds)) * np.linspace(0.5, 1.5, cases)[:, None]
    found = [combined([estimate(case, trimmed=trimmed) for case in run], [1.0] * cases) for run in runs]
    covered = np.mean([each.low <= 0 <= each.high for each in found])
    assert 0.925 < covered < 0.975
    if not trimmed and cases == 1:  # exact: Student's t
        assert covered == pytest.approx(0.95, abs=0.012)


def test_a_case_that_is_lost_is_not_left_out() -> None:
    whole = {f"case {i}": {f"case {i}": [1.0, 1.0, 1.0, 1.0, 1.0]} for i in range(5)}
    assert aggregate(whole) == {"value": 1, "low": 1, "high": 1}
    assert aggregate({**whole, "case 0": {"case 0": [0.0] * 5}})["value"] == pytest.approx(0.8)
    # A single bad seed of a case is.
    assert aggregate({**whole, "case 0": {"case 0": [0.0, 1.0, 1.0, 1.0, 1.0]}})["value"] == 1
    bounds: Bounds = aggregate({"case": {"case": [0.5]}})
    assert (bounds["value"], bounds["low"], bounds["high"]) == (0.5, None, None)


def test_exchangeable_cases_are_the_sample_of_their_stratum() -> None:
    found = aggregate({"family": {str(i): [float(i), float(i)] for i in range(4)}})
    plain = combined([estimate([0.0, 1.0, 2.0, 3.0], trimmed=False)], [1])
    assert (found["value"], found["low"], found["high"]) == pytest.approx(tuple(plain))
    # Strata count as often as they have cases.
    assert aggregate({"a": {"1": [0.0], "2": [0.0], "3": [0.0]}, "b": {"4": [1.0], "5": [1.0]}})["value"] == pytest.approx(0.4)
