"""Everything written can be read again: by number, by batch, as tables, and by other readers of MCAP."""

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from shuttle_marl.game import default_game
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError
from shuttle_marl.recording.chunks import arrow_schema, from_arrow, to_arrow
from shuttle_marl.recording.log_file import unfinished
from tests.recording.conftest import same


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=6), st.integers(1, 50), st.integers(1, 2000), st.integers(0, 99))
def test_what_was_appended_is_read(tmp_path_factory, rallies, header, sizes, batch, n_strokes, seed) -> None:
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    names = default_game().catalogue.names
    strokes = tuple(f"{i}" for i in range(n_strokes)) if n_strokes > len(names) else names[:n_strokes]
    parts = [rallies(size, seed + i, n_strokes) for i, size in enumerate(sizes)]
    with RallyLogWriter(path, dataclasses.replace(header(), strokes=strokes), batch_rallies=batch) as log:
        for part in parts:
            log.append(part)
    assert not unfinished(path).exists()
    if n_strokes > len(names):
        with pytest.raises(RecordingError, match="strokes that this program does not know"):
            RallyLog(path)
        return
    with RallyLog(path) as log:
        read = list(log.batches())
        assert log.n_rallies == sum(sizes)
        assert log.n_strokes == sum(len(part.stroke) for part in parts)
        if read:
            assert same(Rallies.concatenate([batch for _, batch in read]), Rallies.concatenate(parts))
            assert all(len(rallies) == batch for _, rallies in read[:-1])
            assert [first for first, _ in read] == list(range(0, sum(sizes), batch))


def test_strokes_of_a_large_catalogue_take_two_bytes(rallies: Callable[..., Rallies]) -> None:
    for n, kind in ((256, pa.uint8()), (257, pa.uint16())):
        assert arrow_schema(n).field("strokes").type.value_type == kind
        part = rallies(50, n_strokes=n)
        assert same(from_arrow(to_arrow(part, n)), part)


def test_one_rally_by_number(log_file: Path, rallies: Callable[..., Rallies], header) -> None:
    whole = rallies(100)
    with RallyLog(log_file) as log:
        assert log.header == header()
        for number in (0, 15, 16, 57, 99):
            assert same(log.rally(number), whole.slice(number, number + 1))
        for number in (-1, 100, 10**9):
            with pytest.raises(RecordingError, match=f"no rally {number}; they are numbered up to 99"):
                log.rally(number)


def test_tables_hold_every_rally_and_stroke_by_name(log_file: Path, rallies: Callable[..., Rallies]) -> None:
    whole = rallies(100)
    with RallyLog(log_file) as log:
        table, strokes, names = log.rally_table(), log.stroke_table(), log.header.strokes
        catalogue = log.catalogue
    assert table["number"].to_pylist() == list(range(100))
    assert table["length"].to_pylist() == whole.length.tolist()
    assert set(table["policy_0"].to_pylist()) == {"attacking", "ünïcode | name"}
    assert set(table["reason"].to_pylist()) == {"fault", "winner"}
    assert strokes.num_rows == len(whole.stroke)
    assert strokes["stroke"].to_pylist() == [names[i] for i in whole.stroke]
    row, position, seat = whole.row_of_stroke, whole.position, whole.striker
    assert strokes["number"].to_pylist() == row.tolist()
    assert strokes["position"].to_pylist() == position.tolist()
    policy = [("attacking", "ünïcode | name")[whole.policy[r, s]] for r, s in zip(row, seat, strict=True)]
    assert strokes["policy"].to_pylist() == policy
    last = np.r_[position[1:] == 0, True]
    outcome = np.array(strokes["outcome"].to_pylist())
    assert outcome[last].tolist() == [("fault", "winner")[i] for i in whole.reason]
    following = [
        f"returned from {HEIGHTS[catalogue.height[stroke]]}{', hurried' if hurried else ''}"
        for stroke, hurried in zip(whole.stroke[1:][~last[:-1]], whole.hurried[1:][~last[:-1]], strict=True)
    ]
    assert outcome[~last].tolist() == following
    assert strokes["hurried"].to_pylist() == whole.hurried.astype(bool).tolist()
    assert whole.outcome(catalogue).dtype == np.int8


def test_an_empty_log(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    RallyLogWriter(tmp_path / "a.mcap", header()).close()
    with RallyLog(tmp_path / "a.mcap") as log:
        assert (log.n_rallies, log.n_strokes, list(log.batches())) == (0, 0, [])
        assert log.rally_table().num_rows == log.stroke_table().num_rows == 0
        assert len(log.numbers_of_match(0, 0)) == 0
        with pytest.raises(RecordingError, match="no rally 0"):
            log.rally(0)


def test_the_official_reader_reads_it(log_file: Path, rallies: Callable[..., Rallies]) -> None:
    whole = rallies(100)
    with log_file.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert (summary.statistics.message_count, summary.statistics.chunk_count) == (7, 7)
        assert [a.name for a in reader.iter_attachments()] == ["rally_index"]
        assert [m.name for m in reader.iter_metadata()] == ["shuttle_marl.rally_log"]
        batches, sequences = [], []
        for schema, channel, message in reader.iter_messages(topics="/rallies"):
            assert (schema.name, schema.encoding, channel.message_encoding) == (
                "shuttle_marl.Rallies",
                "arrow",
                "arrow_stream",
            )
            assert pa.ipc.read_schema(pa.BufferReader(schema.data)).equals(arrow_schema(len(default_game().catalogue)))
            with pa.ipc.open_stream(message.data) as stream:
                batches.append(stream.read_all())
                assert stream.schema.metadata[b"version"] == b"4"
            sequences.append((message.sequence, message.log_time))
        assert sequences == [(i, 16 * i * 1_000_000) for i in range(7)]
        assert pa.concat_tables(batches)["strokes"].combine_chunks().flatten().to_pylist() == whole.stroke.tolist()
        assert pa.concat_tables(batches)["hurried"].combine_chunks().flatten().to_pylist() == whole.hurried.astype(bool).tolist()


def test_the_same_rallies_give_the_same_bytes(tmp_path: Path, rallies: Callable[..., Rallies], header) -> None:
    whole, files = rallies(200), []
    for name, cuts in (("a", [0, 200]), ("b", [0, 1, 50, 51, 130, 200])):
        with RallyLogWriter(tmp_path / f"{name}.mcap", header(), batch_rallies=32) as log:
            for first, last in itertools.pairwise(cuts):
                log.append(whole.slice(first, last))
        files.append((tmp_path / f"{name}.mcap").read_bytes())
    assert files[0] == files[1]


def test_nothing_is_overwritten(log_file: Path, header: Callable[..., LogHeader]) -> None:
    with pytest.raises(RecordingError, match="there is a rally log already"):
        RallyLogWriter(log_file, header())
    log_file.rename(unfinished(log_file))
    with pytest.raises(RecordingError, match=r"unfinished log stands there; .*recover .*rallies.mcap.part"):
        RallyLogWriter(log_file, header())
