"""Methods, tasks and cases by name, what methods return, and how boards are ordered and written."""

import functools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game.policy import PolicyError
from shuttle_marl.suite import board, method, options, registry, results
from shuttle_marl.suite import text as text_module
from shuttle_marl.suite.board import boards, called, code, number, shown, standing, stated, with_interval
from shuttle_marl.suite.exploit import Equilibrium, Exploit, PlayerSetting, Trained, outcome_of
from shuttle_marl.suite.method import BASELINES, baseline_of, find, kind_of, made
from shuttle_marl.suite.offline import OPPONENT
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.registry import TASKS, arena_of, find_task, new_submission, task_of_run, write_data
from shuttle_marl.suite.task import Arena, Case, Outcome, required, table_of
from shuttle_marl.suite.text import LineProgram, Text, TextSetting
from tests.exact.exact_games import THREE_STROKES, hand_made, random_policy

GAME = hand_made((*THREE_STROKES, "clear:back-left:above:forehand"))


class Player:
    """A class that takes nothing, and has an act."""

    def act(self, observation: Any, mask: Any) -> int:
        return int(mask.argmax())

    def fails(self) -> None:
        raise ValueError("no idea")


def nothing() -> None:
    raise ImportError("stop")


number_seven = 7


@pytest.mark.parametrize(
    ("task_name", "name", "says"),
    [
        ("exploit-v0", "nothing", "no method 'nothing' of exploit-v0; there are: ppo, a2c"),
        ("exploit-v0", "", "no method '' of exploit-v0"),
        ("exploit-v0", "mine:", "no method 'mine:' of exploit-v0"),
        ("exploit-v0", "program:", "programs, as program:COMMAND, are possible in exploit-v0, equilibrium-v0, text-v0"),
        ("adapt-v0", "program:./x", "no method 'program:./x' of adapt-v0: programs, as program:COMMAND, are possible in"),
        ("exploit-v0", "bc:3", "method 'bc:3': bc takes no argument"),
        ("exploit-v0", "ppo-self-play:3", "method 'ppo-self-play:3': ppo-self-play takes no argument"),
        ("text-v0", "random:", "method 'random:': random takes no argument"),
        ("exploit-v0", f"{__name__}:number_seven", "is a int; expected a function or a class"),
    ],
)
def test_methods_that_are_none(task_name: str, name: str, says: str) -> None:
    with pytest.raises(SuiteError, match=says):
        find(task_name, name)


@pytest.mark.parametrize(("name", "argument"), [("restricted:", ""), ("restricted:0.5", "0.5"), ("restricted-counts:0.5", "0.5")])
def test_an_argument_is_taken_where_there_is_a_default(name: str, argument: str) -> None:
    found = find("exploit-v0", name)
    assert isinstance(found, functools.partial)
    assert found.keywords == {"argument": argument}


def test_every_baseline_is_found_with_its_argument() -> None:
    for kind, known in BASELINES.items():
        for name, baseline in known.items():
            found = find(f"{kind}-v0", name)
            plain = getattr(found, "func", found)
            own = baseline.path.partition(":")[2]
            assert plain.__name__.lower().replace("_", "") == own.replace("-", ""), name
            assert getattr(found, "keywords", {}).get("argument") == baseline.argument
            assert baseline_of(f"{kind}-entrance-v0", name) is baseline
    assert baseline_of("exploit-v0", "mine:train") is None
    assert baseline_of("exploit-v0", "ppo:3") is BASELINES["exploit"]["ppo"]
    assert find("exploit-v0", f"{__name__}:Player") is Player
    assert kind_of("exploit-entrance-v0") == "exploit"


def test_programs_are_named_or_adapted() -> None:
    assert find("exploit-v0", "program:./x a")(SimpleNamespace()) == "program:./x a"
    setting = SimpleNamespace(program=lambda name: ["adapted", name])
    assert find("text-v0", "program:./x a")(setting) == ["adapted", "program:./x a"]


