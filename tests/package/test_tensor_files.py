"""Arrays in safetensors files: packed ones are read as they were, and forged ones are refused before they fill the memory."""

import json
import lzma
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from shuttle_marl.base.tensor_files import packed_bytes, read_tensors, tensor_bytes, unpacked_bytes


def test_packed_arrays_are_read_as_they_were(tmp_path: Path) -> None:
    rng, file = np.random.default_rng(0), tmp_path / "file.safetensors"
    arrays: dict[str, Any] = {
        "floats": rng.normal(size=(300, 70)).astype(np.float32),
        "signed": rng.integers(-5, 5, (3, 1 << 15), np.int8),
        "halves": rng.normal(size=1 << 16).astype(np.float16),
        "marks": rng.random(1 << 17) < 0.5,
        "small": np.arange(5, dtype=np.uint16),
    }
    file.write_bytes(tensor_bytes(arrays, {"b": "2", "a": "1"}, pack=True))
    metadata, again = read_tensors(file)
    assert metadata == {"a": "1", "b": "2"}
    for name, array in arrays.items():
        assert again[name].dtype == array.dtype
        assert again[name].flags.writeable
        assert np.array_equal(again[name], array)
    stored = load_file(file)
    assert stored["small"].tolist() == [0, 1, 2, 3, 4]
    assert stored["signed"].nbytes < arrays["signed"].nbytes / 2
    plain = tensor_bytes(arrays, {})
    assert len(plain) > 1.2 * file.stat().st_size
    assert b"packed" not in plain[:1000]


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        ("<f4", [2**40]), ("<f4", [-1]), ("<f4", [1.5]), ("<f4", [2]), ("|O", [2]), ("nothing", [3]), (5, [3]), ("<f4", None),
    ],
)  # fmt: skip
def test_forged_descriptions_are_refused(tmp_path: Path, dtype: Any, shape: Any) -> None:
    packed = packed_bytes(np.zeros(3, np.float32))
    save_file({"x": packed}, tmp_path / "file", metadata={"packed": json.dumps({"x": [dtype, shape]})})
    with pytest.raises(ValueError, match="packed array"):
        read_tensors(tmp_path / "file")


@pytest.mark.parametrize("packed", ["5", '{"y": ["<f4", [3]]}', '{"x": ["<f4"]}', "[" * 50_000])
def test_forged_metadata_are_refused(tmp_path: Path, packed: str) -> None:
    save_file({"x": packed_bytes(np.zeros(3, np.float32))}, tmp_path / "file", metadata={"packed": packed})
    with pytest.raises(ValueError, match=r"packed arrays|nested|Expecting|not enough values"):
        read_tensors(tmp_path / "file")


def test_damaged_and_too_long_content_is_refused() -> None:
    content = packed_bytes(np.zeros(3, np.float32))
    for damaged in (content[:-9], content[::-1].copy(), content[:0]):
        with pytest.raises(ValueError, match="a packed array"):
            unpacked_bytes(damaged, "<f4", [3])
    bomb = np.frombuffer(lzma.compress(bytes(10**8)), np.uint8)
    with pytest.raises(ValueError, match="of 13 bytes, expected 12"):
        unpacked_bytes(bomb, "<f4", [3])


def test_the_arrays_of_a_file_are_bounded_together(tmp_path: Path) -> None:
    packed = np.frombuffer(lzma.compress(bytes(1 << 20)), np.uint8)
    arrays = {f"a{i}": packed for i in range(1000)}
    save_file(arrays, tmp_path / "file", metadata={"packed": json.dumps({name: ["|u1", [1 << 20]] for name in arrays})})
    with pytest.raises(ValueError, match="packed arrays of 1000 MB together, expected at most 128"):
        read_tensors(tmp_path / "file")
    with (tmp_path / "file").open("wb") as file:
        file.truncate(1 << 35)
    with pytest.raises(OSError, match="larger than 128 MB"):
        read_tensors(tmp_path / "file")
