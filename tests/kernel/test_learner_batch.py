"""``RallyBatch`` against ``rally_v0`` played one stroke at a time, with the opponent's choice by its definition."""

import dataclasses
import functools

import numpy as np
import pytest

from shuttle_marl import rally_v0
from shuttle_marl.game import default_game, draws
from shuttle_marl.game.tables import Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import KernelError, RallyBatch
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy

GAME = default_game()
NAMES = ("bc", "random", "attacking@greedy")


@functools.cache
def table(name: str) -> TabulatedPolicy:
    return tabulate(resolve(name, GAME), GAME, name)


@dataclasses.dataclass(frozen=True)
class Turn:
    """Observation, stroke and reward of the learner, stroke by stroke."""

    state: int
    stroke: int
    reward: float


Rally = list[Turn] | bool
"""The learner's turns, or whether the learner won where the opponent's serve ended the rally."""


def learners_choice(game: Game, key: np.uint64, count: int, state: int) -> int:
    """The choice of ``random_strokes``, by its definition."""
    first, last = int(game.pair_start[state]), int(game.pair_start[state + 1])
    upper = int(draws.draw(np.array([key]), count)[0]) >> 32
    return int(game.pair_stroke[first + (upper * (last - first) >> 32)])


def by_hand(game: Game, opponent: TabulatedPolicy, *, seat: int, server: int | None, seed: int, rallies: int) -> list[Rally]:
    """The first rallies of a seed in the AEC environment."""
    env = rally_v0.raw_env(game=game, server=server)  # type: ignore[arg-type]
    played: list[Rally] = []
    for rally in range(rallies):
        env.reset(seed=seed if rally == 0 else None)
        key = draws.stream(seed, rally)[0]
        turns: list[Turn] = []
        count = 0
        while not env.terminations["player_0"]:
            state = env.state_number
            if env.agent_selection == f"player_{seat}":
                stroke = learners_choice(game, key, count, state)
                turns.append(Turn(state, stroke, 0.0))
            else:
                entries = opponent.cumulative[game.pair_start[state] : game.pair_start[state + 1]]
                u = draws.choice_draw(draws.draw(np.array([key]), count))[0]
                stroke = int(game.pair_stroke[game.pair_start[state] + np.searchsorted(entries, u, side="right")])
                assert env.choice_draw() == u
            env.step(stroke)
            count += 1
        reward = env.rewards[f"player_{seat}"]
        if turns:
            turns[-1] = dataclasses.replace(turns[-1], reward=reward)
        played.append(turns or reward > 0)
    return played


def by_kernel(batch: RallyBatch, rallies: int, *, fused: bool = True) -> tuple[dict[int, list[Turn]], dict[int, int]]:
    """The learner's turns in each of the first rallies, and the opponent of each."""
    found: dict[int, list[Turn]] = {}
    met: dict[int, int] = {}
    while batch.rows.rally.min() < rallies:
        state, rally, opponent = batch.rows.state.copy(), batch.rows.rally.copy(), batch.opponents.opponent.copy()
        strokes = batch.random_strokes()
        reward, done = batch.step(strokes, reset=fused)
        assert np.array_equal(done, reward != 0)
        if not fused:
            assert np.array_equal(batch.rows.live, ~done)
            batch.reset(rows=done)
        for row in np.flatnonzero(rally < rallies):
            found.setdefault(int(rally[row]), []).append(Turn(int(state[row]), int(strokes[row]), float(reward[row])))
            met[int(rally[row])] = int(opponent[row])
    return found, met


def unseen_among(played: list[Rally]) -> tuple[int, int]:
    return sum(rally is True for rally in played), sum(rally is False for rally in played)


@pytest.mark.parametrize("server", [None, 0, 1])
@pytest.mark.parametrize("seat", [0, 1])
def test_one_row_plays_the_rallies_of_the_environment(seat: int, server: int | None) -> None:
    for seed, name in enumerate(NAMES):
        expected = by_hand(GAME, table(name), seat=seat, server=server, seed=seed, rallies=120)
        batch = RallyBatch(GAME, 1, opponents=[table(name)], seat=seat, server=server, seed=seed)  # type: ignore[arg-type]
        turns, _ = by_kernel(batch, 100)
        assert turns == {number: rally for number, rally in enumerate(expected[:100]) if not isinstance(rally, bool)}
        assert batch.rows.rally[0] < 120
        assert batch.unseen == unseen_among(expected[: batch.rows.rally[0]])


