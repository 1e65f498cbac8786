"""The benchmark of speed runs and keeps its contract; how fast anything is, is not tested."""

import json

import numpy as np
import pytest

pytest.importorskip("pygame")

from benchmarks import throughput
from benchmarks.lower_bound import lower_bound_of
from benchmarks.synthetic import synthetic_game
from benchmarks.throughput_cases import BATCHED, SINGLE
from docs.tools.markdown import saved
from shuttle_marl.game import default_game


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


def test_results_hold_all_that_is_measured() -> None:
    rows = saved("benchmarks", "throughput")
    measured = {(row["what"], row["batch"], row["threads"]) for row in rows if "states" not in row}
    for what in BATCHED:
        for batch in throughput.BATCHES:
            assert (what, batch, 1) in measured
    assert {(what, 1, 1) for what in SINGLE} <= measured


@pytest.mark.parametrize(("strokes", "replies"), [(40, 14), (100, 28)])
def test_synthetic_games_have_the_size_asked_for(strokes: int, replies: int) -> None:
    game = synthetic_game(strokes, replies, seed=3)
    assert game.n_strokes == strokes
    assert set(game.legal_count(np.arange(4, game.n_states)).tolist()) == {replies}
    assert game.n_states == pytest.approx(8 * strokes * replies, rel=0.1)


def test_the_lower_bound_is_that_of_the_tables() -> None:
    game = default_game()
    least = lower_bound_of(game, 1)
    assert least.read_bytes == 24
    assert least.shown_bytes == 2 * game.n_strokes + 7 * 4
    least.play()
    least.show()
