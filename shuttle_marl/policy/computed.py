"""Tables of policies: computed ones (perfect, robust and human-like play, best responses), those made of others, and stored ones.

Tables of solved policies and of trained agents are cached by everything that they depend on. Numba is imported when a policy is
solved.
"""

import contextlib
import functools
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import zstandard

from shuttle_marl.base.arrays import Floats
from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.base.files import content_hash, problem, read_file, replace_file
from shuttle_marl.game.policy import Policy, PolicyError, TabulatedPolicy, TemperedPolicy, from_pair_probabilities, tabulate
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.shipped import is_refit, origin_of, refits_of, variants
from shuttle_marl.game.tables import Game
from shuttle_marl.policy import baselines

TYPICAL_TAU: Final = 0.05
"""Cost of the listed KL-regularised equilibrium, which wins about as often as perfect play in refits of the game."""
_CACHE: Final = Cache("tables", 256)  # some hundred MB


def cached_table(game: Game, key: str, compute: Callable[[], TabulatedPolicy], *, rooms: tuple[str, ...] = ()) -> TabulatedPolicy:
    """A table from the cache, or computed and stored there.

    Args:
        key: everything that the result depends on besides the game and the source code of game, solvers and policies.
        rooms: that compute it too, see :func:`shuttle_marl.base.cache.key_of`.
    """
    name = key_of(game.hash, key, rooms=rooms)
    for content in _CACHE.read([name]).values():
        with contextlib.suppress(ValueError, zstandard.ZstdError, PolicyError):  # written by another version
            return TabulatedPolicy.unpacked(content, game, key)
    table = compute()
    _CACHE.store({name: table.packed()})
    return table


@functools.lru_cache(maxsize=8)
def minimax_policy(game: Game, kind: str | None = None) -> TabulatedPolicy:
    """``minimax``, of a game or of a player in the game of a pair; ``minimax:robust`` has the best worst case over its refits.

    Raises:
        PolicyError: ``kind`` is neither None nor ``robust``, or the game has no refits for robust play.
    """
    from shuttle_marl.exact.optimal import solve, solve_robust  # noqa: PLC0415  numba

    if kind is None:
        return cached_table(game, f"minimax {game.opposite.hash}", lambda: solve(game).policy[0])
    if kind != "robust":
        raise PolicyError(f"policy minimax:{kind}: expected minimax or minimax:robust")
    if not (others := refits_of(game)):
        raise PolicyError("policy minimax:robust needs refits of the game on resampled matches; this game has none")
    key = " ".join(["robust", *(other.hash for other in others)])
    return cached_table(game, key, lambda: solve_robust([game, *others]).policy[0])


def best_response_policy(policy: TabulatedPolicy) -> TabulatedPolicy:
    """The best response to a policy."""
    from shuttle_marl.exact.optimal import best_response  # noqa: PLC0415  numba

    key = f"best-response {policy.game.hash} {policy.hash}"
    return cached_table(policy.game.opposite, key, lambda: best_response(policy).policy)


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
        game, f"human {tau!r} {game.opposite.hash} {priors}", lambda: tabulated_pairs(solve_soft(own, average, tau=tau).policy[0])
    )


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


def mixture(policies: Sequence[TabulatedPolicy], probabilities: Sequence[float] | Floats) -> TabulatedPolicy:
    """The mean of policies of a game in every state, in strokes and positions.

    It draws one of them for every choice and not once a rally, so it is a policy of the game, and exact figures are its own.

    Args:
        probabilities: ``[K]`` probabilities of the policies.
    """
    mixed = [(policy, float(p)) for policy, p in zip(policies, probabilities, strict=True) if p > 0]
    if len(mixed) == 1:
        return mixed[0][0]
    game = mixed[0][0].game
    blocks = (sum(p * policy.block_probabilities(block) for policy, p in mixed) for block in range(game.n_blocks))
    mean = from_pair_probabilities(game, np.concatenate(list(blocks)))
    if all(policy.waits is None for policy, _ in mixed):
        return mean
    return mean.waiting_at(np.sum([p * policy.position_probabilities() for policy, p in mixed], axis=0))


def sharpened(policy: TabulatedPolicy, temperature: float) -> TabulatedPolicy:
    """The policy with stroke probabilities p^(1 / temperature), normalised.

    The entropy bonus lets a learner play strokes that are nearly optimal; a temperature below 1 makes them rare.
    """
    return tabulate(TemperedPolicy(policy, temperature), policy.game)


def deterministic(policy: TabulatedPolicy) -> TabulatedPolicy:
    """The policy that always makes the likeliest choice of another one, of strokes and of positions."""
    pure = sharpened(policy, 0.0)
    return pure.waiting_at(np.eye(N_POSITIONS)[policy.position_probabilities().argmax(axis=1)])


def policy_file(folder: Path, digest: str) -> Path:
    """File of the policy of a hash."""
    return folder / f"{digest}.zst"


class StoredPolicies:
    """Tables of policies in a folder."""

    def __init__(self, folder: Path, game: Game) -> None:
        self.folder, self.game = folder, game

    def save(self, policy: TabulatedPolicy) -> str:
        """Save a policy unless it exists, and return its hash."""
        path = policy_file(self.folder, policy.hash)
        if not path.exists():
            replace_file(path, policy.packed())
        return policy.hash

    def read(self, digest: str) -> TabulatedPolicy:
        """Read the policy of a hash.

        Raises:
            PolicyError: it is missing, damaged, of another game, or does not have this hash.
        """
        path = policy_file(self.folder, digest)
        try:
            size = 4 * (self.game.n_pairs + N_POSITIONS * self.game.n_states)
            policy = TabulatedPolicy.unpacked(read_file(path, size), self.game, str(path))
        except (OSError, ValueError, zstandard.ZstdError) as error:
            raise PolicyError(f"{path}: the policy cannot be read ({problem(error)}); run again what wrote it") from error
        if policy.hash != digest:
            raise PolicyError(f"{path}: the table was changed: its hash is {policy.hash[:12]}; run again what wrote it")
        return policy

    def prune(self, retained: Collection[str]) -> None:
        """Delete all policies except those of the given hashes."""
        for path in self.folder.glob("*.zst"):
            if path.stem not in retained:
                path.unlink(missing_ok=True)
