"""Expected visits of a profile to states and strokes, the length of its rallies, and their endings; and derivatives of the
probability of winning a rally by the log-odds of faults, returns and contacts.

With f the probability of a fault, r that of a good stroke to be returned, a that of a return to be met above the net, and B and A
the values of the next states to the receiver with contact below and above, on average over whether the receiver is hurried, the
value of a stroke to its striker is

    Q = -f + (1 - f) ((1 - r) - r C),        C = (1 - a) B + a A,

and a probability p changes by p (1 - p) with its log-odds. A change of the outcomes of strokes changes the value of a rally by
the change of Q in every state, weighted by the expected visits (the derivative of a fixed point; policies do not change).
"""

import dataclasses
import functools
from typing import Final, Literal, NamedTuple

import numpy as np

from shuttle_marl.base.arrays import F64, I8, I32, U8, U16
from shuttle_marl.base.compiling import compiled
from shuttle_marl.exact.fixed_point import ROUNDING, TOLERANCE, solve_linear
from shuttle_marl.exact.profile import InducedChain, StatePolicy, block_chances, check_opponents, evaluate_chains, facing, induced
from shuttle_marl.exact.solver import ProfileValue, successors
from shuttle_marl.exact.sweeps import propagate
from shuttle_marl.game.draws import ONE
from shuttle_marl.game.stroke import N_SHOTS
from shuttle_marl.game.tables import ROOT

ENDINGS: Final = ("winner of player 0", "fault of player 1", "winner of player 1", "fault of player 0")
"""Endings of a rally; player 0 wins the first two."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Visits:
    """Expected numbers of visits in a rally of player 0 against player 1.

    Attributes:
        policies: of player 0 and player 1.
        states: ``[S]`` each: expected number of strokes of player 0 and of player 1 in a state.
        error_bound: bound of the summed absolute errors over all states.
    """

    policies: tuple[StatePolicy, StatePolicy]
    states: tuple[F64, F64]
    error_bound: float

    def pairs(self, player: int) -> F64:
        """``[P]`` expected number of times that a player plays each legal pair."""
        policy = self.policies[player]
        return np.asarray(policy.pair_probabilities() * policy.game.of_pairs(self.states[player]))

    def base_pairs(self, player: int) -> F64:
        """``[L, base pairs]`` expected number of times that a player plays each base pair, by row of the limits of the game."""
        policy = self.policies[player]
        game = policy.game
        total = np.zeros(game.limits.shape[:2])
        for block in range(game.n_blocks):
            if self.states[player][game.block_states(block)].any():
                total[game.table_of(block)] += self.block_pairs(player, block)
        return total

    def block_pairs(self, player: int, block: int) -> F64:
        """``[base pairs]`` expected number of times that a player plays each legal pair of one block."""
        policy = self.policies[player]
        visited = self.states[player][policy.game.block_states(block)]
        return np.asarray(policy.block_probabilities(block) * visited[policy.game.base_pair_state])

    @property
    def rally_length(self) -> float:
        """Expected number of strokes of a rally."""
        return float(self.states[0].sum() + self.states[1].sum())

    def endings(self) -> dict[str, float]:
        """Fraction of rallies with each of :data:`ENDINGS`."""
        shares = dict.fromkeys(ENDINGS, 0.0)
        for player, policy in enumerate(self.policies):
            played = self.base_pairs(player)
            fault, winner = np.moveaxis(policy.game.limits[..., :2].astype(np.float64), -1, 0) / ONE
            # A sum of numpy, because the last bits of BLAS depend on the number of threads.
            shares[f"winner of player {player}"] = float((played * (winner - fault)).sum())
            shares[f"fault of player {player}"] = float((played * fault).sum())
        return shares

    def shot_mix(self, player: int) -> F64:
        """``[13]`` fraction of each shot type in a player's strokes, in the order of :data:`shuttle_marl.game.stroke.SHOTS`."""
        game = self.policies[player].game
        played = np.bincount(game.catalogue.shot[game.base_pair_stroke], self.base_pairs(player).sum(axis=0), N_SHOTS)
        return np.asarray(played / played.sum())


