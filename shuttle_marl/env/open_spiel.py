"""The rally as a game of OpenSpiel; importing this module registers it.

    import pyspiel
    import shuttle_marl.env.open_spiel

    game = pyspiel.load_game("python_shuttle_marl_rally", {"server": 0})

A player's stroke is followed by a chance node with its outcome. Rallies have no longest length, and states that play on alike
have one name, so algorithms on trees (best responses, CFR) need a game without cycles, or ``max_strokes``; algorithms on states
(value iteration with ``cyclic_game=True``) and those that sample take the game as it is.

``python_shuttle_marl_rally_recovery`` is the game with recovery, one of imperfect information: the receiver chooses a position,
then the striker a stroke without seeing it, as if both acted at once. Information states are those of the striker's state, whose
future depends on nothing that came before; so they leave out what their player chose for earlier strokes. Only ``str(state)``,
the name of the node of the tree, and its history contain the position.
"""

import functools
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pyspiel
from open_spiel.python import policy as spiel_policy

from shuttle_marl.base.arrays import F32
from shuttle_marl.base.errors import OptionError
from shuttle_marl.game.layout import RALLY_WIDTH
from shuttle_marl.game.policy import Policy, position_shares, tabulate
from shuttle_marl.game.rally import stepper_of
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.rules import FAULT, OUTCOMES, RETURNED_BELOW, WINNER
from shuttle_marl.game.shipped import RECOVERY, resolve_game
from shuttle_marl.game.tables import ROOT, Game

__all__ = ["NAME", "RECOVERY_NAME", "RallyGame", "RallyState", "open_spiel_policy"]

NAME: Final = "python_shuttle_marl_rally"
RECOVERY_NAME: Final = f"{NAME}_recovery"
_DEFAULTS: Final[dict[str, Any]] = {"model": "default", "profile": "", "server": -1, "max_strokes": 0}
_LONGEST: Final = 100_000  # maximum length reported to OpenSpiel for rallies without a limit
_STROKE: Final = -1  # value of pair where a stroke is due and not its outcome


def _type(name: str, long_name: str, information: Any, defaults: dict[str, Any]) -> Any:
    return pyspiel.GameType(
        short_name=name,
        long_name=long_name,
        dynamics=pyspiel.GameType.Dynamics.SEQUENTIAL,
        chance_mode=pyspiel.GameType.ChanceMode.EXPLICIT_STOCHASTIC,
        information=information,
        utility=pyspiel.GameType.Utility.ZERO_SUM,
        reward_model=pyspiel.GameType.RewardModel.TERMINAL,
        max_num_players=2,
        min_num_players=2,
        provides_information_state_string=True,
        provides_information_state_tensor=True,
        provides_observation_string=True,
        provides_observation_tensor=True,
        parameter_specification=defaults,
    )


_INFORMATION: Final = pyspiel.GameType.Information
_TYPE: Final = _type(NAME, "Badminton rally", _INFORMATION.PERFECT_INFORMATION, _DEFAULTS)
_RECOVERY: Final = {**_DEFAULTS, "profile": RECOVERY}
_RECOVERY_TYPE: Final = _type(
    RECOVERY_NAME, "Badminton rally with hidden positions", _INFORMATION.IMPERFECT_INFORMATION, _RECOVERY
)


