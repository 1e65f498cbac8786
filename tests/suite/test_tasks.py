"""The task text; programs, templates, and data."""

import json
import shutil
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.table_files import read_parquet
from shuttle_marl.env.words import OVER, WAIT, TextRallyEnv, described, position, prompt, text_env
from shuttle_marl.game.observation import states_of
from shuttle_marl.game.shipped import load_game
from shuttle_marl.suite import store
from shuttle_marl.suite.exploit import PlayerSetting
from shuttle_marl.suite.method import find
from shuttle_marl.suite.offline import generate
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import arena_of, find_task, new_submission, write_data
from shuttle_marl.suite.text import chosen_states, positions, regrets
from tests import golden
from tests.reduced import reduced_game, reduced_model
from tests.suite import small
from tests.suite.small import summary, verified

GAME = reduced_game()


def run(tmp_path: Path, task: str, method: str, **options: Any) -> Path:
    return small.run(task, method, **{"out": tmp_path / "run", **options})


def accepted(folder: Path) -> bool:
    return not verified(folder).refused


def test_text_scores_regret_and_legality(tmp_path: Path) -> None:
    arena = arena_of(find_task("text-v0"), reduced_model(), "test", quick=True)
    regret = regrets(GAME)
    best = summary(run(tmp_path / "best", "text-v0", "policy:minimax", split="test"))["scores"]
    assert (best["regret"]["value"], best["legal"]["value"]) == (pytest.approx(0, abs=1e-9), 1)
    folder = run(tmp_path / "wrong", "text-v0", f"{__name__}:Wrong", split="test")
    worst = summary(folder)["scores"]
    states = chosen_states(arena).tolist()
    assert worst["regret"]["value"] == pytest.approx(100 * np.mean([regret[GAME.pairs_of(state)].max() for state in states]))
    assert worst["legal"]["value"] == 0
    assert accepted(folder)
    golden.check("text", {"places": positions(arena)[:2], "states": states, "wrong": worst})


class Wrong:
    def answer(self, position: Any) -> str:
        return "smash"


def test_positions_are_described_in_words() -> None:
    state = int(GAME.playable.argmax())
    assert described(GAME, state) == "You serve."
    later = int(np.flatnonzero((GAME.own(np.arange(GAME.n_states)) < GAME.n_strokes) & GAME.playable)[-1])
    place = position(GAME, later)
    assert place["text"].startswith("Your opponent played: ")
    assert "Your own last stroke was: " in place["text"]
    calm = GAME.state_of(*(*GAME.observation(later)[:-1], 0))
    assert place["text"].replace(" You are hurried: late or stretched.", "") == described(GAME, int(calm)) != place["text"]
    assert set(place["legal"]) == {GAME.catalogue.names[stroke] for stroke in GAME.legal_strokes(later)}
    assert all(name in prompt(place) for name in place["legal"])


COMMANDS = {
    "exploit-v0": "my_player:train",
    "adapt-v0": "my_adapter:Adapter",
    "offline-v0": "my_offline:Learner",
    "evaluate-v0": "my_estimator:Estimator",
    "text-v0": "my_text:Player",
}


