"""The benchmarks run and keep their contracts; how fast anything is, is not tested."""

import json

import pytest

pytest.importorskip("pygame")

from benchmarks import recording
from benchmarks.league import benchmark
from benchmarks.throughput import measure_recovery
from benchmarks.throughput_cases import BATCHED, RECOVERY, SINGLE


@pytest.mark.parametrize("what", [*BATCHED, *SINGLE])
def test_every_maker_plays(what: str) -> None:
    batch = 3 if what in BATCHED else 1
    play = {**BATCHED, **SINGLE}[what](batch, 1)
    for _ in range(2):
        played = play()
        assert played > 0
        assert played % batch == 0 or what == "tournament"


@pytest.mark.slow
@pytest.mark.parametrize("what", RECOVERY)
def test_games_with_recovery_are_measured_beside_the_game_without(what: str) -> None:
    (measured,) = measure_recovery(what, 0.0, 1)
    assert measured["recovery_ratio"] > 0


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
    assert 0 < found["training_overhead"] < 1
