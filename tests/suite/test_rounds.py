"""Rounds: commitments, draws, reruns behind a boundary, and what a competitor tries."""

import dataclasses
import datetime as dt
import io
import json
import os
import platform
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import numpy as np
import pytest

import shuttle_marl
from shuttle_marl.base import runs
from shuttle_marl.base.files import replace_sealed
from shuttle_marl.commands.suite import main
from shuttle_marl.suite import apart, remote, store
from shuttle_marl.suite.board import _is_new, boards, called, render, rows_of
from shuttle_marl.suite.options import RerunOptions, Resources, SuiteError, VerifyOptions
from shuttle_marl.suite.population import luck
from shuttle_marl.suite.registry import TASKS, arena_of, new_submission
from shuttle_marl.suite.remote import Container, Namespaces, find_boundary
from shuttle_marl.suite.results import Row
from shuttle_marl.suite.run import Commitment, Round, commit, draw_round, rerun, time_of, write
from shuttle_marl.suite.task import Outcome
from tests.reduced import reduced_model
from tests.suite import small

METHODS = (Path(__file__).parent / "strange_methods.py").read_text(encoding="utf-8")
BEACON, RANDOM, OTHER = 20_000_000, "ab" * 32, "cd" * 32
DRAWN = time_of(BEACON)
BEFORE = DRAWN - dt.timedelta(days=1)
TASK = "exploit-v0"


ANSWERS = """
import numpy as np
from pathlib import Path


def train(setting):
    return Answers(np.load(Path(__file__).with_name("answers.npy")))


class Answers:
    def __init__(self, table):
        self.table = table

    def probabilities(self, observation, mask):
        return self.table
"""


def can_rerun() -> bool:
    try:
        find_boundary(Path(__file__).parent)
    except SuiteError as error:
        if "inside, one sees" in str(error):
            raise  # the boundary leaks, which is no reason to skip its tests
        return False
    return True


needs_boundary = pytest.mark.skipif(not (sys.platform == "linux" and can_rerun()), reason="needs namespaces of Linux")


def code(place: Path, source: str = METHODS) -> Path:
    """A folder of a stranger."""
    folder = place / "code"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "strange.py").write_text(source.replace("PACKAGE", str(Path(shuttle_marl.__file__).parent)))
    return folder


def entered(place: Path, folder: Path, method: str, *, task: str = TASK, author: str = "alice", randomness: str = RANDOM) -> Path:
    """The file of a round with one entry."""
    write(place / "commitment.json", commit(folder, task=task, method=method, author=author, now=BEFORE))
    path = place / "round.json"
    write(path, draw_round([place / "commitment.json"], beacon=BEACON, randomness=randomness))
    return path


def reran(place: Path, path: Path, folder: Path, task: str = TASK, seeds: int | None = None) -> Path:
    asked = RerunOptions(task=task, author="alice", randomness=RANDOM, by="bob")
    return rerun(path, folder, asked, Resources(quick=True, game=reduced_model(), out=place / "run", seeds=seeds))


def row_of(*folders: Path, reran: tuple[Path, ...] = ()) -> tuple[list[Row], list[str]]:
    left: list[str] = []
    return rows_of(folders, reran=reran, given=VerifyOptions(game=reduced_model(), beacon=RANDOM), failed=left.append), left


