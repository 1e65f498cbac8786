"""A log through appends, flushes, kills, cuts, damage and resumptions, against the list of its rallies."""

import re
import shutil
import tempfile
from pathlib import Path
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from shuttle_marl.recording import Rallies, RallyLog, RallyLogWriter, RecordingError, recover
from shuttle_marl.recording.recorder import resume
from tests.recording.conftest import a_header, read_rallies, same, some_rallies

OPTIONS: dict[str, Any] = {"batch_rallies": 8}
writing = precondition(lambda self: self.writing)
killed = precondition(lambda self: not self.writing)


class Log(RuleBasedStateMachine):
    """``rallies`` were appended; batches end at the numbers in ``ends``."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="log-"))
        self.start()

    def start(self) -> None:
        for file in self.folder.iterdir():
            file.unlink()
        self.log = RallyLogWriter(self.folder / "a.mcap", a_header(), **OPTIONS)
        self.rallies, self.ends, self.writing, self.damaged = some_rallies(0), [0], True, False

    def teardown(self) -> None:
        if self.writing:
            self.log.close()
            assert same(read_rallies(self.folder), self.rallies)
        shutil.rmtree(self.folder)

    def unfinished(self) -> Path:
        (part,) = self.folder.glob("a*.part")
        return part

    @writing
    @rule(counts=st.lists(st.sampled_from((8, 8, 8, 20, 1, 0)), min_size=1, max_size=6), flushed=st.booleans())
    def append(self, counts: list[int], flushed: bool) -> None:
        for count in counts:
            part = some_rallies(count, len(self.rallies))
            self.log.append(part)
            self.rallies = Rallies.concatenate([self.rallies, part])
            if flushed:
                assert self.log.flush(sync=False) == len(self.rallies)
                self.ends.append(len(self.rallies))

    @writing
    @rule(torn=st.just(0) | st.integers(1, 3000), hit=st.none() | st.integers(0, 3))
    def kill(self, torn: int, hit: int | None) -> None:
        """What is left may be cut, and one of its batches damaged: they stand behind the names of their compression."""
        self.log.abort()
        content = bytearray(self.unfinished().read_bytes())
        batches = [found.end() for found in re.finditer(b"zstd", content) if found.end() + 50 < len(content)]
        self.writing, self.damaged = False, torn > 0 or (hit is not None and bool(batches))
        if hit is not None and batches:
            content[batches[hit % len(batches)] + 50] ^= 0xFF
        self.unfinished().write_bytes(content[: len(content) - torn])

    @killed
    @rule()
    def recover(self) -> None:
        copy = self.folder / "copy.mcap"
        try:
            found = recover(self.unfinished(), copy)
        except RecordingError:
            assert self.damaged or not self.ends[-1]
            return
        with RallyLog(copy) as log:
            batches = list(log.batches())
        for first, batch in batches:
            assert same(batch, self.rallies.slice(first, first + len(batch)))
        if not self.damaged:
            assert found.lost == 0
            assert batches[-1][0] + len(batches[-1][1]) >= self.ends[-1]
        copy.unlink()

    @killed
    @rule(back=st.integers(0, 3))
    def resume(self, back: int) -> None:
        keep = self.ends[-1 - back % len(self.ends)]
        try:
            self.log = resume(self.folder / "a.mcap", a_header(), keep, **OPTIONS)
        except RecordingError:
            assert self.damaged
            self.start()
            return
        self.rallies, self.ends = self.rallies.slice(0, keep), [end for end in self.ends if end <= keep]
        self.writing, self.damaged = True, False
        if keep:  # a log with a hole is not resumed
            assert recover(self.unfinished(), self.folder / "copy.mcap").lost == 0
            (self.folder / "copy.mcap").unlink()


TestLog = Log.TestCase
TestLog.settings = settings(max_examples=25, stateful_step_count=25, deadline=None)
