"""Rallies for language models: observations are the words of ``text-v0``, actions are sentences that name a stroke.

``TextRallyEnv`` is a Gymnasium environment against an opponent, ``text_env()`` a PettingZoo environment of two players. An action
that names no legal stroke loses the rally, as illegal strokes do in ``rally_v0``.
"""

import string
from typing import Any, Final

import gymnasium
from gymnasium import spaces

from shuttle_marl.env import rally_v0
from shuttle_marl.env.aec import CheckedEnv
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.game.tables import Game
from shuttle_marl.suite.text import position, prompt, read_answer

OVER: Final = "The rally is over."
WAIT: Final = "Your opponent strikes."
WORDS: Final = spaces.Text(1 << 16, charset=string.printable)


def stroke_of(game: Game, state: int, answer: str) -> int:
    """Catalogue index of the last legal stroke that an answer names; of an illegal stroke if it names none."""
    legal = {game.catalogue.names[stroke]: int(stroke) for stroke in game.legal_strokes(state)}
    name = read_answer(answer, list(legal))
    return int(game.mask(state).argmin()) if name is None else legal[name]


class TextRallyEnv(gymnasium.Env[str, str]):
    """One rally against an opponent, in words.

    Args:
        options: of :class:`shuttle_marl.env.single.SingleRallyEnv`, such as ``opponent`` and ``game``.
    """

    observation_space = WORDS
    action_space = WORDS

    def __init__(self, **options: Any) -> None:
        self.rally = SingleRallyEnv(**options)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[str, dict[str, Any]]:
        """Start the next rally, up to the first stroke of the learner."""
        super().reset(seed=seed)
        _, info = self.rally.reset(seed=seed, options=options)
        return self._words(), info

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Play the stroke that an answer names; see :meth:`shuttle_marl.env.single.SingleEnv.step`."""
        stroke = stroke_of(self.rally.game, self.rally.state_number, action)
        _, reward, over, cut, info = self.rally.step(stroke)
        return OVER if over else self._words(), reward, over, cut, info

    def _words(self) -> str:
        return words(self.rally.game, self.rally.state_number)


def words(game: Game, state: int) -> str:
    """A state as a question, with the legal strokes."""
    return prompt(position(game, state))


def text_env(**options: Any) -> "TextEnv":
    """``rally_v0`` in words, with the options of ``rally_v0.raw_env``."""
    return TextEnv(rally_v0.raw_env(**options))


class TextEnv(CheckedEnv):
    """Observations and actions in words; an agent that does not strike is told to wait."""

    def observation_space(self, agent: str) -> spaces.Text:  # noqa: ARG002
        """Any text."""
        return WORDS

    def action_space(self, agent: str) -> spaces.Text:  # noqa: ARG002
        """Any text."""
        return WORDS

    def observe(self, agent: str) -> Any:
        """The state in words."""
        raw = self._raw
        if raw.terminations.get(agent, True):
            return OVER
        return words(raw.game, raw.state_number) if agent == raw.agent_selection else WAIT

    def step(self, action: str | None) -> None:
        """Play the stroke that an answer names; None after the end of the rally."""
        over = action is None or not self._raw.agents or self._raw.terminations[self._raw.agent_selection]
        super().step(None if over else stroke_of(self._raw.game, self._raw.state_number, str(action)))
