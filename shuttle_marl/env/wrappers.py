"""Wrappers of ``raw_env()`` that make ``env()``: PettingZoo's checks, and the choice between two views of the action."""

from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo.utils.env_logger import EnvLogger
from pettingzoo.utils.wrappers.order_enforcing import OrderEnforcingWrapper

from shuttle_marl.env.strokes import PARTS, STROKE_WIDTH, Observation
from shuttle_marl.errors import ActionError, OptionError
from shuttle_marl.game.rally import IllegalStrokeError

if TYPE_CHECKING:
    from shuttle_marl.env.rally_v0 import ShuttleEnv

ActionView = Literal["flat", "components"]

_CUTS: Final = np.cumsum(PARTS)[:-1]


class CheckedEnv(OrderEnforcingWrapper[str, Observation, Any]):
    """PettingZoo's checks in one wrapper: the order of calls, actions out of bounds, illegal strokes.

    A stroke that is not legal in the state ends the episode: -1 for who tried it, +1 for the other, and
    ``info["reason"]`` says so. PettingZoo's ``TerminateIllegalWrapper`` pays the other nothing and explains nothing, so
    the game would not be zero-sum; and a chain of three wrappers takes three times as long as the environment itself.
    """

    def __init__(self, env: "ShuttleEnv") -> None:
        super().__init__(env)
        self._raw = env

    def last(self, observe: bool = True) -> tuple[Observation | None, float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated and info of the agent to move."""
        if not self._has_reset:
            EnvLogger.error_observe_before_reset()
        raw = self._raw
        agent = raw.agent_selection
        return (
            self.observe(agent) if observe else None,
            raw._cumulative_rewards[agent],
            raw.terminations[agent],
            raw.truncations[agent],
            raw.infos[agent],
        )

    def step(self, action: Any) -> None:
        """Play a stroke, or lose by it.

        Raises:
            ActionError: the action is not in the action space.
        """
        try:
            super().step(action)
        except IllegalStrokeError as illegal:
            self._lose(illegal.stroke)

    def _lose(self, stroke: int | None) -> None:
        EnvLogger.warn_on_illegal_move()
        self._raw.forfeit(stroke)

    def __str__(self) -> str:
        return str(self.env)


class ComponentEnv(CheckedEnv):
    """Actions as (shot type, area, height, technique), ``MultiDiscrete([13, 9, 2, 3])``.

    ``action_mask`` is the concatenation of four masks, 13 + 9 + 2 + 3 = 27 int8: which shot types, areas, heights and
    techniques occur among the legal strokes. It is a relaxation: four allowed components need not make a legal stroke,
    and one that is not legal loses the episode. :func:`component_masks` cuts it into the four masks that
    ``MultiDiscrete.sample`` takes.
    """

    def __init__(self, env: "ShuttleEnv") -> None:
        super().__init__(env)
        catalogue = env.game.catalogue
        columns = np.stack([catalogue.shot, catalogue.area, catalogue.height, catalogue.technique], axis=1)
        self._by_parts = catalogue.by_parts
        self._occurs = np.zeros((len(catalogue), STROKE_WIDTH), dtype=np.int8)
        self._occurs[np.arange(len(catalogue))[:, None], columns + np.r_[0, _CUTS]] = 1
        self._action_spaces = {agent: spaces.MultiDiscrete(list(PARTS)) for agent in env.possible_agents}
        mask = spaces.Box(0, 1, (STROKE_WIDTH,), np.int8)
        self._observation_spaces = {
            agent: spaces.Dict({"observation": env.observation_spaces[agent]["observation"], "action_mask": mask})
            for agent in env.possible_agents
        }

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """``MultiDiscrete([13, 9, 2, 3])``."""
        return self._action_spaces[agent]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The observation of the flat view, and a mask of 27."""
        return self._observation_spaces[agent]

    def observe(self, agent: str) -> Observation:
        """The observation of the flat view, and the concatenated masks of the four components."""
        seen = super().observe(agent)
        legal = self._occurs[seen["action_mask"].astype(bool)]
        return {"observation": seen["observation"], "action_mask": legal.max(axis=0, initial=0)}

    def step(self, action: npt.ArrayLike | None) -> None:
        """Play the stroke of four components; a combination outside the catalogue loses like any illegal stroke.

        Raises:
            ActionError: the action is not in the action space.
        """
        if action is None:
            super().step(None)
            return
        if not self._action_spaces[self.agent_selection].contains(np.asarray(action)):
            raise ActionError(f"action {action!r}: expected shot type, area, height and technique, each below {PARTS}")
        stroke = int(self._by_parts[tuple(np.asarray(action))])
        if stroke < 0 and not (self.terminations[self.agent_selection] or self.truncations[self.agent_selection]):
            self._has_updated = True
            self._lose(None)
        else:
            super().step(stroke)


def component_masks(mask: npt.NDArray[np.int8]) -> tuple[npt.NDArray[np.int8], ...]:
    """Cut a ``[27]`` mask into those of shot type, area, height and technique."""
    return tuple(np.split(mask, _CUTS))


def wrapped(raw: "ShuttleEnv", action: ActionView) -> CheckedEnv:
    """A raw environment with PettingZoo's checks.

    Raises:
        OptionError: an unknown view of the action.
    """
    if action not in ("flat", "components"):
        raise OptionError(f"action {action!r}: expected 'flat' or 'components'")
    return CheckedEnv(raw) if action == "flat" else ComponentEnv(raw)
