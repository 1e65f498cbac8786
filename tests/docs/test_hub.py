"""Folders for the hub: agents that play, and a card that names them."""

from pathlib import Path

import pytest
import yaml

from docs.tools import hub
from shuttle_marl import default_game, resolve, tabulate
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.policy.agents import AGENTS


@pytest.mark.slow
def test_agents_play_from_their_folders(tmp_path: Path) -> None:
    game = default_game()
    hub.main(out=tmp_path / "out", quick=True)
    copied, shipped = (tabulate(resolve(name, game), game) for name in (f"agent:{tmp_path / 'out' / 'agents' / 'ppo'}", "ppo"))
    assert (copied.pair_probabilities() == shipped.pair_probabilities()).all()
    _, front, body = (tmp_path / "out" / "agents" / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    names = sorted(path.name for path in (model_folder() / AGENTS).iterdir())
    assert [entry["name"] for entry in yaml.safe_load(front)["model-index"]] == names
    assert all(f"| `{name}` |" in body for name in names)
