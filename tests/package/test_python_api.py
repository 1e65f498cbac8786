"""What the command line does, from Python."""

from pathlib import Path

import numpy as np
import polars
import pytest
import torch

import shuttle_marl as sm
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.shipped import model_folder
from shuttle_marl.policy.agents import load_agent
from tests.reduced import reduced_game

SAMPLE = Path(__file__).parents[2] / "datasets/sample/strokes.parquet"


def test_strokes_become_a_data_frame_with_names() -> None:
    strokes = sm.read_matches(SAMPLE)
    frame = sm.to_df(strokes)
    assert len(frame) == len(strokes)
    assert {"smash", "clear"} < set(frame["shot"])
    assert isinstance(sm.to_df(strokes, "polars"), polars.DataFrame)


def test_reports_are_figures_and_pages(tmp_path: Path) -> None:
    game = reduced_game()
    found = sm.report(SAMPLE, "axelsen chou", game=game)
    path = found.save(str(tmp_path / "report.html"), language="zh")
    assert path.read_bytes() == found.html("zh") != found.html()
    assert "axelsen" in str(found.figures)
    assert found.html("zh") == path.read_bytes(), "no sentence keeps the language of an earlier page"
    with pytest.raises(ShuttleError, match="3 matches"):
        sm.report(SAMPLE, "viktor axelsen")


@pytest.mark.slow
def test_scouting_reports_are_pages() -> None:
    assert b"Chen" in sm.scouting_report("an-se-young", "chen-yufei", data=SAMPLE).html()


def test_the_network_of_an_agent_plays_as_its_table() -> None:
    folder, game = model_folder() / "agents" / "ppo", default_game()
    network, table = sm.agent_network(folder), load_agent(folder, game)
    states = np.flatnonzero(game.playable)[::5000]
    with torch.no_grad():
        logits = network(torch.from_numpy(game.observation(states)))
    legal = game.mask(states)
    best = torch.where(torch.from_numpy(legal), logits, -torch.inf).argmax(dim=1).numpy()
    chance = table.probabilities(States(game=game, state=states.astype(np.int32)))
    assert logits.shape == (len(states), game.n_strokes)
    assert (chance[np.arange(len(states)), best] >= chance.max(axis=1) - 1e-3).mean() > 0.99


def test_networks_of_other_games_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="no trained agent"):
        sm.agent_network(tmp_path)
    with pytest.raises(PolicyError, match="of another game"):
        sm.agent_network(model_folder() / "agents" / "ppo", sm.load_game("default:recovery"))
