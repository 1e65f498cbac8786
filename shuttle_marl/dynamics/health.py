"""Is the solved game healthy? Minimax by plain value iteration, best response to a policy, and how play looks.

A model of badminton that predicts well can still be a bad game: one exploitable corner of the tables, and perfect play is
a stall or a single killing stroke. So every fit is solved, and what perfect play looks like is part of its card.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shuttle_marl.dynamics.support import Support, is_serve_pair
from shuttle_marl.game.rally import ONE, ROOT, Game
from shuttle_marl.game.stroke import SHOTS

Floats = npt.NDArray[np.float64]

TOLERANCE: Final = 1e-10
_SWEEPS: Final = 20_000


@dataclasses.dataclass(frozen=True, eq=False)
class Solver:
    """Value iteration on the tables of one game; values are the striker's, +1 for winning the rally."""

    game: Game

    @functools.cached_property
    def _starts(self) -> npt.NDArray[np.int32]:
        starts = self.game.pair_start
        return starts[:-1][np.diff(starts) > 0]

    @functools.cached_property
    def _playable(self) -> npt.NDArray[np.bool_]:
        return np.diff(self.game.pair_start) > 0

    @functools.cached_property
    def _chances(self) -> tuple[Floats, Floats, Floats]:
        """``[P]`` each: expected reward now, chance of going on with a contact below, above."""
        t = self.game.threshold.astype(np.float64) / ONE
        fault, winner = t[:, 0], t[:, 1] - t[:, 0]
        return winner - fault, t[:, 2] - t[:, 1], 1 - t[:, 2]

    def continuation(self) -> Floats:
        """``[P]`` chance that the rally goes on."""
        _, below, above = self._chances
        return below + above

    def quality(self, value_of_receiver: Floats) -> Floats:
        """``[P]`` value of each legal stroke when the next striker's value is given, ``[S]`` and seen by the other."""
        now, below, above = self._chances
        edge = 2 * self.game.pair_edge
        return now + below * value_of_receiver[edge] + above * value_of_receiver[edge + 1]

    def _over_states(self, reduce: np.ufunc, pairs: Floats) -> Floats:
        out: Floats = np.zeros(self.game.n_states)
        out[self._playable] = reduce.reduceat(pairs, self._starts)
        return out

    def _iterate(self, sweep: Callable[[Floats], Floats]) -> Floats:
        value = np.zeros(self.game.n_states)
        for _ in range(_SWEEPS):
            following = sweep(value)
            if np.abs(following - value).max() < TOLERANCE:
                return following
            value = following
        raise ArithmeticError("value iteration did not converge; does some stroke never end a rally?")

    def minimax(self) -> Floats:
        """``[S]`` value of every state under perfect play by both."""
        return self._iterate(lambda v: self._over_states(np.maximum, self.quality(-v)))

    def greedy(self, quality: Floats) -> Floats:
        """``[P]`` the policy that plays the first best stroke of each state."""
        best = self._over_states(np.maximum, quality)
        ties = quality >= best[self.game.pair_state] - 1e-12
        first = np.full(self.game.n_states, self.game.n_pairs)
        np.minimum.at(first, self.game.pair_state[ties], np.flatnonzero(ties))
        chosen = np.zeros(self.game.n_pairs)
        chosen[first[first < self.game.n_pairs]] = 1.0
        return chosen

    def best_response(self, policy: Floats) -> tuple[float, Floats]:
        """Share of rallies (serving and receiving equally often) that the best response to ``[P]`` wins, and the policy."""
        opponent_strikes = self._iterate(lambda u: self._opponent(policy, u))
        value = self._over_states(np.maximum, self.quality(opponent_strikes))
        share = 0.5 + 0.25 * (value[ROOT] + opponent_strikes[ROOT])
        return float(share), self.greedy(self.quality(opponent_strikes))

    def _opponent(self, policy: Floats, u: Floats) -> Floats:
        """One sweep of the responder's value where the opponent strikes: ours after theirs, then theirs again."""
        ours = self._over_states(np.maximum, self.quality(u))
        now, below, above = self._chances
        edge = 2 * self.game.pair_edge
        pairs = -now + below * ours[edge] + above * ours[edge + 1]
        return self._over_states(np.add, policy * pairs)

    def visits(self, policy: Floats) -> Floats:
        """``[P]`` expected number of times each legal pair is played in a rally when both play ``policy``."""
        _, below, above = self._chances
        edge = 2 * self.game.pair_edge
        n = self.game.n_states
        reached: Floats = np.zeros(n)
        reached[ROOT] = 1.0
        total: Floats = np.zeros(n)
        for _ in range(_SWEEPS):
            total += reached
            played = policy * reached[self.game.pair_state]
            reached = np.asarray(np.bincount(edge, played * below, n) + np.bincount(edge + 1, played * above, n))
            if reached.sum() < TOLERANCE:
                break
        return np.asarray(policy * total[self.game.pair_state])