def test_what_a_method_makes_has_the_calls_of_its_task() -> None:
    assert isinstance(made(Player, None, "a task", "act"), Player)
    assert made(lambda setting: setting, "given", "a task") == "given"
    with pytest.raises(SuiteError, match="the method of a task: expected an object with act and fit, got a Player"):
        made(Player, None, "a task", "act", "fit")
    failing, stopping = (function.__code__.co_firstlineno + 1 for function in (Player.fails, nothing))
    with pytest.raises(SuiteError, match=rf"a task raised ValueError: no idea \(test_methods_by_name.py, line {failing}\)"):
        method.called("a task", Player().fails)
    with pytest.raises(SuiteError, match=rf"a task raised ImportError: stop \(test_methods_by_name.py, line {stopping}\)"):
        made(nothing, None, "a task")
    with pytest.raises(PolicyError, match="of the package"):
        method.called("a task", _raise, PolicyError("of the package"))
    with pytest.raises(SuiteError, match="a task raised SystemExit"):
        method.called("a task", _raise, SystemExit(3))


def _raise(error: BaseException) -> None:
    raise error


def test_names_of_tasks_and_splits() -> None:
    assert find_task("text-v0") is TASKS["text-v0"]
    with pytest.raises(SuiteError, match=r"no task 'exploit'.*there are: exploit-v0, equilibrium-v0"):
        find_task("exploit")
    with pytest.raises(SuiteError, match="text-v0 has no split 'round'; there are: dev, test"):
        arena_of(find_task("text-v0"), "default", "round")
    for given in (None, "xyz", "ab"):
        with pytest.raises(SuiteError, match="64 hexadecimal digits of randomness"):
            arena_of(find_task("exploit-v0"), "default", "round", beacon=given)


def test_the_game_of_an_arena_has_the_variant_of_its_split(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(registry, "resolve_game", lambda name: asked.append(name) or GAME)  # type: ignore[func-returns-value]
    monkeypatch.setattr(registry, "drawn_game", lambda game, rng, sigma: SimpleNamespace(hash="drawn", sigma=sigma))
    arena_of.cache_clear()
    beacon = "ab" * 32
    drawn = arena_of(find_task("exploit-v0"), "m", "round", beacon=beacon, quick=True, budget=7)
    assert (drawn.model, drawn.base, drawn.split, drawn.quick, drawn.budget) == ("m:recovery", GAME.hash, "round", True, 7)
    assert (drawn.game.hash, drawn.game.sigma, drawn.beacon) == ("drawn", 0.5, beacon)  # type: ignore[attr-defined]
    plain = arena_of(find_task("exploit-entrance-v0"), "m", "test")
    assert (plain.model, plain.base, plain.game, plain.quick, plain.budget, plain.beacon) == (
        "m",
        GAME.hash,
        GAME,
        False,
        None,
        None,
    )
    for name, split, expected in (
        ("equilibrium-v0", "dev", "m:women-recovery"),
        ("equilibrium-entrance-v0", "dev", "m:women"),
        ("equilibrium-v0", "test", "m:recovery"),
        ("text-v0", "dev", "m:women"),
    ):
        assert arena_of(find_task(name), "m", split).model == expected
    arena_of.cache_clear()


def config(**fields: Any) -> Any:
    plain = {"task": "exploit-v0", "split": "dev", "quick": False, "budget": 10**5, "game": SimpleNamespace(model="default")}
    return SimpleNamespace(**{**plain, **fields})


def test_runs_of_strangers_name_shipped_models_and_one_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Any] = []
    arena = Arena(game=GAME)

    def arena_for(*arguments: Any, **named: Any) -> Arena:
        seen.append((arguments[1:], named))
        return arena

    monkeypatch.setattr(registry, "arena_of", arena_for)
    monkeypatch.setattr(registry, "is_shipped", lambda model: model == "default")
    cases = [Case(name="a", budget=1), Case(name="b", budget=2)]
    monkeypatch.setattr(Exploit, "cases", lambda self, _: cases)
    assert task_of_run(config()) == (TASKS["exploit-v0"], arena, cases)
    assert task_of_run(config(game=SimpleNamespace(model="/theirs")), "mine", "ab")[1] is arena
    assert seen == [
        (("default", "dev"), {"quick": False, "budget": 10**5, "beacon": None}),
        (("mine", "dev"), {"quick": False, "budget": 10**5, "beacon": "ab"}),
    ]
    with pytest.raises(SuiteError, match="the run names the model '/theirs', which is not shipped"):
        task_of_run(config(game=SimpleNamespace(model="/theirs")))
    with pytest.raises(SuiteError, match="the run names no budget; budgets are never pooled"):
        task_of_run(config(budget=None))
    del cases[1]
    assert task_of_run(config(budget=None))[2] == cases


