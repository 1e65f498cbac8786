"""How far computed values can be from the true ones: the contraction that every error bound here comes from.

Let player i strike in state s. With W(s') the value of the next state, seen by the receiver who strikes there, the value of
s to player i is

    (T_i W)(s) = opt_a [now(s, a) - below(s, a) W(2 e) - above(s, a) W(2 e + 1)],      e the edge that follows (s, a),

where *opt* is the maximum over the legal strokes, or their mean under a policy pi_i, and below + above = p r is the chance
that the rally goes on. (Shapley 1953 and Condon 1992 for such games; Patek & Bertsekas 1999 for games without discount
that end with probability 1.)

**T_i is a contraction in the sup norm over the rally states**, those other than the serve. Rally states only follow each
other, and |max_a f - max_a g| <= max_a |f - g|, so |T_i W - T_i U| <= c_i |W - U| with

- c_i = d, the supremum of p r over all legal pairs but the serves, for the maximum;
- c_i = max_s sum_a pi_i(a | s) p r, the largest mean continuation, for the mean under pi_i: at most d.

**The bound.** From x, an approximation of V_0 however found, let y = T_1 x, z = T_0 y and rho = |z - x|. T_0 T_1 contracts
with D = c_0 c_1 and has the fixed point V_0, so |x - V_0| <= |x - z| + |z - V_0| <= rho + D |x - V_0|, hence
|x - V_0| <= rho / (1 - D), |z - V_0| <= D |x - V_0|, and for y' = T_1 z, |y' - V_1| <= c_1 |z - V_0|. All rally values
returned, z and y', are within D rho / (1 - D). In the symmetric game V = T V, one operator does: from x, z = T x and
rho = |z - x|, |z - V| <= d rho / (1 - d).

**The serve** follows no state, so its value is one application of T_i to rally values. A serve goes on with probability at
most 1, so its error is at most that of the rally values it is computed from, whatever its own p r. It is therefore always
computed last, from rally values for which the bound holds already.

**Rounding.** One application of T_0 T_1 in double precision is off by less than :data:`ROUNDING`; that is added to rho, once
more to the bound because z itself is rounded, and once more for y' and the serve.
"""

from typing import Final

import numpy as np

from shuttle_marl.exact.errors import ExactError
from shuttle_marl.game.rally import ONE, Game

ROUNDING: Final = 2.0**-40
"""More than the rounding of two applications: a sum of 2 K + 1 products whose absolute values add up to 2 at most loses at
most 2 (2 K + 2) 2^-53 in double precision, below 2^-41 for states of K <= 1000 legal strokes."""

TOLERANCE: Final = 1e-9
"""Error bound up to which values are computed unless asked otherwise, on the scale from -1 to 1."""

FIRST_RALLY_STATE: Final = 2
"""States 0 and 1 are the start of the rally; no state leads there."""


def largest_continuation(game: Game) -> float:
    """The supremum d of p r, the chance that the rally goes on, over all legal pairs but the serves.

    Raises:
        ExactError: it is 1, so some stroke never ends a rally and values have no bound.
    """
    # The second threshold is the chance, in fixed point, that the stroke ends the rally.
    ends = game.threshold[game.pair_start[FIRST_RALLY_STATE] :, 1]
    if not len(ends) or ends.min() > 0:
        return float(1 - ends.min(initial=ONE - 1) / ONE)
    pair = int(game.pair_start[FIRST_RALLY_STATE]) + int(np.argmin(ends))
    raise ExactError(
        f"{game.catalogue.names[game.pair_stroke[pair]]} never ends the rally in state: "
        f"{game.describe(int(game.pair_state[pair]))}; exact values need a chance above 0 for every stroke to end it"
    )


def error_bound(residual: float, contraction: float) -> float:
    """``|z - V|`` for ``z = T x``, ``residual = |z - x|`` and an operator T that contracts with ``contraction`` (see above)."""
    return (residual + ROUNDING) * contraction / (1 - contraction) + 2 * ROUNDING
