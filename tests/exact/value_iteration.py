"""An oracle for the solvers: plain value iteration in numpy, sharing no code with them. It made the figures of the model card."""

import functools
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from shuttle_marl.game.tables import ROOT, Game
from shuttle_marl.game.thresholds import ONE

Floats = npt.NDArray[np.float64]

TOLERANCE = 1e-10
SWEEPS = 20_000


class ValueIteration:
    """Value iteration on the tables of one game; values are the striker's, +1 for winning the rally."""

    def __init__(self, game: Game) -> None:
        self.game = game

    @functools.cached_property
    def _playable(self) -> npt.NDArray[np.bool_]:
        return np.diff(self.game.pair_start) > 0

    @functools.cached_property
    def _probabilities(self) -> tuple[Floats, Floats]:
        """``[P]`` expected reward now, and ``[P, 4]`` probability that the rally continues with each arrival."""
        t = self.game.limits_of().astype(np.float64) / ONE
        fault, winner = t[:, 0], t[:, 1] - t[:, 0]
        returned = np.stack([t[:, 2] - t[:, 1], 1 - t[:, 2]], axis=1)
        hurried = np.tile(self.game.hurry / 256, (self.game.n_blocks, 1))
        return winner - fault, np.concatenate([returned * (1 - hurried), returned * hurried], axis=1)

    @functools.cached_property
    def _next(self) -> npt.NDArray[np.integer]:
        """``[P, 4]`` the receiver's state."""
        return self.game.arrivals()

    def continuation(self) -> Floats:
        """``[P]`` probability that the rally continues."""
        return np.asarray(self._probabilities[1].sum(axis=1))

    def quality(self, value_of_receiver: Floats) -> Floats:
        """``[P]`` value of each legal stroke when the next striker's value is given, ``[S]`` and seen by the other."""
        now, later = self._probabilities
        return np.asarray(now + (later * value_of_receiver[self._next]).sum(axis=1))

    def _over_states(self, reduce: np.ufunc, pairs: Floats) -> Floats:
        out: Floats = np.zeros(self.game.n_states)
        out[self._playable] = reduce.reduceat(pairs, self.game.pair_start[:-1][self._playable])
        return out

    def _iterate(self, sweep: Callable[[Floats], Floats]) -> Floats:
        value = np.zeros(self.game.n_states)
        for _ in range(SWEEPS):
            following = sweep(value)
            if np.abs(following - value).max() < TOLERANCE:
                return following
            value = following
        raise ArithmeticError("value iteration did not converge")

    @functools.cached_property
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
        now, later = self._probabilities
        return self._over_states(np.add, policy * (-now + (later * ours[self._next]).sum(axis=1)))

    def visits(self, policy: Floats) -> Floats:
        """``[P]`` expected number of times each legal pair is played in a rally when both play ``policy``."""
        later, following = self._probabilities[1], self._next.ravel()
        n = self.game.n_states
        reached: Floats = np.zeros(n)
        reached[ROOT] = 1.0
        total: Floats = np.zeros(n)
        for _ in range(SWEEPS):
            total += reached
            played = policy * reached[self.game.pair_state]
            reached = np.asarray(np.bincount(following, (played[:, None] * later).ravel(), n))
            if reached.sum() < TOLERANCE:
                break
        return np.asarray(policy * total[self.game.pair_state])
