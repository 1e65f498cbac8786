"""Files that are whole or not there, tables that notice a changed bit, and text that is safe to print."""

import os
import stat
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from shuttle_marl.base.errors import printable
from shuttle_marl.base.files import FileReadError, FileWriteError, open_file, read_json, replace_file, replacing
from shuttle_marl.base.table_files import csv_bytes, parquet_bytes, read_parquet, write_parquet
from shuttle_marl.commands.cli import check_free

FLIPS = int(os.environ.get("SHUTTLE_MUTATIONS", "300"))


def a_table() -> pa.Table:
    rng = np.random.default_rng(0)
    names = pa.array(["smash", "clear", "drop"]).take(pa.array(rng.integers(0, 3, 500)))
    table = pa.table({"number": rng.integers(0, 99, 500), "share": rng.random(500), "name": names.dictionary_encode()})
    return table.replace_schema_metadata({"about": "x" * 200})


def test_a_file_gets_the_permissions_that_the_umask_leaves(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        replace_file(tmp_path / "private", b"x")
        os.umask(0o002)
        replace_file(tmp_path / "shared", b"x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "private").stat().st_mode) == 0o600
    assert stat.S_IMODE((tmp_path / "shared").stat().st_mode) == 0o664


@pytest.mark.parametrize("name", ["x" * 256, "a\0b", "\ud800"])
def test_an_impossible_name_is_an_error_that_says_so(tmp_path: Path, name: str) -> None:
    with pytest.raises(FileWriteError, match="cannot be written"):
        replace_file(tmp_path / name, b"x")
    assert not list(tmp_path.iterdir())


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path, tmp_path / "fifo", Path("/dev/null")):
        with pytest.raises(OSError, match="not a regular file"):
            open_file(path)
    (tmp_path / "file").write_bytes(b"content")
    with open_file(tmp_path / "file") as file:
        assert file.read() == b"content"


def test_a_sealed_table_is_read_by_every_reader(tmp_path: Path) -> None:
    path, table = tmp_path / "t.parquet", a_table()
    write_parquet(path, table)
    assert path.read_bytes() == parquet_bytes(table)
    assert read_parquet(path).equals(table, check_metadata=True)
    assert pq.read_table(path, page_checksum_verification=True).equals(table)
    # Tables of others have no seal.
    pq.write_table(table, path)
    assert read_parquet(path).equals(table)


def test_a_flipped_bit_in_a_table_is_found_or_changes_nothing(tmp_path: Path) -> None:
    path, table = tmp_path / "t.parquet", a_table()
    content = parquet_bytes(table)
    rng, found = np.random.default_rng(0), 0
    for at in rng.integers(0, 8 * len(content), FLIPS):
        changed = bytearray(content)
        changed[at >> 3] ^= 1 << (at & 7)
        path.write_bytes(changed)
        try:
            assert read_parquet(path).equals(table, check_metadata=True), f"bit {at}"
        except (OSError, ValueError, pa.ArrowException):
            found += 1
    assert found > 0.95 * FLIPS


def test_text_in_csv_is_no_formula() -> None:
    names = ["=1+1", "+1", "-1", "@x", "\t=1", "plain", "a=b", None]
    table = pa.table({"name": pa.array(names).dictionary_encode(), "number": list(range(-4, 4))})
    lines = csv_bytes(table).decode().splitlines()
    assert lines[1:5] == ['"\'=1+1",-4', '"\'+1",-3', '"\'-1",-2', '"\'@x",-1']
    assert "'\t=1" in lines[5]
    assert lines[6:] == ['"plain",1', '"a=b",2', ",3"]


def test_text_for_the_terminal_has_no_control_characters() -> None:
    assert printable("ünïcode | name") == "ünïcode | name"
    assert printable("\x1b[31mred\x07\n") == "\\x1b[31mred\\x07\\n"
    assert printable("a\nb\x1b", keep="\n") == "a\nb\\x1b"
    assert printable("\u202eevil\udcff") == "\\u202eevil\\udcff"


@pytest.mark.parametrize("kind", ["FIFO", "symbolic link", "folder"])
def test_only_regular_files_are_replaced(tmp_path: Path, kind: str) -> None:
    path, other = tmp_path / "out", tmp_path / "other"
    other.write_bytes(b"before")
    if kind == "FIFO":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to(other)
    before = path.lstat()
    with pytest.raises(FileWriteError, match=f"cannot be written: it is a {kind}"):
        replace_file(path, b"x")
    if kind != "folder":  # whose contents may be replaced
        with pytest.raises(FileWriteError, match=f"cannot be written: it is a {kind}"):
            check_free(path, overwrite=True)
    assert path.lstat() == before
    assert other.read_bytes() == b"before"
    assert sorted(tmp_path.iterdir()) == sorted([path, other])


def test_an_entry_that_stands_there_twice(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"a": {"b": 1, "c": 2, "b": 3}}')
    with pytest.raises(FileReadError, match="the entry 'b' stands there twice"):
        read_json(tmp_path / "a.json", dict[str, Any])


def test_a_large_file_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    with (tmp_path / "config.json").open("wb") as file:
        file.truncate(60 << 20)
    with pytest.raises(FileReadError, match="larger than 16 MB"):
        read_json(tmp_path / "config.json", dict[str, Any])


def test_memory_of_a_table_is_added_up_before_it_is_used(tmp_path: Path) -> None:
    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(10_000, np.int32)), pa.array(["x" * 60_000]))
    pq.write_table(pa.table({"a": text}), tmp_path / "t.parquet", store_schema=False)
    assert (tmp_path / "t.parquet").stat().st_size < 1_000_000
    with pytest.raises(pa.ArrowInvalid, match="a table of 572 MB, expected at most 512"):
        read_parquet(tmp_path / "t.parquet")