@pytest.mark.parametrize(
    ("name", "language", "files", "line"),
    [
        ("exploit-v0", "python", {"my_player.py", "card.json"}, "run exploit-v0 --method my_player:train --quick"),
        ("adapt-v0", "python", {"my_adapter.py", "card.json"}, "run adapt-v0 --method my_adapter:Adapter --quick"),
        ("equilibrium-entrance-v0", "perl", {"player.pl", "card.json"}, "--method 'program:perl player.pl' --quick"),
        (
            "equilibrium-v0",
            "apart",
            {"my_apart.py", "card.json"},
            "commit . --task equilibrium-v0 --method my_apart:train --author",
        ),
    ],
)
def test_templates_are_new_files(name: str, language: Any, files: set[str], line: str, tmp_path: Path) -> None:
    assert line in new_submission(name, tmp_path / "mine", language)
    assert {path.name for path in (tmp_path / "mine").iterdir()} == files
    for kept in files:
        (tmp_path / kept).mkdir()
        (tmp_path / kept / kept).touch()
        with pytest.raises(SuiteError, match=f"{kept}: already exists; name another folder"):
            new_submission(name, tmp_path / kept, language)


@pytest.mark.parametrize(("name", "language"), [("adapt-v0", "perl"), ("text-v0", "apart"), ("offline-v0", "perl")])
def test_templates_that_there_are_not(name: str, language: Any, tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match=f"no such template for {name}; there is one for exploit, equilibrium"):
        new_submission(name, tmp_path, language)


def test_data_of_tasks_without_logs_and_of_no_seeds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "arena_of", lambda *_, **__: Arena(game=GAME))
    for seeds, says in (
        (0, "--seeds 0: expected 1 or more"),
        (-1, "--seeds -1"),
        (1, "exploit-v0 has no data"),
        (None, "no data"),
    ):
        with pytest.raises(SuiteError, match=says):
            write_data("exploit-v0", tmp_path, "dev", "default", seeds)


def test_logs_are_written_by_behaviour_budget_and_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = registry.TASKS["offline-v0"]
    cases = [
        Case(name="a", budget=300, options={"behaviour": "bc*minimax:robust+x"}),
        Case(name="b", budget=40, options={"behaviour": "bc", "log": "fresh"}),
        Case(name="c", budget=40, options={"behaviour": "bc", "log": "same"}),
    ]
    monkeypatch.setattr(registry, "arena_of", lambda *_, **__: Arena(game=GAME, model="m"))
    monkeypatch.setattr(type(found), "cases", lambda self, _: cases)
    log = SimpleNamespace(transitions="t", table=lambda: "table")
    monkeypatch.setattr(
        registry, "log_of_unit", lambda arena, case, seed: SimpleNamespace(**vars(log), hash=f"{case.name}{seed}")
    )
    written: list[Any] = []
    monkeypatch.setattr(registry, "write_parquet", lambda path, table: written.append(path.relative_to(tmp_path)))
    monkeypatch.setattr(registry, "write_minari", lambda _, name, *rest: written.append((name, *rest)))
    names = ["test-bcxminimax-robust-x-300", "test-bc-40-fresh", "test-bc-40"]
    hashes = write_data("offline-v0", tmp_path, "test", "m", 2)
    assert hashes == {
        f"{name}-{seed}.parquet": f"{each}{seed}" for name, each in zip(names, "abc", strict=True) for seed in (0, 1)
    }
    assert [str(path) for path in written] == list(hashes)
    assert len(write_data("offline-v0", tmp_path, "test", "m", None)) == 3 * found.seeds
    written.clear()
    hashes = write_data("offline-v0", tmp_path, "test", "m", 1, minari=True)
    assert list(hashes) == [f"shuttle_marl/{name}-v0" for name in names]
    assert written[0] == ("shuttle_marl/test-bcxminimax-robust-x-300-v0", tmp_path, "m", OPPONENT)


