"""A run folder through starts, interrupts, resumptions, replacements and damage, against what should be in it."""

import contextlib
import json
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from shuttle_marl.base.runs import CONFIG, LOCK, MANIFEST, RunError, is_finished, locked, open_run, write_json

SEEDS = st.integers(0, 1)


class Run(RuleBasedStateMachine):
    """``seed`` is that of the configuration, None without a run and -1 if it is damaged; ``files`` are all others."""

    def __init__(self) -> None:
        super().__init__()
        self.home = Path(tempfile.mkdtemp(prefix="run-"))
        self.folder = self.home / "run"
        self.seed: int | None = None
        self.files = set[str]()

    def teardown(self) -> None:
        shutil.rmtree(self.home)

    def open(self, seed: int, *, resume: bool = False, overwrite: bool = False) -> None:
        with open_run(self.folder, "run", {"seed": seed}, resume=resume, overwrite=overwrite):
            pass

    def refused(self) -> str | None:
        """Why nothing new may be started here without ``overwrite``."""
        if self.seed is None:
            return "contains files that are not a run" if self.files else None
        state = "a finished run" if is_finished(self.folder) else "an unfinished run"
        return f"contains {state}; --resume continues it" if self.files - {MANIFEST} else None

    @rule(seed=SEEDS, overwrite=st.booleans())
    def start(self, seed: int, overwrite: bool) -> None:
        says = self.refused()
        if says and not (overwrite and self.seed is not None):
            with pytest.raises(RunError, match=says):
                self.open(seed, overwrite=overwrite)
        else:
            self.open(seed, overwrite=overwrite)
            self.seed, self.files = seed, set()

    @rule(seed=SEEDS)
    def resume(self, seed: int) -> None:
        if self.seed == seed:
            self.open(seed, resume=True)
            return
        says = "no run to resume" if self.seed is None else "cannot be read" if self.seed < 0 else r"other flags \(seed"
        with pytest.raises(RunError, match=says):
            self.open(seed, resume=True)

    @precondition(lambda self: self.seed in (0, 1))
    @rule(name=st.sampled_from(["rallies.mcap", "checkpoints/1"]))
    def play_and_be_interrupted(self, name: str) -> None:
        with (
            contextlib.suppress(KeyboardInterrupt),
            open_run(self.folder, "run", {"seed": self.seed}, resume=True, overwrite=False),
        ):
            (self.folder / name).parent.mkdir(exist_ok=True)
            (self.folder / name).touch()
            raise KeyboardInterrupt
        self.files.add(name)

    @precondition(lambda self: self.seed is not None)
    @rule(status=st.sampled_from(["running", "finished"]))
    def describe(self, status: str) -> None:
        write_json(self.folder / MANIFEST, {"status": status})
        self.files.add(MANIFEST)
        assert is_finished(self.folder) == (status == "finished")

    @precondition(lambda self: self.seed is not None)
    @rule(content=st.sampled_from([b"[]", b"[" * 200_000, b"\xff", b""]), name=st.sampled_from([CONFIG, MANIFEST]))
    def damage(self, content: bytes, name: str) -> None:
        (self.folder / name).write_bytes(content)
        if name == CONFIG:
            self.seed = -1
        else:
            self.files.add(MANIFEST)
            assert not is_finished(self.folder)

    @precondition(lambda self: self.seed is None and self.folder.exists())
    @rule()
    def be_killed_before_the_configuration(self) -> None:
        (self.folder / f".{CONFIG}.0123456789ab.part").write_text("{")

    @precondition(lambda self: self.seed is None)
    @rule()
    def hold_something_else(self) -> None:
        self.folder.mkdir(exist_ok=True)
        (self.folder / "letter.txt").touch()
        self.files.add("letter.txt")

    @precondition(lambda self: self.seed is not None)
    @rule(seed=SEEDS, resume=st.booleans())
    def be_busy(self, seed: int, resume: bool) -> None:
        with locked(self.folder), pytest.raises(RunError, match="another process"):
            self.open(seed, resume=resume, overwrite=not resume)

    @invariant()
    def holds_what_it_should(self) -> None:
        found = {str(path.relative_to(self.folder)) for path in self.folder.rglob("*") if not path.is_dir()}
        assert {name for name in found if not name.endswith(".part")} - {LOCK} == self.files | (
            {CONFIG} if self.seed is not None else set()
        )
        if self.seed in (0, 1):
            assert json.loads((self.folder / CONFIG).read_text()) == {"seed": self.seed}


TestRun = Run.TestCase
TestRun.settings = settings(max_examples=50, stateful_step_count=25, deadline=None)
