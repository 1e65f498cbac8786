"""The benchmarks run and keep their contracts; how fast anything is, is not tested."""

import pytest

pytest.importorskip("pygame")

import json
import sys

import pytest

from benchmarks import aec, exact_values, recording, startup
from benchmarks.league import benchmark
from benchmarks.throughput_cases import BATCHED, SINGLE
from tests.reduced import reduced_game


@pytest.mark.parametrize("what", [*BATCHED, *SINGLE])
def test_every_maker_plays(what: str) -> None:
    batch = 3 if what in BATCHED else 1
    play = {**BATCHED, **SINGLE}[what](batch, 1)
    for _ in range(2):
        played = play()
        assert played > 0
        assert played % batch == 0 or what == "tournament"


def test_cpu_time_is_that_of_the_command() -> None:
    busy = [sys.executable, "-c", "import time\nwhile time.process_time() < 0.3: pass"]
    assert 0.3 <= startup.cpu_seconds(busy, 1) < 3


def test_thirty_policies_differ() -> None:
    policies = exact_values.thirty_policies(reduced_game())
    assert len({policy.cumulative.tobytes() for policy in policies}) == len(policies) == 30


@pytest.mark.slow
def test_the_quick_benchmark_measures_everything(capsys: pytest.CaptureFixture[str]) -> None:
    benchmark(quick=True, json_output=True)
    found = json.loads(capsys.readouterr().out)
    assert found["exact"]["pairs_per_s"] > 0
    assert [(case["pool"], case["workers"]) for case in found["sampled"]] == [(3, 1), (3, 2), (6, 1), (6, 2)]
    assert [case["matches"] for case in found["sampled"]] == [30, 30, 150, 150]
    assert all(case["matches_per_s"] > 0 and case["memory_mib"] > 50 for case in found["sampled"])


@pytest.mark.slow
def test_everything_is_measured() -> None:
    found = recording.measure(matches=20, strokes=40_000, repeat=1)
    assert found["rallies"] > 6 * 20 * 2 * 21
    assert 0 < found["bytes_per_stroke"] < 5
    assert 0 < found["cpu_us_per_stroke"] < 10
    assert found["recorded_strokes_per_s"] > 1000
    assert found["read_strokes_per_s"] > 1000
    assert 0 < found["find_rally_ms"] < 1000
    assert 0 < found["training_overhead"] < 1
    assert 0 < found["training_waits"] < 1
    assert 0 < found["training_bytes_per_stroke"] < 20


pytest.importorskip("pygame")


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
