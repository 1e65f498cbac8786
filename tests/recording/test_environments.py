"""``RecordRallies``: the log of somebody's own loop over an environment."""

import gc
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from shuttle_marl import RallyLog, RecordRallies, load_game, match_v0, rally_v0
from shuttle_marl.base.errors import OptionError
from shuttle_marl.game.scoring import Rules
from shuttle_marl.recording import RecordingError
from shuttle_marl.recording.reader import check
from tests.recording.conftest import read_rallies


def play(env: Any, episodes: int, seed: int = 0) -> None:
    """Random legal actions."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    for episode in range(episodes):
        if episode:
            env.reset()
        for agent in env.agent_iter():
            *_, over, cut, _ = env.last()
            env.step(None if over or cut else int(rng.choice(np.flatnonzero(env.observe(agent)["action_mask"]))))


@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_rallies_of_pettingzoo_play_again(game: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / "rallies.mcap"
    env = RecordRallies(rally_v0.env(game=game), path, names=("mine", "other"))
    play(env, 30, seed=4)
    env.close()
    assert check(path, load_game(game)).problems == ()
    with RallyLog(path) as log:
        assert [player.name for player in log.policies] == ["mine", "other"]
    found = read_rallies(path)
    assert found.match.tolist() == list(range(30))
    assert (found.waited is None) == (game == "default")


def test_rallies_of_a_match_have_its_score(tmp_path: Path) -> None:
    path = tmp_path / "match.mcap"
    env = RecordRallies(match_v0.env(rules=Rules(points=5, clear=2, cap=7, games=2)), path)
    play(env, 3)
    env.close()
    assert check(path, load_game("default")).problems == ()
    found = read_rallies(path)
    for match in range(3):
        of_match = found.select(found.match == match)
        assert of_match.rally.tolist() == list(range(len(of_match)))
        assert of_match.score[0].tolist() == [0, 0, 0, 0]
        assert of_match.score[-1].max() >= 4


def test_rallies_of_gymnasium_play_again(tmp_path: Path) -> None:
    path = tmp_path / "rallies.mcap"
    env = RecordRallies(gymnasium.make("shuttle_marl:shuttle_marl/Rally-v0", opponent="bc"), path)
    rng = np.random.default_rng(0)
    env.reset(seed=9)
    for _ in range(40):
        over = False
        while not over:
            _, _, over, _, _ = env.step(int(rng.choice(np.flatnonzero(env.get_wrapper_attr("action_masks")()))))
        env.reset()
    env.close()
    assert check(path, load_game("default")).problems == ()
    assert len(read_rallies(path)) >= 40  # and those that the opponent's serve decided


def test_another_seed_begins_another_log(tmp_path: Path) -> None:
    env = RecordRallies(rally_v0.env(), tmp_path / "rallies.mcap")
    for seed in (1, 1, 2):
        play(env, 2, seed)
    env.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rallies-2.mcap", "rallies.mcap"]
    with RallyLog(tmp_path / "rallies-2.mcap") as log:
        assert log.files[0].header.seed == 2
    assert len(read_rallies(tmp_path / "rallies.mcap")) == 4


def test_an_environment_that_nobody_closes_leaves_a_whole_log(tmp_path: Path) -> None:
    env = RecordRallies(rally_v0.env(), tmp_path / "rallies.mcap")
    play(env, 5)
    del env
    gc.collect()
    assert len(read_rallies(tmp_path / "rallies.mcap")) == 5


def test_forks_do_not_record_and_what_cannot_be_logged_is_left_out(tmp_path: Path) -> None:
    env = RecordRallies(rally_v0.env(max_strokes=3), tmp_path / "rallies.mcap")
    env.reset(seed=0)
    fork = env.fork(seed=1)
    assert fork.unwrapped.recorder is None
    ended = 0
    rng = np.random.default_rng(0)
    for _ in range(60):
        env.reset()
        while not (any(env.terminations.values()) or any(env.truncations.values())):
            env.step(int(rng.choice(np.flatnonzero(env.observe(env.agent_selection)["action_mask"]))))
        ended += any(env.terminations.values())
    env.reset()
    env.step(int(np.flatnonzero(env.observe(env.agent_selection)["action_mask"] == 0)[0]))
    assert any(env.terminations.values())
    env.close()
    assert 0 < ended < 60
    assert len(read_rallies(tmp_path / "rallies.mcap")) == ended


def test_what_cannot_record_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="leagues and training record by themselves"):
        RecordRallies(gymnasium.make_vec("shuttle_marl:shuttle_marl/Rally-v0", num_envs=2), tmp_path / "a.mcap")
    env = RecordRallies(rally_v0.env(), tmp_path / "rallies.mcap")
    with pytest.raises(OptionError, match="records already"):
        RecordRallies(env, tmp_path / "b.mcap")
    play(env, 1)
    env.close()
    with pytest.raises(RecordingError, match="exists already"):
        RecordRallies(rally_v0.env(), tmp_path / "rallies.mcap")
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written"):
        RecordRallies(rally_v0.env(), tmp_path / "file" / "rallies.mcap")
