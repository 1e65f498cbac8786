"""The batched TorchRL environments against ``rally_v0``, and TorchRL's own checks."""

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from shuttle_marl import rally_v0
from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.observation import stroke_features
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.rules import IllegalStrokeError
from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import KernelError
from shuttle_marl.policy.registry import resolve
from tests.exact.exact_games import random_game, random_policy, tiring_game

GAME = default_game()
EITHER = pytest.mark.parametrize("make", [RallyEnv, VersusEnv])
BC = tabulate(resolve("bc", GAME), GAME)

Env = RallyEnv | VersusEnv


def steps(env: Env, n: int, *, fused: bool = True) -> Iterator[tuple[Any, Any]]:
    """Tensordicts before and with each of n steps of random legal strokes; rows whose rally is over begin the next one."""
    now = env.reset()
    for _ in range(n):
        acted = env.rand_action(now)
        if fused:
            stepped, following = env.step_and_maybe_reset(acted)
        else:
            stepped = env.step(acted)
            following = env.maybe_reset(stepped["next"].clone())
        yield now, stepped
        now = following


@EITHER
@pytest.mark.parametrize("batch", [1, 8, 1024])
def test_specs(make: type[Env], batch: int) -> None:
    env = make(batch)
    check_env_specs(env, seed=0)
    assert env.batch_size == torch.Size([batch])


@EITHER
def test_rollouts_of_torchrl(make: type[Env]) -> None:
    env = make(16)
    rollout = env.rollout(50, break_when_any_done=False)
    assert rollout.batch_size == torch.Size([16, 50])
    reward, over = rollout["next", "reward"], rollout["next", "terminated"]
    assert torch.equal(reward != 0, over)
    assert set(reward.unique().tolist()) == {-1.0, 0.0, 1.0}
    legal = rollout["action_mask"].gather(-1, rollout["action"].unsqueeze(-1))
    assert legal.all()


@EITHER
@pytest.mark.parametrize("threads", [1, 2])
def test_stock_and_fused_reset_agree(make: type[Env], threads: int) -> None:
    batch = 2500
    stock, fused = make(batch, seed=3, threads=threads), make(batch, seed=3, threads=threads)
    for (now, stepped), (now_too, stepped_too) in zip(steps(stock, 12, fused=False), steps(fused, 12), strict=True):
        for key in ("observation", "action_mask", "action"):
            assert torch.equal(now[key], now_too[key]), key
        for key in ("reward", "terminated", "done"):
            assert torch.equal(stepped["next", key], stepped_too["next", key]), key
        continues = ~stepped["next", "done"].squeeze(-1)
        for key in ("observation", "action_mask"):
            assert torch.equal(stepped["next", key][continues], stepped_too["next", key][continues]), key


@EITHER
def test_seeds(make: type[Env]) -> None:
    def play(env: Env) -> list[int]:
        return [x for _, stepped in steps(env, 6) for x in stepped["next", "observation"].flatten().tolist()]

    first = play(make(8, seed=1))
    assert play(make(8, seed=1)) == first
    assert play(make(8, seed=2)) != first
    env = make(8)
    env.set_seed(1)
    assert play(env) == first
    assert play(env) != first, "a second reset continues"
    env.set_seed(1)
    assert play(env) == first


@EITHER
def test_partial_resets_continue_with_the_next_rally_of_the_row(make: type[Env]) -> None:
    env = make(6, server=0)
    first = env.reset()
    wanted = torch.tensor([True, False, False, True, False, False]).unsqueeze(-1)
    first.set("_reset", wanted)
    env.reset(first)
    rows = env._batch.rows
    assert rows.rally.tolist() == [6, 1, 2, 9, 4, 5]
    assert (rows.state == ROOT).all()


