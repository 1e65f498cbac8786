"""Rounds of a league without learning: files of turns, workers that die, when turns end, and which policies join."""

import dataclasses
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from shuttle_marl.training.config import PPOConfig, SACConfig
from shuttle_marl.training.league import run as league_run
from shuttle_marl.training.league import turns as league_turns
from shuttle_marl.training.league.config import LeagueTrainingConfig, LeagueTrainingError
from shuttle_marl.training.league.population import Frozen
from shuttle_marl.training.league.run import _League
from shuttle_marl.training.league.state import Best, LeagueState, Member, Turn, TurnResult
from shuttle_marl.training.league.turns import (
    Workers,
    _first_stroke,
    _learner_config,
    _Turn,
    completed,
    input_files,
    output_files,
    prune_states,
)
from shuttle_marl.training.networks import DivergedError
from shuttle_marl.training.run import write_state
from tests.exact.exact_games import tiring_game

MEMBER = "main-agent-0"
CONFIG = LeagueTrainingConfig(strokes=1000, rounds=3)


def result_of(member: str = MEMBER, letter: str = "a", strokes: int = 7, seconds: float = 1.5) -> TurnResult:
    return TurnResult(member=member, hash=letter * 64, strokes=strokes, seconds=seconds, iterations=2)


def frozen(letter: str, name: str = "bc", role: str = "given", number: int = 0) -> Frozen:
    return Frozen(name=name, role=role, round=number, hash=letter * 64)


def test_a_turn_reads_its_opponents_and_its_last_state_and_writes_its_own_last() -> None:
    fresh = Turn(member=MEMBER, round=1, opponents=("b" * 64,))
    assert input_files(fresh) == [Path("tables") / f"{'b' * 64}.zst"]
    later = dataclasses.replace(fresh, round=3, fresh=False)
    before = [Path("learners/main-agent-0-2.json"), Path("learners/main-agent-0-2.state.safetensors")]
    assert input_files(later) == [Path("tables") / f"{'b' * 64}.zst", *before]
    names = [path.as_posix() for path in output_files(CONFIG, later, result_of())]
    written = [
        f"tables/{'a' * 64}.zst",
        "learners/main-agent-0-3.network.safetensors",
        "rallies/main-agent-0-3.mcap",
        "learners/main-agent-0-3.state.safetensors",
        "learners/main-agent-0-3.json",
    ]
    assert names == written
    unrecorded = dataclasses.replace(CONFIG, record="none")
    assert [path.as_posix() for path in output_files(unrecorded, later, result_of())] == written[:2] + written[3:]


def test_states_of_earlier_rounds_are_deleted_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "learners"
    folder.mkdir()
    for number in (1, 2, 3, 10):
        for kind in ("state.safetensors", "network.safetensors", "json"):
            (folder / f"league-exploiter-12-{number}.{kind}").touch()
    prune_states(tmp_path, before=3)
    left = {path.name.removeprefix("league-exploiter-12-") for path in folder.iterdir()}
    everywhere = {f"{number}.{kind}" for number in (1, 2, 3, 10) for kind in ("network.safetensors", "json")}
    assert left == everywhere | {"3.state.safetensors", "10.state.safetensors"}


def test_a_turn_is_completed_if_its_files_are_whole_and_its_settings_the_same(tmp_path: Path) -> None:
    turn, result = Turn(member=MEMBER, round=2, strokes=5), result_of()
    assert completed(tmp_path, turn) is None
    (tmp_path / "learners").mkdir()
    state, about = (tmp_path / "learners" / f"{MEMBER}-2.{kind}" for kind in ("state.safetensors", "json"))
    content = {"turn": dataclasses.asdict(turn), "result": dataclasses.asdict(result)}
    write_state(state, about, {"x": torch.zeros(2)}, content)
    assert completed(tmp_path, turn) == result
    assert completed(tmp_path, dataclasses.replace(turn, strokes=6)) is None
    state.unlink()
    assert completed(tmp_path, turn) is None
    state.touch()
    about.write_bytes(about.read_bytes()[:-9])
    assert completed(tmp_path, turn) is None


