"""Rallies for language models: observations are positions in words, actions are sentences that name a stroke.

A position is also what the task ``text-v0`` asks about. ``TextRallyEnv`` is a Gymnasium environment against an opponent,
``text_env()`` a PettingZoo environment of two players. An action that names no legal stroke loses the rally, as illegal strokes
do in ``rally_v0``.
"""

import string
from collections.abc import Sequence
from typing import Any, Final, TypedDict

import gymnasium
from gymnasium import spaces

from shuttle_marl.env import rally_v0
from shuttle_marl.env.aec import CheckedEnv
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.snapshot import area_in_words
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.game.tables import Game

OVER: Final = "The rally is over."
WAIT: Final = "Your opponent strikes."
WORDS: Final = spaces.Text(1 << 16, charset=string.printable)


class Position(TypedDict):
    """A position: number, description, names of the legal strokes, and the numbers of the state."""

    id: int
    text: str
    legal: list[str]
    observation: list[int]


def position(game: Game, state: int, number: int = 0) -> Position:
    """A state as a position."""
    legal = [game.catalogue.names[stroke] for stroke in game.legal_strokes(state)]
    return {"id": number, "text": described(game, state), "legal": legal, "observation": game.observation(state).tolist()}


def described(game: Game, state: int) -> str:
    """A state in words, from the view of the striker."""
    own, incoming, contact, duel, effort, other, hurried = game.observation(state).tolist()
    if incoming == game.n_strokes:
        return "You serve."
    words = [f"Your opponent played: {_stroke(game, incoming)}. You reach the shuttle {HEIGHTS[contact]} the net."]
    if hurried:
        words.append("You are hurried: late or stretched.")
    if own < game.n_strokes:
        words.append(f"Your own last stroke was: {_stroke(game, own)}.")
    if duel > 1:
        words.append(f"The last {duel} strokes were net shots.")
    if game.levels > 1:
        words.append(f"Attacks so far in this rally, counted up to {game.levels - 1}: you {effort}, your opponent {other}.")
    return " ".join(words)


def _stroke(game: Game, stroke: int) -> str:
    shot, _, height, technique = game.catalogue.names[stroke].split(":")
    area = area_in_words(game.catalogue, stroke)
    return f"{shot.replace('-', ' ')} to the {area}, hit {height} the net, {technique.replace('-', ' ')}"


RULES: Final = (
    "You are playing a rally of badminton singles. Strokes are named SHOT:TARGET:CONTACT:TECHNIQUE; targets are areas of the "
    "opponent's half, right is the opponent's forehand side and left the backhand side. A stroke ends as one of: "
    f"{'; '.join(OUTCOMES)}. Choose the stroke that wins the rally most often. "
    "Answer with the name of one legal stroke and nothing else."
)


def prompt(place: Position) -> str:
    """A position as a question to a chat model."""
    return f"{RULES}\n\n{place['text']}\n\nLegal strokes: {', '.join(place['legal'])}\n"


def read_answer(text: str, legal: Sequence[str]) -> str | None:
    """The last legal stroke that an answer names; None if it names none."""
    found = [(text.rfind(name), name) for name in legal if name in text]
    return max(found)[1] if found else None


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
        return words(self.rally.game, self.rally.state_number), info

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Play the stroke that an answer names; see :meth:`shuttle_marl.env.single.SingleEnv.step`."""
        stroke = stroke_of(self.rally.game, self.rally.state_number, action)
        _, reward, over, cut, info = self.rally.step(stroke)
        return OVER if over else words(self.rally.game, self.rally.state_number), reward, over, cut, info


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
