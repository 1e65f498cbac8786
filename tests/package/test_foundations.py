"""Functions that all packages share: intervals, journals, files, programs, checks, bounds, caches and interrupts."""

import dataclasses
import errno
import json
import math
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from shuttle_marl.base import files, runs, table_files
from shuttle_marl.base.cache import NAME, Cache, key_of
from shuttle_marl.base.errors import OptionError, ShuttleError, described, suggesting
from shuttle_marl.base.files import (
    Count,
    CountOrZero,
    FileReadError,
    Fraction,
    FractionOrZero,
    Positive,
    Seed,
    Weight,
    check_bounds,
)
from shuttle_marl.base.runs import Journal, RunError


def message(call: Callable[..., object], kind: type[Exception] = ShuttleError, *arguments: Any) -> str:
    """Message of an error; empty without one."""
    try:
        call(*arguments)
    except kind as error:
        return str(error)
    return ""


# Errors.


def test_arguments_that_a_constructor_lacks() -> None:
    @suggesting
    class Made:
        def __init__(self, length: int, width: int = 2) -> None:
            self.size = length, width

    make: Any = Made
    assert (make(1).size, make(1, width=5).size, make(length=3).size) == ((1, 2), (1, 5), (3, 2))
    start = "Made() got an unexpected keyword argument"
    assert message(lambda: make(1, lenght=3), TypeError) == f"{start} 'lenght'; did you mean length?"
    assert message(lambda: make(1, zzz=3), TypeError) == f"{start} 'zzz'; there are length, width"
    assert "rows are reset in the same step" in message(lambda: make(1, autoreset_mode=3), TypeError)


def test_errors_of_others_are_described() -> None:
    class Broken(Exception):
        def __str__(self) -> str:
            raise RuntimeError

    assert described(ValueError("wrong")) == "ValueError: wrong"
    assert described(Broken()) == "Broken: (its message cannot be read)"
    assert described(ValueError("x" * 1000)) == "ValueError: " + "x" * 1000
    assert described(ValueError("x" * 1001)) == "ValueError: " + "x" * 1000 + "\N{HORIZONTAL ELLIPSIS}"


# Bounds.


@pytest.mark.parametrize(
    ("kind", "fine", "wrong"),
    [
        (Count, (1, 10**15, np.int64(7)), (0, 10**15 + 1, 2.0)), (CountOrZero, (0, 10**15), (-1, 10**15 + 1, 0.5)),
        (Positive, (1e-30, 1e30, 1), (0, 9e-31, 1.1e30, math.nan)), (Fraction, (1e-30, 1), (0, 1.01, math.nan)),
        (FractionOrZero, (0, 1), (-0.01, 1.01)), (Weight, (0, 10), (-0.1, 10.1)),
        (Seed, (0, (1 << 63) - 1), (-1, 1 << 63)),
    ],
)  # fmt: skip
def test_bounds_of_settings(kind: Any, fine: tuple[Any, ...], wrong: tuple[Any, ...]) -> None:
    config = dataclasses.make_dataclass("Config", [("the_number", kind), ("other", kind | None, None)])
    for value in fine:
        check_bounds(config(value), OptionError)
        check_bounds(config(fine[0], value), OptionError)
    for value in wrong:
        assert message(check_bounds, OptionError, config(value), OptionError).startswith(f"--the-number {value}: expected ")
        assert message(check_bounds, OptionError, config(fine[0], value), OptionError).startswith("--other ")


# Run folders and journals.