def test_settings_of_the_learners_of_a_league() -> None:
    usual = PPOConfig()
    ppo = _learner_config(CONFIG, self_play=True)
    assert isinstance(ppo, PPOConfig)
    assert (ppo.opponent, ppo.discount, ppo.width) == (("self",), -1.0, 64)
    assert (ppo.entropy, ppo.anneal_after, ppo.learning_rate, ppo.batch) == (0.1, 1.0, usual.learning_rate, usual.batch)
    own = dataclasses.replace(CONFIG, learner="sac", learning_rate=0.5, batch=33, width=9)
    sac = _learner_config(own, self_play=False)
    assert isinstance(sac, SACConfig)
    assert (sac.opponent, sac.discount, sac.learning_rate, sac.batch, sac.width) == (("bc",), 1.0, 0.5, 33, 9)
    a2c = _learner_config(dataclasses.replace(CONFIG, learner="a2c", entropy=0.25), self_play=True)
    assert (a2c.algorithm, cast(Any, a2c).entropy) == ("a2c", 0.25)


def test_before_the_first_best_response_is_known_the_first_legal_stroke_is_played() -> None:
    game = tiring_game()
    chance = _first_stroke(game).pair_probabilities()
    first = np.r_[True, game.pair_state[1:] != game.pair_state[:-1]]
    assert chance.tolist() == first.astype(float).tolist()


def taking(monkeypatch: pytest.MonkeyPatch) -> list[Turn]:
    """Lets turns be taken at once."""
    taken: list[Turn] = []

    def take(folder: Path, config: object, turn: Turn) -> TurnResult:
        taken.append(turn)
        return result_of(turn.member)

    monkeypatch.setattr(league_turns, "take_turn", take)
    return taken


TURNS = [Turn(member=f"main-agent-{number}", round=1) for number in (0, 1)]


def test_one_worker_or_one_turn_needs_no_processes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    taken = taking(monkeypatch)
    monkeypatch.setattr(Workers, "_submit", lambda *_: pytest.fail("a process was asked"))
    for count, turns in ((1, TURNS), (2, TURNS[:1])):
        with Workers(count, tiring_game()) as workers:
            assert [result.member for result in workers.take(tmp_path, CONFIG, turns)] == [turn.member for turn in turns]
    assert taken == [*TURNS, TURNS[0]]


