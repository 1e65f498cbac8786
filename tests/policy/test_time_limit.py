"""Time limits, what programs are asked and answer, and a policy that tries to end the program."""

import contextlib
import json
import sys
import threading
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from shuttle_marl.base.programs import ProgramError, ProgramTimeoutError
from shuttle_marl.game.policy import PolicyError, States, reads_score
from shuttle_marl.game.tables import ROOT
from shuttle_marl.policy import foreign
from shuttle_marl.policy.foreign import POLICY_TIMEOUT, current_limit, time_limit
from tests.exact.exact_games import tiring_game


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf"), 1e300])
def test_impossible_limits(seconds: float) -> None:
    with pytest.raises(PolicyError, match="--policy-timeout"), time_limit(seconds):
        pass


def test_one_that_exits_when_asked_whether_it_reads_the_score_is_refused() -> None:
    class Moody:
        @property
        def reads_score(self) -> bool:
            sys.exit()

        def probabilities(self, states: States) -> np.ndarray:
            return states.mask / states.mask.sum(axis=1, keepdims=True)

    with pytest.raises(PolicyError, match="reads_score of Moody raised SystemExit"):
        reads_score(Moody())


def test_limits_hold_within_their_context_alone() -> None:
    assert current_limit() == 0
    with time_limit(2.5):
        assert current_limit() == 2.5
        with time_limit(0):
            assert current_limit() == 0
        with contextlib.suppress(ZeroDivisionError), time_limit(threading.TIMEOUT_MAX):
            assert current_limit() == threading.TIMEOUT_MAX
            raise ZeroDivisionError
        assert current_limit() == 2.5
    assert current_limit() == 0
    assert POLICY_TIMEOUT == 10


GAME = tiring_game()
PLAYABLE = np.flatnonzero(GAME.playable).astype(np.int32)


class Answering:
    """In place of a program: answers each decision with its first legal stroke, or with what is given."""

    def __init__(self, answer: Any = None) -> None:
        self.started, self.sent, self.unread, self.answer, self.killed = False, list[list[Any]](), list[bytes](), answer, ""

    def write(self, content: bytes) -> None:
        self.started = True
        assert content.endswith(b"\n")
        self.sent.append([json.loads(line) for line in content.splitlines()])
        for asked in self.sent[-1]:
            if asked["type"] == "stroke":
                given = {"id": asked["id"], "stroke": asked["legal"][0]} if self.answer is None else self.answer
                self.unread.append(given if isinstance(given, bytes) else json.dumps(given).encode())

    def read_line(self) -> bytes:
        return self.unread.pop(0)

    def failed(self, problem: str) -> ProgramError:
        self.killed = problem
        return ProgramError(problem)

    def close(self) -> None:
        self.killed = "closed"


def playing(monkeypatch: pytest.MonkeyPatch, answer: Any = None) -> tuple[foreign.ProgramPolicy, Answering]:
    program = Answering(answer)
    monkeypatch.setattr(foreign, "Program", lambda *_: program)
    return foreign.ProgramPolicy("./player", GAME, 1.0), program


def test_decisions_are_sent_in_batches_and_numbered_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "_AHEAD", 4)
    policy, program = playing(monkeypatch)
    assert policy.reads_score
    for number, first in ((9, 0), (2, 9), (0, 11)):
        states = States(game=GAME, state=PLAYABLE[:number])
        found = policy.probabilities(states)
        np.testing.assert_array_equal(found, np.eye(GAME.n_strokes)[states.mask.argmax(axis=1)])
        asked = [each["id"] for batch in program.sent[-3 if number == 9 else -1 :] for each in batch]
        assert asked == list(range(first, first + number)) or not number
    assert [len(batch) for batch in program.sent] == [1, 4, 4, 1, 2]
    (about,) = program.sent[0]
    assert about == {"type": "game", "protocol": 1, "game": GAME.hash, "strokes": list(GAME.catalogue.names)}
    policy.close()
    assert program.killed == "closed"


def test_decisions_say_what_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, program = playing(monkeypatch)
    names = GAME.catalogue.names
    state = int(PLAYABLE[(GAME.own(PLAYABLE) == 3) & (GAME.incoming(PLAYABLE) == 1)][-1])  # the last: greatest efforts
    for score in (None, np.array([[11, 9, 0, 1]] * 2, np.int16)):
        policy.probabilities(States(game=GAME, state=np.array([ROOT, state], np.int32), score=score))
        serve, later = ({name: each[name] for name in each if name != "id"} for each in program.sent[-1])
        told = None if score is None else [11, 9, 0, 1]
        assert serve == {
            "type": "stroke", "own": None, "incoming": None, "contact": "below", "hurried": False, "duel": 0,
            "effort": [0, 0], "score": told, "legal": [names[0]],
        }  # fmt: skip
        seen = GAME.observation(state).tolist()
        assert later == {
            "type": "stroke", "own": names[3], "incoming": names[1], "contact": ("below", "above")[seen[2]],
            "hurried": bool(seen[6]), "duel": seen[3], "effort": seen[4:6], "score": told,
            "legal": [names[stroke] for stroke in GAME.legal_strokes(state)],
        }  # fmt: skip
        assert later["effort"] == [2, 2]


def test_shares_are_taken_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    names = GAME.catalogue.names
    policy, _ = playing(monkeypatch, {"id": 0, "probabilities": {names[2]: 0.25, names[5]: 0.75}})
    assert policy.probabilities(States(game=GAME, state=PLAYABLE[:1])).tolist() == [[0, 0, 0.25, 0, 0, 0.75, 0, 0]]


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ({"id": 1, "stroke": "short-serve:front-centre:below:backhand"}, "it answered 1 where the answer to 0 was expected"),
        ({"id": 0}, "expected an id and a stroke or probabilities of strokes"),
        ({"stroke": "short-serve:front-centre:below:backhand"}, "expected an id and a stroke or probabilities of strokes"),
        ({"id": 0, "stroke": "smash"}, "expected an id and a stroke or probabilities of strokes"),
        ({"id": 0, "probabilities": ["smash"]}, "expected an id and a stroke or probabilities of strokes"),
        ([0], "expected an id and a stroke or probabilities of strokes"),
        (b"\xff" + b"x" * 200, r"it answered '\\\\xffx{79}'; expected an id"),
        (b"y" * 200, r"it answered 'y{80}'; expected an id"),
    ],
)
def test_answers_that_are_none_kill_the_program(answer: Any, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    policy, program = playing(monkeypatch, answer)
    with pytest.raises(PolicyError, match=says):
        policy.probabilities(States(game=GAME, state=np.array([ROOT], np.int32)))
    assert program.killed


def test_more_time_is_offered_to_who_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    policy, program = playing(monkeypatch)
    for error, says in (
        (ProgramTimeoutError("late"), "^late; --policy-timeout gives more time$"),
        (ProgramError("gone"), "^gone$"),
    ):
        monkeypatch.setattr(program, "read_line", Mock(side_effect=error))
        with pytest.raises(PolicyError, match=says):
            policy.probabilities(States(game=GAME, state=PLAYABLE[:1]))
