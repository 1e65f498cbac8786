"""Learning in the game with recovery: decisions, advantages, and networks that wait."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torchrl.envs.utils import check_env_specs

from shuttle_marl.env.batched import RallyEnv, VersusEnv
from shuttle_marl.game import default_game
from shuttle_marl.game.policy import States, TabulatedPolicy
from shuttle_marl.kernel import RallySampler
from shuttle_marl.policy.network import PolicyNetwork
from shuttle_marl.training.config import SHARP, A2CConfig, PPOConfig
from shuttle_marl.training.learner import Callback, Learner
from shuttle_marl.training.networks import LegalStrokes, Observer, decision_masks, logit_network, make_actor, weights_of
from shuttle_marl.training.ppo import PPO
from shuttle_marl.training.run import tempered
from tests.kernel.recovery import GAME, TABLES

SIZE = 2 * GAME.n_states


def assess(decisions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rows = np.random.default_rng(0)
    logits = rows.normal(size=(509, GAME.n_actions)).astype(np.float32)
    return logits[decisions % 509], np.cos(decisions).astype(np.float32)


@pytest.mark.parametrize("opponents", [(), (TABLES[1],)], ids=["self-play", "versus"])
def test_decisions_are_credited_as_the_recursion_says(opponents: tuple[TabulatedPolicy, ...]) -> None:
    sampler, lam = RallySampler(GAME, opponents, gae_lambda=0.7), 0.7
    sampler.reset(3)
    sampler.collect(2000, assess, keep=True)
    strokes, observer = sampler.strokes, Observer(GAME, "cpu")
    state, following, reward = strokes.state, strokes.following, strokes.reward
    actions = observer.strokes(torch.from_numpy(strokes.pair)).numpy()
    assert decision_masks(GAME, state)[np.arange(len(state)), actions].all()
    assert 0 < (state >= GAME.n_states).sum() < len(state)
    value = np.cos(np.arange(SIZE)).astype(np.float32)
    if opponents:  # each decision follows the last one
        expected, after = np.zeros(len(state)), 0.0
        for i in reversed(range(len(state))):
            over = following[i] < 0
            delta = reward[i] + (0 if over else value[following[i]]) - value[state[i]]
            expected[i] = after = delta + (0 if over else lam * after)
        assert np.allclose(strokes.advantage, expected, atol=1e-5)
    else:  # a position returns to the receiver what the stroke against it costs the striker
        own, other = strokes.advantage[::2] + value[state[::2]], strokes.advantage[1::2] + value[state[1::2]]
        assert np.array_equal(state[1::2], state[::2] + GAME.n_states)
        assert np.allclose(own, -other, atol=1e-5)
        assert np.array_equal(reward[::2], -reward[1::2])
    taken = sampler.take()
    assert taken.strokes == len(state)
    assert np.isclose(taken.advantage.sum(), strokes.advantage.sum(), rtol=1e-3, atol=0.05)


def test_agents_of_self_play_stay_mixed_where_perfect_play_mixes() -> None:
    against, itself = PPOConfig(), PPOConfig(opponent=("self",))
    assert tempered(against, GAME).temperature == tempered(itself, default_game()).temperature == SHARP
    assert tempered(itself, GAME).temperature == itself.final_temperature > SHARP
    assert tempered(PPOConfig(opponent=("self",), eval_temperature=1.0), GAME).temperature == 1
    assert tempered(A2CConfig(opponent=("self",)), GAME).temperature == 1


def test_a_network_waits_as_its_table() -> None:
    torch.manual_seed(0)
    actor = make_actor(GAME, width=16, hidden=1)
    with torch.no_grad():
        for weight in logit_network(actor).parameters():
            weight.add_(0.3 * torch.randn_like(weight))
    table = PolicyNetwork.of_tensors(weights_of(actor), GAME).table(GAME)
    states = np.flatnonzero(GAME.playable)[::97].astype(np.int32)
    observer = Observer(GAME, "cpu")
    inputs = observer.inputs(torch.from_numpy(np.r_[states, states + GAME.n_states]))
    p = LegalStrokes(logit_network(actor)(inputs["observation"]), mask=inputs["action_mask"]).probs.detach().numpy()
    seen = States(game=GAME, state=states)
    assert np.allclose(table.probabilities(seen), p[: len(states), : GAME.n_strokes], atol=1e-4)
    assert np.allclose(table.positions(seen), p[len(states) :, GAME.n_strokes :], atol=1e-4)


@pytest.mark.parametrize("variant", ["plain", "magnet", "emagnet"])
def test_ppo_takes_steps_on_strokes_and_positions(variant: str, tmp_path: Path) -> None:
    config = PPOConfig(opponent=("self",), variant=variant, batch=2000, strokes=6000, width=16, out=tmp_path)  # type: ignore[arg-type]
    logged: list[dict[str, float]] = []

    class Log(Callback):
        def learned(self, learner: Learner, losses: dict[str, float]) -> None:
            logged.append(losses)

    learner = PPO(config, GAME)
    for remaining in (1.0, 0.5):
        learner.iterate(remaining, Log())
    for losses in logged:
        assert np.isfinite(list(losses.values())).all()
        assert (losses["loss_entropy"] == 0) == (variant == "emagnet")
    assert len(logged) == learner.iteration == 2


def test_torchrl_environments() -> None:
    for env in (VersusEnv(8, game=GAME, opponents=TABLES[1]), RallyEnv(8, game=GAME)):
        check_env_specs(env)
        assert env.rollout(30, break_when_any_done=False)["next", "terminated"].any()
