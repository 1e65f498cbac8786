"""``minimax`` and ``best-response:POLICY`` as policies by name; entry points of the package lead here.

The solvers are imported when a policy is asked for, so that listing names stays quick.
"""

import functools
from typing import Final

from shuttle_marl.policy import bc
from shuttle_marl.policy.base import Policy, PolicyError
from shuttle_marl.policy.registry import Family, resolve
from shuttle_marl.policy.table import TabulatedPolicy, tabulate
from shuttle_marl.rally import Game


@functools.lru_cache(maxsize=4)
def minimax_policy(game: Game) -> TabulatedPolicy:
    """The minimax policy of a game, solved once."""
    from shuttle_marl.exact.minimax import solve  # noqa: PLC0415  numba

    return solve(game).policy[0]


def _load_minimax(argument: str | None, game: Game) -> Policy:
    if argument is not None:
        raise PolicyError(f"policy minimax:{argument}: 'minimax' takes nothing behind a colon; write minimax")
    return minimax_policy(game)


def _load_best_response(name: str | None, game: Game) -> Policy:
    from shuttle_marl.exact.response import best_response  # noqa: PLC0415  numba

    if not name:
        raise PolicyError("policy best-response: expected the name of a policy behind the colon, as in best-response:bc")
    return best_response(tabulate(resolve(name, game), game, name)).policy


MINIMAX: Final = Family(load=_load_minimax, names=lambda: ("minimax",))
"""Perfect play."""
BEST_RESPONSE: Final = Family(
    load=_load_best_response,
    names=lambda: ("best-response:bc",) if bc.installed() else (),
    of_policies=True,
)
"""What wins most against one policy."""
