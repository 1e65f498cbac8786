"""Files that were cut off or changed, processes that were killed, disks that are full."""

import dataclasses
import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
from mcap.records import Message
from mcap.writer import Writer

from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError, chunks, file_writer, recover
from shuttle_marl.recording import log_file as log_file_module
from shuttle_marl.recording.chunks import FRAME, arrow_schema, decode, encode, from_arrow, to_arrow
from shuttle_marl.recording.file_writer import LogFileWriter, NoRoomError, Sink
from shuttle_marl.recording.header import VERSION, DamagedLogError
from shuttle_marl.recording.log_file import unfinished
from shuttle_marl.recording.recover import salvage
from shuttle_marl.recording.replay import check
from tests.recording.conftest import read_all, same


def test_every_length_is_refused_and_recovered(log_file: Path, tmp_path: Path) -> None:
    content = log_file.read_bytes()
    with RallyLog(log_file) as log:
        ends = [*log.files[0]._offset[1:].astype(int), len(content)]
        at = int(log.files[0]._offset[0])
    first_chunk = at + FRAME.size + FRAME.unpack_from(content, at)[1]
    path, saved = tmp_path / "a.mcap.part", tmp_path / "a.mcap"
    for length in range(0, len(content), 701):
        path.write_bytes(content[:length])
        with pytest.raises(RecordingError) as refused:
            RallyLog(path)
        if length < first_chunk:
            with pytest.raises(RecordingError, match=r"cannot be read|damaged|no rally log|nothing could be recovered"):
                recover(path)
            assert list(tmp_path.glob("a.*")) == [path]
            continue
        assert f"python -m shuttle_marl.recording recover {path}" in str(refused.value)
        found = recover(path)
        assert found.path == saved
        # The index of a chunk's messages stands behind it; without that the chunk is whole all the same.
        assert found.rallies >= 16 * sum(end <= length for end in ends[:-1])
        assert found.rallies == read_all(saved)
        assert path.exists()
        saved.unlink()


def test_batches_behind_a_damaged_one_are_saved(log_file: Path, tmp_path: Path) -> None:
    with RallyLog(log_file) as log:
        at = int(log.files[0]._offset[2]) + 100
        expected = [batch.stroke.tobytes() for _, batch in log.batches()]
    content = bytearray(log_file.read_bytes())
    content[at] ^= 0xFF
    log_file.write_bytes(content)
    with RallyLog(log_file) as log:
        assert log.rally(31) is not None
        with pytest.raises(DamagedLogError, match="recover"):
            log.rally(32)
    found = recover(log_file)
    assert found.path == tmp_path / "rallies.recovered.mcap"
    assert (found.rallies, found.lost) == (84, 16)
    with RallyLog(found.path) as log:
        assert [first for first, _ in log.batches()] == [0, 16, 48, 64, 80, 96]
        assert [batch.stroke.tobytes() for _, batch in log.batches()] == expected[:2] + expected[3:]
        assert log.rally(48).stroke.tobytes() == expected[3][: len(log.rally(48).stroke)]
        with pytest.raises(RecordingError, match="no rally 40"):
            log.rally(40)
    with pytest.raises(RecordingError, match="exists already"):
        recover(log_file)


