"""Does the advantage of a policy hold in a game fitted on other matches?

The training matches are halved, and a game is fitted on each half. The fraction of rallies that a policy wins in the game in
which it was computed (home) is compared with the other game (away), both against the average player of the game. All values are
exact.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from scipy import stats

from experiments.truth.matches import Strokes, folds_of
from experiments.truth.worlds import Fitter, World
from shuttle_marl.exact import best_response, evaluate, solve, visits
from shuttle_marl.exact.profile import moved
from shuttle_marl.game.policy import TabulatedPolicy


def transfer(strokes: Strokes, fitter: Fitter, *, halvings: int, seed: int) -> dict[str, dict[str, float]]:
    """Fraction of rallies won at home and away, and the fraction ``kept`` of the advantage over one half.

    Args:
        strokes: of the matches to halve.
        fitter: fits the games.
        halvings: how often; each gives two directions.
        seed: of the halvings.

    Returns:
        For ``best_response`` and ``minimax``: ``home``, ``away``, ``kept``, and its 95 % interval ``low`` to ``high``
        (Student's t over the directions) with their number ``directions``.
    """
    pairs = []
    for number in range(halvings):
        half = folds_of(strokes, 2, seed + number)
        one, other = (fitter.fit(strokes.take(half == side).matches, layout=strokes.matches) for side in (0, 1))
        pairs += [(one, other), (other, one)]
    return transferred(pairs)


def transferred(pairs: Iterable[tuple[World, World]]) -> dict[str, dict[str, float]]:
    """Figures of :func:`transfer` for pairs of home and away worlds with the same layout."""
    found: dict[str, list[tuple[float, float]]] = {"best_response": [], "minimax": []}
    for home, away in pairs:
        policies = {"best_response": best_response(home.bc).policy, "minimax": solve(home.game).policy[0]}
        for name, policy in policies.items():
            found[name].append((wins(policy, home), wins(policy, away)))
    return {name: _summary(np.array(pairs)) for name, pairs in found.items()}


def wins(policy: TabulatedPolicy, world: World) -> float:
    """Share of the rallies that a policy wins against the average player of a world with the same layout."""
    return float(evaluate(moved(policy, world.game), world.bc).odds().rally)


def _summary(pairs: Any) -> dict[str, float]:
    home, away = pairs.T
    kept = (away - 0.5) / (home - 0.5)
    width = stats.t.ppf(0.975, len(kept) - 1) * stats.sem(kept)
    return {
        "home": float(home.mean()),
        "away": float(away.mean()),
        "kept": float(kept.mean()),
        "low": float(kept.mean() - width),
        "high": float(kept.mean() + width),
        "directions": len(kept),
    }


def thin_support(world: World, least: float = 5.0) -> dict[str, float]:
    """Share of the strokes of each policy with fewer than ``least`` real ones in the innermost cell of data."""
    response, perfect = best_response(world.bc).policy, solve(world.game).policy[0]
    thin = world.behind[world.game.base_pair_edge] < least
    profiles = {"bc": (world.bc, world.bc), "best_response": (response, world.bc), "minimax": (perfect, perfect)}
    out = {}
    for name, (policy, opponent) in profiles.items():
        played = visits(policy, opponent).base_pairs(0).sum(axis=0)
        out[name] = float(played[thin].sum() / played.sum())
    return out
