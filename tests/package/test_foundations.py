"""Functions that all packages share: intervals, run folders, journals, files, programs, checks, bounds, caches and clusters."""

import dataclasses
import errno
import functools
import io
import json
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy import stats

from shuttle_marl.base import cluster, extras, files, interrupts, runs, table_files
from shuttle_marl.base.bounds import (
    Count,
    CountOrZero,
    Fraction,
    FractionOrZero,
    Growth,
    Positive,
    Seed,
    Weight,
    Within,
    check_bounds,
)
from shuttle_marl.base.cache import NAME, Cache, key_of
from shuttle_marl.base.cluster import ClusterError, Shared, Task, check_processes, in_processes, in_threads
from shuttle_marl.base.errors import (
    OptionError,
    ShuttleError,
    command,
    described,
    did_you_mean,
    seed_number,
    suggesting,
    whole_number,
)
from shuttle_marl.base.files import FileReadError, FileWriteError
from shuttle_marl.base.intervals import Interval, Moments, combined, estimate, interquartile_mean, probability_of_improvement
from shuttle_marl.base.programs import Program, ProgramError, ProgramTimeoutError
from shuttle_marl.base.runs import CONFIG, LOCK, MANIFEST, Journal, RunError
from shuttle_marl.base.tensor_files import checked, packed_bytes, read_tensors, tensor_bytes, unpacked_bytes


def message(call: Callable[..., object], kind: type[Exception] = ShuttleError, *arguments: Any) -> str:
    """Message of an error; empty without one."""
    try:
        call(*arguments)
    except kind as error:
        return str(error)
    return ""


# Intervals.


def test_moments_of_a_sample() -> None:
    assert estimate([3.0], trimmed=False)[::2] == (3.0, 0)
    assert math.isnan(estimate([3.0], trimmed=True).variance)
    # Mean 3, variance 20 / 3, of which the error is a quarter.
    assert estimate([0.0, 2.0, 4.0, 6.0], trimmed=False) == pytest.approx((3.0, 20 / 3 / 4, 3))
    # 0 and 100 are left out; the winsorised sample is 1, 1, 2, 3, 3 ... of mean 2: sum of squares 4; (n - 1) s² / (h (h - 1)).
    assert estimate([100.0, 1.0, 2.0, 0.0, 3.0], trimmed=True) == pytest.approx((2.0, 4 / (3 * 2), 2))
    assert estimate([5.0, 1.0, 3.0], trimmed=True) == estimate([5.0, 1.0, 3.0], trimmed=False), "a quarter of three is none"
    numbers = np.arange(8.0) ** 2
    kept = np.clip(numbers, numbers[2], numbers[5])
    assert estimate(numbers, trimmed=True) == pytest.approx((numbers[2:6].mean(), kept.var(ddof=1) * 7 / (4 * 3), 3))


def test_combined_estimates() -> None:
    one, other = Moments(1.0, 0.04, 4), Moments(3.0, 0.16, 9)
    found = combined([one, other], [3, 1])
    share = np.array([0.75, 0.25])
    errors = share**2 * [0.04, 0.16]
    freedom = errors.sum() ** 2 / (errors**2 / [4, 9]).sum()
    half = stats.t.ppf(0.975, freedom) * math.sqrt(errors.sum())
    assert found == pytest.approx((1.5, 1.5 - half, 1.5 + half))
    exact = stats.ttest_1samp([1.0, 2.0, 4.0, 8.0], 0).confidence_interval(0.95)
    assert combined([estimate([1.0, 2.0, 4.0, 8.0], trimmed=False)], [1])[1:] == pytest.approx((exact.low, exact.high))
    assert combined([Moments(1.0, 0.0, 3)], [2]) == (1, 1, 1)
    unknown = combined([one, Moments(3.0, math.nan, 0)], [1, 1])
    assert unknown.value == 2
    assert math.isnan(unknown.low)
    assert math.isnan(unknown.high)


