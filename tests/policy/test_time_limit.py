"""Policies that do not answer, and policies that try to end the program."""

import gc
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from shuttle_marl.game import default_game
from shuttle_marl.game.policy import GamePolicy, PolicyError, States, checked_probabilities, reads_score
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.foreign import FunctionPolicy, TimedPolicy, limited, time_limit
from shuttle_marl.policy.registry import resolve

GAME = default_game()
STATES = States(game=GAME, state=np.zeros(2, dtype=np.int32))


def uniform(states: States) -> np.ndarray:
    return states.mask / states.mask.sum(axis=1, keepdims=True)


def test_within_a_limit_policies_answer_as_without() -> None:
    with time_limit(60):
        timed = resolve("safe@0.5", GAME)
        assert tabulate(resolve("bc", GAME), GAME).hash == tabulate(resolve("bc", GAME), GAME).hash
    assert isinstance(timed, GamePolicy)
    assert isinstance(timed.policy, TimedPolicy)
    assert tabulate(timed, GAME).hash == tabulate(resolve("safe@0.5", GAME), GAME).hash
    after = resolve("safe", GAME)
    assert isinstance(after, GamePolicy)
    assert not isinstance(after.policy, TimedPolicy)
    with time_limit(0):
        unlimited = resolve("safe", GAME)
        assert isinstance(unlimited, GamePolicy)
        assert not isinstance(unlimited.policy, TimedPolicy)


def test_one_that_hangs_is_given_up_and_never_asked_again() -> None:
    calls = []
    ended = threading.Event()

    def hangs(states: States) -> np.ndarray:
        calls.append(threading.current_thread())
        try:
            while True:
                pass
        finally:
            ended.set()

    policy = TimedPolicy(FunctionPolicy(hangs), 0.1)
    with pytest.raises(
        PolicyError, match=r"'TimedPolicy' raised TimeoutError: no answer within 0\.1 s; --policy-timeout gives more"
    ):
        checked_probabilities(policy, STATES)
    assert ended.wait(10), "the loop takes time from everything else"
    begun = time.monotonic()
    with pytest.raises(PolicyError, match=r"did not answer within 0\.1 s before, and is not asked again"):
        checked_probabilities(policy, STATES)
    assert time.monotonic() - begun < 0.1
    assert len(calls) == 1


def test_errors_are_those_of_the_policy() -> None:
    def fails(states: States) -> np.ndarray:
        raise LookupError("no idea")

    def interrupts(states: States) -> np.ndarray:
        raise KeyboardInterrupt

    def exits(states: States) -> np.ndarray:
        sys.exit(3)

    for function, says in (
        (fails, "raised LookupError: no idea"),
        (interrupts, "raised RuntimeError: KeyboardInterrupt"),
        (exits, "raised SystemExit: 3"),
    ):
        policy = TimedPolicy(FunctionPolicy(function), 60)
        for _ in range(2):  # an error is not a hang: it is asked again
            with pytest.raises(PolicyError, match=says):
                checked_probabilities(policy, STATES)


def test_whether_it_reads_the_score_is_asked_under_the_limit_too() -> None:
    class Moody:
        def __init__(self, answer: Callable[[], object]) -> None:
            self.answer = answer

        @property
        def reads_score(self) -> bool:
            return bool(self.answer())

        def probabilities(self, states: States) -> np.ndarray:
            return uniform(states)

    assert reads_score(TimedPolicy(Moody(lambda: True), 60))
    for policy in (Moody(sys.exit), TimedPolicy(Moody(sys.exit), 60)):
        with pytest.raises(PolicyError, match="reads_score of Moody raised SystemExit"):
            reads_score(policy)
    with pytest.raises(PolicyError, match=r"no answer within 0\.05 s"):
        reads_score(TimedPolicy(Moody(lambda: time.sleep(60)), 0.05))


def test_threads_end_with_their_policies() -> None:
    threads = []

    def noted(states: States) -> np.ndarray:
        threads.append(threading.current_thread())
        return uniform(states)

    policies = [TimedPolicy(FunctionPolicy(noted), 60) for _ in range(5)]
    for policy in policies:
        for _ in range(2):
            checked_probabilities(policy, STATES)
    assert len(set(threads)) == 5
    assert all(thread.is_alive() and thread.daemon for thread in threads)
    del policies, policy
    gc.collect()
    for thread in threads:
        thread.join(10)
    assert not any(thread.is_alive() for thread in threads)


@pytest.mark.parametrize("seconds", [-1.0, float("nan"), float("inf"), 1e300])
def test_impossible_limits(seconds: float) -> None:
    with pytest.raises(PolicyError, match="--policy-timeout"), time_limit(seconds):
        pass


def test_a_table_needs_no_limit() -> None:
    table = tabulate(resolve("random", GAME), GAME)
    with time_limit(1):
        assert limited(table) is table


HANGS = """
import sys, time
import numpy as np
from shuttle_marl.policy.foreign import FunctionPolicy
from shuttle_marl.policy.foreign import TimedPolicy

try:
    TimedPolicy(FunctionPolicy(lambda states: time.sleep(1000)), 0.05).probabilities(None)
except TimeoutError:
    print("given up")
"""


def test_the_program_does_not_wait_for_one_that_hangs(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", HANGS], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "given up\n", "")
