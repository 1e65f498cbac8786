"""Files from others: what they name is neither run nor opened nor printed as it stands, and each is refused in words."""

import contextlib
import dataclasses
import json
import os
import resource
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from shuttle_marl.base.files import seal
from shuttle_marl.commands import analysis, recording
from shuttle_marl.recording import LogHeader, Player, RallyLog, RallyLogWriter, RecordingError, recover
from shuttle_marl.recording.header import DamagedLogError
from shuttle_marl.recording.log_file import FRAME, message_of_chunk, unfinished
from shuttle_marl.recording.reader import check
from tests.recording.conftest import chunks_of, read_all, read_rallies
from tests.recording.mutate import Mutator

FORGED = (
    "evil_module:attribute",
    "best-response:evil_module:attribute",
    "evil_module:attribute@0.5",
    "best-response:evil_module:attribute@0.5",
    "table:/etc/passwd",
    "agent:../../secret",
    "agent:/etc/passwd",
)


@pytest.fixture
def forged(tmp_path: Path, played: Path) -> Path:
    """A log, right in all else, whose policies are named for code and for files."""
    with RallyLog(played) as log:
        header = dataclasses.replace(log.header, policies=tuple(Player(name=name) for name in FORGED))
    rallies = read_rallies(played).slice(0, 200)
    policy = np.stack([np.arange(200) % len(FORGED), np.arange(1, 201) % len(FORGED)], axis=1).astype(np.uint16)
    with RallyLogWriter(tmp_path / "forged.mcap", header) as writer:
        writer.append(dataclasses.replace(rallies, policy=policy))
    return tmp_path / "forged.mcap"


class Watch:
    """Notes imports and files that are opened; an audit hook cannot be taken away, so it is switched off."""

    def __init__(self) -> None:
        self.on = False
        self.seen: list[tuple[str, object]] = []
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[object, ...]) -> None:
        if self.on and event in ("import", "open", "os.listdir", "os.scandir") and arguments:
            self.seen.append((event, arguments[0]))


@pytest.fixture(scope="module")
def watch() -> Watch:
    return Watch()


