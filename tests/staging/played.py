"""Rallies to stage."""

from shuttle_marl.game import default_game
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.rally import Rally
from shuttle_marl.kernel import play_rallies
from shuttle_marl.policy.registry import resolve


def self_play_rallies(policy: str, n: int, *, seed: int) -> list[Rally]:
    """The first ``n`` episodes of ``rally_v0`` on the default game, both seats playing the same policy.

    Args:
        policy: name in the registry; the policy does not read the score.
        n: number of rallies, at least 1.
        seed: random seed.
    """
    game = default_game()
    table = tabulate(resolve(policy, game), game)
    rallies = play_rallies(game, (table, table), n, seed=seed)
    return [rallies.row(k, game.catalogue) for k in range(n)]
