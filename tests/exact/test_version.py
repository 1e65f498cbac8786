"""The hash in the keys of cached values: code that computes one changes it."""

import importlib.util
from pathlib import Path

import pytest

from shuttle_marl.exact import version


@pytest.mark.parametrize("file", ["exact/sweeps.py", "game/rally.py", "kernel/core.py", "policy/network.py"])
def test_changed_source_changes_the_hash(file: str, tmp_path: Path) -> None:
    def hash_now() -> str:
        spec = importlib.util.spec_from_file_location("copy_of_version", tmp_path / "exact" / "version.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module.sources_hash()

    for name in ("exact/version.py", file):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes((Path(version.__file__).parents[1] / name).read_bytes())
    before = hash_now()
    assert hash_now() == before
    (tmp_path / file).write_text("changed = True\n")
    assert hash_now() != before
