"""The task text; programs, templates, and data."""

import dataclasses
import importlib
import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from shuttle_marl.analysis.tabular import SHRINK
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.programs import ProgramError
from shuttle_marl.base.table_files import read_parquet
from shuttle_marl.env.words import OVER, WAIT, TextRallyEnv, described, position, prompt, read_answer, text_env
from shuttle_marl.exact import best_response
from shuttle_marl.game.observation import states_of
from shuttle_marl.game.shipped import load_game
from shuttle_marl.game.tabulated import TabulatedPolicy
from shuttle_marl.recording.logs import play_log
from shuttle_marl.suite import store
from shuttle_marl.suite.adapt import observed
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.method import find
from shuttle_marl.suite.methods import solving, training
from shuttle_marl.suite.methods.chat import Chat
from shuttle_marl.suite.offline import generate
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import arena_of, find_task, new_submission, write_data
from shuttle_marl.suite.text import chosen_states, positions, regrets
from tests import golden
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy
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
    places = positions(arena)
    regret = regrets(GAME)
    assert regret.min() == 0
    best = summary(run(tmp_path / "best", "text-v0", "policy:minimax", split="test"))["scores"]
    assert (best["regret"]["value"], best["legal"]["value"]) == (pytest.approx(0, abs=1e-9), 1)
    folder = run(tmp_path / "wrong", "text-v0", f"{__name__}:Wrong", split="test")
    worst = summary(folder)["scores"]
    states = chosen_states(arena).tolist()
    assert worst["regret"]["value"] == pytest.approx(100 * np.mean([regret[GAME.pairs_of(state)].max() for state in states]))
    assert worst["legal"]["value"] == 0
    assert accepted(folder)
    assert len(places) == len(states)
    golden.check("text", {"places": places[:2], "states": states, "wrong": worst})
    chosen = GAME.pair(states[0], GAME.catalogue.names.index(places[0]["legal"][0]))
    assert regret[chosen] == pytest.approx(regret[GAME.pairs_of(states[0])][0])


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


def test_answers_of_chat_models_are_read() -> None:
    legal = ["smash:a", "clear:b"]
    assert read_answer("I considered smash:a, but clear:b is better.", legal) == "clear:b"
    assert read_answer("no idea", legal) is None
    setting: Any = None
    echo = Chat(setting, f"{sys.executable} -c \"import sys; print(sys.stdin.read().split('strokes: ')[1].split(', ')[0])\"")
    place = position(GAME, 0)
    assert echo.answer(place) == place["legal"][0]
    with pytest.raises(ProgramError, match="/no/such/program"):
        Chat(setting, "/no/such/program").answer(place)


def test_a_program_answers_positions(tmp_path: Path) -> None:
    program = tmp_path / "player.py"
    program.write_text(
        "import json, sys\nfor line in sys.stdin:\n    print(json.loads(line)['legal'][0], flush=True)\n", encoding="utf-8"
    )
    found = summary(run(tmp_path, "text-v0", f"program:{sys.executable} {program}", split="test"))
    assert found["scores"]["legal"]["value"] == 1


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


TEMPLATES: Final = "shuttle_marl.suite.templates.submission"
SMALL = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))


def test_the_template_of_text_attacks() -> None:
    player = importlib.import_module(f"{TEMPLATES}.text").Player()
    assert player.answer({"legal": ["lift:x", "smash:a", "net-kill:b"]}) == "smash:a"
    assert player.answer({"legal": ["lift:x", "clear:y"]}) == "lift:x"


def test_the_template_of_logs_counts_rallies_that_were_won() -> None:
    rows = ((0, 4, 0, True), (1, 0, 3, False), (1, 0, 3, True), (1, 0, 1, False), (0, 1, 2, True))
    contact, incoming, stroke, won = (np.array(column) for column in zip(*rows, strict=True))
    game = SimpleNamespace(n_strokes=4, contact=lambda state: contact[state], incoming=lambda state: incoming[state])
    learner = importlib.import_module(f"{TEMPLATES}.offline").Learner()
    found = learner.fit(SimpleNamespace(game=game, state=np.arange(5), stroke=stroke, won=won))
    expected = np.full((2, 5, 4), 0.4)
    expected[0, 4, 0], expected[1, 0, 3], expected[1, 0, 1], expected[0, 1, 2] = 3 / 6, 3 / 7, 2 / 6, 3 / 6
    assert found.worth == pytest.approx(expected)
    mask = np.array([[True, True, False, False], [False, True, True, True], [False, True, False, False]])
    states = SimpleNamespace(game=game, mask=mask, contact=np.array([0, 1, 1]), incoming=np.array([4, 0, 0]))
    assert found.probabilities(states).tolist() == [[1, 0, 0, 0], [0, 0, 0, 1], [0, 1, 0, 0]]


