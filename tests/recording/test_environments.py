"""``record=`` of every environment: one log of all rallies, each with its seed and the reason of its end."""

import gc
import json
from collections import Counter
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from shuttle_marl import RallyEnv, RallyLog, VersusEnv, load_game, match_v0, rally_v0, resolve, tabulate
from shuttle_marl.commands.recording import main
from shuttle_marl.game.scoring import Rules
from shuttle_marl.recording import RecordingError, replay
from shuttle_marl.recording.reader import check
from tests.recording.conftest import read_rallies

GYM = "shuttle_marl:shuttle_marl/"
SHORT = Rules(points=5, clear=2, cap=7, games=2)


def choice(rng: np.random.Generator, mask: np.ndarray, illegal: float = 0.0) -> int:
    """A random legal action, or with a probability an illegal one."""
    return int(rng.choice(np.flatnonzero((mask != 0) ^ (rng.random() < illegal))))


def play(env: Any, seeds: range, illegal: float = 0.0) -> Counter[str]:
    """An episode of each seed; returns how often each reason ended one."""
    rng, ends = np.random.default_rng(0), Counter[str]()
    for seed in seeds:
        env.reset(seed=seed)
        for agent in env.agent_iter():
            *_, over, cut, info = env.last()
            if over or cut:
                ends[info["reason"]] += agent == "player_0"
            env.step(None if over or cut else choice(rng, env.observe(agent)["action_mask"], illegal))
    return ends


def reasons(path: Path) -> Counter[str]:
    with RallyLog(path) as log:
        return Counter(log.rally_table()["reason"].to_pylist())


