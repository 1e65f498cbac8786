"""The game of a pair in the kernel, the stepper and all environments: the same rallies everywhere."""

from typing import Any, Literal

import numpy as np
import pytest
import torch

from shuttle_marl.env.batched import VersusEnv
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.vector import RallyVectorEnv
from shuttle_marl.game.pairs import pair_game
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.tables import GameError
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import KernelError, RallyBatch, play_matches, play_rallies
from shuttle_marl.kernel.lockstep import play
from shuttle_marl.league.entrants import Entrant, Strikers
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy
from tests.kernel.episodes import compare_with_rally_v0
from tests.kernel.test_matches_kernel import RULES, assert_same, some_matches
from tests.reduced import reduced_game, reduced_model

A, B = "viktor-axelsen", "kento-momota"
PAIR = pair_game(A, B, game=reduced_model())
NAMES = ("bc", "minimax", "random")


def seated(name: str) -> list[TabulatedPolicy]:
    return [tabulate(resolve(name, game), game, name) for game in PAIR.seats]


def test_matches_are_those_of_the_lockstep() -> None:
    """Every entrant strikes at seat 0 with the tables of one player, at seat 1 with those of the other."""
    wanted, tables = some_matches(60, len(NAMES), 1), [seated(name) for name in NAMES]
    entrants = [
        Entrant(name=n, policy=first, table=first, opposite=second) for n, (first, second) in zip(NAMES, tables, strict=True)
    ]
    expected = play(PAIR, wanted, Strikers(PAIR, entrants).choose, rules=RULES["to five"])
    packed = [table for seat in zip(*tables, strict=True) for table in seat]
    by_seat = type(wanted)(
        entrant=wanted.entrant + np.array([0, len(NAMES)], np.int32), first_server=wanted.first_server, key=wanted.key
    )
    played = play_matches(PAIR, by_seat, packed, rules=RULES["to five"])
    relabelled = played.rallies.policy % len(NAMES)
    assert np.array_equal(relabelled, expected.rallies.policy)
    played.rallies.policy[:] = relabelled
    assert_same(played, expected)


def test_rallies_are_those_of_the_environment() -> None:
    bc = seated("bc")
    compare_with_rally_v0(3, play_rallies(PAIR, (bc[0], bc[1]), 60, seed=3), game=PAIR)
    # And not those of the average game.
    with pytest.raises((AssertionError, IllegalStrokeError)):
        compare_with_rally_v0(3, play_rallies(PAIR, (bc[0], bc[1]), 60, seed=3), game=reduced_game())


@pytest.mark.parametrize("seat", [0, 1])
def test_learners_against_the_other_player(seat: Literal[0, 1]) -> None:
    """The Gymnasium environments of one rally and of many, and TorchRL's, play the same episodes."""
    options: dict[str, Any] = {"game": PAIR}
    single = SingleRallyEnv(opponent="minimax", seat=seat, **options)
    vector = RallyVectorEnv(1, opponent="minimax", seat=seat, **options)
    versus = VersusEnv(1, opponents="minimax", seat=seat, seed=4, **options)
    opponent = single.opponent.policy
    assert isinstance(opponent, TabulatedPolicy)
    assert opponent.hash == seated("minimax")[1 - seat].hash
    seen, _ = single.reset(seed=4)
    vector.reset(seed=4)
    now = versus.reset()
    for step in range(300):
        assert single.state_number == vector.versus.rows.state[0] == versus.states[0]
        legal = np.flatnonzero(seen["action_mask"])
        stroke = int(legal[step % len(legal)])
        seen, reward, over, _, _ = single.step(stroke)
        _, rewards, overs, _, _ = vector.step(np.array([stroke]))
        stepped = versus.step_and_maybe_reset(now.set("action", torch.tensor([stroke])))
        assert reward == rewards[0] == stepped[0]["next", "reward"].item()
        assert over == overs[0] == stepped[0]["next", "terminated"].item()
        now = stepped[1]
        if over:
            seen, _ = single.reset()


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(GameError, match="expected 0 or 1 for all rows"):
        RallyVectorEnv(4, game=PAIR, seat=np.array([0, 1, 0, 1]))
    with pytest.raises(KernelError, match="tabulated for another game"):
        RallyBatch(PAIR, 4).run(3, (seated("bc")[0], random_policy(random_game(1), 0)))
