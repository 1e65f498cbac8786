"""From a trained network to the chances of every legal stroke, and from those back to a network."""

import numpy as np
import numpy.typing as npt
import torch
from torch import nn
from torch.nn import functional
from torchrl.modules import ProbabilisticActor

from shuttle_marl.game.rally import Game
from shuttle_marl.game.table import TabulatedPolicy, from_pair_probabilities
from shuttle_marl.training.networks import IMPOSSIBLE


def observations(game: Game) -> torch.Tensor:
    """``[S, 3]`` int32 observation of every state: own last stroke, incoming stroke, contact."""
    state = np.arange(game.n_states)
    columns = (game.edge_own[state >> 1], game.edge_incoming[state >> 1], state & 1)
    return torch.from_numpy(np.stack(columns, axis=1).astype(np.int32))


def logit_network(actor: ProbabilisticActor) -> nn.Module:
    """The part of an actor that turns observations into logits."""
    network: nn.Module = actor.module[0].module
    return network


@torch.no_grad()
def tabulated(actor: ProbabilisticActor, game: Game) -> TabulatedPolicy:
    """An actor on every state."""
    network = logit_network(actor)
    device = next(network.parameters()).device
    seen = observations(game)
    legal = torch.from_numpy(game.mask(np.arange(game.n_states)))
    chunks = [
        functional.softmax(torch.where(mask, network(part.to(device)).cpu().double(), IMPOSSIBLE), dim=-1)
        for part, mask in zip(torch.split(seen, 4096), torch.split(legal, 4096), strict=True)
    ]
    p = torch.cat(chunks).numpy()
    return from_pair_probabilities(game, p[game.pair_state, game.pair_stroke])


def imitate(actor: ProbabilisticActor, policy: TabulatedPolicy, weight: npt.NDArray[np.float64], *, steps: int = 600) -> float:
    """Teach an actor to play like a policy; its draws come from torch's generator.

    Args:
        actor: changed in place.
        policy: to be imitated.
        weight: ``[S]`` how often each state is visited.
        steps: gradient steps.

    Returns:
        Cross-entropy beyond the policy's own entropy, in nats a stroke, at the end.
    """
    game = policy.game
    network = logit_network(actor)
    device = next(network.parameters()).device
    seen = observations(game)
    wanted = torch.zeros(game.n_states, game.n_strokes)
    wanted[torch.from_numpy(game.pair_state.astype(np.int64)), torch.from_numpy(game.pair_stroke.astype(np.int64))] = (
        torch.from_numpy(policy.pair_probabilities()).float()
    )
    # Half of the states as they are visited, half from anywhere: rare states matter when play changes.
    playable = torch.from_numpy(np.diff(game.pair_start) > 0).double()
    chance = torch.from_numpy(weight) / weight.sum() + playable / playable.sum()
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    gap = torch.tensor(float("nan"))
    for step in range(steps):
        optimizer.param_groups[0]["lr"] = 3e-3 * (1 - step / steps)
        drawn = torch.multinomial(chance, 1024, replacement=True)
        target = wanted[drawn].to(device)
        mask = torch.from_numpy(game.mask(drawn.numpy())).to(device)
        logits = functional.log_softmax(torch.where(mask, network(seen[drawn].to(device)), IMPOSSIBLE), dim=-1)
        gap = (torch.special.xlogy(target, target) - target * logits).sum(-1).mean()
        optimizer.zero_grad()
        gap.backward()
        optimizer.step()
    return float(gap.detach())