def test_interquartile_means_and_chances_of_improvement() -> None:
    # The middle half of 0 to 7 is 2 to 5.
    found = interquartile_mean([[0.0, 7.0, 2.0, 5.0], [1.0, 3.0, 4.0, 6.0]])
    assert found.value == 3.5
    assert 0 < found.low < 3.5 < found.high < 7
    assert interquartile_mean([[2.0, 2.0], [2.0, 2.0]]) == Interval(2, 2, 2)
    assert math.isnan(interquartile_mean([[1.0], [2.0, 3.0]]).low)
    # Of 4 x 2 pairs six are larger and one is equal.
    better = probability_of_improvement([1.0, 3.0, 4.0, 5.0], [0.0, 3.0])
    assert better.value == (1 + 1.5 + 2 + 2) / 8
    assert 0 < better.low < better.value < better.high <= 1
    assert probability_of_improvement([0.0, 3.0], [1.0, 3.0, 4.0, 5.0]).value == 1 - better.value
    assert probability_of_improvement([1.0, 1.0], [1.0, 1.0]) == Interval(0.5, 0.5, 0.5)
    assert math.isnan(probability_of_improvement([2.0], [1.0, 1.0]).high)
    assert interquartile_mean([[0.0, 1.0, 5.0]], seed=1) == interquartile_mean([[0.0, 1.0, 5.0]], seed=1)


# Errors.


def test_whole_numbers_and_seeds() -> None:
    assert (whole_number("n", np.int8(3)), whole_number("n", 3, 3), whole_number("n", True)) == (3, 3, 1)
    assert message(lambda: whole_number("n", 2, 3), OptionError) == "n 2: expected a whole number, 3 or more"
    assert message(lambda: whole_number("n", 2.0), OptionError) == "n 2.0: expected a whole number"
    assert message(lambda: whole_number("n", "2", 0), OptionError) == "n '2': expected a whole number, 0 or more"
    assert (seed_number(0), seed_number((1 << 64) - 1)) == (0, (1 << 64) - 1)
    assert [bool(message(seed_number, OptionError, value)) for value in (-1, 1 << 64)] == [True, True]


def test_hints_at_names() -> None:
    assert did_you_mean("smsh", ["smash", "clear"]) == "; did you mean smash?"
    assert did_you_mean("clea", ["clear", "clears", "cleat", "clean"]).count(" or ") == 2
    assert did_you_mean("xyz", ["smash"]) == ""
    assert did_you_mean("sxxxh", ["smash"]) == ""
    assert did_you_mean("sxxxh", ["smash"], cutoff=0.3) == "; did you mean smash?"


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


def test_commands_work_as_printed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    found: dict[str, str | None] = {}
    monkeypatch.setattr("shuttle_marl.base.errors.shutil.which", found.get)
    monkeypatch.setattr(sys, "executable", "/env/bin/python3")
    assert command("data", "import", "my file.csv") == "/env/bin/python3 -m shuttle_marl.data import 'my file.csv'"
    found["python"] = "/usr/bin/python"
    assert command("data") == "/env/bin/python3 -m shuttle_marl.data"
    found["python"] = "/env/bin/python"
    assert command("data", "a\x1b") == r"python -m shuttle_marl.data 'a\x1b'"
    found.clear()
    monkeypatch.setattr(sys, "executable", str(tmp_path / "env" / "python"))
    assert command("data") == "env/python -m shuttle_marl.data"


