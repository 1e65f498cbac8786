"""The benchmark of recording measures what it says it does."""

import pytest

from benchmarks import recording


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
