"""The recorder with a thread of its own, and which rallies a log holds: ``--record all|sample:N|none``."""

import dataclasses
import datetime
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest

from shuttle_marl import __version__
from shuttle_marl.game import default_game
from shuttle_marl.game.draws import stream
from shuttle_marl.game.scoring import BWF
from shuttle_marl.league import LeagueConfig
from shuttle_marl.recording import (
    LogHeader,
    Player,
    Rallies,
    RallyLog,
    RallyLogWriter,
    RallyRecorder,
    RecordingError,
    Sampling,
    recover,
)
from shuttle_marl.recording.header import SINGLE_RALLY, Pair
from shuttle_marl.recording.log_file import unfinished
from shuttle_marl.recording.recorder import free_name
from shuttle_marl.recording.replay import check
from tests.recording.conftest import read_rallies
from tests.tournaments import play_league


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


def test_too_much_waiting_makes_the_caller_wait(tmp_path: Path, rallies, header, monkeypatch: pytest.MonkeyPatch) -> None:
    part = rallies(64)
    gate, most, sizes = threading.Event(), 3 * len(part.stroke), []
    original = RallyLogWriter.append

    def slow(self: RallyLogWriter, some: Rallies) -> None:
        gate.wait()
        original(self, some)

    monkeypatch.setattr(RallyLogWriter, "append", slow)
    log = RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=64)
    with RallyRecorder(log, waiting_strokes=most) as recorder:

        def add() -> None:
            for _ in range(20):
                recorder.add(part)
                sizes.append(recorder._waiting)

        caller = threading.Thread(target=add)
        caller.start()
        time.sleep(0.1)
        assert len(sizes) == 4
        gate.set()
        caller.join()
    assert max(sizes) <= most + len(part.stroke)
    assert len(read_rallies(tmp_path / "a.mcap")) == 20 * 64