class RallyGame(pyspiel.Game):
    """One rally: +1 for who wins it, -1 for the other, 0 if it is cut off.

    Args:
        params: ``model``: a model by name or folder; ``profile``: variant of that model, such as ``men``; ``server``: 0, 1, or -1
            for a chance node that decides; ``max_strokes``: strokes after which a rally is cut off, 0 for never.
        tables: the tables of another game, instead of those of a model.

    Raises:
        OptionError: a parameter that is not among those.
        GameError: the model does not exist.
    """

    def __init__(self, params: Mapping[str, Any] | None = None, tables: Game | None = None) -> None:
        given = {**_DEFAULTS, **(params or {})}
        self.server, self.max_strokes = int(given["server"]), int(given["max_strokes"])
        if self.server not in (-1, 0, 1) or self.max_strokes < 0:
            raise OptionError(f"server {self.server}, max_strokes {self.max_strokes}: expected -1, 0 or 1, and 0 or more")
        self.tables = resolve_game(given["model"], given["profile"] or None) if tables is None else tables
        hides, self.stepper = self.tables.hides, stepper_of(self.tables)
        info = pyspiel.GameInfo(
            num_distinct_actions=self.stepper.n_actions,
            max_chance_outcomes=len(OUTCOMES),
            num_players=2,
            min_utility=-1.0,
            max_utility=1.0,
            utility_sum=0.0,
            max_game_length=(1 + hides) * (self.max_strokes or _LONGEST),
        )
        super().__init__(_RECOVERY_TYPE if hides else _TYPE, info, dict(params or {}))

    def new_initial_state(self) -> "RallyState":
        """The state before the serve, or before it is decided who serves."""
        return RallyState(self)

    def make_py_observer(self, iig_obs_type: Any = None, params: Any = None) -> "RallyObserver":  # noqa: ARG002
        """The observer of ``rally_v0``: all that the future of the rally depends on."""
        return RallyObserver(self.tables)


class _RecoveryGame(RallyGame):
    """A class, as OpenSpiel would destroy its last reference to a function after the end of the interpreter."""

    def __init__(self, params: Mapping[str, Any] | None = None) -> None:
        super().__init__({**_RECOVERY, **(params or {})})


class RallyState(pyspiel.State):
    """A state, named in words by who strikes in which state of :mod:`shuttle_marl.game.tables`; its clones share no luck.

    Attributes:
        striker: who is to strike or has just struck, 0 or 1; -1: it is not decided who serves.
        number: state of the striker, as in :mod:`shuttle_marl.game.tables`.
        choosing: whether the receiver is to choose a position for this state.
    """

    def __init__(self, game: RallyGame) -> None:
        super().__init__(game)
        self.tables = game.tables
        self.striker, self.strokes = game.server, 0
        self._limit = game.max_strokes
        self._pair, self._winner, self._over = _STROKE, -1, False
        self._stepper = game.stepper
        self._enter(ROOT)

    def _enter(self, number: int) -> None:
        self.number, self._pair = number, _STROKE
        self.choosing = self._stepper.chooses_position(number)
        self._position = self._stepper.only_position(number)

    def current_player(self) -> int:
        """0, 1, or the number of chance or of the end."""
        if self._over:
            return int(pyspiel.PlayerId.TERMINAL)
        return int(pyspiel.PlayerId.CHANCE) if self.striker < 0 or self._pair != _STROKE else self.striker ^ self.choosing

    def _legal_actions(self, player: int) -> list[int]:  # noqa: ARG002
        stepper = self._stepper
        mask = stepper.position_mask(self.number) if self.choosing else stepper.legal_action_mask(self.number)
        found: list[int] = mask.nonzero()[0].tolist()
        return found

    def chance_outcomes(self) -> list[tuple[int, float]]:
        """Outcomes of the stroke with their probabilities, as in :data:`shuttle_marl.game.rules.OUTCOMES`; or who serves."""
        if self.striker < 0:
            return [(0, 0.5), (1, 0.5)]
        return [(i, p) for i, p in enumerate(self.tables.outcome_probabilities(self._pair, self._position).tolist()) if p > 0]

    def _apply_action(self, action: int) -> None:
        if self.striker < 0:
            self.striker = action
        elif self.choosing:
            self.choosing, self._position = False, action - self.tables.n_strokes
        elif self._pair == _STROKE:
            self._pair = int(self.tables.pair(self.number, action))
        elif action in (FAULT, WINNER):
            self._winner, self._over = (self.striker if action == WINNER else 1 - self.striker), True
        else:
            self._enter(int(self.tables.arrivals(self._pair)[action - RETURNED_BELOW]))
            self.striker = 1 - self.striker
            self.strokes += 1
            self._over = self.strokes == self._limit

    def is_terminal(self) -> bool:
        """Whether the rally is over."""
        return self._over

    def returns(self) -> list[float]:
        """+1 and -1, or zeros."""
        return [0.0, 0.0] if self._winner < 0 else [1.0 - 2 * self._winner, 2 * self._winner - 1.0]

    def _action_to_string(self, player: int, action: int) -> str:
        if player >= 0:
            return self._stepper.game.action_names[action]
        return f"player {action} serves" if self.striker < 0 else OUTCOMES[action]

    def __str__(self) -> str:
        if self._position is None or self._over or not self._stepper.chooses_position(self.number):
            return self.seen()
        return f"{self.seen()}; receiver at {POSITIONS[self._position]}"

    def seen(self) -> str:
        """The name of the state as both players see it: without the position of the receiver."""
        if self._over:
            return f"won by {self._winner}" if self._winner >= 0 else "cut off"
        if self.striker < 0:
            return "who serves is not decided"
        name = f"player {self.striker} to strike: {_described(self.tables, self.number)}"
        if self.choosing:
            name = f"player {1 - self.striker} to wait, {name}"
        if self._pair != _STROKE:
            name += f"; plays {self.tables.catalogue.names[self.tables.base_pair_stroke[self._pair % self.tables.n_base_pairs]]}"
        return f"{name}; stroke {self.strokes + 1}" if self._limit else name