def test_strokes_and_curves_of_a_trained_player() -> None:
    policy = random_policy(GAME, 0)
    plain = outcome_of(policy, GAME, "a task")
    assert (plain.policies["player"].hash, plain.strokes, plain.curve) == (policy.hash, None, ())
    found = outcome_of(Trained(player=policy, strokes=np.int64(7), curve=((np.int64(1), np.float32(0.5)),)), GAME, "a task")  # type: ignore[arg-type]
    assert (found.strokes, found.curve) == (7, ((1, 0.5),))
    assert [type(found.strokes), *map(type, found.curve[0])] == [int, int, float]
    for strokes in (7.5, "7"):
        with pytest.raises(SuiteError, match=f"the method of a task used {strokes!r} strokes, no whole number"):
            outcome_of(Trained(player=policy, strokes=strokes), GAME, "a task")  # type: ignore[arg-type]


def test_players_of_all_forms_are_tables() -> None:
    policy = random_policy(GAME, 2)
    assert table_of(policy, GAME, "a task") is policy
    assert table_of(SimpleNamespace(table=SimpleNamespace(table=policy)), GAME, "a task") is policy
    first = table_of(Player(), GAME, "a task").pair_probabilities()
    assert np.array_equal(first == 1, GAME.rank(GAME.pair_state, GAME.pair_stroke) == 0)
    for wrong in (3, None, object()):
        with pytest.raises(SuiteError, match=f"the method of a task returned a {type(wrong).__name__}; expected a policy"):
            table_of(wrong, GAME, "a task")
    assert required(Outcome(policies={"player": policy})) is policy
    with pytest.raises(SuiteError, match="no policy 'player' is stored"):
        required(Outcome(policies={"other": policy}))


def test_cases_of_exploit_and_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shuttle_marl.suite.exploit.families", lambda _: ["a", "switcher", "b", "learner", "c"])
    names = {
        split: [case.options["opponent"] for case in Exploit().all_cases(Arena(game=GAME, split=split)) if case.budget == 10**5]
        for split in ("dev", "test", "round")
    }
    assert names["round"] == ["a/2000", "b/2002", "c/2004"]
    assert names["test"] == ["bc", "defensive", *names["round"]]
    assert names["dev"] == ["bc@0.5", "a/2000", "b/2002"]
    every = Exploit().cases(Arena(game=GAME))
    assert [case.name for case in every[:3]] == ["bc@0.5/100,000", "bc@0.5/1,000,000", "bc@0.5/10,000,000"]
    assert [case.budget for case in every] == [10**5, 10**6, 10**7] * 3
    (quick,) = Exploit().cases(Arena(game=GAME, quick=True))
    assert (quick.name, quick.budget, quick.stratum, quick.counts) == ("bc@0.5/20,000", 20_000, "bc@0.5/20,000", True)
    assert [case.budget for case in Equilibrium().cases(Arena(game=GAME))] == [10**6, 10**7, 10**8]
    assert [case.name for case in Equilibrium().cases(Arena(game=GAME, quick=True))] == ["20,000"]
    assert [case.budget for case in Exploit().cases(Arena(game=GAME, budget=10**6))] == [10**6] * 3
    with pytest.raises(SuiteError, match="--budget 5: exploit-v0 has 100000, 1000000, 10000000"):
        Exploit().cases(Arena(game=GAME, budget=5))
    with pytest.raises(SuiteError, match="--budget 5: text-v0 has no budgets"):
        Text().cases(Arena(game=GAME, budget=5))