def test_files_that_are_no_rally_logs(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    text, other, folder = tmp_path / "a.txt", tmp_path / "other.mcap", tmp_path / "folder"
    text.write_text("smash " * 100)
    writer = Writer(str(other))
    writer.start(profile="ros2")
    writer.finish()
    folder.mkdir()
    for path, says in (
        (text, "does not start as an MCAP file"),
        (other, "profile 'ros2'"),
        (tmp_path / "nothing.mcap", "cannot be read"),
    ):
        for read in (RallyLog, recover, check):
            with pytest.raises(RecordingError, match=says):
                read(path)
    for read, says in ((RallyLog, "holds no rally log"), (check, "holds no rally log"), (recover, "cannot be read")):
        with pytest.raises(RecordingError, match=says):
            read(folder)


def test_logs_of_another_version(tmp_path: Path, header: Callable[..., LogHeader], monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("shuttle_marl.recording.header.VERSION", 1)
        RallyLogWriter(tmp_path / "a.mcap", header()).close()
    with pytest.raises(RecordingError, match="schema version 1, this program reads version 4"):
        RallyLog(tmp_path / "a.mcap")


def test_batches_of_another_version(
    header: Callable[..., LogHeader], rallies: Callable[..., Rallies], monkeypatch: pytest.MonkeyPatch
) -> None:
    about, other = header(), dataclasses.replace(header(), columns=("waited",))
    message = Message(channel_id=1, log_time=0, publish_time=0, sequence=0, data=bytes(encode(0, rallies(3), len(about.strokes))))
    assert same(decode(message, about)[1], rallies(3))
    with pytest.raises(DamagedLogError, match="other columns"):
        decode(message, other)
    monkeypatch.setattr(chunks, "VERSION", VERSION + 1)
    with pytest.raises(DamagedLogError, match="other columns"):
        decode(message, about)


def message_of(data: bytes, log_time: int = 0) -> Message:
    return Message(channel_id=1, log_time=log_time, publish_time=log_time, sequence=0, data=data)


def test_a_message_is_one_batch_of_limited_size(
    header: Callable[..., LogHeader], rallies: Callable[..., Rallies], monkeypatch: pytest.MonkeyPatch
) -> None:
    about, part = header(), rallies(3)
    data = bytes(encode(5, part, len(about.strokes)))
    right = message_of(data, 5_000_000)
    first, found = decode(right, about)
    assert (first, same(found, part)) == (5, True)
    monkeypatch.setattr(chunks, "MAX_RALLIES", 3)
    monkeypatch.setattr(chunks, "MAX_STROKES", len(part.stroke))
    assert decode(right, about)[0] == 5
    monkeypatch.setattr(chunks, "MAX_STROKES", len(part.stroke) - 1)
    with pytest.raises(DamagedLogError, match=f"{len(part.stroke)} strokes in a batch, expected at most {len(part.stroke) - 1}"):
        decode(right, about)
    monkeypatch.setattr(chunks, "MAX_RALLIES", 2)
    with pytest.raises(DamagedLogError, match="batches in a message: 3 rallies; expected 1 of at most 2 rallies"):
        decode(right, about)
    with pa.ipc.open_stream(data) as stream:
        (batch,) = stream
    for batches, says in (([], "none"), ([batch, batch], "3 rallies and 3 rallies")):
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, batch.schema) as writer:
            for each in batches:
                writer.write_batch(each)
        with pytest.raises(DamagedLogError, match=f"batches in a message: {says}; expected 1"):
            decode(message_of(sink.getvalue().to_pybytes(), 5_000_000), about)


def test_a_batch_stands_where_its_time_says(header: Callable[..., LogHeader], rallies: Callable[..., Rallies]) -> None:
    about, part = header(), rallies(3)
    whole = to_arrow(part, len(about.strokes))
    for batch, first, log_time in ((whole, 5, 5), (whole, -1, -1_000_000), (whole, None, 0), (whole.slice(0, 0), 0, 0)):
        metadata = {"version": "4"} | ({} if first is None else {"first_rally": str(first)})
        marked = batch.replace_schema_metadata(metadata)
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, marked.schema) as writer:
            writer.write_batch(marked)
        with pytest.raises(DamagedLogError, match="a batch without a place in the log"):
            decode(message_of(sink.getvalue().to_pybytes(), log_time), about)


def test_a_rally_has_strokes_and_a_position_for_each(header: Callable[..., LogHeader], rallies: Callable[..., Rallies]) -> None:
    part = rallies(3)
    about, n = header(), len(part.stroke)
    none = dataclasses.replace(part, length=np.array([part.length[0] + part.length[1], 0, part.length[2]], np.int32))
    with pytest.raises(DamagedLogError, match="a rally without strokes"):
        decode(message_of(bytes(encode(0, none, len(about.strokes)))), about)
    placed = header(columns=("waited",))
    for position, says in ((-1, "position -1 in a batch, expected less than 9"), (9, "position 9"), (0, ""), (8, "")):
        waited = np.zeros(n, np.int8)
        waited[-1] = position
        message = message_of(bytes(encode(0, dataclasses.replace(part, waited=waited), len(about.strokes))))
        if says:
            with pytest.raises(DamagedLogError, match=says):
                decode(message, placed)
        else:
            assert decode(message, placed)[1].waited.tolist() == waited.tolist()
    batch = to_arrow(dataclasses.replace(part, waited=np.zeros(n, np.int8)), len(about.strokes))
    shorter = pa.array([[0] * (length - (row == 1)) for row, length in enumerate(part.length)], batch.schema.field("waited").type)
    at = batch.schema.get_field_index("waited")
    with pytest.raises(DamagedLogError, match="number of strokes differs from the length of its waited"):
        from_arrow(batch.set_column(at, batch.schema.field("waited"), shorter))


