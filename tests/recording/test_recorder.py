"""The recorder with a thread of its own, headers, and names of logs."""

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.draws import stream
from shuttle_marl.recording import LogHeader, Player, Rallies, RallyLog, RallyLogWriter, RallyRecorder, RecordingError, recover
from shuttle_marl.recording.header import Pair
from shuttle_marl.recording.log_file import unfinished
from tests.recording.conftest import read_rallies


def test_the_same_bytes_as_without_a_thread_rallies(tmp_path: Path, rallies: Callable[..., Rallies], header) -> None:
    parts = [rallies(count, seed) for seed, count in enumerate((10, 0, 70, 3, 200))]
    with RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=32) as log:
        for part in parts:
            log.append(part)
    with RallyRecorder.create(tmp_path / "b.mcap", header(), batch_rallies=32) as recorder:
        for part in parts:
            recorder.add(part)
    assert (tmp_path / "b.mcap").read_bytes() == (tmp_path / "a.mcap").read_bytes()


def test_a_flush_counts_what_is_safe(tmp_path: Path, rallies, header) -> None:
    path = tmp_path / "a.mcap"
    with RallyRecorder.create(path, header(), batch_rallies=64) as recorder:
        recorder.add(rallies(70))
        requested = recorder.request_flush(sync=False)
        recorder.add(rallies(10))
        assert requested.result() == 70
        assert recorder.flush() == 80
        assert recover(unfinished(path), tmp_path / "copy.mcap").rallies == 80
        assert recorder.flush() == 80
    assert len(read_rallies(path)) == 80


class Slow(RallyLogWriter):
    """A writer that notes how many rallies were added before each of its calls."""

    added, noted = 0, list[int]()

    def append(self, rallies: Rallies) -> None:
        time.sleep(0.01)
        self.noted.append(self.added)
        super().append(rallies)


def test_too_much_waiting_makes_the_caller_wait(tmp_path: Path, rallies, header) -> None:
    part = rallies(64)
    log = Slow(tmp_path / "a.mcap", header(), batch_rallies=64)
    with RallyRecorder(log, waiting_strokes=3 * len(part.stroke)) as recorder:
        for log.added in range(20):
            recorder.add(part)
    assert max(ahead - written for written, ahead in enumerate(log.noted)) <= 5
    assert len(read_rallies(tmp_path / "a.mcap")) == 20 * 64


def test_errors_of_the_thread_reach_the_caller(tmp_path: Path, rallies, header) -> None:
    """What was flushed before stays unfinished, and no log is published."""
    path, good = tmp_path / "a.mcap", rallies(64)
    recorder = RallyRecorder.create(path, header(), batch_rallies=64)
    recorder.add(good)
    assert recorder.flush() == 64
    recorder.add(dataclasses.replace(good, update=np.zeros(64, np.uint32)))
    for call in (recorder.flush, lambda: recorder.add(good), lambda: recorder.request_flush().result(), recorder.close):
        with pytest.raises(RecordingError, match=r"rallies with columns \('update',\), expected \(\)"):
            call()
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap.part"]
    assert unfinished(path).stat().st_size < 1 << 20, "the room that was set aside is given back"
    assert recover(unfinished(path)).rallies == 64


def test_an_error_of_the_caller_keeps_what_was_added(tmp_path: Path, rallies, header) -> None:
    def work() -> None:
        with RallyRecorder.create(tmp_path / "a.mcap", header(), batch_rallies=16) as recorder:
            recorder.add(rallies(32))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.part"]
    assert recover(tmp_path / "a.mcap.part").rallies == 32


def test_other_columns_than_the_header_names(header) -> None:
    for columns in (("speed",), ("value", "update")):
        with pytest.raises(RecordingError, match="in that order"):
            header(columns=columns)


