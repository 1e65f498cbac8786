"""Distinct states: the network runs once for each state, and the loss once for each stroke in it, however often they are played.

Few states make up most of the play: late in self-play 181,043 strokes of an iteration are in 770 states. So rallies are played
from a table of the network's outputs in each state (:mod:`shuttle_marl.kernel.sampling`), and the learner gets

- U distinct states s with the number N(s) of strokes in each, and
- R rows of a stroke a in one of them, with the sum of its advantages: a row for the positive ones, a row for the negative ones.

The gradient is that over all strokes. The objective of PPO, min(rho A, clip(rho) A), is linear in A for either sign of A, and all
strokes a in s have the same rho: the sum over them is the objective of the sums. Entropy and value depend on the state alone, and
the gradient of (V(s) - V_target)^2 on the mean of the targets. ``docs/training.md`` has an example.

:func:`normalised` turns sums over rows and weighted sums over states into means over the N strokes, :func:`minibatches` splits by
state, and :func:`weighted_sums` reduces a loss of TorchRL.
"""

from collections.abc import Iterator
from itertools import pairwise

import torch
from tensordict import TensorDict, TensorDictBase


def normalised(data: TensorDictBase) -> TensorDictBase:
    """Distinct states with weights, and with advantages that are divided by their standard deviation.

    Args:
        data: distinct states of N strokes, from :meth:`RallyCollector.collect`.

    Returns:
        The same with ``weight`` w(s) = N(s) / N, and ``advantage`` divided by N and by the standard deviation, so that weighted
        sums over states and sums over rows are means over the N strokes.
    """
    strokes, deviation = int(data["strokes"]), float(data["deviation"])
    scale = 1 / (strokes * max(deviation, 1e-6))
    return data.copy().update({"weight": data["visits"].float() / strokes, "advantage": data["advantage"] * scale})


def minibatches(data: TensorDictBase, count: int) -> Iterator[TensorDictBase]:
    """Minibatches of about as many states each, in the order of the states, which is random.

    Args:
        data: output of :func:`normalised`.
        count: number of minibatches; fewer if there are fewer states.

    Yields:
        Each with weights and advantages multiplied by the number of minibatches, so that means over minibatches are unbiased.
    """
    states = len(data["weight"])
    count = max(1, min(count, states))
    cuts = [states * part // count for part in range(count + 1)]
    starts = data["start"].tolist() if count > 1 else [0] * states + [len(data["row"])]
    for a, b in pairwise(cuts):
        rows = slice(starts[a], starts[b])
        entries = {name: data[name][a:b] for name in ("observation", "action_mask", "value_target")}
        entries |= {name: data[name][rows] for name in ("action", "action_log_prob")}
        entries |= {
            "row": data["row"][rows] - a,
            "weight": data["weight"][a:b] * count,
            "advantage": data["advantage"][rows] * count,
        }
        yield TensorDict(entries, batch_size=[])


def weighted_sums(terms: TensorDictBase, weight: torch.Tensor) -> TensorDictBase:
    """Reduce the terms of a loss over distinct states to their means over all strokes.

    Args:
        terms: output of a TorchRL loss with ``reduction="none"``: the objective of each row, other terms of each state.
        weight: ``[U]`` weight w(s) of each state.
    """
    summed = {name: (terms[name].reshape(-1) * weight).sum() for name in ("loss_critic", "loss_entropy")}
    return terms.copy().update({**summed, "loss_objective": terms["loss_objective"].sum()})
