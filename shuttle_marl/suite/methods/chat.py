"""Baselines of ``text``: policies by name, and chat models through a command."""

import random

import numpy as np

from shuttle_marl.base.programs import Program
from shuttle_marl.env.words import Position, prompt, read_answer
from shuttle_marl.game.policy import States, checked_probabilities
from shuttle_marl.policy.registry import resolve
from shuttle_marl.suite.options import SuiteError
from shuttle_marl.suite.text import SECONDS, TextSetting


class Random:
    """A random legal stroke."""

    def __init__(self, setting: TextSetting) -> None:
        self._random = random.Random(setting.seed)

    def answer(self, position: Position) -> str:
        """One of the legal strokes."""
        return self._random.choice(position["legal"])


class Policy:
    """The likeliest stroke of a policy of the game, whose name is the argument."""

    def __init__(self, setting: TextSetting, argument: str = "bc") -> None:
        self._game, self._policy = setting.game, resolve(argument, setting.game)

    def answer(self, position: Position) -> str:
        """Its likeliest legal stroke; the first one in the catalogue if several are."""
        state = self._game.state_of(*position["observation"])
        chance = checked_probabilities(self._policy, States(game=self._game, state=np.atleast_1d(state)))[0]
        return self._game.catalogue.names[int(chance.argmax())]


class Chat:
    """Any chat model: the argument is a command that reads a prompt from standard input and writes an answer.

    It is a program and its arguments in shell syntax; no shell is started.
    """

    def __init__(self, setting: TextSetting, argument: str = "") -> None:  # noqa: ARG002
        if not argument:
            raise SuiteError("expected chat:COMMAND, a command that reads a prompt and writes an answer")
        self._command = argument

    def answer(self, position: Position) -> str | None:
        """The stroke that the model names; None if it names none.

        Raises:
            ProgramError: the command cannot be started, fails, or exceeds the time limit.
        """
        program = Program(self._command, SECONDS)
        program.write(prompt(position).encode())
        return read_answer(program.read_rest().decode(errors="replace"), position["legal"])