@pytest.mark.parametrize("failure", [OSError(28, "No space left on device"), ZeroDivisionError(), KeyboardInterrupt()])
def test_errors_of_the_thread_reach_the_caller(
    tmp_path: Path, rallies, header, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    expected = RecordingError if isinstance(failure, OSError) else type(failure)
    recorder = RallyRecorder.create(tmp_path / "a.mcap", header(), batch_rallies=64)
    recorder.add(rallies(64))
    assert recorder.flush() == 64

    def fail(*_: object) -> None:
        raise failure

    with monkeypatch.context() as patch:
        patch.setattr("shuttle_marl.recording.file_writer.Sink.commit", fail)
        recorder.add(rallies(64))
        with pytest.raises(expected):
            recorder.flush()
    with pytest.raises(expected):
        recorder.add(rallies(64))
    with pytest.raises(expected):
        recorder.request_flush().result()
    with pytest.raises(expected):
        recorder.close()
    assert not any(thread.is_alive() for thread in recorder._thread._threads)
    assert recover(unfinished(tmp_path / "a.mcap")).rallies == 64


def test_an_error_of_the_caller_keeps_what_was_added(tmp_path: Path, rallies, header) -> None:
    def work() -> None:
        with RallyRecorder.create(tmp_path / "a.mcap", header(), batch_rallies=16) as recorder:
            recorder.add(rallies(32))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.part"]
    assert recover(tmp_path / "a.mcap.part").rallies == 32


def test_other_columns_than_the_header_names(tmp_path: Path, rallies, header) -> None:
    recorder = RallyRecorder.create(tmp_path / "a.mcap", header(columns=("value",)))
    recorder.add(rallies(3))
    with pytest.raises(RecordingError, match=r"columns \(\), expected \('value',\)"):
        recorder.close()
    for columns in (("speed",), ("value", "update")):
        with pytest.raises(RecordingError, match="in that order"):
            header(columns=columns)
    with pytest.raises(RecordingError, match="draws 'dice'"):
        header(draws="dice")


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


def test_what_may_be_asked_for() -> None:
    assert [str(Sampling.parse(text)) for text in ("all", "sample:1", "none", "sample:10")] == ["all", "all", "none", "sample:10"]
    for text in ("", "ALL", "sample:0", "sample:1.5", "10"):
        with pytest.raises(RecordingError, match="expected all, none, or sample:N"):
            Sampling.parse(text)
    with pytest.raises(RecordingError, match="sample:N"):
        LogHeader(seed=0, game="", strokes=(), policies=(), record="half")


def test_headers_have_limits(header) -> None:
    long = "x" * 1000
    for fine in (
        {"strokes": (long,), "policies": (Player(name=long),), "pair": Pair(players=(long, long))},
        {"matches_per_draw": 1, "part": 0, "first_rally": 0, "pairings": (0, 2**64 - 1)},
        {"matches_per_draw": 2**32 - 1, "part": 2**31 - 1, "first_rally": 2**62 - 1, "pairings": ()},
    ):
        assert header(**fine).software == header().software
    for wrong, says in (
        ({"strokes": (long + "x",)}, "strokes and policies: expected names of up to 1000 characters"),
        ({"policies": (Player(name="a"), Player(name=long + "x"))}, "strokes and policies: expected names"),
        ({"pair": Pair(players=("a", long + "x"))}, "players: expected names of up to 1000 characters"),
        ({"matches_per_draw": 0}, "matches_per_draw 0: expected a number from 1 up to 4294967296"),
        ({"matches_per_draw": 2**32}, "matches_per_draw 4294967296: expected"),
        ({"part": -1}, "part -1: expected a number from 0 up to 2147483648"),
        ({"part": 2**31}, "part 2147483648: expected"),
        ({"first_rally": -1}, "first_rally -1: expected a number from 0 up to 4611686018427387904"),
        ({"first_rally": 2**62}, "first_rally 4611686018427387904: expected"),
        ({"pairings": (0, 2**64)}, "pairings: expected keys from 0 up to"),
        ({"pairings": (-1, 0)}, "pairings: expected keys from 0 up to"),
    ):
        with pytest.raises(RecordingError, match=says):
            header(**wrong)


def test_headers_have_defaults() -> None:
    made = LogHeader(seed=3, game="g", strokes=("a",), policies=())
    assert (made.pairings, made.matches_per_draw, made.rules, made.draws, made.record) == ((0,), 2, BWF, "league", "all")
    assert (made.columns, made.pair, made.part, made.first_rally) == ((), None, 0, 0)
    assert made.software == f"shuttle_marl {__version__}"
    assert made == dataclasses.replace(made, part=4, first_rally=7) != dataclasses.replace(made, seed=4)
    assert SINGLE_RALLY.as_tuple == (1, 1, 1, 1)
    assert Player(name="a").hash == ""


def test_nothing_waits_after_a_flush(tmp_path: Path, rallies, header) -> None:
    with RallyRecorder.create(tmp_path / "a.mcap", header(), batch_rallies=8) as recorder:
        for count in (3, 9):
            recorder.add(rallies(count))
            assert recorder.flush(sync=False) == (3 if count == 3 else 12)
            assert recorder._waiting == 0
    with RallyLog(tmp_path / "a.mcap") as log:
        assert log.rallies.tolist() == [3, 8, 1]


def test_headers_without_strokes_or_of_no_version_are_refused(header) -> None:
    empty = header(strokes=()).to_metadata()
    with pytest.raises(RecordingError, match=r"its header is not one of version 4 \(no strokes"):
        LogHeader.from_metadata(empty)
    with pytest.raises(RecordingError, match="schema version None, this program reads version 4"):
        LogHeader.from_metadata({})
    made = header(part=3, first_rally=9, pair=Pair(players=("a", "b"), date="2020-01-02"))
    found = LogHeader.from_metadata(made.to_metadata())
    assert (found, found.part, found.first_rally, found.pair) == (made, 3, 9, made.pair)
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


def test_writers_and_recorders_have_options(tmp_path: Path, rallies, header, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RecordingError, match="batch_rallies 0"):
        RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=0)
    with pytest.raises(RecordingError, match="max_bytes 0"):
        RallyLogWriter(tmp_path / "a.mcap", header(), max_bytes=0)
    with pytest.raises(RecordingError, match="--record none records nothing"):
        RallyRecorder.create(tmp_path / "a.mcap", header(), "none")
    assert list(tmp_path.iterdir()) == []
    with RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=1, max_bytes=1) as log:
        log.append(rallies(2))
        assert (log.rallies, log.flush()) == (2, 2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.1.mcap", "a.mcap"]
    with RallyLogWriter(tmp_path / "b.mcap", header(), batch_rallies=2) as log:
        log.append(rallies(1))
        size = log._file.size
        log.flush(sync=False)
        monkeypatch.setattr(log, "_max_bytes", log._file.size)
        assert log._file.size > size
        log.append(rallies(2))
        log.append(rallies(1))
        assert log.rallies == 3
        assert log._file.header.part == 1
    assert len(read_rallies(tmp_path / "b.mcap")) == 4


def test_a_sample_of_all_or_of_nothing_is_the_rallies_themselves(rallies, header) -> None:
    some, about = rallies(40), header()
    assert Sampling(every=1).of(about, some) is some
    assert len(Sampling(every=0).of(about, some)) == 0
    kept = Sampling(every=3).of(about, some)
    assert kept.match.tolist() == some.match[Sampling(every=3).keeps(about, some.pairing, some.match)].tolist()
    assert 0 < len(kept) < 40
    assert len(Sampling(every=3).of(about, some.slice(0, 0))) == 0
    match = np.arange(40)
    found = np.flatnonzero(Sampling(every=3).keeps(dataclasses.replace(about, seed=1), np.zeros_like(match), match))
    assert found.tolist() == [2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 36, 37], (
        "logs that are written in parts by several versions have one sample"
    )


def test_the_players_of_a_pair_and_their_day() -> None:
    assert Pair.of(GAME) is None
    for day, expected in ((datetime.date(2020, 1, 2), "2020-01-02"), (None, None)):
        people: Any = SimpleNamespace(players=("a", "b"), date=day, discipline="men")
        game: Any = SimpleNamespace(people=people)
        assert Pair.of(game) == Pair(players=("a", "b"), date=expected, discipline="men")


def test_free_names_are_counted_from_two(log_file: Path) -> None:
    assert free_name(log_file.with_name("other.mcap")) == log_file.with_name("other.mcap")
    assert free_name(log_file) == log_file.with_name("rallies-2.mcap")
    log_file.with_name("rallies-2.1.mcap.part").touch()
    assert free_name(log_file) == log_file.with_name("rallies-3.mcap")


def test_one_in_n_at_random_and_cells_together(header) -> None:
    """Matches that share their draws are in together, and the samples of seeds and pairings differ."""
    match = np.arange(20_000)
    pairing = np.zeros(len(match), dtype=np.uint32)
    kept = Sampling(every=7).keeps(header(), pairing, match)
    cells = kept.reshape(-1, 2)
    assert (cells[:, 0] == cells[:, 1]).all()
    # Who serves first alternates from cell to cell; the sample must not prefer either.
    assert [cells[parity::2, 0].mean() for parity in (0, 1)] == pytest.approx([1 / 7] * 2, abs=0.02)
    for other in (Sampling(every=7).keeps(header(seed=8), pairing, match), Sampling(every=7).keeps(header(), pairing + 1, match)):
        assert (other & kept).mean() == pytest.approx(1 / 49, abs=0.01)
    alone = Sampling(every=7).keeps(header(matches_per_draw=1), pairing, match).reshape(-1, 2)
    assert (alone[:, 0] != alone[:, 1]).any()
    assert not Sampling(every=0).keeps(header(), pairing, match).any()
    assert Sampling(every=1).keeps(header(), pairing, match).all()


@pytest.fixture(scope="module")
def sampled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sampled") / "run"
    play_league(LeagueConfig(pool=POOL, matches=60, seed=3, record="sample:4", out=out))
    return out


def test_a_sampled_tournament_holds_whole_matches_that_play_again(sampled: Path, tmp_path: Path) -> None:
    full = LeagueConfig(pool=POOL, matches=60, seed=3, out=tmp_path / "full")
    play_league(full)
    assert (sampled / "results.csv").read_bytes() == (tmp_path / "full" / "results.csv").read_bytes()
    assert check(sampled / "rallies.mcap", GAME).problems == ()
    some, everything = (read_rallies(run / "rallies.mcap") for run in (sampled, tmp_path / "full"))
    with RallyLog(sampled / "rallies.mcap") as log:
        assert log.header.record == "sample:4"
        expected = everything.select(Sampling(every=4).keeps(log.header, everything.pairing, everything.match))
    assert 0.1 < len(some) / len(everything) < 0.4
    for field in ("pairing", "match", "rally", "winner", "stroke"):
        assert np.array_equal(getattr(some, field), getattr(expected, field))
    assert "One match in 4, drawn at random, is in" in (sampled / "report.html").read_text()
    counted = sum(row["rallies"] for row in pyarrow.parquet.read_table(sampled / "results.parquet").to_pylist())
    assert counted == len(everything)


def test_rallies_that_do_not_belong_to_the_sample_are_found(tmp_path: Path, sampled: Path) -> None:
    with RallyLog(sampled / "rallies.mcap") as log:
        header = dataclasses.replace(log.header, record="sample:5")
    with RallyLogWriter(tmp_path / "a.mcap", header) as log_writer:
        log_writer.append(read_rallies(sampled / "rallies.mcap"))
    assert "does not belong to sample:5" in check(tmp_path / "a.mcap").problems[0]