def test_settings_of_players(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[PlayerSetting] = []
    policy = random_policy(GAME, 1)

    def train(setting: PlayerSetting) -> Any:
        given.append(setting)
        return Trained(player=policy, strokes=5)

    arena = Arena(game=GAME, model="m")
    case = Case(name="x", budget=9, options={"opponent": "random"})
    assert Exploit().play(arena, case, train, 4, tmp_path).strokes == 5
    (setting,) = given
    assert (setting.game, setting.model, setting.opponent, setting.budget, setting.seed, setting.folder) == (
        GAME, "m", "random", 9, 4, tmp_path,
    )  # fmt: skip
    assert setting.against is setting.policy("random")
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr("shuttle_marl.suite.exploit.opponent", lambda *asked: SimpleNamespace(policies=[policy], asked=asked))
    drawn = Case(name="y", budget=9, options={"opponent": "tilted/2003"})
    Exploit().play(arena, drawn, train, 4, tmp_path)
    assert given[1].opponent == f"table:{tmp_path / 'opponent.npz'}"
    assert given[1].against.hash == policy.hash
    assert list(Exploit().given(arena, drawn, 0)) == [policy.hash]
    Equilibrium().play(arena, Case(name="z", budget=9), train, 4, tmp_path)
    assert given[2].opponent is None
    assert list(Equilibrium().given(arena, Case(name="z"), 0)) == []


def test_answers_in_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = [b'{"stroke": "smash:a"}\n', b" clear:b \r", b"[1]", b'{"other": 1}', b"7", b"\xff"]
    written: list[bytes] = []
    program = SimpleNamespace(read_line=lambda: lines.pop(0), write=written.append)
    given: list[Any] = []
    monkeypatch.setattr(text_module, "Program", lambda *arguments: given.append(arguments) or program)  # type: ignore[func-returns-value]
    player = TextSetting(game=GAME, model="m", seed=0, folder=Path()).program("program:./x --a:b")
    place: Any = {"id": 3, "text": "You serve."}
    found = [player.answer(place) for _ in range(6)]
    assert found == ["smash:a", "clear:b", "[1]", '{"other": 1}', "7", "\ufffd"]
    assert given == [("./x --a:b", 120.0)]
    assert written == [b'{"id": 3, "text": "You serve."}\n'] * 6
    assert isinstance(player, LineProgram)


def test_scores_of_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """The regret of a legal stroke, the largest one of the state for any other answer; in points, of which a rally has 100."""
    several = np.flatnonzero(GAME.legal_count(np.arange(GAME.n_states)) > 1)[:3]
    regret = np.arange(GAME.n_pairs) / 1000
    pairs = [GAME.pairs_of(state) for state in several.tolist()]
    arena = Arena(game=GAME)
    monkeypatch.setattr(text_module, "chosen_states", lambda _: several)
    monkeypatch.setattr(text_module, "regrets", lambda _: regret)
    policy = random_policy(GAME, 1)
    monkeypatch.setattr(Arena, "policy", lambda self, name: policy if name == "bc" else None)
    names = GAME.catalogue.names
    serve = next(name for name in names if "serve" in name)
    answers = [names[GAME.pair_stroke[pairs[0].start]], serve, "smash"]
    task_, case = Text(), Case(name="positions")
    outcome = Outcome(answers={"strokes": answers})
    lost = [regret[pairs[0].start], regret[pairs[1].stop - 1], regret[pairs[2].stop - 1]]
    assert task_.parts(arena, case, outcome) == pytest.approx({str(i): 100 * each for i, each in enumerate(lost)})
    scores = task_.score(arena, case, 0, outcome)
    share = policy.pair_probabilities()[pairs[0].start]
    assert scores == pytest.approx({"regret": 100 * np.mean(lost), "legal": 1 / 3, "likeness": share / 3})
    for wrong in (answers[:2], [*answers, "x"], None, {"0": "x"}):
        with pytest.raises(SuiteError, match="expected 3 answers"):
            task_.score(arena, case, 0, Outcome(answers={"strokes": wrong}))
    given = iter(["x" * 200, 7, "smash:a"])
    monkeypatch.setattr(text_module, "positions", lambda _: [{}, {}, {}])
    player = SimpleNamespace(answer=lambda position: next(given))
    assert task_.play(arena, case, lambda setting: player, 0, Path()).answers == {"strokes": ["x" * 100, None, "smash:a"]}
    assert [task_.all_cases(Arena(game=GAME, quick=quick))[0].name for quick in (False, True)] == ["positions", "positions/20"]


def row(**fields: Any) -> Any:
    bounds = {"value": 1.0, "low": None, "high": None}
    plain = {
        "task": "exploit-entrance-v0", "split": "test", "budget": 10**5, "cases": "c" * 64, "game": "g" * 64, "method": "mine",
        "author": "", "kind": "method", "access": "samples", "score": 0.5, "scores": {"gain": bounds, "best": bounds},
        "seeds": 3, "outputs": "o", "units": {"0": {"a": [0.5]}}, "remarks": [], "commitment": None, "recomputed": True,
    }  # fmt: skip
    return {**plain, **fields}


def test_rows_are_ordered_by_class_access_and_score() -> None:
    rows = [
        row(method="low", score=0.1),
        row(method="reader", score=0.9, access="opponent"),
        row(method="high", score=0.8),
        row(method="tables", score=0.95, access="tables"),
        row(method="reference", score=0.99, kind="reference"),
        row(method="unchecked", score=0.85, recomputed=False),
        row(method="rerun", score=0.2, reran_by=["bob"]),
        row(method="taken as it is", score=0.3, recomputed=None),
    ]
    (found,) = boards(rows)
    order = ["rerun", "reference", "unchecked", "high", "taken as it is", "low", "tables", "reader"]
    assert [each["method"] for each in found["rows"]] == order
    ranks = {each["method"]: each.get("rank") for each in found["rows"]}
    assert ranks == {
        "rerun": 1, "reference": None, "unchecked": None, "high": 1, "taken as it is": 2, "low": 3, "tables": 1, "reader": 1,
    }  # fmt: skip
    assert found["best"] is not None
    assert (found["best"]["method"], found["optimum"], found["gap"]) == ("rerun", 1.0, pytest.approx(0.8))
    assert (found["title"], found["split"], found["budget"]) == ("exploit-entrance-v0, test, 100,000 strokes", "test", 10**5)
    assert found["columns"] == ["best"]


def test_less_is_better_where_the_metric_is_a_loss() -> None:
    bounds = {"value": 1.0, "low": None, "high": None}
    rows = [
        row(task="text-v0", budget=None, score=score, method=str(score), scores={"regret": bounds, "legal": bounds}, split="dev")
        for score in (3.0, 1.0, 2.0)
    ]
    (found,) = boards(rows)
    assert [each["method"] for each in found["rows"]] == ["1.0", "2.0", "3.0"]
    assert (found["title"], found["budget"], found["optimum"], found["gap"]) == ("text-v0, dev", 0, 0.0, 1.0)
    (empty,) = boards([row(task="text-v0", budget=None, kind="reference", split="dev")])
    assert (empty["best"], empty["optimum"], empty["gap"]) == (None, 0.0, None)


def test_boards_stand_by_task_split_budget_and_cases() -> None:
    rows = [
        row(budget=10**6), row(split="dev"), row(game="h" * 64), row(cases="d" * 64), row(), row(split="round"),
        row(task="unknown"), row(task="text-v0", split="round"), row(task="exploit-v0"),
    ]  # fmt: skip
    assert [found["title"] for found in boards(rows)] == [
        "exploit-v0, test, 100,000 strokes",
        "exploit-entrance-v0, dev, 100,000 strokes",
        "exploit-entrance-v0, test, 100,000 strokes, game gggggggg, cases cccccccc",
        "exploit-entrance-v0, test, 100,000 strokes, game gggggggg, cases dddddddd",
        "exploit-entrance-v0, test, 100,000 strokes, game hhhhhhhh, cases cccccccc",
        "exploit-entrance-v0, test, 1,000,000 strokes",
        "exploit-entrance-v0, round, 100,000 strokes",
    ]
    with_more = boards([row(), row(cases="d" * 64)])
    assert [len(found["rows"]) for found in with_more] == [1, 1]


RERUN = {"commitment": "k", "reran_by": ["bob"], "round": "r"}


@pytest.mark.parametrize(
    ("new", "other", "says"),
    [
        ({}, {"task": "text-v0", "outputs": "p"}, None),
        ({}, {"split": "dev"}, None),
        ({}, {"budget": 1}, None),
        ({}, {"cases": "d"}, None),
        ({"outputs": "p", "units": {}}, {}, None),
        ({"seeds": 2}, {}, None),
        ({}, {}, "the same run as another one of the board"),
        ({"outputs": "p"}, {}, "the same run as another one of the board"),
        ({"units": {}}, {}, "the same run as another one of the board"),
        ({**RERUN, "round": "s"}, RERUN, "is of another file of the round; take that of the organiser"),
        ({**RERUN, "round": "s"}, {}, "the same run as another one of the board"),
        ({**RERUN, "reran_by": ["al"], "score": 0.5 + 1e-3}, RERUN, r"says 0.5010 \(3 seeds\); the code gave 0.5000 \(3 seeds\)"),
        ({"commitment": "k", "reran_by": [], "seeds": 2}, RERUN, r"says 0.5000 \(2 seeds\); the code gave 0.5000 \(3 seeds\)"),
        ({"commitment": "k", "reran_by": [], "outputs": "p"}, RERUN, "the code gave"),
    ],
)
def test_runs_that_stand_beside_others(new: Any, other: Any, says: str | None) -> None:
    mine, theirs = row(**{"reran_by": [], **new}), row(**other)
    if says is None:
        assert board._is_new(mine, [theirs])
        assert (mine["remarks"], theirs["remarks"]) == ([], [])
        return
    with pytest.raises(SuiteError, match=says):
        board._is_new(mine, [theirs])
    if mine["reran_by"] and "says" in says:
        assert theirs["remarks"] == ["0.5010 when al reran it"]
    else:
        assert theirs["remarks"] == []


def test_another_rerun_of_the_same_code_is_added() -> None:
    theirs = row(**RERUN)
    assert not board._is_new(row(**{**RERUN, "reran_by": ["al", "bob"], "score": 0.5 + results.TOLERANCE / 2}), [theirs])
    assert theirs["reran_by"] == ["al", "bob"]
    assert not board._is_new(row(commitment="k", reran_by=[]), [theirs])
    assert theirs["reran_by"] == ["al", "bob"]


def test_copies_of_another_author_are_marked_on_both() -> None:
    for change, what in (({}, "policies"), ({"outputs": "p"}, "scores")):
        mine, theirs = row(author="eve", reran_by=[], **change), row(author="ann")
        assert board._is_new(mine, [theirs])
        assert (mine["remarks"], theirs["remarks"]) == ([f"the same {what} as ann/mine"], [f"the same {what} as eve/mine"])
    mine, theirs = row(author="eve", reran_by=[], kind="reference"), row(author="ann")
    assert board._is_new(mine, [theirs])
    assert mine["remarks"] == theirs["remarks"] == []
    close, far = ({"0": {"a": [0.5 + by]}} for by in (1e-8, 1e-5))
    assert board._figures(row(units=close)) == board._figures(row()) != board._figures(row(units=far))


def test_names_and_figures_as_text() -> None:
    assert shown("x" * 60) == "x" * 60
    assert shown("x" * 61) == "x" * 60 + "..."
    assert shown("abcdef", 3) == "abc..."
    assert shown(" a \n b ") in ("a b", "a \\n b")
    assert shown("  ") == "(no name)"
    assert code("a`b|c") == "`a'b\\|c`"
    assert [called(row()), called(row(author="eve"))] == ["mine", "eve/mine"]
    assert standing(row()) == "self-reported, recomputed"
    assert standing(row(recomputed=None)) == "self-reported, not recomputed"
    assert standing(row(reran_by=["al", "bob"])) == "rerun by al, bob"
    assert [stated(each) for each in (None, 12_000, "a few")] == ["not stated", "12,000", "a few"]
    assert [number(each) for each in (None, 0.12345, -1e-9, 2.0)] == ["", "0.123", "0.000", "2.000"]
    whole: Any = {"value": 1.0, "low": 0.5, "high": 1.25}
    assert with_interval(whole) == "1.000 (0.500 to 1.250)"
    assert {with_interval(whole | {part: None}) for part in ("low", "high")} == {"1.000"}


def test_options_that_exclude_each_other() -> None:
    for given in ({"resume": True}, {"overwrite": True}, {"workers": 512}, {"workers": 1}):
        options.Resources(**given)
    with pytest.raises(SuiteError, match="--resume continues a run and --overwrite replaces it"):
        options.Resources(resume=True, overwrite=True)
    for workers in (0, 513):
        with pytest.raises(SuiteError, match="workers"):
            options.Resources(workers=workers)