@needs_boundary
def test_a_round_from_commitment_to_board(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commit, draw, run, and rerun in another folder and as another user: equal scores."""

    def told(*arguments: str) -> Any:
        assert main((*arguments, "--json")) == 0, capsys.readouterr().err
        return json.loads(capsys.readouterr().out)

    folder = code(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("shuttle_marl.suite.run.time_of", lambda beacon: dt.datetime.now(dt.UTC))
    words = ("commit", str(folder), "--task", TASK, "--method", "strange:learner", "--author", "alice")
    assert main((*words, "--out", str(folder / "commitment.json"))) == 1
    assert "would change the code" in capsys.readouterr().err
    made = told(*words)
    assert made["hash"] == json.loads(Path("commitment.json").read_text())["hash"]
    monkeypatch.setattr("shuttle_marl.suite.run.time_of", lambda beacon: dt.datetime.now(dt.UTC) + dt.timedelta(days=1))
    assert main(("round", "commitment.json", "--beacon", "9", "--randomness", RANDOM)) == 1
    assert "appears at" in capsys.readouterr().err
    later = dt.datetime.fromisoformat(json.loads(Path("commitment.json").read_text())["date"]) + dt.timedelta(seconds=1)
    monkeypatch.setattr("shuttle_marl.suite.run.time_of", lambda beacon: min(later, dt.datetime.now(dt.UTC)))
    while dt.datetime.now(dt.UTC) < later:
        pass
    assert told("round", "commitment.json", "--beacon", "9", "--randomness", RANDOM)["entries"] == "1"
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(folder, elsewhere / "copy")
    scores = []
    for by, place in (("alice", folder), ("bob", elsewhere / "copy")):
        asked = ["--task", TASK, "--author", "alice", "--randomness", RANDOM, "--by", by, "--quick", "--game", reduced_model()]
        found = told("rerun", "round.json", str(place), *asked, "--out", str(tmp_path / f"run-{by}"))
        assert found["access"] == "samples"
        assert found["strokes"] == 64 * (20_000 // 64)
        scores.append((found["score"], found["outputs"]))
    assert scores[0] == scores[1]
    ((row,), left) = row_of(tmp_path / "run-alice", reran=(tmp_path / "run-bob",))
    assert (row["reran_by"], left, called(row)) == (["bob"], [], "alice/strange:learner")
    assert "`rerun by bob` | samples | 1 | `alice/strange:learner`" in render([row], "md")
    # Without a rerun of one's own, it is what its author says.
    ((alone,), _) = row_of(tmp_path / "run-alice")
    assert "`self-reported, recomputed`" in render([alone], "md")
    ((two,), _) = row_of(reran=(tmp_path / "run-alice", tmp_path / "run-bob"))
    assert two["reran_by"] == ["alice", "bob"]


@needs_boundary
@pytest.mark.parametrize(
    ("task", "method"),
    [
        ("equilibrium-v0", "apart:train"),
        ("equilibrium-v0", "learner"),
        ("equilibrium-entrance-v0", "learner"),
        ("adapt-v0", "Adapter"),
        ("offline-v0", "Offline"),
        ("evaluate-v0", "Estimator"),
    ],
)
def test_methods_get_episodes(task: str, method: str, tmp_path: Path) -> None:
    folder = code(tmp_path)
    name = f"strange:{method}" if ":" not in method else f"my_{method}"
    if ":" in method:
        assert f"--method {name} --author NAME" in new_submission(task, folder, "apart")
    made = reran(tmp_path, entered(tmp_path, folder, name, task=task), folder, task)
    ((row,), left) = row_of(reran=(made,))
    assert (row["access"], left) == ("samples", [])


@needs_boundary
def test_an_answer_table_fails_its_rerun(tmp_path: Path) -> None:
    """Answers of the public split beside the code win there, and are worth nothing in games that are drawn later."""
    folder = tmp_path / "code"
    folder.mkdir()
    (folder / "cheat.py").write_text(ANSWERS)
    claimed = small.run(TASK, "restricted", tmp_path / "public", split="test")
    best = small.summary(claimed)
    assert best["score"] == pytest.approx(best["scores"]["best"]["value"], abs=1e-4)
    entry = store.read_entry(store.entry_path(claimed, 0, 0))
    game = load(f"{reduced_model()}:recovery")
    table = store.read_outcome(claimed, entry, game).policies["player"]
    chance = np.zeros((game.n_states, game.n_strokes), np.float32)
    row, pair = game.pairs(np.arange(game.n_states))
    chance[row, game.pair_stroke[pair]] = table.probability_of(pair)
    np.save(folder / "answers.npy", chance)
    path = entered(tmp_path, folder, "cheat:train")
    made = reran(tmp_path, path, folder)
    found = small.summary(made, RANDOM)
    assert found["score"] < 0.5 * found["scores"]["best"]["value"]
    # Answers that are put beside the code after the draw are not what was committed to.
    np.save(folder / "answers.npy", 1 - chance)
    with pytest.raises(SuiteError, match="is not the code of the commitment"):
        reran(tmp_path / "again", path, folder)
    # A folder with better policies than the code gives is left out.
    forged = tmp_path / "forged"
    shutil.copytree(made, forged)
    better = small.run(TASK, "minimax", tmp_path / "minimax", split="round", beacon=RANDOM)
    for part in (store.ENTRIES, store.POLICIES):
        shutil.rmtree(forged / part)
        shutil.copytree(better / part, forged / part)
    ((_,), left) = row_of(forged, reran=(made,))
    assert "the code gave" in left[0]
    ((alone,), _) = row_of(forged)
    assert alone["reran_by"] == []
    # Without a rerun, who is listed first does not stand for the code.
    (both, left) = row_of(forged, made)
    assert (len(both), left) == (2, [])


def load(name: str) -> Any:
    from shuttle_marl.game.shipped import load_game

    return load_game(name)


@needs_boundary
@pytest.mark.parametrize(
    ("method", "reason"),
    [
        ("named", "expected an object with act"),
        ("wrong", "plays the illegal position"),
        ("imports", "No module named 'shuttle_marl'"),
        ("opens", "No such file"),
        ("through_a_folder", "No such file"),
        ("through_a_link", "No such file"),
        ("searches", "IndexError"),
        ("reads_the_memory", "PermissionError|IndexError|OSError"),
        ("reads_the_frame", "no table in any frame"),
        ("calls_out", "unreachable|PermissionError"),
        ("reads_the_folder", "IndexError"),
        ("subclass", "No such file"),
        ("writes", "Read-only|Permission"),
        ("prints", "SystemExit: 3"),
        ("missing", "AttributeError"),
        ("floods", "invalid message|raised|closed|exited"),
    ],
)
def test_code_behind_the_boundary_reaches_nothing(method: str, reason: str, tmp_path: Path) -> None:
    folder = code(tmp_path)
    with pytest.raises(Exception, match=reason):
        reran(tmp_path, entered(tmp_path, folder, f"strange:{method}"), folder)


@needs_boundary
@pytest.mark.skipif(platform.machine() != "x86_64", reason="calls the kernel by numbers")
def test_units_leave_no_notes(tmp_path: Path) -> None:
    """Keys of the kernel outlive a process: a unit could tell the next one about the same opponent."""
    folder = code(tmp_path)
    made = reran(tmp_path, entered(tmp_path, folder, "strange:notes"), folder, seeds=2)
    assert small.summary(made, RANDOM)["seeds"] == 2


@needs_boundary
def test_nothing_that_a_method_started_goes_on(tmp_path: Path) -> None:
    folder = code(tmp_path)
    reran(tmp_path, entered(tmp_path, folder, "strange:goes_on"), folder, seeds=1)
    commands = [path.read_bytes() for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists()]
    assert not [command for command in commands if b"strange:goes_on" in command]


@needs_boundary
def test_another_file_of_a_round_has_no_place_on_the_board(tmp_path: Path) -> None:
    folder = code(tmp_path)
    first = reran(tmp_path, entered(tmp_path, folder, "strange:First"), folder, seeds=1)
    second = tmp_path / "second"
    shutil.copytree(first, second)
    told = json.loads((second / store.RERUN).read_text())
    (second / store.RERUN).write_text(json.dumps({**told, "round": "0" * 64}))
    rows, left = row_of(reran=(first, second))
    assert len(rows) == 1
    assert "another file of the round" in left[0]
    (second / store.RERUN).write_text(json.dumps(told))
    row = row_of(reran=(second,))[0][0]
    # A table may be changed where it is never used, seeds may be fewer, and a second rerun may differ.
    twin = {**row, "author": "mallory", "commitment": "1" * 64, "outputs": "2" * 64, "remarks": []}
    assert _is_new(cast(Row, twin), rows)
    assert twin["remarks"] == [f"the same scores as {called(row)}"]
    for other in ({**row, "seeds": 3}, {**row, "score": row["score"] + 1, "reran_by": ["carol"]}):
        with pytest.raises(SuiteError, match="the code gave"):
            _is_new(cast(Row, other), rows)
    assert "when carol reran it" in rows[0]["remarks"][-1]


@needs_boundary
def test_what_is_hashed_is_what_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = code(tmp_path)
    path = entered(tmp_path, folder, "strange:learner")
    asked = RerunOptions(task=TASK, author="alice", randomness=RANDOM, by="bob")
    with pytest.raises(SuiteError, match="leave --resume out"):
        rerun(path, folder, asked, Resources(quick=True, game=reduced_model(), out=tmp_path / "run", resume=True))
    monkeypatch.setattr("shuttle_marl.suite.run.shutil.copyfile", lambda _, to: Path(to).write_text("changed"))
    with pytest.raises(SuiteError, match="a file differs"):
        reran(tmp_path, path, folder)
    with pytest.raises(SuiteError, match="one sees your files"):
        find_boundary(folder, hidden=[path, Path(os.__file__)])


def test_one_hash_fits_one_folder(tmp_path: Path) -> None:
    folder = code(tmp_path)
    (folder / f"a\n{'0' * 64} b").write_text("")
    with pytest.raises(SuiteError, match="names that can be printed"):
        commit(folder, task=TASK, method="strange:First", author="alice")


def test_a_commitment_counts_in_the_announced_round(tmp_path: Path) -> None:
    found = commit(code(tmp_path), task=TASK, method="strange:First", author="alice", beacon=BEACON, now=BEFORE)
    assert found.hash != commit(code(tmp_path), task=TASK, method="strange:First", author="alice", now=BEFORE).hash
    write(tmp_path / "commitment.json", found)
    assert draw_round([tmp_path / "commitment.json"], beacon=BEACON, randomness=RANDOM).commitments == [found]
    with pytest.raises(SuiteError, match=f"committed for round {BEACON} of the beacon, not {BEACON + 1}"):
        draw_round([tmp_path / "commitment.json"], beacon=BEACON + 1, randomness=RANDOM)


def test_a_message_that_is_too_large_is_not_read() -> None:
    with pytest.raises(ValueError, match="a message of 1,073,741,825 bytes; expected at most 1,073,741,824"):
        apart.receive(io.BytesIO(((1 << 30) + 1).to_bytes(8, "little")))


def test_messages_are_arrays_and_end_where_the_other_side_does(monkeypatch: pytest.MonkeyPatch) -> None:
    content = apart.message(first=np.arange(3), second="text")
    pipe = io.BytesIO(content + content)
    for _ in range(2):
        found = apart.receive(pipe)
        assert (found["first"].tolist(), str(found["second"])) == ([0, 1, 2], "text")
    for cut in (b"", content[:7]):
        with pytest.raises(EOFError, match="the other side has ended"):
            apart.receive(io.BytesIO(cut))
    with pytest.raises(ValueError, match="no message"):
        apart.receive(io.BytesIO(content[:-1]))
    monkeypatch.setattr(apart, "_MOST", len(content) - 8)
    assert set(apart.receive(io.BytesIO(content))) == {"first", "second"}
    monkeypatch.setattr(apart, "_MOST", len(content) - 9)
    with pytest.raises(ValueError, match="expected at most"):
        apart.receive(io.BytesIO(content))


def a_setting(ask: Any, folder: Path, feasible: int = 3) -> apart.Setting:
    """Of three states with two strokes, none of which is legal in the second state."""
    mask = np.array([[True, False], [False, False], [True, True]])
    fields = {"observation": np.arange(6).reshape(3, 2), "mask": mask, "feasible": np.ones((feasible, 9), bool)}
    return apart.Setting(ask, fields | {"seed": np.array(4), "budget": np.array(50), "opponents": np.array(2)}, folder)


def test_a_setting_asks_the_other_side(tmp_path: Path) -> None:
    asked: list[dict[str, Any]] = []

    def ask(**request: Any) -> dict[str, Any]:
        asked.append(request)
        return {"state": len(asked), "reward": "reward", "over": "over", "waits": np.full(2, len(asked) > 1)}

    setting = a_setting(ask, tmp_path)
    assert (setting.seed, setting.budget, setting.opponents, setting.waits.tolist()) == (4, 50, 2, [])
    assert (setting.reset(), setting.waits.tolist()) == (1, [False, False])
    assert (setting.step([1, 0]), setting.waits.tolist()) == ((2, "reward", "over"), [True, True])
    setting.reset(7, opponent=1)
    setting.step([0, 1], [8, 3])
    assert [set(request) for request in asked] == [{"reset", "opponent"}, {"step"}, {"reset", "opponent"}, {"step", "positions"}]
    assert (asked[0], asked[2]) == ({"reset": 256, "opponent": 0}, {"reset": 7, "opponent": 1})
    assert (asked[1]["step"].tolist(), asked[3]["positions"].tolist()) == ([1, 0], [8, 3])


def test_answers_of_methods_are_arrays(tmp_path: Path) -> None:
    setting, without = a_setting(None, tmp_path), a_setting(None, tmp_path, feasible=0)
    assert apart.answer_of(None, setting) == {"nothing": 0}
    assert apart.answer_of("minimax", setting) == {"text": "minimax"}
    values = apart.answer_of([1, 0.5], setting)["values"]
    assert (values.tolist(), values.dtype) == ([1, 0.5], np.float64)
    acts = apart.answer_of(SimpleNamespace(act=lambda seen, mask: seen[1] * 10 + mask.sum()), setting)
    assert {name: each.tolist() for name, each in acts.items()} == {"stroke": [11, -1, 52]}
    drawn = SimpleNamespace(probabilities=lambda seen, mask: seen + mask, positions=lambda seen, feasible: 2 * feasible)
    found = apart.answer_of(drawn, setting)
    assert found["probability"].tolist() == [[1, 1], [2, 3], [5, 6]]
    assert found["probability"].dtype == np.float32
    assert found["position"].tolist() == [[2.0] * 9] * 3
    assert set(apart.answer_of(drawn, without)) == {"probability"}


APART = """
class Player:
    def __init__(self, setting=None):
        self.setting = setting
    def policy_for_next_rally(self):
        return "table"
    def estimate(self, data, policies):
        return [data.x, *(policy.probabilities([0, 1])[0] for policy in policies)]
    def observe_rally(self, rally):
        self.setting.reset(3)
    def fit(self, data):
        raise LookupError("nothing there")
class WithoutSetting(Player):
    def __init__(self):
        pass
"""


@pytest.mark.parametrize("name", ["Player", "WithoutSetting"])
def test_the_side_of_the_method_answers_until_the_other_one_ends(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "set_apart.py").write_text(APART)
    fields = {name: np.ones((1, 9), bool) for name in ("observation", "mask", "feasible")}
    requests: list[dict[str, Any]] = [fields | {"seed": 0, "budget": 1, "opponents": 0}, {"call": "policy_for_next_rally"}]
    requests += [{"call": "estimate", "policies": 2, "x": 5.0}, {"probability": [0.25]}, {"probability": [0.75]}]
    if name == "Player":
        requests += [{"call": "observe_rally", "own": 1}, {"waits": [False], "state": [0]}]
        requests += [{"call": "observe_rally", "own": 1}, {"error": "the budget is used up"}]
    else:
        requests.append({"call": "fit"})
    pipe, answers, moved = io.BytesIO(b"".join(apart.message(**request) for request in requests)), io.BytesIO(), []
    system = SimpleNamespace(
        dup=lambda handle: handle,
        dup2=lambda *handles: moved.append(handles),
        fdopen=lambda handle, _: (pipe, answers)[handle],
        uname=lambda: SimpleNamespace(machine="none"),
    )
    monkeypatch.setattr(apart, "os", system)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.delitem(sys.modules, "set_apart", raising=False)
    apart.main(f"set_apart:{name}", str(tmp_path), str(tmp_path / "work"))
    monkeypatch.delitem(sys.modules, "set_apart", raising=False)
    assert moved == [(2, 1)]
    assert (tmp_path / "work").is_dir()
    answers.seek(0)
    found = []
    while answers.tell() < len(answers.getvalue()):
        found.append({key: value.tolist() for key, value in apart.receive(answers).items()})
    assert found[:4] == [
        {"text": "table"},
        {"policy": 0, "state": [0, 1]},
        {"policy": 1, "state": [0, 1]},
        {"values": [5.0, 0.25, 0.75]},
    ]
    if name == "Player":
        assert found[4:6] == [{"reset": 3, "opponent": 0}, {"nothing": 0}]
        assert found[-1] == {"error": "RuntimeError: the budget is used up"}
    else:
        assert found[4:] == [{"error": "LookupError: nothing there"}]


def test_messages_are_not_unpacked() -> None:
    packed = io.BytesIO()
    np.savez_compressed(packed, values=np.zeros(1 << 20))
    content = packed.getvalue()
    with pytest.raises(ValueError, match="a message that is packed"):
        apart.receive(io.BytesIO(len(content).to_bytes(8, "little") + content))
    values = np.array([{}], dtype=object)
    with pytest.raises(ValueError, match="allow_pickle"):
        apart.receive(io.BytesIO(apart.message(values=values)))


def test_an_invented_beacon_is_found(tmp_path: Path) -> None:
    folder = code(tmp_path)
    path = entered(tmp_path, folder, "strange:learner", randomness=OTHER)
    with pytest.raises(SuiteError, match=f"not that of round {BEACON} of the beacon"):
        reran(tmp_path, path, folder)
    changed = json.loads(path.read_text())
    path.write_text(json.dumps({**changed, "randomness": RANDOM}))
    with pytest.raises(SuiteError, match="checksum"):
        reran(tmp_path, path, folder)


def commitments(tmp_path: Path, *made: Commitment) -> list[Path]:
    paths = [tmp_path / f"{number}.json" for number in range(len(made))]
    for path, each in zip(paths, made, strict=True):
        write(path, each)
    return paths


def test_a_published_commitment_is_of_no_use_to_a_thief(tmp_path: Path) -> None:
    """Who copies a commitment under another name and an earlier date stops no round, and has no code that fits."""
    folder = code(tmp_path)
    honest = commit(folder, task=TASK, method="strange:learner", author="alice", now=BEFORE)
    thief = dataclasses.replace(honest, author="mallory", date=BEFORE - dt.timedelta(days=1))
    drawn = draw_round(commitments(tmp_path, thief, honest), beacon=BEACON, randomness=RANDOM)
    write(tmp_path / "round.json", drawn)
    asked = RerunOptions(task=TASK, author="mallory", randomness=RANDOM, by="bob")
    with pytest.raises(SuiteError, match="is not the code of the commitment"):
        rerun(tmp_path / "round.json", folder, asked, Resources(quick=True, game=reduced_model(), out=tmp_path / "run"))


def test_an_old_beacon_is_not_replayed(tmp_path: Path) -> None:
    """A round file that a stranger wrote, with the randomness of a beacon that had appeared when the code was committed to."""
    folder = code(tmp_path)
    late = commit(folder, task=TASK, method="strange:learner", author="alice", now=DRAWN + dt.timedelta(days=1))
    write(tmp_path / "round.json", Round(beacon=BEACON, randomness=RANDOM, commitments=[late]))
    with pytest.raises(SuiteError, match="not before the beacon"):
        reran(tmp_path, tmp_path / "round.json", folder)


def test_nobody_knows_the_luck_of_a_round(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who knows the draws finds probabilities at the rate of a search, and in adapt which opponent it is."""
    assert luck("round", RANDOM, 0, 1) != luck("round", OTHER, 0, 1)
    assert luck("round", RANDOM, 0, 1) != luck("round", RANDOM, 0, 2)
    assert luck("dev", None, 0, 1) == luck("test", None, 0, 1), "results of public splits"
    for task in ("adapt-entrance-v0", "offline-v0"):
        drawn: list[Any] = []

        def of_others(*numbers: Any, drawn: list[Any] = drawn) -> int:
            drawn.append(numbers)
            return 7

        monkeypatch.setattr(f"shuttle_marl.suite.{task.partition('-')[0]}.luck", of_others)
        method = {"adapt": "minimax", "offline": "clone"}[task.partition("-")[0]]
        small.run(task, method, tmp_path / task, split="round", beacon=RANDOM)
        assert drawn
        assert all(numbers[:2] == ("round", RANDOM) for numbers in drawn)


def test_perfect_play_of_the_shipped_game_is_weak_in_drawn_ones() -> None:
    """A table of answers beside the code is no rank in ``equilibrium`` either."""
    task, game = TASKS["equilibrium-entrance-v0"], reduced_model()
    shipped = arena_of(task, game, "test", budget=10**6).policy("minimax")
    for beacon in (RANDOM, OTHER):
        arena = arena_of(task, game, "round", budget=10**6, beacon=beacon)
        outcome = Outcome(policies={"player": dataclasses.replace(shipped, game=arena.game)})
        assert task.score(arena, task.cases(arena)[0], 0, outcome)["exploitability"] > 2


def test_twins_come_second(tmp_path: Path) -> None:
    folder = code(tmp_path)
    honest = commit(folder, task=TASK, method="strange:learner", author="alice", now=BEFORE)
    for twin in ("ALICE", "a1ice", "a lice", "Alice."):
        copy = commit(folder, task=TASK, method="strange:learner", author=twin, now=BEFORE + dt.timedelta(hours=1))
        with pytest.raises(SuiteError, match="has the name of alice, who committed first"):
            draw_round(commitments(tmp_path, copy, honest), beacon=BEACON, randomness=RANDOM)
    labs = [commit(folder, task=TASK, method="strange:learner", author=f"lab {number}", now=BEFORE) for number in (7, 8)]
    assert len(draw_round(commitments(tmp_path, *labs), beacon=BEACON, randomness=RANDOM).commitments) == 2
    late = commit(folder, task=TASK, method="strange:learner", author="late", now=DRAWN)
    with pytest.raises(SuiteError, match="not before the beacon"):
        draw_round(commitments(tmp_path, late), beacon=BEACON, randomness=RANDOM)


@pytest.mark.parametrize("name", ["\u0440po", "\uff50po", "ppo (ours)", "", "@all", "x" * 50, "alice\n"])
def test_authors_have_plain_names(name: str, tmp_path: Path) -> None:
    with pytest.raises(SuiteError, match="no commitment"):
        commit(code(tmp_path), task=TASK, method="strange:learner", author=name)


def test_commitments_are_checked(tmp_path: Path) -> None:
    folder = code(tmp_path)
    for method in ("ppo", "a b:c", "strange:learner; x"):
        with pytest.raises(SuiteError, match="no commitment"):
            commit(folder, task=TASK, method=method, author="alice")
    with pytest.raises(SuiteError, match="has no rounds"):
        commit(folder, task="text-v0", method="strange:learner", author="alice")
    made = commit(folder, task=TASK, method="strange:learner", author="alice", now=BEFORE)
    (folder / ".hidden").write_text("x")
    assert commit(folder, task=TASK, method="strange:learner", author="alice", now=BEFORE) == made
    (folder / "link").symlink_to("/etc/passwd")
    with pytest.raises(SuiteError, match="is a link"):
        commit(folder, task=TASK, method="strange:learner", author="alice")
    replace_sealed(tmp_path / "forged.json", {**msgspec.to_builtins(made), "date": "2024-01-01T00:00:00"})
    with pytest.raises(SuiteError, match="date"):
        draw_round([tmp_path / "forged.json"], beacon=BEACON, randomness=RANDOM)
    (tmp_path / "empty").mkdir()
    with pytest.raises(SuiteError, match="has no files"):
        commit(tmp_path / "empty", task=TASK, method="strange:learner", author="alice")


def player(setting: Any) -> Any:
    from shuttle_marl.suite import Trained

    return Trained(player=f"bc@{0.3 + 0.1 * setting.seed}", strokes=int(0.97 * setting.budget))


def test_what_was_not_rerun_is_self_reported(tmp_path: Path) -> None:
    """Names, access, budgets and marks of a stranger change nothing about the class."""
    folder = small.run("equilibrium-entrance-v0", f"{__name__}:player", tmp_path / "run", split="test")
    (folder / store.CARD).write_text(json.dumps({"authors": "ppo", "access": "samples", "kind": "method"}))
    (folder / store.RERUN).write_text(json.dumps({"by": "bob", "boundary": "unshare", "round": "0" * 64}))
    path = folder / runs.CONFIG
    path.write_text(json.dumps({**json.loads(path.read_text()), "method": "ppo", "commitment": "0" * 64}))
    left: list[str] = []
    (row,) = rows_of([folder], given=VerifyOptions(game=reduced_model()), failed=left.append)
    assert row["reran_by"] == []
    assert (called(row), left) == ("ppo/ppo", [])
    assert "self-reported" in render([row], "md")
    assert boards([row])[0]["rows"][0]["rank"] == 1
    plain = small.run("equilibrium-entrance-v0", "minimax", tmp_path / "plain")
    assert rows_of([], reran=[plain], given=VerifyOptions(game=reduced_model()), failed=left.append) == []
    assert "is no rerun of a round" in left[-1]


def test_a_machine_without_a_boundary_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(SuiteError, match="cannot be rerun here: no unshare"):
        find_boundary(tmp_path)
    with pytest.raises(SuiteError, match="cannot be rerun here: neither podman nor docker"):
        find_boundary(tmp_path, "image")


@needs_boundary
@pytest.mark.parametrize("leak", ["print('the package')", "raise SystemExit(1)"])
def test_a_boundary_that_leaks_is_refused(leak: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(remote, "_PROBE", leak)
    with pytest.raises(SuiteError, match="cannot be rerun here: unshare"):
        find_boundary(tmp_path)


@needs_boundary
@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="another user needs root")
def test_the_probe_sees_what_it_must_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each part of the boundary that is left out is noticed."""
    whole = Namespaces().command

    def without(part: str) -> Any:
        return lambda self, code, arguments: [each.replace(part, "") for each in whole(code, arguments) if each != part]

    for part in ("--bounding-set=-all", "--no-new-privs", "--pid"):
        monkeypatch.setattr(Namespaces, "command", without(part))
        with pytest.raises(SuiteError, match="cannot be rerun here"):
            find_boundary(tmp_path)


def test_containers_have_no_network_and_no_privileges(tmp_path: Path) -> None:
    command = Container("podman", "python:3.12").command(tmp_path, ["-c", "pass"])
    for part in ("--network=none", "--read-only", "--cap-drop=ALL", f"--volume={tmp_path}:/code:ro"):
        assert part in command
    assert any(re.fullmatch(r"--user=(\d{10}):\1", part) for part in command)
    assert command[-5:] == ["python:3.12", "python", "-I", "-c", "pass"]
