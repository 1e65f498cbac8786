"""The benchmark of the loop runs; how fast anything is, is not tested."""

import json

import pytest

pytest.importorskip("pygame")

from benchmarks import aec


def test_the_benchmark_reports_all_environments(capsys):
    aec.main(seconds=0.02, repeat=1, as_json=True)
    report = json.loads(capsys.readouterr().out)
    rows = {row["environment"]: row for row in report["environments"]}
    assert set(rows) == set(aec.ENVIRONMENTS)
    reference = rows["connect_four_v3"]
    assert reference["ratio"] == 1
    for row in rows.values():
        assert 0 < row["slowest"] <= row["steps_per_second"] <= row["fastest"]
        assert row["ratio"] == pytest.approx(row["steps_per_second"] / reference["steps_per_second"])
