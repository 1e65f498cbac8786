"""References for tasks of players: they compute from the tables of the game and use no strokes."""

from shuttle_marl.exact import best_response as respond
from shuttle_marl.exact.profile import PairPolicy
from shuttle_marl.game.tabulated import from_pair_probabilities, tabulate
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.exploit import PlayerSetting, Trained

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


def best_response(setting: PlayerSetting) -> Trained:
    """The exact best response to the opponent: the upper bound of ``exploit``."""
    return Trained(player=f"best-response:{setting.opponent}", strokes=0)


def fictitious_play(setting: PlayerSetting) -> Trained:
    """Fictitious play with exact best responses, averaged state by state (Sayin, Parise & Ozdaglar 2022, arXiv 2010.04223)."""
    game = setting.game
    mean = tabulate(resolve("bc", game), game).pair_probabilities()
    for step in range(_STEPS):
        answer = respond(PairPolicy(game=game, probability=mean), tolerance=1e-6).policy
        mean += (answer.pair_probabilities() - mean) / (step + 2)
    return Trained(player=from_pair_probabilities(game, mean), strokes=0)