@pytest.mark.parametrize(
    "command",
    [
        (recording, ["info", "LOG"]),
        (recording, ["check", "LOG"]),
        (recording, ["recover", "LOG", "--out", "recovered.mcap"]),
        (recording, ["export", "LOG", "strokes.parquet", "--rows", "strokes"]),
        (recording, ["show", "LOG", "--rally", "1"]),
        (recording, ["scene", "LOG", "--rally", "1", "--out", "scene.mcap"]),
        (analysis, ["LOG", "--rallies", "50", "--out", "pictures"]),
    ],
    ids=lambda command: "-".join([command[0].__name__.rpartition(".")[2], *command[1]]),
)
def test_a_forged_log_runs_no_code_and_opens_no_other_file(
    command: tuple[ModuleType, list[str]], forged: Path, watch: Watch, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, arguments = command
    folder = forged.parent
    (folder / "evil_module.py").write_text("from pathlib import Path\nPath('marker').write_text('ran')\n\ndef attribute(): ...\n")
    sys.modules.pop("evil_module", None)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    watch.seen, watch.on = [], True
    try:
        status = module.main([str(forged) if each == "LOG" else each for each in arguments])
    finally:
        watch.on = False
    assert status in (0, 1)
    assert watch.seen
    assert not (folder / "marker").exists()
    assert "evil_module" not in sys.modules
    assert not any("evil" in str(what) for event, what in watch.seen if event == "import")
    # Pictures that are named for a player stay in the folder that was asked for.
    opened = [folder / what for event, what in watch.seen if event != "import" and isinstance(what, str)]
    named = [path for path in opened if any(word in path.name for word in ("evil", "passwd", "secret"))]
    assert all(path.resolve().parent == folder / "pictures" for path in named)


ESCAPES = "\x1b[31mred\x1b]0;title\x07\u202e\n[/bold]"


@pytest.mark.parametrize(
    "command",
    [(recording, ["info", "LOG"]), (recording, ["show", "LOG", "--match", "0"]), (analysis, ["LOG", "--rallies", "20"])],
    ids=lambda command: "-".join([command[0].__name__.rpartition(".")[2], *command[1]]),
)
def test_names_reach_the_terminal_without_control_characters(
    command: tuple[ModuleType, list[str]], played: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RallyLog(played) as log:
        header = dataclasses.replace(log.header, policies=(Player(name=ESCAPES),) * 3, software=ESCAPES)
        rallies = log.batch(0)[1].slice(0, 50)
    with RallyLogWriter(tmp_path / "a.mcap", header) as writer:
        writer.append(rallies)
    module, arguments = command
    assert module.main([str(tmp_path / "a.mcap") if each == "LOG" else each for each in arguments]) == 0
    printed = capsys.readouterr()
    assert "\\x1b[31mred" in printed.out
    assert recording.main(["info", f"/nowhere/{ESCAPES}"]) == 1
    for text in (printed.out, printed.err, capsys.readouterr().err):
        assert [c for c in text if not c.isprintable() and c != "\n"] == []


def write_with_header(path: Path, text: str, header: LogHeader) -> None:
    """A log whose header is this text, sealed if it is an object."""
    with contextlib.suppress(ValueError, TypeError, RecursionError, AttributeError):
        fields = json.loads(text)
        fields.pop("checksum", None)
        text = seal(fields).decode()
    metadata = {"header": text, "version": "4"}

    class Forged(LogHeader):
        def to_metadata(self) -> dict[str, str]:
            return metadata

    RallyLogWriter(path, Forged(**{f.name: getattr(header, f.name) for f in dataclasses.fields(header)})).close()


@pytest.mark.parametrize(
    "text",
    ["null", "[" * 100_000, '{"policies":' + "[" * 100_000 + "]" * 100_000 + "}", '{"seed":' + "9" * 10_000 + "}", "{}"],
    ids=["null", "open", "deep", "digits", "empty"],
)
def test_strange_headers_are_refused(tmp_path: Path, header: Callable[..., LogHeader], text: str) -> None:
    path = tmp_path / "a.mcap"
    write_with_header(path, text, header())
    for read in (RallyLog, check, recover):
        with pytest.raises(RecordingError, match=r"its header is not one of version 4" if text == "{}" else "the header"):
            read(path)
    for command in ("info", "check", "recover"):
        assert recording.main([command, str(path)]) == 1


def test_what_is_no_file_is_refused_quickly(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "a.mcap")
    os.mkfifo(tmp_path / "b.mcap.part")
    for path in (tmp_path / "a.mcap", tmp_path / "b.mcap.part", Path("/dev/zero"), tmp_path):
        for command in (["info"], ["check"], ["recover"], ["show", "--rally", "0"], ["export", str(tmp_path / "x.csv")]):
            assert recording.main([command[0], str(path), *command[1:]]) == 1
            assert "not a regular file" in capsys.readouterr().err


def test_one_lost_log_does_not_keep_the_others(log_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = log_file.read_bytes()
    first = chunks_of(log_file)[0][0]
    log_file.unlink()
    (tmp_path / "a.mcap.part").write_bytes(content[: first + 50])
    (tmp_path / "b.mcap.part").write_bytes(content[:-100])
    assert recording.main(["recover", str(tmp_path)]) == 1
    printed = capsys.readouterr()
    assert "a.mcap.part: nothing could be recovered" in printed.err
    assert "b.mcap: 100 rallies" in printed.out
    with pytest.raises(RecordingError, match="nothing could be recovered"):
        recover(tmp_path / "a.mcap.part")


@pytest.mark.skipif(sys.platform == "win32", reason="needs a limit on file sizes")
def test_recovering_on_a_full_disk_leaves_nothing_behind(log_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python would keep a module that it could only write in part
    part = unfinished(log_file)
    log_file.rename(part)
    for limit in (1_000, part.stat().st_size - 100):
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            with pytest.raises(RecordingError, match=r"cannot be written \(File too large\); .* is unchanged: free disk space"):
                recover(part)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        assert list(tmp_path.iterdir()) == [part]


@pytest.mark.parametrize("name", ["x" * 256 + ".csv", "\udcff.csv", "folder.csv"], ids=["long", "undecodable", "folder"])
def test_an_impossible_target_is_refused_in_words(
    log_file: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "folder.csv").mkdir()
    before = sorted(tmp_path.iterdir())
    target = str(tmp_path / name)
    for arguments in (["export", str(log_file), target], ["recover", str(log_file), "--out", target]):
        assert recording.main(arguments) == 1
        assert ("expected text in UTF-8" if "udcff" in ascii(name) else "cannot be written") in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before
    assert recording.main(["info", "x" * 300]) == 1
    assert "File name too long" in capsys.readouterr().err


def test_a_chunk_that_says_less_than_it_unpacks_to_is_refused_before_it_does() -> None:
    bomb = Chunk("zstd", zstandard.compress(bytes(1 << 28)), 0, 0, 0, 1 << 10)
    with pytest.raises(DamagedLogError, match="the sizes in a chunk disagree"):
        message_of_chunk(body_of(bomb))
    honest = Chunk("zstd", zstandard.compress(bytes(1 << 10)), 0, 1, 0, 1 << 10)
    with pytest.raises(DamagedLogError, match="the checksum of a chunk"):
        message_of_chunk(body_of(honest))
    for other in ("gzip", "lz4"):
        with pytest.raises(DamagedLogError, match=f"packed as '{other}'"):
            message_of_chunk(body_of(dataclasses.replace(honest, compression=other)))


def test_a_chunk_of_many_records_is_refused() -> None:
    empty = bytes([200, *bytes(8)]) * 1000  # records of an unknown kind without a body
    crc, size = zlib.crc32(empty), len(empty)
    chunk = Chunk("zstd", zstandard.compress(empty), 0, 0, uncompressed_crc=crc, uncompressed_size=size)
    with pytest.raises(DamagedLogError, match="0 messages in the first 9 records"):
        message_of_chunk(body_of(chunk))


@pytest.mark.parametrize(
    ("kind", "says"), [("bomb", "columns are compressed again"), ("names", "names of up to 1000 characters")]
)
def test_files_that_expand_are_refused(kind: str, says: str, tmp_path: Path) -> None:
    mutator = Mutator(tmp_path, 0)
    mutator.make(kind)
    with pytest.raises(RecordingError, match=says):
        read_all(mutator.path)
    with pytest.raises(RecordingError):
        recover(mutator.path)


def body_of(chunk: Chunk) -> bytes:
    builder = RecordBuilder()
    chunk.write(builder)
    return builder.end()[FRAME.size :]
