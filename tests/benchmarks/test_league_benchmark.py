"""The benchmark of tournaments."""

import json

import pytest

from benchmarks.league import benchmark


@pytest.mark.slow
def test_the_quick_benchmark_measures_everything(capsys: pytest.CaptureFixture[str]) -> None:
    benchmark(quick=True, json_output=True)
    found = json.loads(capsys.readouterr().out)
    assert found["exact"]["pairs_per_s"] > 0
    assert [(case["pool"], case["workers"]) for case in found["sampled"]] == [(3, 1), (3, 2), (6, 1), (6, 2)]
    assert [case["matches"] for case in found["sampled"]] == [30, 30, 150, 150]
    assert all(case["matches_per_s"] > 0 and case["memory_mib"] > 50 for case in found["sampled"])
