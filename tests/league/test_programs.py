"""External programs as policies: one that plays, and those that hang, die or answer rubbish, beside whom all others play on."""

import json
import os
import re
import shlex
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from shuttle_marl.game import default_game, load_game
from shuttle_marl.game.policy import PolicyError, States, checked_probabilities
from shuttle_marl.game.tables import ROOT
from shuttle_marl.league import LeagueConfig
from shuttle_marl.policy import resolve
from shuttle_marl.policy.foreign import time_limit
from shuttle_marl.policy.programs import ProgramPolicy
from shuttle_marl.policy.registry import resolve_recorded
from tests.tournaments import play_league
from tests.waiting import wait_until

HEAD = """
import json, os, sys, time
game = json.loads(sys.stdin.readline())
assert game["type"] == "game" and game["protocol"] == 1 and len(game["strokes"]) == 3
def answer(**fields):
    print(json.dumps(fields), flush=True)
for count, line in enumerate(sys.stdin):
    asked = json.loads(line)
    legal, number = asked["legal"], asked["id"]
"""
PLAYS = {
    "first": "answer(id=number, stroke=legal[0])",
    "even": "answer(id=number, probabilities={name: 1 / len(legal) for name in legal})",
}
FAILS = {
    "hangs": ("time.sleep(60) if count == 30 else answer(id=number, stroke=legal[0])", "no answer within 0.5 s"),
    "dies": ("sys.exit('out of shuttles') if count == 30 else answer(id=number, stroke=legal[0])", "status 1: …out of shuttles"),
    "killed": ("os.kill(os.getpid(), 9)", "status -9"),
    "rubbish": ("print('smash!', flush=True)", "answered 'smash!'"),
    "array": ("print('[1]', flush=True)", "answered '\\[1\\]'"),
    "other": ("answer(id=number + 1, stroke=legal[0])", "where the answer to"),
    "unknown": ("answer(id=number, stroke='tweener')", "tweener"),
    "illegal": ("answer(id=number, stroke=next(s for s in game['strokes'] if s not in legal))", "illegal stroke"),
    "unequal": ("answer(id=number, probabilities={legal[0]: 0.4})", "no distribution"),
    "text": ("answer(id=number, probabilities={legal[0]: 'all'})", "expected an id"),
    "nan": ("answer(id=number, probabilities={legal[0]: float('nan')})", "NaN"),
    "long": ("sys.stdout.write('x' * 200000); sys.stdout.flush()", "more than 65,536 bytes"),
    "deaf": ("os.close(1); time.sleep(60)", "closed its output"),
}


def program(folder: Path, name: str, body: str) -> str:
    path = folder / f"{name}.py"
    path.write_text(HEAD + f"    {body}\n")
    return f"program:{sys.executable} -S -E {path}"


def states(model: str) -> States:
    """The serve, and two other states with legal strokes."""
    game = load_game(model)
    everywhere = np.arange(game.n_states, dtype=np.int32)
    known = everywhere[game.mask(everywhere).any(axis=1)]
    return States(game=game, state=np.r_[ROOT, known[known != ROOT][:2]], score=np.zeros((3, 4), dtype=np.int16))


def test_programs_play(small_model: str, tmp_path: Path) -> None:
    game = load_game(small_model)
    asked = states(small_model)
    first = resolve(program(tmp_path, "first", PLAYS["first"]), game).probabilities(asked)
    assert (first[np.arange(3), asked.mask.argmax(axis=1)] == 1).all()
    some = States(game=game, state=np.flatnonzero(game.playable)[2:].astype(np.int32))
    told = resolve(program(tmp_path, "told", "answer(id=number, stroke=legal[-1 if asked['hurried'] else 0])"), game)
    last = some.mask.shape[1] - 1 - some.mask[:, ::-1].argmax(axis=1)
    expected = np.where(some.hurried, last, some.mask.argmax(axis=1))
    assert (told.probabilities(some)[np.arange(len(some)), expected] == 1).all()
    even = resolve(program(tmp_path, "even", PLAYS["even"]), game)
    for _ in range(60):  # more than may be sent ahead
        assert even.probabilities(asked) == pytest.approx(asked.mask / asked.mask.sum(axis=1, keepdims=True))


