"""The benchmark of speed runs and keeps its contract; how fast anything is, is not tested."""

import json

import pytest

pytest.importorskip("pygame")

from benchmarks import throughput
from benchmarks.throughput_cases import BATCHED, SINGLE


@pytest.mark.parametrize("what", [*BATCHED, *SINGLE])
def test_every_maker_plays(what: str) -> None:
    batch = 3 if what in BATCHED else 1
    play = {**BATCHED, **SINGLE}[what](batch, 1)
    for _ in range(2):
        played = play()
        assert played > 0
        assert played % batch == 0 or what == "tournament"


@pytest.mark.slow
def test_json_is_a_list_of_measurements(capsys: pytest.CaptureFixture[str]) -> None:
    throughput.main(
        only=("kernel", "aec", "connect_four_v3"), batches=(1, 8192), threads=(1, 2), seconds=0.01, turns=1, as_json=True
    )
    rows = json.loads(capsys.readouterr().out)
    shipped = [row for row in rows if "states" not in row]
    expected = [
        ("kernel", 1, 1),
        ("kernel", 1, 2),
        ("kernel", 8192, 1),
        ("kernel", 8192, 2),
        ("aec", 1, 1),
        ("connect_four_v3", 1, 1),
    ]
    assert [(row["what"], row["batch"], row["threads"]) for row in shipped] == expected
    for row in rows:
        assert 0 < row["median_per_s"] <= row["strokes_per_s"]
        assert row["peak_mb"] > 10
        assert ("bound_per_s" in row) == (row in shipped and row["batch"] == 8192)
    sizes = [row for row in rows if "states" in row]
    assert {row["what"] for row in sizes} == {"kernel", "kernel_observed"}
    assert len(sizes) == 2 * (1 + len(throughput.SIZES))