def test_the_template_of_estimates_weighs_rallies_by_clipped_ratios() -> None:
    data = SimpleNamespace(
        first=np.array([True, False, True, True]), won=np.array([True, True, False, True]), pair=np.arange(4),
        probability=np.array([0.5, 0.5, 0.25, 0.01]),
    )  # fmt: skip
    policy = SimpleNamespace(probability_of=lambda pair: np.array([1.0, 0.25, 0.5, 0.5])[pair])
    estimator = importlib.import_module(f"{TEMPLATES}.estimator").Estimator()
    found = estimator.estimate(SimpleNamespace(transitions=data), [policy, policy])
    assert found == pytest.approx([(1 + 20 + 1) / (1 + 2 + 20 + 2)] * 2)


def test_the_template_of_adapt_answers_the_likeliest_type() -> None:
    known = {str(i): random_policy(SMALL, i, 3.0) for i in range(3)}
    adapter = importlib.import_module(f"{TEMPLATES}.adapter").Adapter(SimpleNamespace(known=known))
    assert adapter.policy_for_next_rally().hash == best_response(known["0"]).policy.hash
    expected = np.zeros(3)
    for rally in observed(SMALL, (known["1"], known["2"]), 40, 0):
        adapter.observe_rally(rally)
        theirs = rally.pair[~rally.own]
        expected += [np.log(policy.pair_probabilities()[theirs].clip(1e-4)).sum() for policy in known.values()]
    assert adapter.log_likelihood == pytest.approx(expected, abs=1e-3)
    assert adapter.policy_for_next_rally().hash == best_response(known["2"]).policy.hash
    assert adapter.policy_for_next_rally() is adapter.policy_for_next_rally()


class Scripted:
    """An environment of rallies of two choices: after none, or after the shot of number 5; stroke 2 wins the rally at once."""

    def __init__(self) -> None:
        self.seeds: list[int | None] = []

    def seen(self) -> Any:
        observation = np.zeros(60)
        observation[27 + 5] = self.count
        return {"observation": observation, "action_mask": np.array([False, True, True, True, False])}

    def reset(self, seed: int | None) -> Any:
        self.seeds.append(seed)
        self.count = 0
        return self.seen(), {}

    def step(self, stroke: int) -> Any:
        self.count += 1
        return self.seen(), float(stroke == 2) - 0.5, stroke == 2 or self.count == 2, False, {}


