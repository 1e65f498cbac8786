"""PettingZoo's checks around an environment, and the options of ``env()``: views of the action, the mask and the info."""

import copy
from collections.abc import Callable
from typing import Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from pettingzoo.utils.env_logger import EnvLogger
from pettingzoo.utils.wrappers.order_enforcing import OrderEnforcingWrapper

from shuttle_marl.base.arrays import I8
from shuttle_marl.base.errors import ActionError, OptionError, did_you_mean
from shuttle_marl.env.aec import Belief, Observation, ShuttleEnv
from shuttle_marl.game.layout import PARTS, STROKE_WIDTH
from shuttle_marl.game.recovery import N_POSITIONS
from shuttle_marl.game.rules import IllegalStrokeError

ActionView = Literal["flat", "components"]
MaskView = Literal["observation", "info", "none"]  # place of the mask: dictionary, info, or none
InfoView = Literal["full", "none"]  # content of the info: the last stroke, with text and None, or numbers only

_ENDS: Final = np.cumsum([*PARTS, N_POSITIONS])  # ends of the masks of the components


class _Wrapper(OrderEnforcingWrapper[str, Any, Any]):
    """A wrapper that can be forked."""

    env: Any

    def fork(self, seed: int | None = None, belief: Belief = None) -> Self:
        """Copy with fresh luck; see :meth:`shuttle_marl.env.aec.ShuttleEnv.fork`."""
        twin = copy.copy(self)
        twin.env = self.env.fork(seed, belief)
        return twin

    def __str__(self) -> str:
        return str(self.env)


class CheckedEnv(_Wrapper):
    """PettingZoo's checks in one wrapper: the order of calls, actions out of bounds, illegal strokes.

    An illegal stroke ends the episode: -1 for the striker, +1 for the other agent, and ``info["reason"]`` is ``illegal stroke``;
    an illegal position likewise. PettingZoo's ``TerminateIllegalWrapper`` gives the other agent no reward, so the game would not
    be zero-sum; and three nested wrappers take three times as long as the environment.
    """

    env: ShuttleEnv

    def last(self, observe: bool = True) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated and info of the agent to move."""
        if not self._has_reset:
            EnvLogger.error_observe_before_reset()
        raw = self.env
        agent = raw.agent_selection
        return (
            self.observe(agent) if observe else None,
            raw._cumulative_rewards[agent],
            raw.terminations[agent],
            raw.truncations[agent],
            raw.infos[agent],
        )

    def step(self, action: Any) -> None:
        """Play a stroke; an illegal one loses the episode. Raises ActionError: the action is not in the action space."""
        try:
            super().step(action)
        except IllegalStrokeError as illegal:
            self._lose(illegal.stroke)

    def _lose(self, stroke: int | None) -> None:
        EnvLogger.warn_on_illegal_move()
        self.env.forfeit(stroke)


class ComponentEnv(CheckedEnv):
    """Actions as (shot type, area, height, technique), ``MultiDiscrete([13, 9, 2, 3])``; with recovery a position is the fifth.

    ``action_mask`` is the concatenation of four masks, 13 + 9 + 2 + 3 = 27 int8: the shot types, areas, heights and
    techniques of the legal strokes. It is a relaxation: four allowed components may not form a legal stroke, and an illegal
    stroke loses the episode. :func:`component_masks` splits it into the masks of ``MultiDiscrete.sample``. In the game with
    recovery it has nine more numbers; components that are not asked for, those of a stroke or the position, have an empty mask
    and are ignored.
    """

    def __init__(self, env: ShuttleEnv) -> None:
        super().__init__(env)
        catalogue = env.game.catalogue
        columns = np.stack([catalogue.shot, catalogue.area, catalogue.height, catalogue.technique], axis=1)
        self._by_parts = catalogue.by_parts
        self._parts = (*PARTS, N_POSITIONS)[: len(PARTS) + env.game.hides]
        n, width, positions = len(catalogue), sum(self._parts), sum(self._parts[len(PARTS) :])
        self._occurs = np.zeros((n + positions, width), dtype=np.int8)
        self._occurs[np.arange(n)[:, None], columns + np.r_[0, _ENDS[: len(PARTS) - 1]]] = 1
        self._occurs[n:, STROKE_WIDTH:] = np.eye(positions, dtype=np.int8)
        self._action_spaces = {agent: spaces.MultiDiscrete(list(self._parts)) for agent in env.possible_agents}
        mask = spaces.Box(0, 1, (width,), np.int8)
        self._observation_spaces = {
            agent: spaces.Dict({"observation": env.observation_spaces[agent]["observation"], "action_mask": mask})
            for agent in env.possible_agents
        }

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """``MultiDiscrete([13, 9, 2, 3])``, or ``[13, 9, 2, 3, 9]``."""
        return self._action_spaces[agent]

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The observation of the flat view, and a mask of 27, or 36."""
        return self._observation_spaces[agent]

    def observe(self, agent: str) -> Observation:
        """The observation of the flat view, and the concatenated masks of the components."""
        seen = super().observe(agent)
        legal = self._occurs[seen["action_mask"].astype(bool)]
        return {"observation": seen["observation"], "action_mask": legal.max(axis=0, initial=0)}

    def step(self, action: npt.ArrayLike | None) -> None:
        """Play a stroke of four components, one outside the catalogue as an illegal one, or choose the position, the fifth.

        Raises:
            ActionError: the action is not in the action space.
        """
        if action is None:
            super().step(None)
            return
        if not self._action_spaces[self.agent_selection].contains(np.asarray(action)):
            position = " (and position)" if len(self._parts) > len(PARTS) else ""
            raise ActionError(
                f"action {action!r}: expected shot type, area, height and technique{position}, each below {self._parts}"
            )
        parts = np.asarray(action)
        if self.env.chooses_position:
            super().step(self.env.game.n_strokes + int(parts[-1]))
            return
        stroke = int(self._by_parts[tuple(parts[: len(PARTS)])])
        if stroke < 0 and not (self.terminations[self.agent_selection] or self.truncations[self.agent_selection]):
            self._has_updated = True
            self._lose(None)
        else:
            super().step(stroke)


