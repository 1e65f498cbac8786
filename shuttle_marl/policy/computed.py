"""Policies that take seconds to compute, and the cache of their tables: perfect, robust and human-like play, best responses.

Tables of solved policies and of trained agents are cached by everything that they depend on. Numba is imported when a policy is
solved.
"""

import contextlib
import functools
from collections.abc import Callable
from typing import Final

import zstandard

from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.files import content_hash
from shuttle_marl.exact.version import sources_hash
from shuttle_marl.game.policy import Policy, PolicyError, TabulatedPolicy
from shuttle_marl.game.shipped import is_refit, origin_of, refits_of, variants
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines

TYPICAL_TAU: Final = 0.05
"""Cost of the listed KL-regularised equilibrium, which wins about as often as perfect play in refits of the game."""
_CACHE: Final = Cache("tables", 256)
"""Some hundred MB."""


def cached_table(game: Game, key: str, compute: Callable[[], TabulatedPolicy]) -> TabulatedPolicy:
    """A table from the cache, or computed and stored there.

    Args:
        key: everything that the result depends on besides the game and the source code of game, solvers and policies.
    """
    name = key_of(game.hash, key, sources_hash())
    for content in _CACHE.read([name]).values():
        with contextlib.suppress(ValueError, zstandard.ZstdError, PolicyError):  # written by another version
            return TabulatedPolicy.unpacked(content, game, key)
    table = compute()
    _CACHE.store({name: table.packed()})
    return table


@functools.lru_cache(maxsize=4)
def minimax_policy(game: Game) -> TabulatedPolicy:
    """The minimax policy of a game, or of a player in the game of a pair."""
    from shuttle_marl.exact.optimal import solve  # noqa: PLC0415  numba

    return cached_table(game, f"minimax {game.opposite.hash}", lambda: solve(game).policy[0])


def best_response_policy(policy: TabulatedPolicy) -> TabulatedPolicy:
    """The best response to a policy."""
    from shuttle_marl.exact.optimal import best_response  # noqa: PLC0415  numba

    key = f"best-response {policy.game.hash} {policy.hash}"
    return cached_table(policy.game.opposite, key, lambda: best_response(policy).policy)


@functools.lru_cache(maxsize=4)
def robust_policy(game: Game) -> TabulatedPolicy:
    """The policy with the best worst case over a game and its refits.

    Raises:
        PolicyError: the game has no refits.
    """
    from shuttle_marl.exact.optimal import solve_robust  # noqa: PLC0415  numba

    others = refits_of(game)
    if not others:
        raise PolicyError("policy minimax:robust needs refits of the game on resampled matches; this game has none")
    key = " ".join(["robust", *(other.hash for other in others)])
    return cached_table(game, key, lambda: solve_robust([game, *others]).policy)


@functools.lru_cache(maxsize=4)
def human_policy(tau: float, player: str | None, game: Game) -> TabulatedPolicy:
    """The KL-regularised equilibrium (:func:`shuttle_marl.exact.solve_soft`).

    Args:
        tau: cost of a nat of divergence from human play.
        player: whose clone is the prior, with the average player as the prior of the opponent; None: the average for both.

    Raises:
        PolicyError: the player does not exist, or the game was not loaded from a model.
    """
    from shuttle_marl.exact.optimal import solve_soft  # noqa: PLC0415
    from shuttle_marl.exact.profile import PairPolicy, tabulated_pairs  # noqa: PLC0415  numba

    average = PairPolicy(game=game.opposite, probability=baselines.probabilities(None, game.opposite))
    same = player is None and game.opposite is game
    own = average if same else PairPolicy(game=game, probability=baselines.probabilities(player, game))
    priors = content_hash(own.probability.tobytes() + average.probability.tobytes())
    return cached_table(
        game,
        f"human {tau!r} {game.opposite.hash} {priors}",
        lambda: tabulated_pairs(solve_soft(own, average, tau=tau).policy[0]),
    )


def load_minimax(kind: str | None, game: Game) -> Policy:
    """``minimax`` (None) or ``minimax:robust``.

    Raises:
        PolicyError: ``kind`` is unknown, or the game has no refits for robust play.
    """
    if kind not in (None, "robust"):
        raise PolicyError(f"policy minimax:{kind}: expected minimax or minimax:robust")
    return minimax_policy(game) if kind is None else robust_policy(game)


def minimax_names(game: Game) -> tuple[str, ...]:
    """Listed names; ``minimax:robust`` if the game has refits."""
    origin = origin_of(game)
    refitted = origin is not None and origin.variant is None and any(map(is_refit, variants(str(origin.folder))))
    return ("minimax", "minimax:robust") if refitted else ("minimax",)


def load_human(argument: str | None, game: Game) -> Policy:
    """``human:TAU`` or ``human:TAU:PLAYER``, from the part after the first colon.

    Raises:
        PolicyError: TAU is not a number above 0, or as :func:`human_policy`.
    """
    tau, _, player = (argument or "").partition(":")
    try:
        cost = float(tau)
    except ValueError:
        cost = 0.0
    if not 0 < cost < float("inf"):
        raise PolicyError(
            f"policy human:{argument or ''}: expected human:TAU or human:TAU:PLAYER with a number TAU above 0, such as human:0.05"
        )
    return human_policy(cost, player or None, game)
