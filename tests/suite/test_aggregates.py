"""Aggregates of the suite: means over cases, interquartile means over seeds, worst cases, and intervals that cover."""

import numpy as np
import pytest

from shuttle_marl.suite.results import Bounds, aggregate


@pytest.mark.parametrize(("cases", "seeds", "covered"), [(1, 3, 0.76), (1, 8, 0.93), (3, 8, 0.95)])
def test_intervals_cover(cases: int, seeds: int, covered: float) -> None:
    rng = np.random.default_rng(cases * seeds)
    samples = rng.normal(size=(400, cases, seeds)) * np.linspace(0.5, 1.5, cases)[:, None]
    found = [aggregate({str(i): {str(i): case} for i, case in enumerate(sample.tolist())}) for sample in samples]
    assert np.mean([each["low"] <= 0 <= each["high"] for each in found if each["low"] is not None]) == pytest.approx(
        covered, abs=0.04
    )


def test_intervals_are_those_of_rliable() -> None:
    """``get_interval_estimates`` of rliable 1.2.0, with 100,000 resamples, for ``trim_mean(runs, 0.25, axis=0).mean()``."""
    samples = np.random.default_rng(0).normal(size=(3, 8))
    found = aggregate({str(i): {str(i): case} for i, case in enumerate(samples.tolist())})
    assert (found["value"], found["low"], found["high"]) == pytest.approx((-0.14618618, -0.42828627, 0.20256395), abs=0.01)


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
    # The mean of four draws from 0 to 3 has the standard deviation .56.
    assert (found["value"], found["low"], found["high"]) == pytest.approx((1.5, 0.5, 2.5), abs=0.3)
    # Strata count as often as they have cases.
    assert aggregate({"a": {"1": [0.0], "2": [0.0], "3": [0.0]}, "b": {"4": [1.0], "5": [1.0]}})["value"] == pytest.approx(0.4)