def test_a_journal_keeps_whole_lines(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = Journal(path, restore="ask for help")
    assert journal.read() == []
    journal.append([{"n": 1}, {"n": 2}])
    journal.append([{"n": 3}])
    whole = path.read_bytes()
    assert (journal.read(), whole.count(b"\n")) == ([{"n": 1}, {"n": 2}, {"n": 3}], 3)
    path.write_bytes(whole + b'{"n": 4')
    assert journal.read() == [{"n": 1}, {"n": 2}, {"n": 3}]
    assert message(lambda: journal.read(finished=True), RunError) == f"{path}: the last line is incomplete; ask for help"
    journal.keep(3)
    assert path.read_bytes() == whole
    assert journal.read(finished=True) == journal.read()
    assert message(lambda: journal.keep(4), RunError) == f"{path}: 3 lines, expected 4; ask for help"
    first, second, _ = whole.splitlines(keepends=True)
    path.write_bytes(first + second.replace(b"2", b"7") + b"x\n")
    assert message(journal.read, RunError).startswith(f"{path}: line 2 is damaged (it was changed")
    assert "line 2 is damaged" in message(lambda: journal.keep(2), RunError)
    journal.keep(1)
    assert path.read_bytes() == first
    journal.keep(0)
    assert path.read_bytes() == b""


def test_a_journal_on_a_full_disk_leaves_no_part_of_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal, path = Journal(tmp_path / "journal", go_on="go on"), tmp_path / "journal"
    journal.append([{"n": 1}])
    whole = path.read_bytes()

    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        told = message(lambda: journal.append([{"n": 2}]), RunError)
    assert told == f"{path}: cannot be written (No space left on device); free disk space and go on"
    assert path.read_bytes() == whole
    journal.append([{"n": 3}])
    assert journal.read() == [{"n": 1}, {"n": 3}]


# Files.


def test_sealed_files_and_cards(tmp_path: Path) -> None:
    content = files.seal({"b": 1, "a": "\u00e9"})
    assert files.unsealed(content) == {"b": 1, "a": "\u00e9"}
    assert content.decode().startswith('{\n  "b": 1,\n  "a": "\u00e9",\n  "checksum": "')
    assert files.seal({"a": 1}, indent=None).count(b"\n") == 1
    assert files.unsealed(json.dumps(dict(reversed(json.loads(content).items()))).encode()) == {"a": "\u00e9", "b": 1}
    assert "checksum does not match" in message(lambda: files.unsealed(content.replace(b"1", b"2", 1)), ValueError)
    assert "not a JSON object" in message(lambda: files.unsealed(b"[1]"), ValueError)
    assert "checksum" in message(lambda: files.unsealed(b"{}"), ValueError)
    files.replace_with_card(tmp_path / "card", {"n": 1}, {"x": b"1", "y": b"2"})
    card = files.read_sealed(tmp_path / "card")
    assert (card["n"], files.hash_in(card, "y")) == (1, files.content_hash(b"2"))
    assert "does not hold the hash of z" in message(lambda: files.hash_in(card, "z"), ValueError)
    assert message(lambda: files.hash_in({"sha256": 3}, "z"), ValueError)
    assert message(lambda: files.hash_in({"sha256": {"z": 3}}, "z"), ValueError)
    assert files.read_json(tmp_path / "card", dict, sealed=True) == card
    assert message(lambda: files.read_json(tmp_path / "x", dict), FileReadError)
    assert "larger" in message(lambda: files.read_json(tmp_path / "card", dict, limit=3), FileReadError)
    (tmp_path / "z").write_text("{}")
    assert "checksum" in message(lambda: files.read_json(tmp_path / "z", dict, sealed=True), FileReadError)


# Caches, interrupts and clusters.


def test_a_cache_keeps_the_newest_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    cache, keys = Cache("tested", 3), [key_of("a", str(number)) for number in range(5)]
    assert len(set(keys)) == 5
    assert key_of("a", "0") == keys[0]
    assert cache.read(keys) == {}
    for key in keys:
        cache.store({key: b"result of " + key})
    assert cache.read(keys) == {key: b"result of " + key for key in keys[2:]}
    cache.store({keys[3]: b"new"})
    assert cache.read(keys[3:4]) == {keys[3]: b"new"}
    assert Cache("other", 3).read(keys) == {}
    (stored,) = tmp_path.rglob(NAME)
    stored.write_bytes(stored.read_bytes().replace(b"result of ", b"resulX of "))
    assert cache.read(keys).keys() == {keys[3]}, "damaged results are none"
    stored.write_bytes(b"no database" * 100)
    assert cache.read(keys) == {}
    assert not stored.exists()


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Processes in the background of a shell ignore interrupts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_interrupts_are_not_held_elsewhere() -> None:
    handlers = []

    def look() -> None:
        with runs.interrupts_held():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
    with runs.interrupts_held():
        held = signal.getsignal(signal.SIGINT)
        look()
        assert signal.getsignal(signal.SIGINT) is held, "the outer context ends later"
    with runs.interrupts_blocked():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


# Bounds of files and late programs.


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"PAR1\x00\x00\x00\x00PAR", b"PAR1" + (9).to_bytes(4, "little") + b"PAR1", b"x" * 40]
)
def test_files_that_are_no_tables(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "t").write_bytes(content)
    assert "not a Parquet file, or truncated" in message(lambda: table_files.read_parquet(tmp_path / "t"), pa.ArrowInvalid)
