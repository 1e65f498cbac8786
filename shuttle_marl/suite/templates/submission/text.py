"""A method for text-v0: net kills and smashes if they are legal, else the first legal stroke.

A program in any language reads positions as lines of JSON and answers with lines: ``--method program:COMMAND``. A chat model is
any command that reads a prompt and prints an answer: ``--method chat:COMMAND``.
"""

from typing import Any


class Player:
    """Answers positions."""

    def answer(self, position: Any) -> str:
        """The name of one of ``position["legal"]``; ``position["text"]`` is the position in words."""
        attacks = [name for name in position["legal"] if name.startswith(("net-kill", "smash"))]
        return (attacks or position["legal"])[0]
