"""The benchmark of speed runs and keeps its contract; how fast anything is, is not tested."""

import pytest

pytest.importorskip("pygame")

from benchmarks.throughput_cases import BATCHED, SINGLE


@pytest.mark.parametrize("what", [*BATCHED, *SINGLE])
def test_every_maker_plays(what: str) -> None:
    batch = 3 if what in BATCHED else 1
    play = {**BATCHED, **SINGLE}[what](batch, 1)
    for _ in range(2):
        played = play()
        assert played > 0
        assert played % batch == 0 or what == "tournament"
