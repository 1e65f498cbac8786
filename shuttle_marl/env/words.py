"""Rallies for language models: observations are positions in words, actions are sentences that name a stroke.

``TextRallyEnv`` is a Gymnasium environment against an opponent, ``text_env()`` a PettingZoo environment of two players. An
action that names no legal stroke loses the rally, as illegal strokes do in ``rally_v0``. In the game with recovery, who struck is
asked where to wait, and names one of the ``wait:…``.
"""

import string
from collections.abc import Sequence
from typing import Any, Final

import gymnasium
from gymnasium import spaces

from shuttle_marl.env import rally_v0
from shuttle_marl.env.aec import CheckedEnv, ShuttleEnv
from shuttle_marl.env.single import SingleRallyEnv
from shuttle_marl.env.snapshot import area_in_words
from shuttle_marl.game.rally import stepper_of
from shuttle_marl.game.rules import OUTCOMES
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.game.tables import Game

OVER: Final = "The rally is over."
WAIT: Final = "Your opponent strikes."
CHOOSES: Final = "Your opponent chooses where to wait."
WORDS: Final = spaces.Text(1 << 16, charset=string.printable)


def described(game: Game, state: int, *, receiver: bool = False) -> str:
    """A state in words, from the view of the striker, or of the receiver."""
    own, incoming, contact, duel, effort, other, hurried = game.observation(state).tolist()
    if incoming == game.n_strokes:
        return "You serve."
    if receiver:
        effort, other = other, effort
        words = [f"You played: {_stroke(game, incoming)}. Your opponent reaches the shuttle {HEIGHTS[contact]} the net."]
    else:
        words = [f"Your opponent played: {_stroke(game, incoming)}. You reach the shuttle {HEIGHTS[contact]} the net."]
    if hurried:
        words.append(f"{'Your opponent is' if receiver else 'You are'} hurried: late or stretched.")
    if own < game.n_strokes:
        words.append(f"{'The last stroke of your opponent' if receiver else 'Your own last stroke'} was: {_stroke(game, own)}.")
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


WAITING: Final = (
    "You are playing a rally of badminton singles, and have struck. Choose where you wait for the stroke of your opponent, who "
    "does not see it. Places are named wait:DEPTH-SIDE, in your own half: front is at the net, forehand your forehand side. "
    "Choose the one that wins the rally most often. Answer with its name and nothing else."
)


def read_answer(text: str, legal: Sequence[str]) -> str | None:
    """The last legal stroke that an answer names; None if it names none."""
    found = [(text.rfind(name), name) for name in legal if name in text]
    return max(found)[1] if found else None


def action_of(game: Game, state: int, answer: str, *, receiver: bool = False) -> int:
    """The last legal stroke, or position of the receiver, that an answer names; an illegal action if it names none."""
    stepper = stepper_of(game)
    mask = stepper.position_mask(state) if receiver else stepper.legal_action_mask(state)
    legal = {stepper.game.action_names[action]: action for action in mask.nonzero()[0].tolist()}
    name = read_answer(answer, list(legal))
    return int(mask.argmin()) if name is None else legal[name]


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
        return words_to_mover(self.rally.raw), info

    def step(self, action: str) -> tuple[str, float, bool, bool, dict[str, Any]]:
        """Do what an answer names; see :meth:`shuttle_marl.env.single.SingleEnv.step`."""
        raw = self.rally.raw
        chosen = action_of(raw.game, raw.state_number, action, receiver=raw.chooses_position)
        _, reward, over, cut, info = self.rally.step(chosen)
        return OVER if over else words_to_mover(raw), reward, over, cut, info


def words(game: Game, state: int) -> str:
    """A state as a question, with the legal strokes."""
    legal = [game.catalogue.names[stroke] for stroke in game.legal_strokes(state)]
    return f"{RULES}\n\n{described(game, state)}\n\nLegal strokes: {', '.join(legal)}\n"


def words_to_mover(raw: ShuttleEnv) -> str:
    """The question to the agent to move: which stroke, or where to wait."""
    game, state = raw.game, raw.state_number
    if not raw.chooses_position:
        return words(game, state)
    stepper = stepper_of(game)
    names = [stepper.game.action_names[action] for action in stepper.position_mask(state).nonzero()[0]]
    return f"{WAITING}\n\n{described(game, state, receiver=True)}\n\nPlaces: {', '.join(names)}\n"


def text_env(**options: Any) -> "TextEnv":
    """``rally_v0`` in words, with the options of ``rally_v0.raw_env``."""
    return TextEnv(rally_v0.raw_env(**options))


class TextEnv(CheckedEnv):
    """Observations and actions in words; an agent that is not to act is told so."""

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
        return words_to_mover(raw) if agent == raw.agent_selection else CHOOSES if raw.chooses_position else WAIT

    def step(self, action: str | None) -> None:
        """Do what an answer names; None after the end of the rally."""
        raw = self._raw
        over = action is None or not raw.agents or raw.terminations[raw.agent_selection]
        super().step(None if over else action_of(raw.game, raw.state_number, str(action), receiver=raw.chooses_position))