@pytest.mark.parametrize("game", ["default", "default:recovery"])
def test_fifty_seeds_give_one_log_of_fifty_rallies_with_the_reasons(
    game: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "new" / "rallies.mcap"
    env = rally_v0.env(game=game, record=path, max_strokes=9)
    ends = play(env, range(50), illegal=0.03)
    env.close()
    assert f"{path}: 50 rallies" in capsys.readouterr().err
    assert {"fault", "winner", "illegal stroke", "too many strokes"} <= ends.keys()
    assert reasons(path) == ends
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert check(path, load_game(game)).problems == ()
    found = read_rallies(path)
    assert found.seed.tolist() == list(range(50))
    assert (found.waited is None) == (game == "default")
    assert set(found.winner[~found.finished].tolist()) == {0, 1, 2}


def test_rallies_of_a_match_have_its_score(tmp_path: Path) -> None:
    path = tmp_path / "match.mcap"
    env = match_v0.env(rules=SHORT, record=str(path), max_strokes=150)
    ends = play(env, range(12), illegal=0.003)
    env.close()
    assert {"illegal stroke", "too many strokes"} <= ends.keys()
    assert check(path, load_game("default")).problems == ()
    found = read_rallies(path)
    assert np.unique(found.match).tolist() == list(range(12))
    for match in range(12):
        of_match = found.select(found.match == match)
        assert of_match.rally.tolist() == list(range(len(of_match)))
        assert of_match.score[0].tolist() == [0, 0, 0, 0]


@pytest.mark.filterwarnings("ignore:.*an action was illegal")
@pytest.mark.parametrize("name", ["Rally-v0", "Match-v0", "RallyRecovery-v0"])
def test_rallies_of_a_vector_environment_are_those_of_its_rows(name: str, tmp_path: Path) -> None:
    path, game = tmp_path / "rallies.mcap", load_game("default:recovery" if "Recovery" in name else "default")
    options: dict[str, Any] = {"rules": SHORT} if "Match" in name else {}
    env = gymnasium.make_vec(f"{GYM}{name}", num_envs=7, opponent="bc", record=path, **options)
    rng, episodes = np.random.default_rng(0), 0
    for seed in (3, 3, 4):
        seen, _ = env.reset(seed=seed)
        for _ in range(400):
            seen, _, over, _, infos = env.step(np.array([choice(rng, mask, 0.02) for mask in seen["action_mask"]]))
            episodes += int(over.sum())
        episodes += int(infos["unseen"].sum())
    env.close()
    found = read_rallies(path)
    ended = found.finished | (found.reason < 4)
    if "Match" not in name:
        assert int(ended.sum()) == episodes
    assert reasons(path)["illegal stroke"] > 10
    assert check(path, game).problems == ()
    with RallyLog(path) as log:
        assert [player.name for player in log.policies] == ["learner", "bc"]
        assert replay(log, game, {"bc": tabulate(resolve("bc", game), game)}).wrong == ()


@pytest.mark.parametrize("name", ["Rally-v0", "Match-v0"])
def test_long_logs_of_many_rows_play_again(name: str, tmp_path: Path) -> None:
    path, game = tmp_path / "rallies.mcap", load_game("default")
    env: Any = gymnasium.make_vec(f"{GYM}{name}", num_envs=2200, opponent="bc", record=path)
    env.reset(seed=3)
    for _ in range(100):
        env.step(env.random_actions())
    env.close()
    assert check(path, game).problems == ()
    with RallyLog(path) as log:
        assert replay(log, game, {"bc": tabulate(resolve("bc", game), game)}).wrong == ()


def test_the_first_illegal_action_of_a_vector_environment_warns() -> None:
    env = gymnasium.make_vec(f"{GYM}Rally-v0", num_envs=4)
    seen, _ = env.reset(seed=0)
    with pytest.warns(UserWarning, match="choose by the action_mask"):
        env.step((seen["action_mask"] == 0).argmax(axis=1))


@pytest.mark.parametrize("kind", [RallyEnv, VersusEnv])
def test_rallies_of_torchrl_play_again(kind: Any, tmp_path: Path) -> None:
    path = tmp_path / "rallies.mcap"
    env = kind(8, record=path)
    ended = 0
    for seed in (1, 2):
        torch.manual_seed(0)
        env.set_seed(seed)
        ended += int(env.rollout(150, break_when_any_done=False)["next", "done"].sum())
        ended += 0 if kind is RallyEnv else sum(env.unseen)
    env.close()
    found = read_rallies(path)
    assert int(found.finished.sum()) == ended
    assert set(found.seed.tolist()) == {1, 2}
    assert check(path, load_game("default")).problems == ()


def test_rallies_of_gymnasium_have_the_name_of_the_opponent(tmp_path: Path) -> None:
    path = tmp_path / "rallies.mcap"
    env = gymnasium.make(f"{GYM}Rally-v0", opponent="bc", seat=1, record=path)
    rng = np.random.default_rng(0)
    for seed in range(20):
        env.reset(seed=seed)
        over = False
        while not over:
            over = env.step(choice(rng, env.get_wrapper_attr("action_masks")()))[2]
    env.close()
    assert check(path, load_game("default")).problems == ()
    with RallyLog(path) as log:
        assert [player.name for player in log.policies] == ["bc", "learner"]
        assert log.n_rallies >= 20  # and those that the opponent's serve decided


def test_an_environment_that_nobody_closes_leaves_a_whole_log(tmp_path: Path) -> None:
    env = rally_v0.env(record=tmp_path / "rallies.mcap")
    play(env, range(5))
    del env
    gc.collect()
    assert len(read_rallies(tmp_path / "rallies.mcap")) == 5


def test_forks_do_not_record_and_a_rally_that_is_left_is_abandoned(tmp_path: Path) -> None:
    path = tmp_path / "rallies.mcap"
    env = rally_v0.env(record=path)
    env.reset(seed=0)  # left before a stroke: no rally
    env.reset(seed=1)
    env.step(choice(np.random.default_rng(0), env.observe(env.agent_selection)["action_mask"]))
    assert not any(env.terminations.values())
    assert env.fork(seed=1).unwrapped.recorder is None
    env.reset(seed=2)
    env.close()
    assert reasons(path) == {"abandoned": 1}
    assert read_rallies(path).seed.tolist() == [1]


def test_information_on_a_log_says_that_each_rally_has_its_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rallies.mcap"
    env = rally_v0.env(record=path)
    play(env, range(7, 9))
    env.close()
    capsys.readouterr()
    assert main(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["seeds"] is None
    assert "seed" in found["columns"]


def test_a_log_that_cannot_be_made_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "rallies.mcap"
    env = rally_v0.env(record=path)
    play(env, range(1))
    env.close()
    assert f"{path}: 1 rally (" in capsys.readouterr().err
    options: dict[str, Any] = {"record": 4}
    for make in (rally_v0.env, lambda **options: gymnasium.make_vec(f"{GYM}Rally-v0", num_envs=2, **options)):
        with pytest.raises(RecordingError, match="record 4: expected the name of a file"):
            make(**options)
    with pytest.raises(RecordingError, match="exists already"):
        match_v0.env(record=path)
    (tmp_path / "file").touch()
    with pytest.raises(RecordingError, match="cannot be written"):
        rally_v0.env(record=tmp_path / "file" / "rallies.mcap")