def test_extras_and_how_to_install_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    clone = Path(extras.__file__).parents[2]
    assert extras.install_hint("train") == f"`make install` in {clone} installs it, or `pip install -e {clone}[train]`" or (
        "'" in extras.install_hint("train")
    )
    assert "make install" not in extras.install_hint("ray")
    lacking = extras.lacking(ModuleNotFoundError(name="torch.nn"))
    assert lacking == f"this needs torch, which is not installed; {extras.install_hint('train')}"
    assert extras.lacking(ModuleNotFoundError(name="os.nothing")) is None
    assert extras.lacking(ModuleNotFoundError("text alone")) is None

    def missing(name: str, text: str = "none") -> None:
        with extras.hinted():
            raise ModuleNotFoundError(text, name=name)

    assert message(lambda: missing("pandas"), ModuleNotFoundError).startswith("this needs pandas, which")
    assert message(lambda: missing("other"), ModuleNotFoundError) == "none"
    monkeypatch.setattr(extras, "__file__", str(tmp_path / "a" / "b" / "extras.py"))
    assert extras.install_hint("train") == "install it again with its extra, in the clone by `pip install '.[train]'`"


# Bounds.


@pytest.mark.parametrize(
    ("kind", "fine", "wrong"),
    [
        (Count, (1, 10**15, None), (0, 10**15 + 1, 2.0)), (CountOrZero, (0, 10**15), (-1, 10**15 + 1, 0.5)),
        (Positive, (1e-30, 1e30, 1), (0, 9e-31, 1.1e30, math.nan)), (Fraction, (1e-30, 1), (0, 1.01, math.nan)),
        (FractionOrZero, (0, 1), (-0.01, 1.01)), (Weight, (0, 10), (-0.1, 10.1)), (Growth, (0, 1000), (-0.1, 1000.1)),
        (Seed, (0, (1 << 63) - 1), (-1, 1 << 63)),
        (Annotated[float, Within(above=2.0, text="more than two")], (2.1, 1e300), (2.0, math.inf, math.nan)),
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


def test_what_a_folder_holds(tmp_path: Path) -> None:
    for name in (CONFIG, MANIFEST, LOCK):
        (tmp_path / name).write_text("{}")
    (tmp_path / "empty").mkdir()
    assert not runs.has_results(tmp_path)
    (tmp_path / "empty" / CONFIG).write_text("{}")
    assert runs.has_results(tmp_path), "a description in a folder below is a result"
    assert not runs.is_finished(tmp_path)
    runs.write_json(tmp_path / MANIFEST, {"status": "finished", "name": "\udcff\u00e9"})
    assert runs.is_finished(tmp_path)
    assert (tmp_path / MANIFEST).read_bytes() == '{\n  "status": "finished",\n  "name": "\\udcff\u00e9"\n}\n'.encode()
    runs.write_json(tmp_path / MANIFEST, {"status": "running"})
    assert not runs.is_finished(tmp_path)
    assert "start the run again with --overwrite" in message(lambda: runs.read_json(tmp_path / "none.json", dict), RunError)


def opened(out: Path | None, *, resume: bool = False, overwrite: bool = False, **fixed: int) -> Path:
    with runs.open_run(out, "test", fixed, resume=resume, overwrite=overwrite) as folder:
        return folder


def test_a_folder_is_created_resumed_and_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert (opened(None, seed=1), opened(None, seed=1), opened(None, seed=1)) == (
        Path("runs/test"),
        Path("runs/test-2"),
        Path("runs/test-3"),
    )
    assert json.loads(Path("runs/test", CONFIG).read_text()) == {"seed": 1}
    os.utime(Path("runs/test-2", CONFIG), (1, 1))
    os.utime(Path("runs/test", CONFIG), (2, 2))
    os.utime(Path("runs/test-3", CONFIG), (3, 3))
    runs.write_json(Path("runs/test-3", MANIFEST), {"status": "finished"})
    assert opened(None, resume=True, seed=1) == Path("runs/test"), "the newest one that is not finished"
    told = message(lambda: opened(None, resume=True, seed=2, more=3), RunError)
    assert "was started with other flags (seed: 1 then, 2 now; more: None then, 3 now); give the same ones" in told
    assert "no run to resume in none; omit --resume" in message(lambda: opened(Path("none"), resume=True), RunError)
    assert opened(Path("runs/test"), seed=5) == Path("runs/test"), "it has no results"
    Path("runs/test", "a").mkdir()
    Path("runs/test", "a", "x").touch()
    told = "runs/test: contains an unfinished run; --resume continues it"
    assert told in message(lambda: opened(Path("runs/test"), seed=6), RunError)
    assert json.loads(Path("runs/test", CONFIG).read_text()) == {"seed": 5}
    assert opened(Path("runs/test"), overwrite=True, seed=6) == Path("runs/test")
    assert sorted(path.name for path in Path("runs/test").iterdir()) == [LOCK, CONFIG]
    Path("runs/test", "x").touch()
    runs.write_json(Path("runs/test", MANIFEST), {"status": "finished"})
    assert "contains a finished run" in message(lambda: opened(Path("runs/test")), RunError)
    Path("other").mkdir()
    Path("other", "letter.txt").touch()
    for overwrite in (False, True):
        told = message(functools.partial(opened, Path("other"), overwrite=overwrite), RunError)
        assert told == "other: contains files that are not a run; name another folder with --out"


def test_a_folder_is_locked_once(tmp_path: Path) -> None:
    with runs.locked(tmp_path):
        assert (tmp_path / LOCK).read_text() == str(os.getpid())
        told = message(lambda: opened(tmp_path), RunError)
        assert told.startswith(f"{tmp_path}: another process ({os.getpid()}) runs there; wait for it")
        (tmp_path / LOCK).write_text("no number")
        assert message(lambda: opened(tmp_path), RunError).startswith(f"{tmp_path}: another process runs there")
    assert opened(tmp_path) == tmp_path
    assert opened(tmp_path / "a" / "b") == tmp_path / "a" / "b"


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
    with monkeypatch.context() as disk:
        disk.setattr(os, "fsync", full)
        disk.setattr(os, "truncate", lambda *_: full(0))
        message(lambda: journal.append([{"n": 2}]), RunError)
    assert path.read_bytes() != whole
    journal.append([{"n": 3}])
    assert journal.read() == [{"n": 1}, {"n": 3}], "the part is removed before the next line"


def test_the_origin_of_a_run() -> None:
    told = runs.describe(["numpy"])
    assert told["packages"] == {"numpy": np.__version__}
    assert told["command"][0] == "python"
    assert {"shuttle_marl", "git", "python", "platform"} < told.keys()


# Files.


def test_files_are_as_large_as_allowed(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"x" * 2048)
    assert len(files.read_file(path, 2048)) == len(files.read_file(path)) == 2048
    assert "larger than 0.00195217 MB" in message(lambda: files.read_file(path, 2047), OSError)
    assert "not a regular file" in message(lambda: files.read_file(tmp_path), OSError)
    assert files.read_hashed(path, files.content_hash(b"x" * 1024, b"x" * 1024)) == b"x" * 2048
    assert "checksum does not match" in message(lambda: files.read_hashed(path, "0" * 64), ValueError)


def test_files_replace_others_unless_they_are_new(tmp_path: Path) -> None:
    path = tmp_path / "a" / "f"
    files.replace_file(path, b"1", new=True)
    assert "File exists" in message(lambda: files.replace_file(path, b"2", new=True), FileWriteError)
    assert path.read_bytes() == b"1"
    files.replace_file(path, b"3")
    assert path.read_bytes() == b"3"

    def fails() -> None:
        with files.replacing(path) as file:
            file.write(b"4")
            raise KeyError("no")

    assert message(fails, KeyError)
    assert (path.read_bytes(), [each.name for each in path.parent.iterdir()]) == (b"3", ["f"])
    assert "it is a folder; name a regular file" in message(lambda: files.replace_file(path.parent, b""), FileWriteError)
    (tmp_path / "link").symlink_to(path)
    assert "it is a symbolic link" in message(lambda: files.replace_file(tmp_path / "link", b""), FileWriteError)


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


def test_json_is_parsed_strictly() -> None:
    assert math.isnan(files.parsed("NaN"))
    assert message(lambda: files.parsed("[-Infinity]", finite=True), ValueError) == "-Infinity is no number"
    assert message(lambda: files.parsed('{"a": 1, "b": 2, "b": 3}'), ValueError) == "the entry 'b' stands there twice"
    assert message(lambda: files.parsed("[" * 100_000), ValueError) == "nested too deeply"
    assert files.problem(OSError(2, "No such file", "f")) == "No such file"
    assert files.problem(ValueError("x")) == files.problem(OSError("x")) == "x"


def test_arrays_are_packed_and_checked() -> None:
    array = np.arange(12, dtype=np.int16).reshape(3, 4) * 300
    assert (unpacked_bytes(packed_bytes(array), "<i2", (3, 4)) == array).all()
    for shape, says in (
        ((3, 5), "24 bytes, expected 30"),
        ((3, 3), "19 bytes, expected 18"),
        ((-1, 4), "shape"),
        ((1.5,), "shape"),
    ):
        assert says in message(unpacked_bytes, ValueError, packed_bytes(array), "<i2", shape)
    assert "numbers and shape" in message(lambda: unpacked_bytes(packed_bytes(array), "S2", (3, 4)), ValueError)
    assert "cannot be unpacked" in message(lambda: unpacked_bytes(np.ones(9, np.uint8), "<i2", (3, 4)), ValueError)
    assert "of 128 MB, expected" not in message(lambda: unpacked_bytes(packed_bytes(array), "u1", (1 << 27,)), ValueError)
    assert "of 128 MB, expected at most 128" in message(
        lambda: unpacked_bytes(packed_bytes(array), "u1", ((1 << 27) + 1,)), ValueError
    )
    assert checked(array, np.int16, (3, 4)) is array
    for dtype, shape in ((np.int32, (3, 4)), (np.int16, (4, 3))):
        assert "expected int" in message(checked, ValueError, array, dtype, shape)
    assert message(lambda: checked(np.array([np.inf]), float, (1,)), ValueError) == "a number that is not finite"


def test_formulas_in_tables_are_text() -> None:
    words = ["=1", "+1", "-1", "@a", "\ta", "\ra", "a=1", "", None, "'a"]
    table = pa.table({"a": words, "n": range(10), "d": pa.array(words).dictionary_encode()})
    plain = table_files.without_formulas(table)
    expected = [*(f"'{word}" for word in words[:6]), *words[6:]]
    assert (plain["a"].to_pylist(), plain["d"].to_pylist(), plain["n"].to_pylist()) == (expected, expected, list(range(10)))
    assert table_files.csv_bytes(pa.table({"a": ["=1", 'x"']})) == b'"a"\n"\'=1"\n"x"""\n'


# Programs.


def test_programs_answer_in_lines_and_bytes() -> None:
    echo = Program(
        [sys.executable, "-S", "-E", "-c", "import sys; print('ready', flush=True); sys.stdout.write(sys.stdin.read())"]
    )
    assert not echo.started
    echo.write(b"abc\nde")
    assert echo.started
    assert (echo.read_line(), echo.read_rest()) == (b"ready", b"abc\nde")
    echo.close()
    echo.close()
    bytewise = Program("cat", seconds=20)
    bytewise.write(b"abcdef\ngh\n\n")
    assert (bytewise.read(2), bytewise.read_line(), bytewise.read(1), bytewise.read_line()) == (b"ab", b"cdef", b"g", b"h")
    assert bytewise.read_line() == b""
    failed = bytewise.failed("a wrong answer")
    assert str(failed) == "a wrong answer"
    assert message(lambda: bytewise.write(b"x"), ProgramError) == "a wrong answer; it is not asked again"


def test_programs_that_fail_say_how() -> None:
    for empty in ("", ()):
        assert message(Program, ProgramError, empty) == "expected a command"
    assert "No closing quotation" in message(lambda: Program("a 'b"), ProgramError)
    assert "it cannot be started: /none: No such file" in message(lambda: Program(["/none"]).write(b""), ProgramError)
    body = "import sys; sys.stdin.readline(); sys.stderr.write('x' * 400 + '\\x1bend\\n'); sys.exit(3)"
    broken = Program([sys.executable, "-S", "-E", "-c", body])
    broken.write(b"\n")
    tail = "x" * 295 + "\\x1bend"
    assert message(broken.read_line, ProgramError) == f"it exited with status 3: \N{HORIZONTAL ELLIPSIS}{tail}"
    status = Program([sys.executable, "-S", "-E", "-c", "import sys; sys.stdin.read(); sys.exit(2)"])
    status.write(b"x")
    assert message(status.read_rest, ProgramError) == "it exited with status 2"
    long = Program([sys.executable, "-S", "-E", "-c", "import sys; sys.stdin.read(1); sys.stdout.write('x' * 200_000)"])
    long.write(b"x")
    assert message(long.read_line, ProgramError) == "it answered a line of more than 65,536 bytes"


# Caches, interrupts and clusters.


def test_a_cache_keeps_the_newest_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.base.cache.cache_folder", lambda: tmp_path)
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
    content = (tmp_path / NAME).read_bytes()
    (tmp_path / NAME).write_bytes(content.replace(b"result of ", b"resulX of "))
    assert cache.read(keys).keys() == {keys[3]}, "damaged results are none"
    (tmp_path / NAME).write_bytes(b"no database" * 100)
    assert cache.read(keys) == {}
    assert not (tmp_path / NAME).exists()


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Processes in the background of a shell ignore interrupts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_interrupts_wait_for_a_safe_point() -> None:
    steps: list[object] = []

    def interrupted(times: int, check: bool) -> None:
        with interrupts.interrupts_held():
            for _ in range(times):
                signal.raise_signal(signal.SIGINT)
                steps.append(interrupts.was_interrupted())
            if check:
                interrupts.check_interrupt()
            steps.append("after")

    for times, check, expected in ((1, False, [True, "after"]), (1, True, [True]), (2, False, [True]), (0, True, ["after"])):
        steps.clear()
        if times:
            with pytest.raises(KeyboardInterrupt):
                interrupted(times, check)
        else:
            interrupted(times, check)
        assert steps == expected
        assert not interrupts.was_interrupted()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_interrupts_are_not_held_elsewhere() -> None:
    handlers = []

    def look() -> None:
        with interrupts.interrupts_held():
            handlers.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
    with interrupts.interrupts_held():
        held = signal.getsignal(signal.SIGINT)
        look()
        assert signal.getsignal(signal.SIGINT) is held, "the outer context ends later"
    with interrupts.interrupts_blocked():
        assert signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


class _Ray:
    """What is used of Ray, in this process."""

    class exceptions:
        class RayError(Exception):
            pass

        class RayTaskError(RayError):
            cause = KeyError("inside")

    def __init__(self, cpus: float | None = None) -> None:
        self.resources = {} if cpus is None else {"CPU": cpus}

    def remote(self, **options: Any) -> Any:
        self.options = options
        return lambda call: SimpleNamespace(remote=lambda *arguments: lambda: call(*arguments))

    def get(self, reference: Any) -> Any:
        return reference()

    def cluster_resources(self) -> dict[str, float]:
        return self.resources


def test_tasks_of_a_cluster() -> None:
    ray = _Ray(7.5)
    versions = cluster._versions(("numpy", "nothing-of-that-name"))
    assert versions["numpy"] == np.__version__
    assert versions["nothing-of-that-name"] == ""
    found = cluster.Cluster(ray, versions)
    assert (found.slots, cluster.Cluster(_Ray(), {}).slots, ray.options["max_retries"]) == (7, 1, 3)
    assert found.submit(pow, 2, 5).result() == 32
    task: Task[int] = cluster.Cluster(ray, {**versions, "numpy": "0"}).submit(pow, 2, 5)
    assert f"has other versions than this one (numpy 0 there, {np.__version__} here)" in message(task.result, ClusterError)

    def lost() -> None:
        raise _Ray.exceptions.RayError("died\nmore")

    def failed() -> None:
        raise _Ray.exceptions.RayTaskError

    told = message(Task(ray, lost).result, ClusterError)
    assert told.startswith("a task was lost 4 times with its worker, perhaps for lack of memory (died); continue with --resume")
    with pytest.raises(KeyError, match="inside"):
        Task(ray, failed).result()
    assert Shared(3) == Shared(3)


def test_calls_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    assert list(in_threads(abs, range(-3, 3), threads=2)) == [3, 2, 1, 0, 1, 2]
    assert list(in_processes(abs, range(-3, 0), 1)) == [3, 2, 1]

    def none(_: str) -> Any:
        raise OSError("no /dev/shm")

    monkeypatch.setattr("shuttle_marl.base.cluster.multiprocessing.get_context", none)
    check_processes(1)
    assert "processes cannot be started" in message(lambda: check_processes(2), ClusterError)
    assert "processes cannot be started" in message(lambda: list(in_processes(abs, [1], 2)), ClusterError)


# Bounds of files and late programs.


def test_values_of_the_compact_protocol() -> None:
    def read(*parts: bytes) -> Any:
        return table_files._thrift(io.BytesIO(b"".join(parts)), 12)

    last = b"\x15\x54\x00"  # field number one more, an integer, 42; the end
    assert read(last) == {1: 42}
    assert read(b"\x05\x20\x54\x15\x53\x00") == {16: 42, 17: -42}, "a number of its own, and a negative integer"
    assert read(b"\x16\xac\x02", last) == {1: 150, 2: 42}, "seven bits in each byte"
    assert read(b"\x34\xff\xff\x03", b"\x00") == {3: -32768}
    for skipped in (b"\x11", b"\x12", b"\x13\x07", b"\x17" + bytes(8), b"\x18\x03abc", b"\x19\x25\x02\x04",
                    b"\x1a\xf5\x10" + bytes(16), b"\x19\x08", b"\x19\x28\x01a\x02bc"):  # fmt: skip
        assert read(skipped, last) == {1: None, 2: 42}
    assert read(b"\x1c\x15\x02\x00", last) == {1: {1: 1}, 2: 42}
    for wrong in (b"\x1d\x00", b"\x19\x1d\x00"):
        with pytest.raises(KeyError):
            read(wrong, last)
    with pytest.raises(IndexError):
        read(b"\x15")


def test_tables_are_as_large_as_allowed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, n = tmp_path / "t.parquet", 50_000
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, np.int8)), pa.array(["abc"]))
    for column, size in ((pa.nulls(n, pa.int64()), 8 * n), (texts, (4 + 3) * n), (pa.array(np.zeros(n, np.bool_)), n)):
        pq.write_table(pa.table({"a": column}), path, store_schema=False)
        monkeypatch.setattr(table_files, "_MOST", size)
        assert table_files.read_parquet(path).num_rows == n
        monkeypatch.setattr(table_files, "_MOST", size - 1)
        assert "divide the file" in message(lambda: table_files.read_parquet(path), pa.ArrowInvalid)
    pq.write_table(pa.table({"a": np.arange(n)}), path, use_dictionary=False, row_group_size=n // 2)
    about = pq.ParquetFile(path).metadata
    with path.open("rb") as file:
        sizes = [table_files._unpacked(file, about.row_group(i).column(0)) for i in (0, 1)]
    assert 8 * n <= sum(sizes) <= 8 * n + 2000
    monkeypatch.setattr(table_files, "_MOST", sum(sizes))
    table_files.open_parquet(path).close()
    monkeypatch.setattr(table_files, "_MOST", sum(sizes) - 1)
    assert message(lambda: table_files.open_parquet(path), pa.ArrowInvalid).startswith("columns of 0 MB, expected at most 0")


@pytest.mark.parametrize(
    "content", [b"", b"PAR1", b"PAR1\x00\x00\x00\x00PAR", b"PAR1" + (9).to_bytes(4, "little") + b"PAR1", b"x" * 40]
)
def test_files_that_are_no_tables(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "t").write_bytes(content)
    assert "not a Parquet file, or truncated" in message(lambda: table_files.read_parquet(tmp_path / "t"), pa.ArrowInvalid)


def test_blocks_and_footers_of_a_file() -> None:
    content = b"PAR1" + b"pages" + b"footer" + (6).to_bytes(4, "little") + b"PAR1"
    assert table_files._footer(io.BytesIO(content)) == (9, len(content))
    assert table_files._footer(io.BytesIO(content[:4] + content[9:]))[0] == 4, "without pages"
    with pytest.raises(pa.ArrowInvalid, match="truncated"):
        table_files._footer(io.BytesIO(content[6:]))
    assert b"".join(table_files._blocks(io.BytesIO(content), (0, 4), (9, 15))) == b"PAR1footer"
    assert list(table_files._blocks(io.BytesIO(b"x"), (0, 9))) == [b"x"]


def test_headers_of_arrays_are_as_long_as_allowed(tmp_path: Path) -> None:
    content = tensor_bytes({"a": np.arange(3)}, {"k": "v"})
    length = int.from_bytes(content[:8], "little")
    for size, says in ((1 << 20, ""), ((1 << 20) + 8, "a header of 1048584 bytes, expected at most 1048576")):
        padded = content[8 : 8 + length].ljust(size) + content[8 + length :]
        (tmp_path / "t").write_bytes(size.to_bytes(8, "little") + padded)
        if says:
            assert says in message(lambda: read_tensors(tmp_path / "t"), ValueError)
        else:
            found = read_tensors(tmp_path / "t")
            assert (found.metadata, found.arrays["a"].tolist()) == ({"k": "v"}, [0, 1, 2])


def test_programs_that_are_late_are_killed() -> None:
    idle = Program([sys.executable, "-S", "-E", "-c", "input(); input()"], seconds=0.05)
    idle.write(b"\n")
    assert message(idle.read_line, ProgramTimeoutError) == "no answer within 0.05 s"
    assert "no answer within 0.05 s; it is not asked again" in message(lambda: idle.write(b"\n"), ProgramError)
    for call in (lambda late: late.read(1), lambda late: late.read_rest()):
        late = Program([sys.executable, "-S", "-E", "-c", "import signal; signal.pause()"], seconds=0.05)
        late.write(b"")
        assert message(call, ProgramTimeoutError, late) == "no answer within 0.05 s"


def test_a_journal_that_wrote_half_a_line_removes_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Half(io.FileIO):
        def write(self, content: Any) -> int:
            return super().write(content[: len(content) // 2])

    journal = Journal(tmp_path / "journal")
    journal.append([{"n": 1}])
    with monkeypatch.context() as disk:
        disk.setattr(Path, "open", lambda path, *_, **__: Half(path, "ab"))
        assert "free disk space and continue with --resume" in message(lambda: journal.append([{"n": 2}]), RunError)
    assert journal.read(finished=True) == [{"n": 1}]


def test_interrupts_are_raised_in_the_main_thread_alone() -> None:
    seen: list[bool] = []

    def check() -> None:
        interrupts.check_interrupt()
        seen.append(interrupts.was_interrupted())

    def interrupted() -> None:
        with interrupts.interrupts_held():
            signal.raise_signal(signal.SIGINT)
            thread = threading.Thread(target=check)
            thread.start()
            thread.join()
            seen.append(False)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert seen == [True, False]