def test_numbers_that_point_nowhere(tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies]) -> None:
    for column, value, says in (
        ("server", 2, "seat 2"),
        ("winner", 9, "seat 9"),
        ("reason", 3, "reason 3"),
        ("policy", 2, "policy 2"),
        ("pairing", 3, "pairing 3"),
        ("stroke", 255, "stroke 255"),
        ("hurried", 1, "a server who is hurried"),
    ):
        part = rallies(5)
        getattr(part, column)[0 if column == "hurried" else -1] = value
        path = tmp_path / f"{column}.mcap"
        with RallyLogWriter(path, header()) as log:
            log.append(part)
        with pytest.raises(DamagedLogError, match=says):
            read_all(path)


@pytest.mark.parametrize(
    ("column", "limit", "what"),
    [
        ("server", 2, "seat"),
        ("winner", 2, "seat"),
        ("reason", 2, "reason"),
        ("policy", 2, "policy"),
        ("pairing", 3, "pairing"),
        ("stroke", 7, "stroke"),
    ],
)
def test_numbers_of_a_batch_stay_below_their_limits(
    column: str, limit: int, what: str, header: Callable[..., LogHeader], rallies: Callable[..., Rallies]
) -> None:
    about = header(7)
    for value, fits in ((limit - 1, True), (limit, False)):
        part = rallies(4, n_strokes=7)
        getattr(part, column)[-1] = value
        message = message_of(bytes(encode(0, part, 7)))
        if fits:
            assert same(decode(message, about)[1], part)
        else:
            with pytest.raises(DamagedLogError, match=f"{what} {limit} in a batch, expected less than {limit}"):
                decode(message, about)


@pytest.mark.parametrize("row", [0, 1, 2])
def test_no_server_of_a_batch_is_hurried(row: int, header: Callable[..., LogHeader], rallies: Callable[..., Rallies]) -> None:
    about, part = header(), rallies(3)
    part.hurried[:] = 1
    part.hurried[part.first_stroke[:-1]] = 0
    assert same(decode(message_of(bytes(encode(0, part, len(about.strokes)))), about)[1], part)
    part.hurried[part.first_stroke[row]] = 1
    with pytest.raises(DamagedLogError, match="a server who is hurried"):
        decode(message_of(bytes(encode(0, part, len(about.strokes)))), about)


