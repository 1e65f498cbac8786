"""References for tasks of players: they compute from the tables of the game and use no strokes."""

import dataclasses

import numpy as np

from shuttle_marl.exact import best_response as respond
from shuttle_marl.exact import restricted_response
from shuttle_marl.exact.lists import cells_of, lists
from shuttle_marl.exact.profile import PairPolicy, tabulated_pairs
from shuttle_marl.game.policy import TemperedPolicy
from shuttle_marl.game.tabulated import TabulatedPolicy, cumulative_positions, tabulate
from shuttle_marl.suite.exploit import PlayerSetting, Trained
from shuttle_marl.suite.frontier import WEIGHT
from shuttle_marl.suite.population import positions_of

_STEPS = 30


def bc() -> Trained:
    """The imitated average player."""
    return Trained(player="bc", strokes=0)


def random() -> Trained:
    """Every legal stroke equally likely."""
    return Trained(player="random", strokes=0)


def minimax() -> Trained:
    """Perfect play."""
    return Trained(player="minimax", strokes=0)


def minimax_deterministic(setting: PlayerSetting) -> Trained:
    """Perfect play that always makes its likeliest choice."""
    return Trained(player=deterministic(setting.policy("minimax")), strokes=0)


def deterministic(policy: TabulatedPolicy) -> TabulatedPolicy:
    """A policy that always makes the likeliest choice of another one, of strokes and of positions."""
    pure = tabulate(TemperedPolicy(policy, 0.0), policy.game)
    if policy.game.recovery is None:
        return pure
    return dataclasses.replace(pure, waits=cumulative_positions(np.eye(9)[positions_of(policy).argmax(axis=1)]))


def best_response(setting: PlayerSetting) -> Trained:
    """The exact best response to the opponent, which is exploited in turn."""
    return Trained(player=f"best-response:{setting.opponent}", strokes=0)


def restricted(setting: PlayerSetting, argument: str = str(WEIGHT)) -> Trained:
    """The exact restricted response to the opponent, the upper bound of ``exploit``; the argument is the restriction."""
    return Trained(player=restricted_response(setting.against, float(argument)).policy, strokes=0)


def constant(setting: PlayerSetting) -> Trained:
    """The best order of preference of the strokes for all states: how little of the state an opponent's weaknesses need."""
    return _best_list(setting)


def constant_by_incoming(setting: PlayerSetting) -> Trained:
    """The best orders of preference for each incoming shot type and contact."""
    return _best_list(setting, "incoming_shot", "contact")


def _best_list(setting: PlayerSetting, *parts: str) -> Trained:
    """The best list that reads some parts of the state (:mod:`shuttle_marl.exact.lists`)."""
    *_, best = [setting.against, *lists(setting.against, cells_of(setting.game, *parts))]
    return Trained(player=best, strokes=0)


def fictitious_play(setting: PlayerSetting) -> Trained:
    """Fictitious play with exact best responses, averaged state by state (Sayin, Parise & Ozdaglar 2022, arXiv 2010.04223)."""
    game = setting.game
    first = setting.policy("bc")
    mean, places = first.pair_probabilities(), None if game.recovery is None else positions_of(first)
    for step in range(_STEPS):
        answer = respond(PairPolicy(game=game, probability=mean, positions=places), tolerance=1e-6).policy
        mean += (answer.pair_probabilities() - mean) / (step + 2)
        if places is not None:
            places += (positions_of(answer) - places) / (step + 2)
    return Trained(player=tabulated_pairs(PairPolicy(game=game, probability=mean, positions=places)), strokes=0)