def test_programs_are_told_what_is_seen(small_model: str, tmp_path: Path) -> None:
    game, told = load_game(small_model), tmp_path / "told"
    body = f"open({str(told)!r}, 'a').write(line); answer(id=number, stroke=legal[0])"
    state, score = int(np.flatnonzero(game.playable)[-1]), [11, 9, 0, 1]
    some = States(game=game, state=np.array([ROOT, state], np.int32), score=np.array([score] * 2, np.int16))
    resolve(program(tmp_path, "notes", body), game).probabilities(some)
    serve, later = map(json.loads, told.read_text().splitlines())
    names, seen = [*game.catalogue.names, None], game.observation(state).tolist()
    assert serve == {
        "type": "stroke", "id": 0, "own": None, "incoming": None, "contact": "below", "hurried": False, "duel": 0,
        "effort": [0, 0], "score": score, "legal": [names[stroke] for stroke in game.legal_strokes(ROOT)],
    }  # fmt: skip
    assert later == {
        "type": "stroke", "id": 1, "own": names[seen[0]], "incoming": names[seen[1]], "contact": ("below", "above")[seen[2]],
        "hurried": bool(seen[6]), "duel": seen[3], "effort": seen[4:6], "score": score,
        "legal": [names[stroke] for stroke in game.legal_strokes(state)],
    }  # fmt: skip


@pytest.mark.parametrize("failure", FAILS)
def test_answers_that_are_no_play(failure: str, small_model: str, tmp_path: Path) -> None:
    body, says = FAILS[failure]
    with time_limit(0.5):
        policy = resolve(program(tmp_path, failure, body), load_game(small_model))

    def asked() -> None:
        for _ in range(40):
            checked_probabilities(policy, states(small_model))

    with pytest.raises(PolicyError, match=says):
        asked()


@pytest.mark.parametrize(("failure", "seconds"), [("dies", 10.0), ("hangs", 0.5)])
def test_a_program_that_fails_forfeits_and_all_others_play(
    failure: str, seconds: float, small_model: str, tmp_path: Path
) -> None:
    body, says = FAILS[failure]
    name = program(tmp_path, failure, body)
    options: dict[str, Any] = {"matches": 4, "game": small_model, "record": "none", "policy_timeout": seconds}
    results = play_league(LeagueConfig(pool=("random", name, "safe"), out=tmp_path / "run", **options)).results
    assert [result.forfeit for result in results] == [(name,), (), (name,)]
    assert [bool(result.reason) for result in results] == [True, False, True]
    assert re.search(says, results[0].reason), results[0].reason
    alone = play_league(LeagueConfig(pool=("random", "safe"), out=tmp_path / "alone", **options)).results
    assert alone[0].seats == results[1].seats


def test_commands_that_cannot_be_run(small_model: str, tmp_path: Path) -> None:
    game = load_game(small_model)
    for name, says in (
        ("program", "expected a command"),
        ("program:", "expected a command"),
        ("program:'x", "No closing quotation"),
    ):
        with pytest.raises(PolicyError, match=says):
            resolve(name, game)
    with pytest.raises(PolicyError, match="cannot be started"):
        resolve(f"program:{tmp_path / 'nothing'}", game).probabilities(states(small_model))
    with pytest.raises(PolicyError, match="not resolved because a file named it"):
        resolve_recorded("program:true", game)


def test_a_program_ends_with_its_policy(small_model: str, tmp_path: Path) -> None:
    body = f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); answer(id=number, stroke=legal[0])"
    with time_limit(5):
        policy = resolve(program(tmp_path, "told", body), load_game(small_model))
    policy.probabilities(states(small_model))
    pid = int((tmp_path / "pid").read_text())
    os.kill(pid, 0)
    del policy
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_children_end_with_the_program(small_model: str, tmp_path: Path) -> None:
    written = str(tmp_path / "child")
    child = f"import os, pathlib, time; pathlib.Path({written!r}).write_text(str(os.getpid())); time.sleep(600)"
    lines = (
        "import subprocess",
        f"subprocess.Popen([sys.executable, '-c', {child!r}]) if count == 0 else None",
        f"while not (os.path.exists({written!r}) and open({written!r}).read()): time.sleep(0.01)",
        "answer(id=number, stroke=legal[0])",
    )
    script = tmp_path / "parent.py"
    script.write_text(HEAD + "".join(f"    {line}\n" for line in lines))
    game = load_game(small_model)
    policy = resolve(f"program:{sys.executable} {script}", game)
    policy.probabilities(States(game=game, state=np.array([ROOT], np.int32)))
    process = int((tmp_path / "child").read_text())
    os.kill(process, 0)
    getattr(policy, "close")()  # noqa: B009  not every policy has it
    wait_until(lambda: not alive(process), 60, "the child to end")


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(") ")[2][0] != "Z"
    except OSError:
        return False


def test_a_program_that_does_not_read_is_late() -> None:
    command = shlex.join([sys.executable, "-S", "-E", "-c", "import time; time.sleep(5)"])
    deaf, states = ProgramPolicy(command, default_game(), 0.5), States(game=default_game(), state=np.arange(500, dtype=np.int32))
    with pytest.raises(PolicyError, match=r"did not read within 0.5 s; --policy-timeout gives more time"):
        deaf.probabilities(states)  # more than a pipe holds
    with pytest.raises(PolicyError, match="it is not asked again"):
        deaf.probabilities(states)
