"""Constant lists: one order of preference of the strokes for all states, or one for each incoming shot type and contact.

They are references (:mod:`shuttle_marl.exact.lists`): they use the tables, and show how little of the state an opponent's
weaknesses need.
"""

from shuttle_marl.exact.lists import cells_of, lists
from shuttle_marl.game.tabulated import tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.exploit import PlayerSetting, Trained


def constant(setting: PlayerSetting) -> Trained:
    """One list for all states."""
    return _best(setting)


def by_incoming(setting: PlayerSetting) -> Trained:
    """One list for each incoming shot type and contact."""
    return _best(setting, "incoming_shot", "contact")


def _best(setting: PlayerSetting, *parts: str) -> Trained:
    """The best list that reads some parts of the state."""
    opponent = tabulate(resolve(setting.opponent or "bc", setting.game), setting.game)
    return Trained(player=[opponent, *lists(opponent, cells_of(setting.game, *parts))][-1], strokes=0)