@pytest.mark.parametrize(("budget", "strokes"), [(300, 100), (10**9, 9_800)])
def test_the_template_of_players_learns_within_its_budget(budget: int, strokes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    template, env, asked = importlib.import_module(f"{TEMPLATES}.player"), Scripted(), list[Any]()

    def make(_: str, **options: Any) -> Scripted:
        asked.append(options)
        return env

    monkeypatch.setattr(template.gymnasium, "make", make)
    game = SimpleNamespace(n_actions=5, n_strokes=4, catalogue=SimpleNamespace(shot=np.array([5, 1, 2, 3])))
    found = template.train(SimpleNamespace(game=game, seed=3, opponent=None, budget=budget))
    assert asked == [{"opponent": "bc", "game": game}]
    assert strokes <= found.strokes <= strokes + 1
    assert set(env.seeds[1:]) == {None}
    assert env.seeds[0] == 3
    worth = found.player.worth
    assert worth.shape == (14, 4)
    assert (worth[[0, 1, 4, 6]] == 0.5).all()
    assert (worth[[5, 13], 0] == 0.5).all()
    tried = 1 / (1 - worth[[5, 13], 2]) - 2
    assert tried == pytest.approx(np.rint(tried))
    assert worth[5, 1] < 0.5
    assert worth[13, 3] > worth[5, 3]
    states = SimpleNamespace(
        game=game,
        incoming=np.array([0, 4, 1]),
        mask=np.array([[True] * 4, [False, True, True, True], [True, True, False, False]]),
    )
    assert found.player.probabilities(states).tolist()[:2] == [[0, 0, 1, 0]] * 2
    assert found.player.probabilities(states)[2].tolist() == [1, 0, 0, 0]


class Alone:
    """The game as a method in a separate process receives it: two states of three strokes; stroke 1 wins."""

    seed = 2

    def __init__(self, budget: int, opponents: int, feasible: int) -> None:
        self.budget, self.opponents = budget, opponents
        self.mask, self.feasible = np.array([[True, True, True], [False, True, True]]), np.eye(2, 9, dtype=bool)[:feasible]
        self.steps: list[tuple[Any, ...]] = []

    def reset(self, rallies: int) -> Any:
        self.waits = np.arange(rallies) % 2 == 1 if len(self.feasible) else np.zeros(rallies, bool)
        return np.arange(rallies) % 2

    def step(self, actions: Any, *positions: Any) -> Any:
        self.steps.append((actions, *positions))
        return np.arange(256) % 2, np.where(actions == 1, 1.0, -1.0), None


@pytest.mark.parametrize(("opponents", "feasible", "number"), [(0, 0, 4), (3, 2, 4), (0, 2, 2)])
def test_the_template_that_runs_apart_plays_what_won(opponents: int, feasible: int, number: int) -> None:
    template, setting = importlib.import_module(f"{TEMPLATES}.apart"), Alone(1024 + 100, opponents, feasible)
    player = template.train(setting)
    assert len(setting.steps) == number
    hidden = feasible > 0
    for actions, *waited in setting.steps:
        assert len(waited) == (hidden and not opponents)
        assert (actions[0::2] < 3).all()
        if hidden:
            assert (actions[1::2] == 3 + 1).all()
            assert all((places[0::2] == 0).all() and (places[1::2] == 1).all() for places in waited)
        else:
            assert set(actions[1::2]) == {1, 2}
        assert set(actions[0::2]) == {0, 1, 2}
    played = np.concatenate([actions[0::2] if hidden else actions for actions, *_ in setting.steps])
    assert player.worth.tolist() == [-(played == 0).sum(), (played == 1).sum(), -(played == 2).sum()]
    mask = np.array([[True, True, True], [True, False, True]])
    best = 0 if player.worth[0] >= player.worth[2] else 2
    assert player.probabilities(None, mask).tolist() == [[0, 1, 0], np.eye(3)[best].tolist()]
    places = player.positions(None, np.array([[True, True, False], [False, False, False]]))
    assert places.tolist() == [[0.5, 0.5, 0], [0, 0, 0]]


@pytest.mark.skipif(shutil.which("perl") is None, reason="needs Perl")
def test_the_template_in_perl_plays_and_is_a_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert "'program:perl player.pl'" in new_submission("exploit-v0", tmp_path, "perl")
    folder = run(tmp_path, "exploit-v0", "program:perl player.pl")
    entry = store.read_entry(store.entry_path(folder, 0, 0))
    player = store.read_outcome(folder, entry, GAME).policies["player"]
    assert set(np.unique(player.cumulative)) <= {0, 65535}
    assert accepted(folder)
    with pytest.raises(SuiteError, match="no such template"):
        new_submission("adapt-v0", tmp_path, "perl")
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


def a_player_setting(folder: Path, budget: int = 1200, opponent: str | None = "random") -> PlayerSetting:
    return PlayerSetting(game=SMALL, model="model", opponent=opponent, budget=budget, seed=3, folder=folder)


@pytest.fixture
def learned(monkeypatch: pytest.MonkeyPatch) -> list[tuple[PlayerSetting, dict[str, Any], Any]]:
    """Settings and options of the agents that were trained, and the opponents in them as probabilities."""
    found: list[tuple[PlayerSetting, dict[str, Any], Any]] = []

    def trained(setting: PlayerSetting, algorithm: str = "ppo", **options: Any) -> Trained:
        assert algorithm == "ppo"
        kind, _, path = (setting.opponent or "").partition(":")
        policy = TabulatedPolicy.load(Path(path), SMALL) if kind == "table" else setting.policy("random")
        against = policy.pair_probabilities()
        found.append((setting, options, against))
        return Trained(player=random_policy(SMALL, len(found)), strokes=100 + len(found), curve=((1, 0.5),))

    monkeypatch.setattr(training, "_trained", trained)
    return found


def test_fictitious_self_play_responds_to_the_mean(tmp_path: Path, learned: list[Any]) -> None:
    found = training.fictitious_self_play(a_player_setting(tmp_path))
    assert [(setting.budget, setting.folder.name, setting.seed) for setting, _, _ in learned] == [
        (100, str(i), 3) for i in range(6)
    ]
    responses = [random_policy(SMALL, i + 1).pair_probabilities() for i in range(6)]
    uniform = 1 / SMALL.legal_count(SMALL.pair_state)
    for turn, (_, _, against) in enumerate(learned):
        np.testing.assert_allclose(against, np.mean(responses[:turn], axis=0) if turn else uniform, atol=2e-4)
    np.testing.assert_allclose(found.player.pair_probabilities(), np.mean(responses, axis=0), atol=2e-4)
    assert found.strokes == 2 * sum(range(101, 107))


def test_the_restricted_learner_meets_the_answers_to_its_agents(tmp_path: Path, learned: list[Any]) -> None:
    found = training.ppo_restricted(a_player_setting(tmp_path))
    assert [setting.budget for setting, _, _ in learned] == [300] * 4
    answers = [best_response(random_policy(SMALL, i + 1)).policy.pair_probabilities() for i in range(4)]
    uniform = 1 / SMALL.legal_count(SMALL.pair_state)
    for phase, (_, _, against) in enumerate(learned):
        expected = WEIGHT * uniform + (1 - WEIGHT) * np.mean(answers[:phase], axis=0) if phase else uniform
        np.testing.assert_allclose(against, expected, atol=2e-4)
    assert found.player.hash == random_policy(SMALL, 4).hash
    assert found.strokes == 101 + 102 + 103 + 104


def test_variants_of_self_play_have_their_options(tmp_path: Path, learned: list[Any]) -> None:
    setting = a_player_setting(tmp_path)
    training.ppo_variant(setting, "restarts")
    training.ppo_variant(setting, "best-response")
    training.ppo_self_play(setting)
    always = training.ppo_deterministic(setting)
    assert [(each.budget, each.opponent, options) for each, options, _ in learned] == [
        (1176, "random", {"variant": "restarts"}),
        (1200, "random", {"variant": "best-response"}),
        (1200, None, {}),
        (1200, "random", {}),
    ]
    assert (always.strokes, always.curve) == (104, ())
    assert set(np.unique(always.player.cumulative)) == {0, 65535}


@pytest.mark.parametrize(("budget", "share"), [(50_000, 0.5), (50_001, 0.65), (200_000, 0.65), (10**6, 0.94)])
def test_the_plan_of_a_learner_fits_its_budget(
    budget: int, share: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    configs: list[Any] = []

    def train(config: Any) -> Any:
        configs.append(config)
        config.out.mkdir()
        rows = ({"strokes": 5, "normalised_score": 0.25, "exploitability": 1}, {"strokes": 9, "normalised_score": None})
        (config.out / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
        return SimpleNamespace(folder=config.out, policy="policy", strokes=77)

    monkeypatch.setattr("shuttle_marl.training.train", train)
    monkeypatch.setattr(training, "load_game", lambda _: SMALL)
    setting = a_player_setting(tmp_path, budget)
    found = training._trained(setting)
    assert (found.player, found.strokes, found.curve) == ("policy", 77, ((5, 0.25),))
    (config,) = configs
    assert (config.opponent, config.seed, config.record, config.resume, config.exploitability) == (
        ("random",),
        3,
        "none",
        False,
        False,
    )
    assert config.batch == min(type(config)().batch, budget // 12)
    assert sum(map(config.batch_of, range(config.iterations))) <= share * budget
    longer = dataclasses.replace(config, strokes=int(config.strokes / 0.97) + 1)
    assert sum(map(longer.batch_of, range(longer.iterations))) > share * budget
    monkeypatch.setattr(training, "load_game", lambda _: GAME)
    with pytest.raises(SuiteError, match="ppo trains in the game of a model, and this game is drawn"):
        training._trained(setting)


def test_leagues_of_the_suite_have_their_options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configs: list[Any] = []

    def train_league(config: Any) -> Any:
        configs.append(config)
        return SimpleNamespace(folder=config.out, figures={"strokes": 55})

    monkeypatch.setattr("shuttle_marl.training.league.run.train_league", train_league)
    setting = a_player_setting(tmp_path, 100_000)
    for method in (training.psro, training.psro_exact):
        found = method(setting)
        assert str(found.player).startswith(f"table:{tmp_path / 'league'}")
        assert found.strokes == 55
    learned, exact = configs
    assert (learned.oracle, learned.strokes, learned.batch) == ("ppo", 85_000, 1000)
    assert (exact.oracle, exact.rounds) == ("exact", 24)
    assert {(each.variant, each.seed, each.game, each.record, each.workers, each.resume) for each in configs} == {
        ("psro", 3, "model", "none", 1, False)
    }


@pytest.mark.parametrize(
    ("hidden", "both", "asked", "used"),
    [(False, False, 900, 2), (True, False, 450, 3), (False, True, 450, 3), (True, True, 225, 6)],
)
def test_random_play_of_a_solver_fits_its_budget(
    hidden: bool, both: bool, asked: int, used: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = play_log((random_policy(SMALL, 0), random_policy(SMALL, 1)), 1, 0)
    log = dataclasses.replace(log, own=np.array([True, False, True]), state=np.zeros(3, np.int32))
    given: list[Any] = []

    def play(*arguments: Any) -> Any:
        given.append(arguments)
        return log

    monkeypatch.setattr(solving, "play_log", play)
    game: Any = SimpleNamespace(recovery=hidden or None)
    setting: Any = SimpleNamespace(game=game, opponent=None if both else "bc", budget=1000, seed=4, policy=lambda name: name)
    found, strokes = solving._random_log(setting, "against")  # type: ignore[arg-type]
    assert given == [(("random", "against"), asked, 4)]
    assert strokes == used
    assert found.game.recovery is None
    setting.budget = 10**9
    solving._random_log(setting, "against")  # type: ignore[arg-type]
    assert given[1][1] == 360_000


@pytest.mark.parametrize("hidden", [False, True])
def test_a_boosted_model_is_learned_in_two_turns(hidden: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = play_log((random_policy(SMALL, 0), random_policy(SMALL, 1)), 20, 0)
    players, calls, answer = list[Any](), list[Any](), random_policy(SMALL, 5)

    def play(both: Any, strokes: int, seed: int) -> Any:
        players.append(both)
        calls.append((strokes, seed))
        return log

    def boosted(game: Any, pair: Any, outcome: Any, *options: Any, **more: Any) -> Any:
        assert game.recovery is None
        calls.append((len(pair), len(outcome), *options))
        assert more == {"objective": "multiclass", "num_class": 6}
        return "shares"

    def response(estimate: Any, p: float) -> Any:
        calls.append((estimate.game, estimate.probability, p))
        return answer

    monkeypatch.setattr(solving, "play_log", play)
    monkeypatch.setattr(solving, "boosted", boosted)
    monkeypatch.setattr(solving, "game_of", lambda game, shares: shares)
    monkeypatch.setattr(solving, "cloned", lambda game, pairs, shrink: (len(pairs), shrink))
    monkeypatch.setattr(solving, "respond", response)
    monkeypatch.setattr(solving, "PairPolicy", SimpleNamespace)
    setting = a_player_setting(tmp_path, 4000)
    if hidden:
        plain, game = SMALL, load_game(f"{reduced_model()}:recovery")
        monkeypatch.setattr(dataclasses, "replace", lambda *_, **__: plain)
        setting = PlayerSetting(game=game, model="", opponent="random", budget=4000, seed=3, folder=tmp_path)
        monkeypatch.setattr(solving, "mixture", lambda parts, shares: (parts[0].cumulative is answer.cumulative, shares))
    found = solving.model_boosted(setting, "0.5")
    n, theirs = len(log), int((~log.own).sum())
    strokes = (2000 if hidden else 4000) * 9 // 20 - 200
    expected: list[Any] = []
    for turn in (1, 2):
        expected += [(strokes, 5 + turn), (turn * n, turn * n, 150, 3), ("shares", (turn * theirs, SHRINK), 0.5)]
    assert calls == expected
    assert found.player.cumulative is answer.cumulative
    assert found.strokes == 2 * (n if hidden else int(log.own.sum()))
    uniform = setting.policy("random")
    assert players[0][0].hash == uniform.hash
    if hidden:
        assert players[1][0] == (True, [0.8, 0.2])
    else:
        mixed = 0.8 * answer.pair_probabilities() + 0.2 * uniform.pair_probabilities()
        np.testing.assert_allclose(players[1][0].pair_probabilities(), mixed, atol=1e-4)


@pytest.mark.parametrize(("method", "budget"), [("a2c", 20_000), ("ppo-self-play", 20_000), *SLOW])
def test_learners_fit_their_budgets(method: str, budget: int, tmp_path: Path) -> None:
    # Rallies become longer while a player learns, most of all in self-play.
    model = "default:recovery" if budget > 20_000 else f"{reduced_model()}:recovery"
    setting = PlayerSetting(game=load_game(model), model=model, opponent="bc", budget=budget, seed=0, folder=tmp_path)
    trained = find("exploit-v0", method)(setting)
    assert budget / 2 < trained.strokes <= budget