@pytest.mark.parametrize("task", COMMANDS)
def test_templates_run_as_they_are(task: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    line = new_submission(task, tmp_path)
    assert line.endswith(f"run {task} --method {COMMANDS[task]} --quick")
    (source,) = tmp_path.glob("my_*.py")
    assert len(source.read_text().splitlines()) <= 40
    folder = run(tmp_path, task, COMMANDS[task])
    assert accepted(folder)
    assert np.isfinite(summary(folder)["score"])
    sys.modules.pop(source.stem)
    with pytest.raises(SuiteError, match="already exists"):
        new_submission(task, tmp_path)


@pytest.mark.skipif(shutil.which("perl") is None, reason="needs Perl")
def test_the_template_in_perl_plays_and_is_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "'program:perl player.pl'" in new_submission("exploit-v0", tmp_path, "perl")
    folder = run(tmp_path, "exploit-v0", "program:perl player.pl")
    entry = store.read_entry(store.entry_path(folder, 0, 0))
    player = store.read_outcome(folder, entry, GAME).policies["player"]
    assert set(np.unique(player.cumulative)) <= {0, 65535}
    assert accepted(folder)
    assert len((tmp_path / "player.pl").read_text().splitlines()) <= 40


def test_data_are_written_with_their_hashes(tmp_path: Path) -> None:
    found = write_data("offline-v0", tmp_path, "dev", reduced_model(), 2, quick=True)
    assert len(found) == 2
    name, digest = next(iter(found.items()))
    table = read_parquet(tmp_path / name)
    assert {"state", "stroke", "probability", "won"} <= set(table.column_names)
    arena = arena_of(find_task("offline-v0"), reduced_model(), "dev", quick=True)
    given = find_task("offline-v0").given(arena, find_task("offline-v0").cases(arena)[0], 0)
    assert digest in given
    logs = write_data("evaluate-v0", tmp_path, "dev", reduced_model(), 1, quick=True)
    assert len({*logs.values()}) == len(logs) == 2
    lines = write_data("text-v0", tmp_path, "dev", reduced_model(), None, quick=True)
    assert list(lines) == ["positions.jsonl"]
    assert json.loads((tmp_path / "positions.jsonl").read_text().splitlines()[0])["legal"]
    with pytest.raises(SuiteError, match="has no data"):
        write_data("adapt-v0", tmp_path, "dev", reduced_model(), None)


def test_minari_data_sets_are_the_transitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari")
    (name,) = write_data("offline-v0", tmp_path, "test", reduced_model(), 1, quick=True, minari=True)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    read = list(minari.load_dataset(name).iterate_episodes())
    data = generate(arena_of(find_task("offline-v0"), reduced_model(), "test", quick=True), "bc", 3000, 0).transitions
    assert np.array_equal(np.concatenate([each.actions for each in read]), data.stroke)
    assert np.array_equal(np.concatenate([each.rewards for each in read]), data.reward)
    assert np.array_equal(np.concatenate([each.infos["state"][:-1, 0] for each in read]), data.state)
    assert {each.infos["state"][-1, 0] for each in read} == {-1}
    seen = np.concatenate([each.observations["observation"][:-1] for each in read])
    assert np.array_equal(states_of(GAME, seen), data.state)
    assert all(each.terminations[-1] and not each.terminations[:-1].any() for each in read)
    env = minari.load_dataset(name).recover_environment()
    assert env.observation_space.contains(env.reset(seed=0)[0])
    with pytest.raises(ShuttleError, match="exist"):
        write_data("offline-v0", tmp_path, "test", reduced_model(), 1, quick=True, minari=True)


def test_rallies_are_played_in_words() -> None:
    env = TextRallyEnv(opponent="safe", game=GAME)
    seen, _ = env.reset(seed=1)
    rewards, over = [], False
    while not over:
        assert env.observation_space.contains(seen)
        seen, reward, over, _, _ = env.step(f"I play {seen.split('Legal strokes: ')[1].split(', ')[0]}.")
        rewards.append(reward)
    assert (abs(sum(rewards)), seen) == (1, OVER)
    env.reset()
    assert env.step("no idea")[1:3] == (-1, True)


def test_two_players_play_in_words() -> None:
    env, strokes = text_env(game=GAME), 0
    env.reset(seed=1)
    for agent in env.agent_iter():
        seen, _, terminated, truncated, _ = env.last()
        assert env.observe(next(other for other in env.possible_agents if other != agent)) in (OVER, WAIT)
        if terminated or truncated:
            assert seen == OVER
            env.step(None)
        else:
            strokes += 1
            env.step(str(seen).split("Legal strokes: ")[1].split(", ")[0])
    assert strokes > 0


SLOW: Final = [
    pytest.param(name, 100_000, marks=pytest.mark.slow) for name in ("ppo", "a2c", "sac", "ppo-self-play", "ppo-restricted")
]


@pytest.mark.parametrize(("method", "budget"), [("a2c", 20_000), ("ppo-self-play", 20_000), *SLOW])
def test_learners_fit_their_budgets(method: str, budget: int, tmp_path: Path) -> None:
    # Rallies become longer while a player learns, most of all in self-play.
    model = "default:recovery" if budget > 20_000 else f"{reduced_model()}:recovery"
    setting = PlayerSetting(game=load_game(model), model=model, opponent="bc", budget=budget, seed=0, folder=tmp_path)
    trained = find("exploit-v0", method)(setting)
    assert budget / 2 < trained.strokes <= budget