def test_tables_of_any_type_are_bounded_before_they_are_read(tmp_path: Path) -> None:
    path, million = tmp_path / "t.parquet", b"x" * 10**6
    numbers = pa.array(np.zeros(10, np.int8))
    kinds: dict[str, pa.Array] = {
        "binary": pa.DictionaryArray.from_arrays(pa.array(np.zeros(1500, np.int32)), pa.array([million])),
        "list": pa.ListArray.from_arrays(pa.array([0, 10], pa.int32()), numbers),
        "struct": pa.StructArray.from_arrays([numbers, numbers], ["a", "b"]),
        "map": pa.array([[("a", 1)]], pa.map_(pa.string(), pa.int8())),
        "fixed_size_list": pa.FixedSizeListArray.from_arrays(numbers, 5),
    }
    for kind, column in kinds.items():
        pq.write_table(pa.table({"x": column}), path, store_schema=kind != "binary")
        with pytest.raises(pa.ArrowInvalid, match=f"column 'x' holds values of type {kind}"):
            read_parquet(path)
    fine = pa.table({"x": ["a", None, "b" * 5000], "y": [1.5, None, 2.5], "z": [True, False, None], "n": pa.nulls(3)})
    several: list[dict[str, Any]] = [
        {},
        {"use_dictionary": False},
        {"compression": "none"},
        {"data_page_version": "2.0"},
        {"write_statistics": False},
    ]
    for options in several:
        write_parquet(path, fine, **options)
        assert read_parquet(path).equals(fine)


def test_page_headers_of_others_that_are_damaged_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    pq.write_table(pa.table({"x": ["a" * 300, "b" * 300]}), path, use_dictionary=False)
    content = path.read_bytes()
    page = content.index(b"\x15", 4)
    for junk in (b"\xff" * 40, b"\x15\x01\x15\x01\x15\x01", b"\x00" * 20, b"\x1c" * 40):
        path.write_bytes(content[:page] + junk + content[page + len(junk) :])
        with pytest.raises((pa.ArrowException, OSError)):
            read_parquet(path)


def test_pages_are_bounded_by_the_sizes_in_the_footer(tmp_path: Path) -> None:
    text = pa.array(["x" * 10**8])
    with pq.ParquetWriter(
        tmp_path / "t.parquet", pa.schema({"x": pa.string()}), compression="zstd", use_dictionary=False
    ) as file:
        for _ in range(6):
            file.write_table(pa.table({"x": text}))
    assert (tmp_path / "t.parquet").stat().st_size < 1_000_000
    with pytest.raises(pa.ArrowInvalid, match="a table of 572 MB, expected at most 512"):
        read_parquet(tmp_path / "t.parquet")


def test_of_two_programs_that_write_a_new_file_at_once_one_is_refused(tmp_path: Path) -> None:
    def second() -> None:
        with replacing(tmp_path / "a", new=True) as file:
            file.write(b"second")
            replace_file(tmp_path / "a", b"first", new=True)

    with pytest.raises(FileWriteError, match="exists"):
        second()
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"first")]
