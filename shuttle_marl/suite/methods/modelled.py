"""Methods of ``exploit`` that estimate something from play, and solve what they estimated for the restricted response.

The argument is the restriction of the response.
"""

import dataclasses
from typing import Final

import numpy as np

from shuttle_marl.analysis.tabular import SHRINK, cloned, game_of
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.tabulated import TabulatedPolicy, tabulate
from shuttle_marl.kernel import play_rallies
from shuttle_marl.policy.computed import minimax_policy
from shuttle_marl.policy.registry import resolve
from shuttle_marl.recording.logs import play_log
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.methods.adapters import positions, respond, tilted_positions
from shuttle_marl.suite.methods.learned import boosted
from shuttle_marl.suite.population import mixture

_COUNTED: Final = 300_000
"""Strokes from which on more counts of an opponent change little."""
_FITTED: Final = 400_000
"""The same for trees."""
_STROKES: Final = 5
"""More own strokes than rallies have on average."""
_EXPLORE: Final = 0.2
"""Fraction of random strokes in the second half of the play."""
_MARGIN: Final = 200
"""Strokes that are left for the end of the last rally."""


def restricted_counts(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """Counts of the opponent's choices against perfect play, shrunken towards bc, and the restricted response in the game.

    The restriction is fixed; that of a data-biased response (Johanson & Bowling, AISTATS 2009) grows with the counts of a state.
    """
    game, opponent = setting.game, _opponent(setting)
    bc = tabulate(resolve("bc", game), game)
    rallies = play_rallies(
        game, (minimax_policy(game), opponent), max(1, min(setting.budget, _COUNTED) // _STROKES), seed=setting.seed
    )
    state, theirs = rallies.states(game), rallies.striker == 1
    pair = game.pair(state, rallies.stroke.astype(np.int32)).astype(np.int64)
    probability, places = cloned(game, pair[theirs], shrink=8.0, prior=bc.block_probabilities(0)), positions(bc)
    if places is not None:
        assert rallies.waited is not None
        places = tilted_positions(places, game, state[~theirs], rallies.waited[~theirs])
    estimate = PairPolicy(game=game, probability=probability, positions=places)
    return Trained(player=respond(estimate, float(argument)), strokes=int((~theirs).sum()))


def boosted_model(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """Outcomes by boosted trees from play, first at random and then as planned, and the restricted response in that model.

    The model has no positions, which it does not see: it waits as people do.
    """
    game, opponent = setting.game, _opponent(setting)
    plain = dataclasses.replace(game, recovery=None)
    player, rows, used = tabulate(resolve("random", game), game), [], 0
    budget = min(setting.budget, _FITTED)
    for turn in range(2):
        log = play_log((player, opponent), budget // 2 - _MARGIN, 2 * setting.seed + turn)
        used += int(log.own.sum())
        rows.append((log.pair, log.outcome, log.pair[~log.own]))
        pair, outcome, theirs = (np.concatenate(column) for column in zip(*rows, strict=True))
        shares = boosted(plain, pair, outcome, 150, setting.seed, objective="multiclass", num_class=len(OUTCOMES))
        model = game_of(plain, shares)
        estimate = PairPolicy(game=model, probability=cloned(plain, theirs, shrink=SHRINK))
        found = TabulatedPolicy(game=game, cumulative=respond(estimate, float(argument)).cumulative)
        player = mixture(game, [found, tabulate(resolve("random", game), game)], [1 - _EXPLORE, _EXPLORE])
    return Trained(player=found, strokes=used)


def _opponent(setting: PlayerSetting) -> TabulatedPolicy:
    return tabulate(resolve(setting.opponent or "bc", setting.game), setting.game)
