"""The benchmarks run and keep their contracts; how fast anything is, is not tested."""

import pytest

pytest.importorskip("pygame")

from benchmarks import recording
from benchmarks.throughput import BATCHED, RECOVERY, SINGLE, measure_recovery


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
def test_everything_is_measured() -> None:
    found = recording.measure(matches=20, repeat=1)
    assert found["rallies"] > 6 * 20 * 2 * 21
    assert 0 < found["bytes_per_stroke"] < 5
