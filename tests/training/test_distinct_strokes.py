"""Learning from distinct states: the gradient of a loss over them is that over all strokes, and games may be large."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.objectives import A2CLoss, ClipPPOLoss, DiscreteSACLoss, ValueEstimators

from shuttle_marl.game import default_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.training import A2CConfig, PPOConfig, SACConfig, TrainingConfig
from shuttle_marl.training.learner import RallyCollector, minibatches, normalised, weighted_sums
from shuttle_marl.training.networks import Observer, logit_network, make_actor, make_critic, make_q_network
from shuttle_marl.training.sac import SAC

GAME = default_game()
BC = tabulate(resolve("bc", GAME), GAME)
TERMS = ("loss_objective", "loss_critic", "loss_entropy")
LOSSES: dict[str, tuple[type[TrainingConfig], Callable[..., Any]]] = {
    "ppo": (PPOConfig, lambda *nets, **options: ClipPPOLoss(*nets, clip_epsilon=0.2, normalize_advantage=False, **options)),
    "a2c": (A2CConfig, A2CLoss),
}


def gradients(loss: Any, total: torch.Tensor) -> torch.Tensor:
    loss.zero_grad()
    total.backward()
    # What a game without efforts leaves out has no gradient.
    return torch.cat([weight.grad.flatten() for weight in loss.parameters() if weight.grad is not None])


def one_by_one(collector: RallyCollector, data: TensorDictBase) -> TensorDictBase:
    """The strokes that were played, in the form of TorchRL's own collectors."""
    sampler = collector.sampler
    strokes, learned = sampler.strokes, sampler._learned
    scale = 1 / float(data["deviation"])
    state = torch.from_numpy(strokes.state).long()
    entries = {
        "observation": torch.from_numpy(GAME.observation(strokes.state)),
        "action_mask": torch.from_numpy(GAME.mask(strokes.state)),
        "action": torch.from_numpy(GAME.base_pair_stroke[strokes.pair % GAME.n_base_pairs].astype(np.int64)),
        "action_log_prob": torch.from_numpy(learned.log_probability[strokes.pair]),
        "advantage": torch.from_numpy(strokes.advantage * scale)[:, None],
        "value_target": torch.from_numpy(strokes.advantage + learned.value[strokes.state])[:, None],
    }
    return TensorDict(entries, [len(state)])


@pytest.mark.parametrize("opponents", [(), (BC,)], ids=["self-play", "fixed"])
@pytest.mark.parametrize("algorithm", LOSSES)
def test_the_gradient_over_distinct_states_is_that_over_all_strokes(
    algorithm: str, opponents: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    torch.manual_seed(0)
    make_config, make_loss = LOSSES[algorithm]
    config = make_config(opponent=("bc",) if opponents else ("self",), batch=4096, width=16)
    actor, critic = make_actor(GAME, width=16, hidden=1, distinct=True), make_critic(GAME, width=16, hidden=1)
    network = logit_network(actor)
    collector = RallyCollector(
        config, GAME, opponents, lambda seen: (network(seen), critic.module(seen).squeeze(-1)), distinct=True
    )
    collect = collector.sampler.collect
    monkeypatch.setattr(collector.sampler, "collect", lambda *args, keep: collect(*args, keep=True))
    data = normalised(collector.collect())
    raw = one_by_one(collector, data)
    assert len(raw) == data["strokes"] > 4 * len(data["weight"]) / 3
    # Weights that moved on, so that some ratios are clipped.
    with torch.no_grad():
        for weight in (*actor.parameters(), *critic.parameters()):
            weight.add_(torch.randn_like(weight), alpha=0.1)
    options = {"entropy_coeff": 0.02, "critic_coeff": 0.7, "loss_critic_type": "l2"}
    distinct = make_loss(actor, critic, reduction="none", **options)
    found = weighted_sums(distinct(data), data["weight"])
    ours = gradients(distinct, sum(found[name] for name in TERMS))
    usual = make_actor(GAME, width=16, hidden=1)
    usual.load_state_dict(actor.state_dict())
    plain = make_loss(usual, critic, **options)
    terms = plain(raw)
    if algorithm == "ppo":
        assert terms["clip_fraction"] > 0.1
    theirs = gradients(plain, sum(terms[name] for name in TERMS))
    assert theirs.abs().max() > 1e-3
    assert (ours - theirs).abs().max() < 5e-6
    for name in TERMS[::2]:
        assert found[name].item() == pytest.approx(terms[name].item(), abs=1e-6)
    # The parts weigh as much as the whole on average.
    parts = [weighted_sums(distinct(part), part["weight"]) for part in minibatches(data, 3)]
    for name in TERMS:
        assert np.mean([part[name].item() for part in parts]) == pytest.approx(found[name].item(), abs=1e-5)


@pytest.mark.parametrize("opponent", [("bc",), ("self",)], ids=["fixed", "self-play"])
def test_the_gradient_of_sac_is_that_over_all_strokes(opponent: tuple[str, ...]) -> None:
    torch.manual_seed(0)
    config = SACConfig(opponent=opponent, batch=2048, width=8)
    learner = SAC(config, GAME, [] if config.self_play else [BC])
    drawn, observer = learner.collect(), Observer(GAME, "cpu")
    ours = learner.loss
    found = learner.terms(drawn)
    names = ("loss_qvalue", "loss_actor", "loss_alpha")
    gradient = gradients(ours, sum(found[name] for name in names))
    plain = DiscreteSACLoss(
        make_actor(GAME, width=8, hidden=config.hidden, log_prob=False),
        make_q_network(GAME, width=8, hidden=config.hidden),
        action_space="categorical",
        num_actions=GAME.n_strokes,
        num_qvalue_nets=config.critics,
        alpha_init=config.alpha,
        target_entropy=float(ours.target_entropy),
        loss_function="l2",
    )
    plain.make_value_estimator(ValueEstimators.TD0, gamma=config.discount)
    plain.load_state_dict(ours.state_dict())
    over = (drawn["following"] < 0)[:, None]
    ahead = {
        **observer.inputs(drawn["following"].clamp_min(0)),
        "reward": drawn["reward"][:, None],
        "done": over,
        "terminated": over,
    }
    raw = {**observer.inputs(drawn["state"]), "action": observer.strokes(drawn["pair"]), "next": TensorDict(ahead, [len(drawn)])}
    terms = plain(TensorDict(raw, [len(drawn)]))
    theirs = gradients(plain, sum(terms[name] for name in names))
    assert theirs.abs().max() > 1e-3
    assert (gradient - theirs).abs().max() < 1e-6
    # The values differ by how much the targets of one pair vary.
    for name in ("loss_actor", "loss_alpha", "entropy"):
        assert found[name].item() == pytest.approx(terms[name].item(), rel=1e-5, abs=1e-6)