@EITHER
def test_an_illegal_stroke_is_refused_and_nothing_changes(make: type[Env]) -> None:
    env = make(8)
    now = env.reset()
    action = env.rand_action(now.clone())["action"]
    before = [array.copy() for array in env._batch.rows]
    wrong = action.clone()
    wrong[5] = int((~now["action_mask"][5]).nonzero()[0])
    for stroke in (wrong, torch.full_like(action, -1)):
        with pytest.raises(IllegalStrokeError, match=r"row [05]: "):
            env.step(now.clone().set("action", stroke))
    after: tuple[np.ndarray, ...] = env._batch.rows
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    env.step(now.set("action", action))


class ReadsScore:
    reads_score = True

    def probabilities(self, states: States) -> Any:
        return states.mask / states.mask.sum(axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"opponents": "bcc"}, PolicyError, "no policy 'bcc'; did you mean bc"),
        ({"opponents": ["bc", ReadsScore()]}, PolicyError, "'ReadsScore' reads the score"),
        ({"opponents": []}, KernelError, "no policy: expected one or more"),
        ({"seat": 5}, KernelError, "seat 5: expected 0 or 1"),
        ({"server": 5}, KernelError, "server 5"),
        ({"batch": 0}, KernelError, "batch 0"),
        ({"threads": 0}, KernelError, "threads 0"),
    ],
)
def test_options_out_of_range_are_refused(options: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        VersusEnv(**{"batch": 4, **options})


def test_an_opponent_of_another_game_is_tabulated_for_this_one_or_refused() -> None:
    """A table of another game raises where it is asked for this one's states."""
    with pytest.raises(PolicyError, match="tabulated for another game"):
        VersusEnv(4, opponents=random_policy(random_game(1), 0))


def test_opponents_by_name_by_object_and_several() -> None:
    bc = tabulate(resolve("bc", GAME), GAME)
    for opponents in ("bc", bc, [resolve("bc", GAME)], ("bc", bc)):
        env = VersusEnv(4, opponents=opponents)
        assert env.versus.n_opponents == (2 if isinstance(opponents, tuple) else 1)
        assert (env.versus.opponents.players.cumulative == bc.cumulative).all()


def test_other_games_are_played() -> None:
    game = random_game(5, 7)
    env = RallyEnv(8, game=game)
    check_env_specs(env, seed=0)
    versus = VersusEnv(8, game=game, opponents=random_policy(game, 1))
    check_env_specs(versus, seed=0)
    assert env.action_spec.n == versus.action_spec.n == game.n_strokes


def compare(game: Game, observations: list[dict[str, np.ndarray]], seen: list[tuple[np.ndarray, ...]]) -> None:
    """Compare what the strikers of a rally saw in the AEC environment with the tokens and masks of a row."""
    one_hots = stroke_features(game)
    tokens, mask = (np.array(column) for column in list(zip(*seen, strict=True))[:2])
    vector = np.array([observation["observation"] for observation in observations])
    assert np.array_equal(vector[:, :27], one_hots[tokens[:, 0]])
    assert np.array_equal(vector[:, 27:54], one_hots[tokens[:, 1]])
    _, incoming, contact, duel, effort, opponent_effort, hurried = tokens.T
    highest = max(1, game.levels - 1)
    rest = [contact, incoming == game.n_strokes, duel / 3, effort / highest, opponent_effort / highest, hurried]
    np.testing.assert_allclose(vector[:, 54:], np.stack(rest, axis=1), rtol=1e-6)
    assert np.array_equal(np.array([observation["action_mask"] for observation in observations]), mask)


def differ(rallies: int, batch: int, seed: int, game: Game = GAME) -> tuple[int, int]:
    """Play rallies of ``RallyEnv`` in ``rally_v0``, comparing everything; returns rallies and strokes."""
    env = RallyEnv(batch, seed=seed, threads=2, game=game)
    log: dict[int, list[tuple[np.ndarray, ...]]] = {}
    row_rally = np.arange(batch)
    for now, stepped in steps(env, 10**9):
        columns = [x.numpy() for x in (now["observation"], now["action_mask"], now["action"], stepped["next", "reward"])]
        over = stepped["next", "terminated"].squeeze(-1).numpy()
        for row in np.flatnonzero(row_rally < rallies):
            log.setdefault(int(row_rally[row]), []).append(tuple(column[row] for column in columns))
        row_rally = np.where(over, row_rally + batch, row_rally)
        if row_rally.min() >= rallies:
            break
    raw = rally_v0.raw_env(game=game)
    strokes = 0
    for rally in range(rallies):
        raw.reset(seed=seed if rally == 0 else None)
        turns = log.pop(rally)
        observations = []
        for number, (_, _, action, reward) in enumerate(turns):
            striker = raw.agent_selection
            observations.append(raw.observe(striker))
            raw.step(int(action))
            assert raw.rewards[striker] == reward[0]
            assert raw.terminations[striker] == (number == len(turns) - 1)
        compare(game, observations, turns)
        strokes += len(turns)
    return rallies, strokes


def test_rallies_are_those_of_the_environment() -> None:
    assert differ(3000, 1024, seed=1)[1] > 10_000
    assert differ(1000, 256, seed=1, game=tiring_game())[1] > 5_000


@pytest.mark.slow(minutes=True)
def test_twenty_thousand_rallies_are_those_of_the_environment() -> None:
    rallies = strokes = 0
    for seed in (10, 11):
        more = differ(10_000, 2048, seed)
        rallies, strokes = rallies + more[0], strokes + more[1]
    assert rallies == 20_000
    assert strokes > 80_000


def differ_versus(rallies: int, batch: int, seed: int, seat: int, opponent: TabulatedPolicy = BC) -> int:
    """Play rallies of ``VersusEnv`` in ``rally_v0``, comparing all that the learner sees and gets; returns strokes.

    The learner's rows are those moments of ``rally_v0`` in which the learner is to strike.
    """
    game = opponent.game
    env = VersusEnv(batch, opponents=opponent, seat=seat, seed=seed, threads=2, game=game)
    log: dict[int, list[tuple[np.ndarray, ...]]] = {}
    now = env.reset()
    while (row_rally := env.versus.rows.rally.copy()).min() < rallies:
        now, following = env.step_and_maybe_reset(env.rand_action(now))
        columns = [x.numpy() for x in (now["observation"], now["action_mask"], now["action"], now["next", "reward"])]
        for row in np.flatnonzero(row_rally < rallies):
            log.setdefault(int(row_rally[row]), []).append(tuple(column[row] for column in columns))
        now = following
    raw = rally_v0.raw_env(game=game)
    learner = f"player_{seat}"
    choose = functools.partial(np.searchsorted, side="right")
    strokes = 0
    for rally in range(rallies):
        raw.reset(seed=seed if rally == 0 else None)
        logged = log.pop(rally, [])
        turns, last = iter(logged), 0.0
        observations = []
        while not raw.terminations[learner]:
            strokes += 1
            if raw.agent_selection == learner:
                _, _, action, reward = next(turns)
                observations.append(raw.observe(learner))
                assert last == 0
                last = reward[0]
                raw.step(int(action))
            else:
                first, end = game.pair_start[raw.state_number], game.pair_start[raw.state_number + 1]
                raw.step(int(game.pair_stroke[first + choose(opponent.cumulative[first:end], raw.choice_draw())]))
        assert next(turns, None) is None
        if logged:
            compare(game, observations, logged)
        assert last == (raw.rewards[learner] if logged else 0.0)
    assert not log
    return strokes


@pytest.mark.parametrize("seat", [0, 1])
def test_versus_env_plays_the_rallies_of_the_environment(seat: int) -> None:
    assert differ_versus(1500, 64, seed=5, seat=seat) > 5000
    assert differ_versus(500, 64, seed=5, seat=seat, opponent=random_policy(tiring_game(), 1)) > 2500


@pytest.mark.slow
@pytest.mark.parametrize("seat", [0, 1])
def test_ten_thousand_rallies_of_each_seat_are_those_of_the_environment(seat: int) -> None:
    assert sum(differ_versus(5000, 1024, seed, seat) for seed in range(2)) > 30_000
