"""The benchmark of speed runs and keeps its contract; how fast anything is, is not tested."""

import json

import numpy as np
import pytest

pytest.importorskip("pygame")

from benchmarks import throughput
from benchmarks.lower_bound import lower_bound_of
from benchmarks.synthetic import synthetic_game
from benchmarks.throughput_cases import BATCHED, SINGLE, Play
from docs.tools.markdown import saved
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game


@pytest.mark.parametrize("what", [*BATCHED, *SINGLE])
def test_every_maker_plays(what: str) -> None:
    batch = 3 if what in BATCHED else 1
    play = {**BATCHED, **SINGLE}[what](batch, 1)
    for _ in range(2):
        played = play()
        assert played > 0
        assert played % batch == 0 or what == "tournament"


class Clocks:
    """Stands for the module ``time``: a call that plays takes 1/256 s of the processor, and ``busy`` times that on the clock."""

    def __init__(self, busy: float = 1) -> None:
        self.busy, self.played = busy, 0

    def process_time(self) -> float:
        return self.played / 256

    def perf_counter(self) -> float:
        return self.busy * self.process_time()


def turns_of(clocks: Clocks, threads: int) -> tuple[list[str], list[list[float]]]:
    """Names in the order in which they had their turns, and the speeds that were found."""
    order: list[str] = []

    def player(name: str) -> Play:
        def play() -> int:
            clocks.played += 1
            if order[-1:] != [name]:
                order.append(name)
            return 7

        return play

    return order, throughput.speeds([player("a"), player("b")], 1 / 64, 3, threads)


@pytest.mark.parametrize("threads", [1, 2])
def test_turns_are_taken_and_end(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks()
    monkeypatch.setattr(throughput, "time", clocks)
    order, found = turns_of(clocks, threads)
    assert order == ["a", "b"] * 4, "a call to warm up and three turns"
    assert found == [[7 * 256.0] * 3] * 2


def test_a_busy_machine_gets_fewer_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    clocks = Clocks(busy=10)
    monkeypatch.setattr(throughput, "time", clocks)
    order, found = turns_of(clocks, 1)
    assert order == ["a", "b"] * 3
    assert found == [[7 * 256.0] * 2] * 2


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


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(ShuttleError, match="no such measurement: kernels; there are kernel, "):
        throughput.main(only=("kernels",))


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