@pytest.mark.parametrize("fused", [True, False])
@pytest.mark.parametrize(("size", "threads"), [(1, 1), (9, 1), (300, 1), (2100, 2)])
def test_neither_company_nor_threads_nor_the_way_to_reset_change_a_rally(size: int, threads: int, fused: bool) -> None:
    """Serves that often end the rally, so that rallies that never come to the learner are frequent."""
    game = random_game(3, 8, 0.5)
    opponent = random_policy(game, 1)
    expected = by_hand(game, opponent, seat=1, server=None, seed=11, rallies=400)
    batch = RallyBatch(game, size, opponents=[opponent], seat=1, seed=11, threads=threads)
    turns, _ = by_kernel(batch, 400, fused=fused)
    assert turns == {number: rally for number, rally in enumerate(expected) if not isinstance(rally, bool)}
    assert min(unseen_among(expected)) > 10


def test_rows_meet_their_opponents_from_their_seats() -> None:
    """K opponents in turn, and a seat for each row."""
    opponents = [table(name) for name in NAMES]
    seat = np.arange(12) // 3 % 2
    batch = RallyBatch(GAME, 12, opponents=opponents, seat=seat, seed=4)
    assert batch.n_opponents == 3
    turns, met = by_kernel(batch, 240)
    played = {(o, s): by_hand(GAME, opponents[o], seat=s, server=None, seed=4, rallies=240) for o in range(3) for s in (0, 1)}
    assert set(met.values()) == {0, 1, 2}
    for rally, found in turns.items():
        row = rally % 12
        assert met[rally] == row % 3
        assert found == played[row % 3, int(seat[row])][rally]


def test_assigned_opponents_come_with_the_next_rally() -> None:
    opponents = [table(name) for name in NAMES]
    batch = RallyBatch(GAME, 50, opponents=opponents, seed=6)
    assert batch.opponents.opponent.tolist() == [row % 3 for row in range(50)]
    batch.assign(np.full(50, 2))
    unchanged = np.ones(50, np.bool_)
    for _ in range(15):
        _, done = batch.step(batch.random_strokes())
        unchanged &= ~done
        assert np.array_equal(batch.opponents.opponent, np.where(unchanged, np.arange(50) % 3, 2))
    assert not unchanged.all()


def test_another_policy_in_the_place_of_an_opponent() -> None:
    replaced = RallyBatch(GAME, 20, opponents=[table("random"), table("bc")], seed=7)
    replaced.replace_opponent(0, table("bc"))
    replaced.reset(7)
    reference = RallyBatch(GAME, 20, opponents=[table("bc")], seed=7)
    for _ in range(20):
        strokes = reference.random_strokes()
        got, expected = replaced.step(strokes), reference.step(strokes)
        assert np.array_equal(got[0], expected[0])
        assert np.array_equal(replaced.rows.state, reference.rows.state)
    with pytest.raises(KernelError, match="policy number 2: expected 0 to 1"):
        replaced.replace_opponent(2, table("bc"))


other_game = random_game(1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"opponents": []}, "no policy: expected one or more"),
        ({"opponents": [random_policy(other_game, 0)]}, "tabulated for another game"),
        ({"seat": 2}, "seat 2: expected 0 or 1"),
        ({"seat": np.array([0, 1, 0])}, r"an array of them of shape \(4,\)"),
        ({"server": 3}, "server 3: expected 0, 1, or None"),
        ({"batch": 0}, "batch 0: expected a whole number, 1 or more"),
        ({"threads": 0}, "threads 0: expected a whole number, 1 or more"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, object], message: str) -> None:
    given: dict[str, object] = {"batch": 4, "opponents": [table("bc")], **options}
    with pytest.raises(KernelError, match=message):
        RallyBatch(GAME, **given)  # type: ignore[arg-type]
