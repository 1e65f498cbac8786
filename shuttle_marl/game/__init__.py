"""The game: court, strokes, rules of a rally and of a match, random numbers, and the interface of a policy.

:mod:`shuttle_marl.game.rules` is the rule book, to be read first. The names that users need, imported when first used::

    from shuttle_marl.game import Policy, States, default_game

    class Smasher:  # a Policy
        def probabilities(self, states: States): ...
"""

from typing import TYPE_CHECKING

from shuttle_marl.base.extras import lazily

if TYPE_CHECKING:
    from shuttle_marl.game.layout import GameError, observations
    from shuttle_marl.game.pairs import pair_game
    from shuttle_marl.game.policy import Policy, PolicyError, States, tabulate
    from shuttle_marl.game.recovery import POSITIONS
    from shuttle_marl.game.rules import ActionError, IllegalStrokeError
    from shuttle_marl.game.scoring import Rules, Score, match_win_probability
    from shuttle_marl.game.shipped import default_game, load_game, model_folder
    from shuttle_marl.game.stroke import SHOTS
    from shuttle_marl.game.tables import Game

__all__ = [
    "POSITIONS",
    "SHOTS",
    "ActionError",
    "Game",
    "GameError",
    "IllegalStrokeError",
    "Policy",
    "PolicyError",
    "Rules",
    "Score",
    "States",
    "default_game",
    "load_game",
    "match_win_probability",
    "model_folder",
    "observations",
    "pair_game",
    "tabulate",
]

__getattr__, __dir__ = lazily(__name__)
