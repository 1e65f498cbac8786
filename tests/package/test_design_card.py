"""The design card, the system of the paper clause by clause: each test is named after its clause and plays the shipped game.

The live page has its clauses in ``tests/watch/test_page.py``.
"""

import io
import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import shuttle_marl as sm
from docs.tools import reproduce
from docs.tools.markdown import ROOT
from shuttle_marl.commands.recording import main as recording
from shuttle_marl.game.court import AREAS
from shuttle_marl.game.stroke import SHOTS, TECHNIQUES
from shuttle_marl.recording import replay

CONFIGS = {sm.PPOConfig: 16_000, sm.A2CConfig: 16_000, sm.SACConfig: 24_000}
"""Strokes after which each algorithm has learned something."""


def rally(env: Any, seed: int) -> list[str]:
    """Play a rally of random legal strokes; returns its strikers."""
    rng, strikers = np.random.default_rng(seed), []
    env.reset(seed=seed)
    while not any(env.terminations.values()):
        assert set(env.rewards.values()) == {0}
        strikers.append(env.agent_selection)
        env.step(int(rng.choice(np.flatnonzero(env.observe(env.agent_selection)["action_mask"]))))
    return strikers


def test_two_agents_alternate_strokes_and_the_reward_is_one_at_the_end_of_a_rally() -> None:
    env = sm.rally_v0.env()
    for seed in range(30):
        assert all(before != after for before, after in pairwise(rally(env, seed)))
        assert sorted(env.rewards.values()) == [-1, 1]


def test_a_stroke_is_shot_type_target_area_contact_height_and_technique() -> None:
    catalogue = sm.default_game().catalogue
    parts = [name.split(":") for name in catalogue.names]
    assert len({tuple(part) for part in parts}) == len(catalogue)
    assert {len(part) for part in parts} == {4}
    for values, known in zip(zip(*parts, strict=True), (SHOTS, AREAS, ("below", "above"), TECHNIQUES), strict=True):
        assert set(values) <= set(known)
        assert len(set(values)) > 1


def test_torch_models_decide_whether_a_stroke_is_good_and_returned() -> None:
    from torch import nn

    from shuttle_marl.dynamics.modules import MRet, MSucc

    models = sm.load_models()
    kinds = {type(each): each for each in vars(models).values() if isinstance(each, nn.Module)}
    assert {MSucc, MRet} <= set(kinds)
    tables, modules = sm.rally_v0.env(), sm.rally_v0.env(outcomes="models")
    for seed in range(5):
        assert rally(tables, seed) == rally(modules, seed)
        assert tables.rewards == modules.rewards


@pytest.mark.parametrize("kind", CONFIGS)
def test_agents_learn_through_torchrl_collectors(kind: type, tmp_path: Path) -> None:
    from torch import nn

    done = sm.train(kind(collector="torchrl", strokes=CONFIGS[kind], batch=2048, exploitability=False, out=tmp_path / "run"))
    assert done.evaluation.rally_win > 0.5, "it has learned something against bc"
    assert isinstance(sm.agent_network(done.folder / "agent"), nn.Module)
    with sm.RallyLog(done.folder / "rallies.mcap") as log:
        assert replay(log, sm.default_game()).wrong == ()


def test_observations_come_from_the_history_of_actions() -> None:
    env, usual = sm.rally_v0.env(history=8), sm.rally_v0.env()
    rally(env, 3)
    rally(usual, 3)
    seen, plain = env.observe("player_0")["observation"], usual.observe("player_0")["observation"]
    assert seen.shape == (60 + 54 * 8,)
    assert np.array_equal(seen[60:87], plain[:27])
    assert seen in env.observation_space("player_0")["observation"]  # type: ignore[index]


def test_a_league_of_self_play_and_imitated_opponents(tmp_path: Path) -> None:
    league = sm.run_league(sm.LeagueConfig(pool=("bc", "random", "ppo", "ppo:self-play"), matches=40, out=tmp_path / "league"))
    ranks = {standing.player: standing.rank for standing in league.standings}
    assert max(ranks["ppo"], ranks["ppo:self-play"]) < min(ranks["bc"], ranks["random"])
    for standing in league.standings:
        assert 0 <= standing.share <= 1


def test_every_rally_is_recorded_to_mcap_and_replays_in_foxglove(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    done = sm.train(sm.PPOConfig(strokes=8_000, out=tmp_path / "run"))
    with sm.RallyLog(done.folder / "rallies.mcap") as log:
        assert np.count_nonzero(sm.to_df(log.stroke_table())["seat"] == 0) == done.strokes
    path = tmp_path / "played.mcap"
    env = sm.rally_v0.env(record=path)
    for seed in range(50):
        rally(env, seed)
    env.close()
    with sm.RallyLog(path) as log:
        assert log.n_rallies == 50
        assert set(sm.to_df(log.rally_table())["reason"]) == {"fault", "winner"}
    scene = tmp_path / "scene.mcap"
    assert recording(["scene", str(path), "--out", str(scene)]) == 0
    reader = make_reader(io.BytesIO(scene.read_bytes()))
    assert any("layout" in attachment.name for attachment in reader.iter_attachments())
    summary = reader.get_summary()
    schemas = {schema.name for schema in summary.schemas.values()}
    assert {"foxglove.SceneUpdate", "foxglove.FrameTransforms"} <= schemas
    assert str(scene) in capsys.readouterr().out


def test_tables_of_the_paper_are_there_and_have_a_command_that_ci_runs() -> None:
    tables = {name: command for name, command, *_ in reproduce.listed()}
    next_stroke = json.loads((ROOT / "experiments/results/next_stroke.json").read_text())
    for which in ("players", "paper"):
        assert len([each for each in next_stroke[which].values() if "shot_type" in str(each)]) >= 2
    for name in ("next_stroke", "win_rates"):
        assert any(name in command for command in tables.values())
        assert json.loads((ROOT / f"experiments/results/{name}.json").read_text())
    assert "pip install '.[train]'" in (ROOT / "README.md").read_text(), "the first command of researchers installs PyTorch"
    script = (ROOT / ".ci/run").read_text()
    assert "docs.tools.reproduce" in script
    assert "experiments.win_rates --quick" in script