@functools.lru_cache(maxsize=1 << 16)  # algorithms on trees ask for the name of every node
def _described(tables: Game, state: int) -> str:
    return tables.describe(state)


class RallyObserver:
    """Tensors and texts of what a player sees; the layout of the numbers is that of ``rally_v0``, and a flag of whose turn it is.

    Attributes:
        tensor: ``[61]`` float32; ``[62]`` in the game with recovery, whether the player is to choose a position at the end.
        dict: the same by name.
    """

    def __init__(self, tables: Game) -> None:
        self._stepper = stepper_of(tables)
        self.tensor = np.zeros(RALLY_WIDTH + 1 + tables.hides, np.float32)
        rally, turn, waits = np.split(self.tensor, (RALLY_WIDTH, RALLY_WIDTH + 1))
        self.dict: dict[str, F32] = {"rally": rally, "turn": turn}
        if tables.hides:
            self.dict["waits"] = waits

    def set_from(self, state: RallyState, player: int) -> None:
        """Write what a player sees."""
        self.tensor[:RALLY_WIDTH] = self._stepper.observe(state.number, receiver=player != state.striker)[:RALLY_WIDTH]
        self.tensor[RALLY_WIDTH] = player == state.striker
        self.tensor[RALLY_WIDTH + 1 :] = state.choosing and player != state.striker

    def string_from(self, state: RallyState, player: int) -> str:  # noqa: ARG002
        """The name of the state, as far as both players know it."""
        return state.seen()


def open_spiel_policy(policy: Policy, game: RallyGame) -> spiel_policy.Policy:
    """A policy of this package for OpenSpiel's algorithms, for both players.

    Args:
        policy: such as :func:`shuttle_marl.policy.resolve` gives; it may not read the score.

    Raises:
        PolicyError: it is no distribution over the legal strokes, or reads the score.
    """
    return _TablePolicy(policy, game)


class _TablePolicy(spiel_policy.Policy):
    def __init__(self, policy: Policy, game: RallyGame) -> None:
        super().__init__(game, [0, 1])
        self._table = tabulate(policy, game.tables)

    def action_probabilities(self, state: RallyState, player_id: int | None = None) -> dict[int, float]:  # noqa: ARG002
        if state.choosing:
            shares = position_shares(self._table.waiting_table[state.number])
            return {action: float(shares[action - self._table.game.n_strokes]) for action in state.legal_actions()}
        pairs = self._table.game.pairs_of(state.number)
        probabilities = self._table.probability_of(np.arange(pairs.start, pairs.stop))
        return dict(zip(self._table.game.legal_strokes(state.number).tolist(), probabilities.tolist(), strict=True))


pyspiel.register_game(_TYPE, RallyGame)
pyspiel.register_game(_RECOVERY_TYPE, _RecoveryGame)
