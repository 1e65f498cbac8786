"""Files that were cut off or changed, processes that were killed, disks that are full."""

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from mcap.records import Message
from mcap.writer import Writer

from shuttle_marl.recording import LogHeader, Rallies, RallyLog, RallyLogWriter, RecordingError, recover
from shuttle_marl.recording.header import DamagedLogError
from shuttle_marl.recording.log_file import decode, encode, from_arrow, to_arrow, unfinished
from shuttle_marl.recording.reader import check
from tests.recording.conftest import chunks_of, read_all


def test_every_length_is_refused_and_recovered(log_file: Path, tmp_path: Path) -> None:
    content = log_file.read_bytes()
    ends = [*(first for first, _ in chunks_of(log_file)[1:]), len(content)]
    first_chunk = chunks_of(log_file)[0][1]
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
    at = chunks_of(log_file)[2][0] + 100
    with RallyLog(log_file) as log:
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
    assert "rallies 32 to 47 are missing, before others of rallies.recovered.mcap" in check(found.path).problems
    with RallyLog(found.path) as log:
        assert [first for first, _ in log.batches()] == [0, 16, 48, 64, 80, 96]
        assert [batch.stroke.tobytes() for _, batch in log.batches()] == expected[:2] + expected[3:]
        assert log.rally(48).stroke.tobytes() == expected[3][: len(log.rally(48).stroke)]
        with pytest.raises(RecordingError, match="no rally 40"):
            log.rally(40)
    with pytest.raises(RecordingError, match="exists already"):
        recover(log_file)


def test_a_log_without_its_header_needs_a_copy(log_file: Path) -> None:
    content = log_file.read_bytes()
    at, says = content.index(b"policies"), r"damaged: .*no rally can be read without its header, restore a copy"
    for damaged in (content[: at + 3], content[:at] + b"x" + content[at + 1 :]):
        log_file.write_bytes(damaged)
        for read in (RallyLog, recover, check):
            with pytest.raises(DamagedLogError, match=says) as refused:
                read(log_file)
            assert "recording recover" not in str(refused.value)


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


def test_logs_of_another_version(tmp_path: Path, header: Callable[..., LogHeader]) -> None:
    class Earlier(LogHeader):
        def to_metadata(self) -> dict[str, str]:
            return {**super().to_metadata(), "version": "1"}

    RallyLogWriter(tmp_path / "a.mcap", Earlier(**vars(header()))).close()
    with pytest.raises(RecordingError, match="schema version 1, this program reads version 4"):
        RallyLog(tmp_path / "a.mcap")


def message_of(data: bytes, log_time: int = 0) -> Message:
    return Message(channel_id=1, log_time=log_time, publish_time=log_time, sequence=0, data=data)


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


@pytest.mark.parametrize(
    ("column", "value", "says"),
    [
        ("server", 2, "seat 2"),
        ("winner", 2, "seat 2"),
        ("reason", 2, "reason 2"),
        ("policy", 2, "policy 2"),
        ("pairing", 3, "pairing 3"),
        ("stroke", 7, "stroke 7"),
        ("hurried", 1, "a server who is hurried"),
    ],
)
def test_numbers_that_point_nowhere(
    column: str, value: int, says: str, tmp_path: Path, header: Callable[..., LogHeader], rallies: Callable[..., Rallies]
) -> None:
    part = rallies(5, n_strokes=7)
    getattr(part, column)[0 if column == "hurried" else -1] = value
    with RallyLogWriter(tmp_path / "a.mcap", header(7)) as log:
        log.append(part)
    with pytest.raises(DamagedLogError, match=says):
        read_all(tmp_path / "a.mcap")


@pytest.mark.parametrize("number", range(32))
def test_every_byte_is_checked(number: int, log_file: Path) -> None:
    """Anywhere, and behind the seven chunks, which have checksums of their own."""
    content = bytearray(log_file.read_bytes())
    places = [*np.linspace(0, len(content) - 1, 25).astype(int), *(end + 3 for _, end in chunks_of(log_file))]
    content[places[number]] ^= 1
    log_file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"damaged|no rally log"):
        check(log_file)


@pytest.mark.parametrize(("seconds", "calls"), [(0, 4), (1e9, 1)])
def test_batches_reach_the_disk_in_time(
    seconds: float, calls: int, tmp_path: Path, header, rallies, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced = list[int]()
    monkeypatch.setattr(os, "fsync", synced.append)
    log = RallyLogWriter(tmp_path / "a.mcap", header(), batch_rallies=1, fsync_seconds=seconds)
    log.append(rallies(3))
    log.flush()
    assert len(synced) == calls
    log.abort()


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
log = RallyLogWriter(Path(sys.argv[1]), header, batch_rallies=64, fsync_seconds=1e9)
while True:
    log.append(dataclasses.replace(nothing, match=np.arange(log.rallies, log.rallies + 64, dtype=np.uint32)))
    sys.stdout.write(f"{log.flush(sync=False)}\\n")
    sys.stdout.flush()
"""


@pytest.mark.slow
def test_a_killed_writer_loses_nothing_that_it_acknowledged(tmp_path: Path) -> None:
    """At random moments of a process that writes a log.

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
        assert recover(folder / "a.mcap.part").lost == 0
        checked = check(folder / "a.mcap")
        assert checked.problems == ()
        assert checked.rallies >= int(lines[-1]) >= 64
        assert read_all(folder / "a.mcap") == checked.rallies
        shutil.rmtree(folder)


FULL = """
import resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from conftest import a_header, some_rallies
from shuttle_marl.recording import RallyLogWriter, RecordingError
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
log = None
try:
    log = RallyLogWriter(Path(sys.argv[1]), a_header(), batch_rallies=int(sys.argv[4]))
    for i in range(10_000):
        log.append(some_rallies(int(sys.argv[4]), seed=i))
except RecordingError as error:
    sys.stdout.write(f"{log.rallies if log else 0}\\n{error}")
"""


def fill(path: Path, limit: int, batch: int) -> str:
    # With -B, because Python would keep a module that it could only write in part.
    script = [sys.executable, "-B", "-c", FULL, str(path), str(Path(__file__).parent), str(limit), str(batch)]
    return subprocess.run(script, capture_output=True, text=True, check=True).stdout


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on file sizes")
@pytest.mark.parametrize(("limit", "batch"), [(50_000, 64), (2_000_000, 2048)])
def test_a_full_disk_leaves_whole_batches(tmp_path: Path, limit: int, batch: int) -> None:
    """A limit on the size of files stands for a disk without room."""
    path = tmp_path / "a.mcap"
    rallies, _, message = fill(path, limit, batch).partition("\n")
    assert message.startswith(f"{unfinished(path)}: cannot be written (File too large); it holds {int(rallies):,} complete rall")
    assert f"recover {unfinished(path)}" in message
    assert list(tmp_path.iterdir()) == [unfinished(path)]
    found = recover(unfinished(path))
    assert (found.rallies, found.lost) == (int(rallies), 0)
    assert read_all(path) == int(rallies) > 0


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on file sizes")
def test_a_disk_that_is_full_from_the_start(tmp_path: Path) -> None:
    assert "nothing was recorded" in fill(tmp_path / "a.mcap", 5_000, batch=64)
    assert list(tmp_path.iterdir()) == []