def test_indexes_and_headers_of_another_kind_are_refused(
    log_file: Path, tmp_path: Path, header: Callable[..., LogHeader], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value, says in (
        ("INDEX_NAME", "other", "the index of its rallies is missing"),
        ("INDEX_SCHEMA", pa.schema([pa.field("first_rally", pa.uint64(), nullable=False)]), "its index has other columns"),
        ("METADATA", "other", "the header is missing"),
        ("PROFILE", "other", "an MCAP file of profile 'other', expected 'shuttle_marl'"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(file_writer, name, value)
            RallyLogWriter(tmp_path / f"{name}.mcap", header()).close()
        with pytest.raises(RecordingError, match=says):
            RallyLog(tmp_path / f"{name}.mcap")
    content = log_file.read_bytes()
    at = content.index(b"application/vnd.apache.arrow.stream") + 200
    log_file.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    with pytest.raises(DamagedLogError, match="the checksum of its index does not match"):
        RallyLog(log_file)


def test_the_checksum_of_the_data_covers_every_block(log_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    content = log_file.read_bytes()
    with RallyLog(log_file) as log:
        end = log.files[0]._summary
        behind_a_chunk = [int(at) - 3 for at in log.files[0]._offset[1:]]
        for block in (1000, end - FRAME.size - 4, 1 << 20):
            monkeypatch.setattr(log_file_module, "_BLOCK", block)
            log.files[0].check_data()
        monkeypatch.setattr(log_file_module, "_BLOCK", 1000)
        for places, says in (
            ([*behind_a_chunk, end - 1], "the checksum of its data does not match"),
            ([end - FRAME.size - 4, end - 5], "its data does not end where the summary says"),
        ):
            for at in places:
                with log_file.open("r+b") as file:
                    file.seek(at)
                    file.write(bytes([content[at] ^ 1]))
                with RallyLog(log_file) as damaged, pytest.raises(DamagedLogError, match=says):
                    damaged.files[0].check_data()
                log_file.write_bytes(content)


def test_a_batch_that_is_too_large_is_not_written(
    tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, part, about = tmp_path / "a.mcap", rallies(3), header()
    data = encode(0, part, len(about.strokes))
    sizes = {"MAX_CHUNK": len(data), "MAX_RALLIES": 3, "MAX_STROKES": len(part.stroke)}
    for name, size in sizes.items():
        monkeypatch.setattr(file_writer, name, size)
    log = LogFileWriter(path, about, fsync_seconds=60)
    log.write(0, data, part)
    for name, size in sizes.items():
        monkeypatch.setattr(file_writer, name, size - 1)
        with pytest.raises(RecordingError, match="a batch of 3 rallies is too large; choose fewer rallies per batch"):
            log.write(3, data, part)
        monkeypatch.setattr(file_writer, name, size)
    assert log.rallies == 3
    log.close()
    log.close()
    log.abort()
    log.sync()
    with pytest.raises(RecordingError, match="is closed; nothing more can be recorded in it"):
        log.write(3, data, part)
    assert read_all(path) == 3


def test_batches_are_flushed_to_the_disk_after_some_seconds(
    tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies], monkeypatch: pytest.MonkeyPatch
) -> None:
    now, synced, part, about = [100.0], [], rallies(3), header()
    monkeypatch.setattr(file_writer, "time", SimpleNamespace(monotonic=lambda: now[0]))
    monkeypatch.setattr(os, "fsync", lambda _: synced.append(now[0]))
    log = LogFileWriter(tmp_path / "a.mcap", about, fsync_seconds=5)
    for batch, when in enumerate((105.0, 105.5, 110.0, 110.5, 110.75)):
        now[0] = when
        log.write(3 * batch, encode(3 * batch, part, len(about.strokes)), part)
    assert synced == [105.5, 110.75]
    log.sync()
    assert synced == [105.5, 110.75, 110.75]
    log.close()
    assert len(synced) == 4
    log.sync()
    assert len(synced) == 4


def test_room_for_a_batch_and_the_end_of_the_file_is_set_aside(
    tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(Sink, "reserve", lambda _, count: asked.append(count))
    part, about = rallies(3), header()
    data = encode(0, part, len(about.strokes))
    log = LogFileWriter(tmp_path / "a.mcap", about, fsync_seconds=60)
    columns, start = arrow_schema(len(about.strokes)).serialize().size, log.size
    for first in (0, 3):
        log.write(first, data, part)
    log.close()
    assert asked == [start + 4096 + columns, *(len(data) + 2 * 4096 + columns + 256 * count for count in (1, 2))]


@pytest.fixture
def sink(tmp_path: Path) -> Iterator[Sink]:
    made = Sink(tmp_path / "a")
    yield made
    made.close()


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="needs to set room aside")
def test_room_is_set_aside_in_steps_as_long_as_there_is_some(sink: Sink, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, int]] = []
    errors: list[int] = []

    def allocate(_: int, offset: int, length: int) -> None:
        asked.append((offset, length))
        if errors:
            raise OSError(errors.pop(0), "why")

    monkeypatch.setattr(os, "posix_fallocate", allocate)
    step = 1 << 20
    sink.reserve(10)
    assert asked == [(0, step)]
    assert sink.write(b"abc") == 3
    assert (sink.tell(), sink.length) == (3, 0)
    sink.commit()
    assert (sink.tell(), sink.length) == (3, 3)
    sink.reserve(step - 3)
    assert len(asked) == 1
    sink.reserve(step - 2)
    assert asked[1:] == [(step, 3)]
    sink.reserve(2 * step)
    assert asked[2:] == [(step + 3, step)]
    errors[:] = [errno.ENOSPC]
    sink.reserve(2 * step + 7)
    assert asked[3:] == [(2 * step + 3, 7), (2 * step + 3, 7)]
    del asked[:]
    errors[:] = [errno.ENOSPC, errno.EFBIG]
    with pytest.raises(NoRoomError) as refused:
        sink.reserve(2 * step + 8)
    assert refused.value.errno == errno.EFBIG
    assert len(asked) == 2
    for error in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
        errors[:] = [error]
        sink.reserve(2 * step + 8)
    assert len(asked) == 5
    errors[:] = [errno.EIO]
    with pytest.raises(OSError, match="why") as failed:
        sink.reserve(2 * step + 8)
    assert type(failed.value) is OSError
    assert len(asked) == 6


def test_a_commit_writes_all_or_nothing(sink: Sink, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, left = os.write, [9]

    def little(handle: int, data: memoryview) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, "full")
        left[0] -= 1
        return write(handle, data[:2])

    monkeypatch.setattr(os, "write", little)
    sink.write(b"abc")
    sink.write(b"de")
    sink.commit()
    assert (sink.length, left) == (5, [6])
    left[0] = 1
    sink.write(b"fghij")
    with pytest.raises(OSError, match="full"):
        sink.commit()
    assert (sink.length, sink.tell()) == (5, 5)
    assert (tmp_path / "a").read_bytes() == b"abcde"
    left[0] = 9
    sink.write(b"klm")
    sink.commit()
    assert (sink.length, sink.tell()) == (8, 8)
    assert (tmp_path / "a").read_bytes() == b"abcdeklm"


def test_room_that_was_set_aside_is_given_back(sink: Sink, tmp_path: Path) -> None:
    sink.reserve(100)
    sink.write(b"abc")
    sink.commit()
    if hasattr(os, "posix_fallocate"):
        assert (tmp_path / "a").stat().st_size == 1 << 20
    sink.close()
    assert (tmp_path / "a").read_bytes() == b"abc"
    with pytest.raises(FileExistsError):
        Sink(tmp_path / "a")


WRITER = """
import dataclasses, sys
from pathlib import Path
import numpy as np
sys.path.insert(0, sys.argv[2])
from conftest import a_header, some_rallies
from shuttle_marl.recording import SINGLE_RALLY, RallyLogWriter
made = some_rallies(64, longest=12)
nothing = dataclasses.replace(made, pairing=0 * made.pairing, rally=0 * made.rally, score=0 * made.score)
header = a_header(rules=SINGLE_RALLY, draws="unknown", matches_per_draw=1)
log = RallyLogWriter(Path(sys.argv[1]), header, batch_rallies=64, max_bytes=100_000, fsync_seconds=1e9)
while True:
    log.append(dataclasses.replace(nothing, match=np.arange(log.rallies, log.rallies + 64, dtype=np.uint32)))
    sys.stdout.write(f"{log.flush(sync=False)}\\n")
    sys.stdout.flush()
"""


@pytest.mark.slow
def test_a_killed_writer_loses_nothing_that_it_acknowledged(tmp_path: Path) -> None:
    """At random moments of a process that writes a log of several parts.

    The environment variable SHUTTLE_KILLS says how many.
    """
    rng = np.random.default_rng(0)
    for i in range(int(os.environ.get("SHUTTLE_KILLS", "6"))):
        folder = tmp_path / str(i)
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(folder / "a.mcap"), str(Path(__file__).parent)], stdout=subprocess.PIPE, text=True
        )
        acknowledged = process.stdout.readline()
        time.sleep(float(rng.uniform(0, 0.3)))
        process.send_signal(signal.SIGKILL)
        lines = (acknowledged + process.stdout.read()).split("\n")[:-1]
        process.wait()
        # The last part is unfinished; killed while it was closed, it may be whole, and killed between parts there is none.
        unfinished_parts = list(folder.glob("*.part"))
        assert len(unfinished_parts) <= 1
        for part in unfinished_parts:
            if not part.read_bytes().strip(b"\0"):  # killed before it wrote the header
                continue
            _, batches = salvage(part)
            if next(batches, None) is not None:  # not killed before it wrote the first batch
                assert recover(part).lost == 0
        checked = check(folder / "a.mcap")
        assert checked.problems == ()
        assert checked.rallies >= int(lines[-1]) >= 64
        assert read_all(folder / "a.mcap") == checked.rallies
        shutil.rmtree(folder)


FULL = """
import os, resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import a_header, some_rallies
from shuttle_marl.recording import RallyLogWriter, RecordingError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
if sys.argv[4] == "0":
    del os.posix_fallocate
log = None
try:
    log = RallyLogWriter(Path(sys.argv[1]), a_header(), batch_rallies=int(sys.argv[5]))
    for i in range(10_000):
        log.append(some_rallies(int(sys.argv[5]), seed=i))
except RecordingError as error:
    sys.stdout.write(f"{log.rallies if log else 0}\\n{error}")
"""


def fill(path: Path, limit: int, *, reserve: bool, batch: int = 64) -> str:
    script = [sys.executable, "-c", FULL, str(path), str(Path(__file__).parent), str(limit), str(int(reserve)), str(batch)]
    return subprocess.run(script, capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="needs limits on file sizes, and to set room aside")
@pytest.mark.parametrize(("limit", "batch"), [(50_000, 64), (2_000_000, 2048)])
def test_a_full_disk_leaves_a_whole_file(tmp_path: Path, limit: int, batch: int) -> None:
    """A limit on the size of files stands for a disk without room: room for the index was reserved before."""
    path = tmp_path / "a.mcap"
    rallies, _, message = fill(path, limit, reserve=True, batch=batch).partition("\n")
    assert message == (
        f"{path}: cannot be written any further (File too large); the {rallies} rallies before it are complete: "
        "free disk space and resume"
    )
    assert limit / 2 < path.stat().st_size <= limit
    assert [file.name for file in tmp_path.iterdir()] == ["a.mcap"]
    assert read_all(path) == int(rallies) > 0


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on file sizes")
def test_a_full_disk_without_reserves_leaves_whole_batches(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    rallies, _, message = fill(path, 50_000, reserve=False).partition("\n")
    assert f"the {rallies} rallies before it are complete" in message
    assert f"recover {unfinished(path)}" in message
    assert not path.exists()
    assert recover(unfinished(path)).rallies == int(rallies) > 0
    assert read_all(path) == int(rallies)


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="needs limits on file sizes, and to set room aside")
def test_a_disk_that_is_full_from_the_start(tmp_path: Path) -> None:
    assert "nothing was recorded" in fill(tmp_path / "a.mcap", 5_000, reserve=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("first_rally", 3, None),
        ("first_rally", 4, None),  # rallies between them were lost
        ("first_rally", 2, "its index is out of order"),
        ("rallies", 0, "its index is out of order"),
        ("rallies", 1, None),
        ("strokes", (1 << 62) - 1, None),
        ("strokes", 1 << 62, "its index holds numbers that no log reaches"),
    ],
)
def test_indexes_with_a_right_checksum(
    column: str, value: int, says: str | None, tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies]
) -> None:
    path, part, about = tmp_path / "a.mcap", rallies(3), header()
    log = LogFileWriter(path, about, fsync_seconds=60)
    for first in (0, 3):
        log.write(first, encode(first, part, len(about.strokes)), part)
    place = ("first_rally", "rallies", "strokes").index(column)
    log._index[1] = (*log._index[1][:place], value, *log._index[1][place + 1 :])
    log.close()
    if says is None:
        with RallyLog(path) as opened:
            assert int(getattr(opened, column)[1]) == value
            assert opened.batch(0)[0] == 0
            if value == 3:
                assert opened.batch(1)[0] == 3
            else:
                with pytest.raises(DamagedLogError, match="batch 1 is not what the index says"):
                    opened.batch(1)
    else:
        with pytest.raises(DamagedLogError, match=says):
            RallyLog(path)