@pytest.mark.parametrize("deaths", [0, 2, 3])
def test_turns_of_workers_that_die_are_repeated_twice(deaths: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[Turn] = []
    pools: list[str] = []

    def submit(self: Workers, function: object, folder: Path, config: object, turn: Turn) -> Future[TurnResult]:
        if self._pool is None:
            self._pool = cast(Any, SimpleNamespace(kill=lambda: pools.append("killed"), __exit__=lambda _: pools.append("ended")))
        asked.append(turn)
        future: Future[TurnResult] = Future()
        if len(asked) <= 2 * deaths and turn == TURNS[1]:
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(result_of(turn.member))
        return future

    monkeypatch.setattr(Workers, "_submit", submit)
    workers = Workers(2, tiring_game())
    if deaths == 3:
        with pytest.raises(LeagueTrainingError, match="workers died 3 times in one round"):
            workers.take(tmp_path, CONFIG, TURNS)
    else:
        assert workers.take(tmp_path, CONFIG, TURNS) == [result_of(turn.member) for turn in TURNS]
    assert asked == TURNS * min(deaths + 1, 3)
    assert pools == ["killed"] * deaths


def test_a_cluster_takes_the_turns_that_are_missing_and_sends_their_files(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    taking(monkeypatch)
    monkeypatch.setattr(league_turns, "completed", lambda _, turn: result_of() if turn.member == "main-agent-0" else None)
    sent: list[tuple[str, object, dict[Path, bytes]]] = []

    def submit(function: object, config: object, turn: Turn, game: object, files: dict[Path, bytes]) -> SimpleNamespace:
        assert function is league_turns.take_remotely
        sent.append((turn.member, game, files))
        done = result_of(turn.member)
        content = {path: f"{turn.member} {path.name}".encode() for path in output_files(CONFIG, turn, done)}
        return SimpleNamespace(result=lambda: (done, content))

    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / f"{'b' * 64}.zst").write_bytes(b"table")
    turns = [dataclasses.replace(turn, opponents=("b" * 64,)) for turn in TURNS]
    workers = Workers(8, tiring_game(), cast(Any, SimpleNamespace(submit=submit, share=lambda _: "shared")))
    assert [result.member for result in workers.take(tmp_path, CONFIG, turns)] == ["main-agent-0", "main-agent-1"]
    assert sent == [("main-agent-1", "shared", {Path("tables") / f"{'b' * 64}.zst": b"table"})]
    for path in output_files(CONFIG, turns[1], result_of("main-agent-1")):
        assert (tmp_path / path).read_bytes() == f"main-agent-1 {path.name}".encode()
    assert not (tmp_path / "learners" / "main-agent-0-1.json").exists()


@pytest.mark.parametrize(("count", "cluster", "asked"), [(1, None, "here"), (3, None, "there there there"), (3, object(), "")])
def test_every_worker_is_warmed_up(count: int, cluster: object, asked: str, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []
    ended: Future[None] = Future()
    ended.set_result(None)
    monkeypatch.setattr(league_turns, "warm_up", lambda _: done.append("here"))

    def submit(*_: object) -> Future[None]:
        done.append("there")
        return ended

    monkeypatch.setattr(Workers, "_submit", submit)
    workers = Workers(count, tiring_game())
    workers._cluster = cast(Any, cluster)
    workers.warm_up(CONFIG)
    assert " ".join(done) == asked


class FakeTrainer:
    """Collects 30 strokes in an iteration; diverges in one."""

    def __init__(self, diverges: int = 99) -> None:
        self.iteration, self.strokes, self.diverges = 0, 0, diverges
        self.remaining: list[float] = []

    def iterate(self, remaining: float, collected: Any) -> None:
        if self.iteration == self.diverges:
            raise DivergedError("too far")
        self.remaining.append(remaining)
        self.iteration += 1
        self.strokes += 30
        collected()


def turn_with(trainer: FakeTrainer, **fields: Any) -> Any:
    turn = Turn(member=MEMBER, round=4, **fields)
    return SimpleNamespace(turn=turn, trainer=trainer, _train=None)


def test_a_turn_ends_with_its_strokes_and_its_learning_rate_falls_with_them() -> None:
    trainer = FakeTrainer()
    own = turn_with(trainer, strokes=100, remaining=(0.75, 0.25))
    assert _Turn._train(own, None) < 60
    # 30, 60 and 90 strokes are not enough.
    assert trainer.strokes == 120
    assert np.allclose(trainer.remaining, [0.75, 0.60, 0.45, 0.30])
    exact = FakeTrainer()
    _Turn._train(turn_with(exact, strokes=90), None)
    assert (exact.strokes, exact.remaining) == (90, [1.0] * 3)


def test_a_turn_ends_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter([100.0, 104.0, 108.0, 110.0, 110.25])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    trainer = FakeTrainer()
    assert _Turn._train(turn_with(trainer, seconds=10.0, remaining=(1.0, 0.5)), None) == 10.25
    assert np.allclose(trainer.remaining, [1.0, 0.8, 0.6])


def test_a_turn_that_diverges_says_whose_and_records_what_was_played() -> None:
    recorded: list[tuple[object, ...]] = []
    log = SimpleNamespace(record=lambda *about: recorded.append(about), settle=lambda: recorded.append(("settled",)))
    trainer = FakeTrainer(diverges=2)
    cast(Any, trainer).collector = SimpleNamespace(sampler="sampler")
    with pytest.raises(DivergedError, match=r"main-agent-0 in round 4: learning diverged \(too far\); .* --learning-rate"):
        _Turn._train(turn_with(trainer, strokes=100), cast(Any, log))
    assert recorded == [("sampler", 0, 0), ("settled",), ("sampler", 0, 1), ("settled",)]


def test_best_responses_are_used_one_interval_after_they_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(league_turns, "weights_of", lambda actor: actor)
    submitted, used = [], []

    def submit(function: object, weights: int, game: str) -> Future[str]:
        assert function is league_turns._best_response
        submitted.append(weights)
        future: Future[str] = Future()
        future.set_result(f"response to {weights} in {game}")
        return future

    sampler = SimpleNamespace(replace_opponent=lambda slot, policy: used.append((slot, policy)))
    own: Any = SimpleNamespace(
        config=SimpleNamespace(update_interval=3),
        solver=SimpleNamespace(submit=submit),
        pending=None,
        game="g",
        turn=Turn(member=MEMBER, round=1, opponents=("a", "b")),
        trainer=SimpleNamespace(learner=SimpleNamespace(actor=0), collector=SimpleNamespace(sampler=sampler)),
    )
    for iteration in range(8):
        own.trainer.learner.actor = iteration
        _Turn._update_response(own, iteration)
    assert submitted == [0, 3, 6]
    assert used == [(2, f"response to {weights} in g") for weights in (0, 0, 3)]


def league(**fields: Any) -> Any:
    """A league with some of its parts; it joins policies as a real one."""
    state = LeagueState(game="", population=[frozen("a")])
    own: Any = SimpleNamespace(**{"state": state, "config": CONFIG, **fields})
    own._join = lambda policy, again=False: _League._join(own, policy, again=again)
    return own


def test_a_policy_joins_once_unless_it_counts_again() -> None:
    own: Any = league()
    assert _League._join(own, frozen("b", "new"))
    assert not _League._join(own, frozen("b", "again"))
    assert _League._join(own, frozen("b", "counted"), again=True)
    assert [each.name for each in own.state.population] == ["bc", "new", "counted"]


def test_exploiters_that_succeed_or_lose_patience_are_frozen_and_begin_again() -> None:
    names = ("main-exploiter-0", "league-exploiter-0", "league-exploiter-1")
    asked = []

    def succeeded(role: str, result: TurnResult, mains: list[str]) -> bool:
        asked.append((role, mains))
        return result.member == "league-exploiter-1"

    own = league(_succeeded=succeeded)
    own.config = dataclasses.replace(CONFIG, patience=4)
    turns = dict(zip(names, (4, 3, 1), strict=True))
    own.state.members = {MEMBER: Member(turns=3, hash="m" * 64)} | {n: Member(turns=k, hash="x" * 64) for n, k in turns.items()}
    _League._join_exploiters(own, [result_of(name, letter) for name, letter in zip(names, "bcd", strict=True)], 7)
    members = own.state.members
    assert [(members[name].turns, bool(members[name].hash)) for name in names] == [(0, False), (3, True), (0, False)]
    assert (members[MEMBER].turns, members[MEMBER].hash) == (3, "m" * 64)
    assert own.state.population[1:] == [
        frozen("b", "main-exploiter-0@7", "main-exploiter", 7),
        frozen("d", "league-exploiter-1@7", "league-exploiter", 7),
    ]
    assert asked == [("league-exploiter", ["m" * 64])] * 2


@pytest.mark.parametrize(
    ("flags", "state", "elapsed", "over"),
    [
        ({"strokes": 9, "rounds": 3}, {"round": 2}, 1e9, False),
        ({"strokes": 9, "rounds": 3}, {"round": 3}, 0.0, True),
        ({"strokes": 9, "rounds": 3}, {"round": 0, "exhausted": True}, 0.0, True),
        ({"budget": "60s"}, {"round": 0}, 99.0, False),  # the first round is always played
        ({"budget": "60s"}, {"round": 1, "overhead": 9.5}, 50.0, False),  # half a second of learning
        ({"budget": "60s"}, {"round": 1, "overhead": 9.5}, 50.1, True),
        ({"budget": "60s", "variant": "psro"}, {"round": 1, "overhead": 99.0}, 52.0, False),  # rounds of 8 s
        ({"budget": "60s", "variant": "psro"}, {"round": 1}, 52.1, True),
    ],
)
def test_a_league_is_over_when_another_round_would_not_end_in_time(
    flags: dict[str, Any], state: dict[str, Any], elapsed: float, over: bool
) -> None:
    own = league(config=LeagueTrainingConfig(**flags), state=LeagueState(game="", **state), longest=8.0, _elapsed=lambda: elapsed)
    assert _League._over(own) == over


@pytest.mark.parametrize(("solver", "known", "size"), [("nash", "b", 2), ("nash", "a", 1), ("linear", "a", 2)])
def test_a_double_oracle_ends_where_the_best_response_is_known(solver: Any, known: str, size: int) -> None:
    committed: list[bool] = []

    def commit(*, exhausted: bool) -> None:
        committed.append(exhausted)

    own = league(
        _measure_mixture=lambda number: SimpleNamespace(policy=f"answer {number}"),
        tables=SimpleNamespace(save=lambda policy: {"answer 1": known * 64}[policy]),
        _commit=commit,
    )
    own.config = LeagueTrainingConfig(variant="psro", meta_solver=solver)
    _League._oracle_round(own)
    assert committed == [size == 1]
    assert len(own.state.population) == size
    if size == 2:
        assert own.state.population[1] == frozen(known, "oracle@1", "best-response", 1)


def measured(best: float | None, *gains: float) -> tuple[LeagueState, dict[str, Any]]:
    """The state after a main agent was evaluated at temperatures 1 and 0.1, and the line in the metrics."""
    lines: list[dict[str, Any]] = []
    own = league(_elapsed=lambda: 12.3456, metrics=SimpleNamespace(append=lines.extend))
    own.console = SimpleNamespace(print=lambda *_, **__: None)
    own.state.round, own.state.members = 4, {"main-agent-0": Member(strokes=30), "main-exploiter-0": Member(strokes=12)}
    own.state.best = None if best is None else Best(name="old", hash="f" * 64, exploitability=best, temperature=1.0)
    own.tables = SimpleNamespace(save=lambda policy: policy * 64)
    odds = SimpleNamespace(rally=0.5625, match=lambda: 0.75)
    own.payoffs = SimpleNamespace(odds=lambda table, others: [odds] if others == ["a" * 64] else [])

    def form(letter: str, gain: float, temperature: float) -> tuple[str, Any, float]:
        return letter, SimpleNamespace(value=SimpleNamespace(odds=lambda: SimpleNamespace(value=gain))), temperature

    _League._measure(own, "main-agent-0@5", cast(Any, list(map(form, "cd", gains, (1.0, 0.1)))))
    (line,) = lines
    return own.state, line


def test_a_main_agent_is_kept_in_its_least_exploitable_form() -> None:
    state, line = measured(None, 0.5, 0.25)
    assert state.best == Best(name="main-agent-0@5", hash="d" * 64, exploitability=0.25, temperature=0.1)
    assert line == {
        **{"round": 5, "policy": "main-agent-0@5", "seconds": 12.35, "strokes": 42, "exploitability": 0.25, "temperature": 0.1},
        **{"exploitability_as_trained": 0.5, "against": "bc", "rally_win": 0.5625, "match_win": 0.75, "policies": 1},
    }
    assert state.metrics == 1
    state, line = measured(0.3, -1e-9, 0.1)
    assert (state.best.hash[0], state.best.temperature, line["exploitability"]) == ("c", 1.0, 0.0)
    for best in (0.25, 0.2):
        assert measured(best, 0.5, 0.25)[0].best.name == "old"


def test_a_round_that_learned_counts_turns_strokes_and_what_was_no_learning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(league_run, "prune_states", lambda folder, before: pruned.append(before))
    pruned: list[int] = []
    joined: list[tuple[str, list[str], int]] = []
    clock = iter([10.0, 22.0])
    results = [result_of("main-agent-0", "b", 30, 4.0), result_of("main-exploiter-0", "c", 12, 1.0)]
    own = league(
        _elapsed=lambda: next(clock),
        folder=Path(),
        schedule=SimpleNamespace(load=1.5, turns=lambda number, began: [number, began]),
        _join_mains=lambda found, number: joined.append(("mains", [each.member for each in found], number)),
        _join_exploiters=lambda found, number: joined.append(("others", [each.member for each in found], number)),
        _commit=lambda: joined.append(("commit", [], 0)),
    )
    own.state.round, own.state.members = 2, {"main-agent-0": Member(turns=2, strokes=60, hash="a" * 64)}

    def take(folder: Path, config: object, turns: object) -> list[TurnResult]:
        assert turns == [3, 10.0]
        return results

    _League._learning_round(own, cast(Any, SimpleNamespace(take=take)))
    assert own.state.members == {
        "main-agent-0": Member(turns=3, strokes=90, hash="b" * 64),
        "main-exploiter-0": Member(turns=1, strokes=12, hash="c" * 64),
    }
    assert own.state.overhead == 6.0  # of 12 s, 4 for each of 1.5 turns
    assert joined == [("mains", ["main-agent-0"], 3), ("others", ["main-exploiter-0"], 3), ("commit", [], 0)]
    assert pruned == [3]


def test_a_commit_keeps_the_tables_of_all_that_are_needed() -> None:
    done: list[Any] = []
    own = league(_elapsed=lambda: 7.777, folder="folder", tables=SimpleNamespace(prune=done.append))
    own.payoffs = SimpleNamespace(as_json=lambda retained: {"kept": sorted(retained)})
    own.state.members = {MEMBER: Member(hash="m" * 64)}
    own.state.best = Best(name="old", hash="f" * 64, exploitability=0.1, temperature=1.0)
    own.state.save = done.append
    _League._commit(own, exhausted=True)
    retained = {letter * 64 for letter in "amf"}
    assert done == ["folder", retained], "the state first"
    assert (own.state.round, own.state.exhausted, own.state.seconds) == (1, True, 7.78)
    assert own.state.cells == {"kept": sorted(retained)}


def test_a_league_without_a_round_is_not_finished() -> None:
    with pytest.raises(LeagueTrainingError, match="no round was completed"):
        _League._finish(league(folder=Path("run")), {})


def test_a_state_of_another_game_is_refused(tmp_path: Path) -> None:
    assert LeagueState.load(tmp_path, "a" * 64) is None
    LeagueState(game="a" * 64, round=3).save(tmp_path)
    assert LeagueState.load(tmp_path, "a" * 64) == LeagueState(game="a" * 64, round=3)
    with pytest.raises(LeagueTrainingError, match="was trained on game aaaaaaaaaaaa, this is bbbbbbbbbbbb; continue"):
        LeagueState.load(tmp_path, "b" * 64)