def play_statistics(solver: Solver, policy: Floats) -> dict[str, Any]:
    """How rallies look when both play ``[P]``: length, endings and shot mix, exactly."""
    game = solver.game
    visits = solver.visits(policy)
    t = game.threshold.astype(np.float64) / ONE
    faults = float(visits @ t[:, 0])
    strokes = float(visits.sum())
    shots = np.bincount(game.catalogue.shot[game.pair_stroke], visits, len(SHOTS)) / strokes
    return {
        "mean_rally": strokes,
        "rallies_ending_on_fault": faults,
        "fault_share": faults / strokes,
        "winner_share": (1 - faults) / strokes,
        "shot_mix": {name: float(share) for name, share in zip(SHOTS, shots, strict=True)},
    }


def health(game: Game, bc: Floats) -> dict[str, Any]:
    """The figures that say whether the solved game is healthy.

    Args:
        game: the tables.
        bc: ``[P]`` chances of the behaviour-cloned average player.
    """
    solver = Solver(game)
    value = solver.minimax()
    perfect = play_statistics(solver, solver.greedy(solver.quality(-value)))
    response, _ = solver.best_response(bc)
    rally = ~is_serve_pair(game)
    shots = list(perfect["shot_mix"].values())
    figures = {
        "minimax": perfect,
        "value_at_serve": float(value[ROOT]),
        "largest_shot_share": max(shots),
        "shot_types_above_2_percent": sum(share > 0.02 for share in shots),
        "largest_continuation": float(solver.continuation()[rally].max()),
        "best_response_to_bc_wins": response,
        "bc": play_statistics(solver, bc),
    }
    figures["healthy"] = bool(
        figures["largest_shot_share"] <= 0.45
        and figures["shot_types_above_2_percent"] >= 6
        and 5 <= perfect["mean_rally"] <= 20
        and figures["largest_continuation"] <= 0.997
        and response >= 0.70
    )
    return figures


def extremes(game: Game, support: Support, count: int = 10) -> dict[str, list[dict[str, Any]]]:
    """The legal pairs with the highest and lowest fault and winner chances, with what supports them."""
    good, returned, _ = game.chances()
    rally = np.flatnonzero(~is_serve_pair(game))
    chance = {"fault": 1 - good, "winner": good * (1 - returned)}
    counts = {"fault": support.faults, "winner": support.winners}
    limits = {"fault": support.fault_range, "winner": support.winner_range}
    out: dict[str, list[dict[str, Any]]] = {}
    for kind, sign in (("fault", 1), ("fault", -1), ("winner", 1), ("winner", -1)):
        values = chance[kind][rally]
        order = rally[np.argsort(-sign * values, kind="stable")]
        # One pair an edge: the chance hardly depends on the striker's own last stroke.
        _, first = np.unique(game.pair_edge[order], return_index=True)
        listed = []
        for pair in order[np.sort(first)][:count]:
            edge = int(game.pair_edge[pair])
            listed.append({
                "state": game.describe(int(game.pair_state[pair])),
                "stroke": game.catalogue.names[game.pair_stroke[pair]],
                "chance": round(float(chance[kind][pair]), 5),
                "strokes": round(float(support.strokes[edge]), 1),
                "events": round(float(counts[kind][edge]), 1),
                "range": [round(float(x), 5) for x in limits[kind][edge]],
            })  # fmt: skip
        out[f"{'highest' if sign > 0 else 'lowest'} {kind} chance"] = listed
    return out
