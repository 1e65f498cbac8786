"""Programs of users as policies, in any language: ``program:COMMAND``, a line of JSON for every stroke.

The program is started without a shell when it is first asked, and reads lines from its standard input. The first one describes
the game, every other one is a decision; to each of these it answers with one line, in their order:

    {"type": "game", "protocol": 1, "game": "9055…", "strokes": ["short-serve:…", …]}
    {"type": "stroke", "id": 7, "own": null, "incoming": "clear:…", "contact": "above", "duel": 0, "effort": [0, 1],
     "score": [11, 9, 0, 1], "legal": ["smash:…", …]}

    {"id": 7, "stroke": "smash:…"}
    {"id": 7, "probabilities": {"smash:…": 0.7, "clear:…": 0.3}}

``own`` and ``incoming`` are strokes, null for none; ``effort`` is that of the striker and of the opponent; ``score`` the
striker's points, the opponent's, the striker's games, the opponent's; null outside of a match. Decisions come in batches, of
many matches at once. A program that exits, answers something else, or takes longer than the time limit for a stroke is ended
and not asked again.
"""

import contextlib
import json
import os
import select
import shlex
import signal
import subprocess
import tempfile
import time
import weakref
from typing import IO, Any, Final

import numpy as np

from shuttle_marl.arrays import F64
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.game.tables import Game
from shuttle_marl.policy.foreign import current_limit

PROTOCOL: Final = 1
_AHEAD: Final = 64
"""Number of decisions that are sent before their answers are read, so few that all answers fit into a pipe."""
_LONGEST: Final = 1 << 16
"""Length of the longest answer [bytes]."""
_STDERR_SHOWN: Final = 300
"""Length of the end of the standard error of a program that messages quote [bytes]."""


class ProgramPolicy:
    """A program that chooses every stroke.

    Args:
        command: program and arguments in shell syntax; no shell is started.
        game: the tables.
        seconds: time limit for each stroke; 0 for no limit.

    Raises:
        PolicyError: the command is empty or has an unclosed quote.
    """

    reads_score: Final = True
    limits_itself: Final = True

    def __init__(self, command: str, game: Game, seconds: float) -> None:
        try:
            self._command = shlex.split(command)
        except ValueError as error:
            raise PolicyError(f"policy program:{command}: {error}") from error
        if not self._command:
            raise PolicyError("policy program: expected a command behind the colon, as in program:./player")
        self._game, self._seconds = game, seconds
        self._index = {name: i for i, name in enumerate(game.catalogue.names)}
        self._process: subprocess.Popen[bytes] | None = None
        self._failure = ""
        self._sent = 0
        self._unread = b""

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probabilities of the answers; 1 for a stroke that the program names.

        Raises:
            PolicyError: the program cannot be started, exited, timed out, or gave an invalid answer.
        """
        if self._failure:
            raise PolicyError(f"{self._failure}; it is not asked again")
        try:
            if self._process is None:
                self._start()
            found = np.zeros((len(states), self._game.n_strokes))
            for first in range(0, len(states), _AHEAD):
                rows = range(first, min(first + _AHEAD, len(states)))
                self._send([self._decision(states, row) for row in rows])
                for row in rows:
                    self._read(found[row], self._sent - len(rows) + (row - first))
            return found
        except PolicyError as error:
            self._failure = str(error)
            self.close()
            raise

    def close(self) -> None:
        """Kill the program."""
        if self._process is not None:
            _end(self._process)

    def _start(self) -> None:
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  open as long as the program runs
        try:
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, start_new_session=True
            )
        except OSError as error:
            raise PolicyError(f"it cannot be started: {self._command[0]}: {error.strerror}") from error
        weakref.finalize(self, _end, self._process)
        assert self._process.stdin is not None
        os.set_blocking(self._process.stdin.fileno(), False)
        game = self._game
        self._send([{"type": "game", "protocol": PROTOCOL, "game": game.hash, "strokes": list(game.catalogue.names)}])

    def _decision(self, states: States, row: int) -> dict[str, Any]:
        names, n = self._game.catalogue.names, self._game.n_strokes
        state = int(states.state[row])
        own, incoming = int(states.own[row]), int(states.incoming[row])
        self._sent += 1
        return {
            "type": "stroke",
            "id": self._sent - 1,
            "own": None if own == n else names[own],
            "incoming": None if incoming == n else names[incoming],
            "contact": HEIGHTS[int(states.contact[row])],
            "duel": int(states.duel[row]),
            "effort": [int(states.effort[row]), int(states.opponent_effort[row])],
            "score": None if states.score is None else states.score[row].tolist(),
            "legal": [names[k] for k in self._game.legal_strokes(state)],
        }

    def _send(self, messages: list[dict[str, Any]]) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        pipe = self._process.stdin.fileno()
        rest = memoryview(b"".join(json.dumps(message).encode() + b"\n" for message in messages))
        end = self._deadline()
        while rest:
            if not select.select([], [pipe], [], _left(end))[1]:
                raise PolicyError(f"it did not read within {self._seconds:g} s; --policy-timeout gives more time")
            try:
                written = os.write(pipe, rest)
            except BlockingIOError:
                continue
            except OSError as error:
                raise PolicyError(self._exited()) from error
            rest, end = rest[written:], self._deadline()

    def _deadline(self) -> float | None:
        return time.monotonic() + self._seconds if self._seconds else None

    def _read(self, probability: F64, number: int) -> None:
        """Read the answer to a decision into a row of probabilities."""
        line = self._line()
        try:
            answer = json.loads(line)
            if answer["id"] != number:
                raise PolicyError(f"it answered {answer['id']!r:.40} where the answer to {number} was expected")
            shares = answer["probabilities"] if "probabilities" in answer else {answer["stroke"]: 1.0}
            for name, share in shares.items():
                probability[self._index[name]] = share
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            shown = line[:80].decode(errors="backslashreplace")
            raise PolicyError(f"it answered {shown!r}; expected an id and a stroke or probabilities of strokes") from error

    def _line(self) -> bytes:
        assert self._process is not None
        assert self._process.stdout is not None
        pipe, end = self._process.stdout.fileno(), self._deadline()
        while b"\n" not in self._unread:
            if len(self._unread) > _LONGEST:
                raise PolicyError(f"it answered a line of more than {_LONGEST:,} bytes")
            if not select.select([pipe], [], [], _left(end))[0]:
                raise PolicyError(f"no answer within {self._seconds:g} s; --policy-timeout gives more time")
            more = os.read(pipe, _LONGEST)
            if not more:
                raise PolicyError(self._exited())
            self._unread += more
        line, self._unread = self._unread.split(b"\n", 1)
        return line

    def _exited(self) -> str:
        """Message about a program that closed its pipes."""
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1)
        status = self._process.poll()
        how = "it closed its output" if status is None else f"it exited with status {status}"
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - _STDERR_SHOWN))
        said = self._errors.read().decode(errors="backslashreplace").strip()
        return f"{how}: …{said}" if said else how


def load(command: str | None, game: Game) -> ProgramPolicy:
    """A program as a policy, under the time limit of the context.

    Raises:
        PolicyError: there is no command.
    """
    return ProgramPolicy(command or "", game, current_limit())


def _left(end: float | None) -> float | None:
    return None if end is None else max(0.0, end - time.monotonic())


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Kill a program and its children."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    process.wait()
