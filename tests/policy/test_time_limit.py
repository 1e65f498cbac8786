"""Time limits, what programs are asked and answer, and a policy that tries to end the program."""

import contextlib
import sys
import threading

import numpy as np
import pytest

from shuttle_marl.game.policy import PolicyError, States, reads_score
from shuttle_marl.policy.foreign import current_limit, time_limit


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