def visits(
    policy: StatePolicy,
    opponent: StatePolicy,
    *,
    server: Literal[0, 1] | None = None,
    tolerance: float = TOLERANCE,
    chains: tuple[InducedChain, InducedChain] | None = None,
) -> Visits:
    """Expected visits when player 0 plays ``policy`` and player 1 plays ``opponent``.

    With b_i the start of a rally that player i serves, and C_i the probabilities of continuing where i strikes, the visits are
    x_0 = b_0 + w, w = C_1' (b_1 + C_0' (b_0 + w)), x_1 = b_1 + C_0' x_0. As w lies on rally states, whose rows in C_i sum to
    c_i at most, ``|C_i' w| <= c_i |w|`` in the 1-norm, and the bound of :mod:`shuttle_marl.exact.fixed_point` holds in that norm:
    the error of w is at most D residual / (1 - D), D = c_0 c_1, and that of x_1 no larger.

    Args:
        server: the server; None: each player half of the time.

    Raises:
        ExactError: the two games have different layouts, or play may never end.
    """
    check_opponents(policy.game, opponent.game)
    policy, opponent = facing(policy, opponent)
    chains = chains or (induced(policy), induced(opponent))
    backward = [
        functools.partial(propagate, played.game, [block_chances(played, block) for block in range(played.game.n_blocks)])
        for played in (policy, opponent)
    ]
    size = len(chains[0].reward)
    start = np.zeros((2, size))
    start[:, ROOT] = 0.5 if server is None else np.eye(2)[server]
    contraction = chains[0].contraction * chains[1].contraction
    constant = backward[1](start[1] + backward[0](start[0]))

    def bound(residual: float, w: F64) -> float:
        # All terms are positive, so rounding is relative to their sum.
        rounding = ROUNDING * (1 + float(np.abs(w).sum()))
        return 2 * ((residual + rounding) * contraction / (1 - contraction) + rounding)

    z, _, error = solve_linear(
        constant,
        lambda w: backward[1](backward[0](w)),
        norm=lambda r: float(np.abs(r).sum()),
        bound=bound,
        tolerance=tolerance,
    )
    first = start[0] + np.maximum(z, 0.0)  # conjugate residuals leave values of -1e-20
    return Visits(policies=(policy, opponent), states=(first, start[1] + backward[0](first)), error_bound=error)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Sensitivity:
    """A profile, and how its result depends on the outcomes of strokes.

    Attributes:
        value: exact values of player 0 against player 1.
        win: ``[2, 3, 13]`` derivative of the probability that player 0 wins a rally, both serving equally often, by the log-odds
            of a fault, of a return, and of a contact above, in the strokes of player 0 and of player 1, by shot type.
    """

    value: ProfileValue
    win: F64


class _Strokes(NamedTuple):
    """Strokes of a block.

    Attributes:
        limits: ``[base pairs, 3]`` thresholds.
        hurry: ``[base pairs, 2]`` probability of a hurried receiver, in units of 1/256.
        pair_start: ``[base states + 1]`` first pair of each state.
        edge: ``[base pairs]`` edge that follows.
        attack: ``[edges]`` whether its stroke is an attack.
        shot: ``[base pairs]`` shot type.
    """

    limits: U16 | F64
    hurry: U8 | F64
    pair_start: I32
    edge: I32
    attack: I8
    shot: I8


@compiled
def _add(visited: F64, chance: F64, strokes: _Strokes, plain: F64, after: F64, out: F64) -> None:
    """Add the derivatives of the values of a block's strokes, weighted by visits.

    Args:
        visited: ``[base states]`` visits.
        chance: ``[base pairs]`` probability of each legal pair given its state.
        plain, after: ``[base states]`` values of the next block after a stroke that is no attack and after an attack.
        out: ``[3, 13]`` the result.
    """
    limits, hurry, pair_start, edge, attack, shot = strokes
    for s in range(visited.size):
        if visited[s] == 0.0:
            continue
        for k in range(pair_start[s], pair_start[s + 1]):
            fault, winner, below = limits[k, 0] / 65536.0, limits[k, 1] / 65536.0, limits[k, 2] / 65536.0
            good, returned = 1.0 - fault, 1.0 - winner
            following, first = after if attack[edge[k]] else plain, 4 * edge[k]
            lower = following[first] + hurry[k, 0] / 256.0 * (following[first + 2] - following[first])
            upper = following[first + 1] + hurry[k, 1] / 256.0 * (following[first + 3] - following[first + 1])
            above = (1.0 - below) / returned
            later = (1.0 - above) * lower + above * upper
            weight, back = visited[s] * chance[k], returned / good
            out[0, shot[k]] -= weight * fault * good * (1.0 + (1.0 - back) - back * later)
            out[1, shot[k]] -= weight * good * back * (1.0 - back) * (1.0 + later)
            out[2, shot[k]] -= weight * returned * above * (1.0 - above) * (upper - lower)


def sensitivity(policy: StatePolicy, opponent: StatePolicy, *, tolerance: float = TOLERANCE) -> Sensitivity:
    """Derivatives of the probability of winning a rally by the log-odds of the outcomes of strokes.

    Raises:
        ExactError: the two games have different layouts, or play may never end.
    """
    check_opponents(policy.game, opponent.game)
    policy, opponent = facing(policy, opponent)
    chains = induced(policy), induced(opponent)
    value = evaluate_chains(*chains, tolerance=tolerance)
    seen = visits(policy, opponent, tolerance=tolerance, chains=chains)
    win = np.zeros((2, 3, N_SHOTS))
    for player, played in enumerate((policy, opponent)):
        game, following = played.game, value.striking[1 - player]
        shot = game.catalogue.shot[game.base_pair_stroke]
        tables = (game.base_pair_start, game.base_pair_edge, game.edge_attack.view(np.int8), shot)
        for block in range(game.n_blocks):
            _add(
                np.ascontiguousarray(seen.states[player][game.block_states(block)]),
                played.block_probabilities(block),
                _Strokes(game.limits[game.table_of(block)], game.hurry_at(game.table_of(block)), *tables),
                *successors(game, following, block),
                win[player],
            )
    # Values lie between -1 and 1, and those of player 1 count against player 0.
    win *= np.array([0.5, -0.5])[:, None, None]
    return Sensitivity(value=value, win=win)