@pytest.mark.parametrize("columns", [("log_probability", "value"), ("update", "log_probability", "value")])
def test_columns_of_learners_are_kept(tmp_path: Path, rallies, header, columns: tuple[str, ...]) -> None:
    whole, rng = rallies(300), np.random.default_rng(0)
    n = len(whole.stroke)
    made = {
        "update": rng.integers(0, 2**32, len(whole), dtype=np.uint32),
        "log_probability": rng.normal(size=n).astype(np.float32),
        "value": np.where(rng.random(n) < 0.3, np.nan, rng.normal(size=n)).astype(np.float32),
    }
    whole = dataclasses.replace(whole, **{name: made[name] for name in columns})
    assert whole.optional_columns == columns
    with RallyLogWriter(tmp_path / "a.mcap", header(columns=columns), batch_rallies=64) as log:
        log.append(whole.slice(0, 130))
        log.append(whole.slice(130, 300))
    found = read_rallies(tmp_path / "a.mcap")
    for name in (f.name for f in dataclasses.fields(Rallies) if getattr(whole, f.name) is not None):
        assert np.array_equal(getattr(found, name), getattr(whole, name), equal_nan=name == "value"), name
    with RallyLog(tmp_path / "a.mcap") as read_log:
        table, strokes = read_log.rally_table(), read_log.stroke_table()
        assert read_log.rally(200).optional_columns == columns
    for name in columns:
        of_strokes = name != "update"
        values = (strokes if of_strokes else table)[name].to_numpy()
        assert np.array_equal(values, made[name], equal_nan=of_strokes)
        assert (name in strokes.column_names) == of_strokes
    chosen = rng.random(300) < 0.5
    picked = whole.select(chosen)
    assert picked.optional_columns == columns
    assert len(picked.stroke) == whole.length[chosen].sum()


GAME = default_game()
POOL = ("bc", "bc:viktor-axelsen", "bc:an-se-young")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"strokes": ("x" * 1001,)}, "players: expected names of up to 1000 characters"),
        ({"policies": (Player(name="x" * 1001),)}, "players: expected names"),
        ({"pair": Pair(players=("a", "x" * 1001))}, "players: expected names of up to 1000 characters"),
        ({"matches_per_draw": 0}, "matches_per_draw 0: expected a number from 1"),
        ({"pairings": (0, 2**64)}, "pairings: expected keys from 0"),
    ],
)
def test_headers_have_limits(wrong: dict[str, Any], says: str, header) -> None:
    with pytest.raises(RecordingError, match=says):
        header(**wrong)


def test_headers_without_strokes_or_of_no_version_are_refused(header) -> None:
    empty = header(strokes=()).to_metadata()
    with pytest.raises(RecordingError, match=r"its header is not one of version 4 \(no strokes"):
        LogHeader.from_metadata(empty)
    with pytest.raises(RecordingError, match="schema version None, this program reads version 4"):
        LogHeader.from_metadata({})
    made = header(pair=Pair(players=("a", "b"), date="2020-01-02"))
    found = LogHeader.from_metadata(made.to_metadata())
    assert found == made
    assert '"pair"' not in header().to_metadata()["header"]


def test_keys_of_draws(header, rallies) -> None:
    """Each way of numbering the draws, from the definition."""
    some = dataclasses.replace(rallies(5), match=np.array([0, 3, 4, 7, 7], np.uint32), rally=np.array([0, 1, 2, 0, 1], np.uint16))
    some = dataclasses.replace(some, pairing=np.array([0, 0, 1, 2, 2], np.uint32), server=np.array([0, 1, 1, 0, 1], np.uint8))
    keys = header().pairings
    rows = list(zip(some.pairing, some.match, some.rally, some.server, strict=True))
    expected = {
        "league": [stream(7, keys[p], int(m) // 3, 2 * int(r) + int(s)) for p, m, r, s in rows],
        "rally_v0": [stream(7, int(m)) for _, m, _, _ in rows],
        "match_v0": [stream(7, int(m), int(r)) for _, m, r, _ in rows],
        "training": [stream(keys[p], int(m)) for p, m, _, _ in rows],
    }
    for draws, wanted in expected.items():
        assert header(draws=draws, matches_per_draw=3).rally_key(some).tolist() == [key.item() for key in wanted]
    with pytest.raises(RecordingError, match="the draws of this log are unknown"):
        header(draws="unknown").rally_key(some)


def test_writers_and_recorders_have_options(tmp_path: Path, header) -> None:
    with pytest.raises(RecordingError, match="batch_rallies 0"):
        RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=0)
    assert list(tmp_path.iterdir()) == []
