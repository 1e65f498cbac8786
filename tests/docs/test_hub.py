"""Folders for the hub: agents that play, tables that their descriptions describe, and cards that name their files."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

from docs.tools import hub
from shuttle_marl import default_game, resolve, tabulate
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.policy.agents import AGENTS


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("hub") / "out"
    hub.main(out=out, quick=True)
    return out


def card(path: Path) -> tuple[Any, str]:
    """Front matter and text of a card."""
    empty, front, body = (path / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    assert empty == ""
    return yaml.safe_load(front), body


@pytest.mark.slow
def test_agents_play_from_their_folders(folder: Path) -> None:
    game = default_game()
    copied, shipped = (tabulate(resolve(name, game), game) for name in (f"agent:{folder / 'agents' / 'ppo'}", "ppo"))
    np.testing.assert_array_equal(copied.pair_probabilities(), shipped.pair_probabilities())
    front, body = card(folder / "agents")
    names = sorted(path.name for path in (model_folder() / AGENTS).iterdir())
    assert [entry["name"] for entry in front["model-index"]] == names
    assert all(f"| `{name}` |" in body for name in names)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sample", "suite"])
def test_descriptions_are_of_the_files(folder: Path, name: str) -> None:
    described = json.loads((folder / name / "croissant.json").read_text(encoding="utf-8"))
    files = {file["@id"]: file for file in described["distribution"]}
    assert set(files) == {path.name for path in (folder / name).glob("*.parquet")}
    for file, entry in files.items():
        assert entry["sha256"] == hashlib.sha256((folder / name / file).read_bytes()).hexdigest()
    for records in described["recordSet"]:
        (file,) = {field["source"]["fileObject"]["@id"] for field in records["field"]}
        assert [field["source"]["extract"]["column"] for field in records["field"]] == pq.read_schema(folder / name / file).names
    assert {file for config in card(folder / name)[0]["configs"] for file in config["data_files"]} == set(files)