class PlainEnv(_Wrapper):
    """View of observations and infos for libraries that need a plain ``Box``, or only numbers in the info."""

    def __init__(self, env: CheckedEnv, mask: MaskView, info: InfoView) -> None:
        super().__init__(env)
        self._mask, self._info = mask, info
        self._full: Any = None
        self._views: dict[str, dict[str, Any]] = {}
        self._spaces = {
            agent: env.observation_space(agent) if mask == "observation" else env.observation_space(agent)["observation"]
            for agent in env.possible_agents
        }

    @property
    def infos(self) -> dict[str, dict[str, Any]]:
        """Infos of both agents. Raises AttributeError: no episode has started."""
        full = self.__getattr__("infos")
        if full is not self._full:
            # Cached until the next stroke: callers compare infos, and dictionaries with arrays are equal only if identical.
            self._full, self._views = full, {agent: self._view_of(agent, info) for agent, info in full.items()}
        return {agent: self._views[agent] for agent in full}

    def _view_of(self, agent: str, full: dict[str, Any]) -> dict[str, Any]:
        view = dict(full) if self._info == "full" else {}
        if self._mask == "info":
            view["action_mask"] = self.env.observe(agent)["action_mask"]
        return view

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The same object at every call."""
        return self._spaces[agent]

    def observe(self, agent: str) -> Any:
        """Observation of an agent, without the mask unless ``mask="observation"``."""
        seen = super().observe(agent)
        return seen if self._mask == "observation" else seen["observation"]


def checked_views(mask: MaskView, info: InfoView | None) -> InfoView:
    """The view of the info, by default full with ``mask="observation"``, else none. Raises OptionError: an unknown view."""
    if mask not in ("observation", "info", "none"):
        raise OptionError(f"mask {mask!r}: expected 'observation', 'info' or 'none'")
    if info not in (None, "full", "none"):
        raise OptionError(f"info {info!r}: expected 'full' or 'none'")
    return info or ("full" if mask == "observation" else "none")


def without_parallel(module: str, known: list[str]) -> Callable[[str], Any]:
    """``__getattr__`` of a module of an environment, whose players strike in turn."""

    def missing(name: str) -> Any:
        parallel = "; players strike in turn, so there is no parallel environment: use env()"
        hint = parallel if "parallel" in name else did_you_mean(name, known)
        raise AttributeError(f"module {module!r} has no attribute {name!r}{hint}")

    return missing


def component_masks(mask: I8) -> tuple[I8, ...]:
    """Split a ``[27]`` or ``[36]`` mask into those of shot type, area, height and technique, and of the position."""
    return tuple(np.split(mask, _ENDS[len(mask) > _ENDS]))


def wrapped(raw: ShuttleEnv, action: ActionView, mask: MaskView, info: InfoView | None) -> CheckedEnv | PlainEnv:
    """A raw environment with PettingZoo's checks. Raises OptionError: an unknown view of the action, the mask or the info."""
    shown = checked_views(mask, info)
    if action not in ("flat", "components"):
        raise OptionError(f"action {action!r}: expected 'flat' or 'components'")
    checked = CheckedEnv(raw) if action == "flat" else ComponentEnv(raw)
    return checked if (mask, shown) == ("observation", "full") else PlainEnv(checked, mask, shown)
