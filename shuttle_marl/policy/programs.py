"""Programs in any language that play, ``program:COMMAND``: groups of processes that answer in lines, under a time limit."""

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

from shuttle_marl.base.arrays import F64
from shuttle_marl.base.errors import printable
from shuttle_marl.game.policy import PolicyError, States
from shuttle_marl.game.stroke import HEIGHTS
from shuttle_marl.game.tables import Game

PROTOCOL: Final = 1  # version of the messages
_AHEAD: Final = 64  # number of decisions that are sent before their answers are read, so few that all answers fit into a pipe
_CHUNK: Final = 1 << 16  # most bytes that are read at once, and length of the longest line [bytes]
_STDERR_SHOWN: Final = 300


class ProgramPolicy:
    """A program in any language that chooses every stroke, ``program:COMMAND``.

    The program is started without a shell on first use and reads lines from its standard input. The first line describes the
    game; every other line is a decision, which it answers with one line, in order:

        {"type": "game", "protocol": 1, "game": "9055…", "strokes": ["short-serve:…", …]}
        {"type": "stroke", "id": 7, "own": null, "incoming": "clear:…", "contact": "above", "hurried": false, "duel": 0,
         "effort": [0, 1], "score": [11, 9, 0, 1], "legal": ["smash:…", …]}

        {"id": 7, "stroke": "smash:…"}
        {"id": 7, "probabilities": {"smash:…": 0.7, "clear:…": 0.3}}

    ``own`` and ``incoming`` are strokes or null; ``hurried`` says whether the striker is late or stretched; ``effort`` is that of
    the striker and of the opponent; ``score`` is the striker's points, the opponent's points, the striker's games, the opponent's
    games, or null outside of a match. Decisions come in batches from many matches at once. A program that exits, gives an invalid
    answer, or exceeds the time limit for a stroke is killed, with the processes that it started, and not asked again; it is also
    killed when this object is deleted.

    Args:
        command: program and arguments in shell syntax; no shell is started.
        seconds: time limit for each stroke; 0 for no limit.

    Raises:
        PolicyError: the command is empty or has an unclosed quote.
    """

    reads_score: Final = True

    def __init__(self, command: str, game: Game, seconds: float) -> None:
        try:
            self._command = shlex.split(command)
            if not self._command:
                raise ValueError("expected a command")
        except ValueError as error:
            raise PolicyError(f"policy program:{command}: {error}, as in program:./player") from error
        self._game, self._seconds, self._failure = game, seconds, ""
        self._index = {name: i for i, name in enumerate(game.catalogue.names)}
        self._process: subprocess.Popen[bytes] | None = None
        self._unread, self._sent = bytearray(), 0

    def probabilities(self, states: States) -> F64:
        """``[B, n]`` probabilities of the answers; 1 for a stroke that the program names.

        Raises:
            PolicyError: the program cannot be started, exited, timed out, or gave an invalid answer.
        """
        if self._failure:
            raise PolicyError(f"{self._failure}; it is not asked again")
        if self._process is None:
            self._start()
            strokes = list(self._game.catalogue.names)
            self._send([{"type": "game", "protocol": PROTOCOL, "game": self._game.hash, "strokes": strokes}])
        found = np.zeros((len(states), self._game.n_strokes))
        for first in range(0, len(states), _AHEAD):
            rows = range(first, min(first + _AHEAD, len(states)))
            self._send([self._decision(states, row) for row in rows])
            for row in rows:
                self._read(found[row], self._sent - len(rows) + (row - first))
        return found

    def close(self) -> None:
        """Kill the program."""
        if self._process is not None:
            self._finalize()

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
            "hurried": bool(states.hurried[row]),
            "duel": int(states.duel[row]),
            "effort": [int(states.effort[row]), int(states.opponent_effort[row])],
            "score": None if states.score is None else states.score[row].tolist(),
            "legal": [names[k] for k in self._game.legal_strokes(state)],
        }

    def _read(self, probability: F64, number: int) -> None:
        line = self._line()
        try:
            answer = json.loads(line)
            if answer["id"] != number:
                raise self._failed(f"it answered {answer['id']!r:.40} where the answer to {number} was expected")
            shares = answer["probabilities"] if "probabilities" in answer else {answer["stroke"]: 1.0}
            for name, share in shares.items():
                probability[self._index[name]] = share
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            shown = line[:80].decode(errors="backslashreplace")
            raise self._failed(f"it answered {shown!r}; expected an id and a stroke or probabilities of strokes") from error

    def _send(self, messages: list[dict[str, Any]]) -> None:
        rest, end = memoryview(b"".join(json.dumps(message).encode() + b"\n" for message in messages)), self._deadline()
        while rest:
            if not select.select([], [self._stdin], [], _left(end))[1]:
                raise self._late("it did not read")
            try:
                written = os.write(self._stdin, rest)
            except BlockingIOError:
                continue
            except OSError as error:
                raise self._failed(self._exited()) from error
            rest, end = rest[written:], self._deadline()

    def _line(self) -> bytes:
        """The next line of its output."""
        end = self._deadline()
        while (length := self._unread.find(b"\n")) < 0:
            if len(self._unread) > _CHUNK:
                raise self._failed(f"it answered a line of more than {_CHUNK:,} bytes")
            if not select.select([self._stdout], [], [], _left(end))[0]:
                raise self._late("no answer")
            if not (more := os.read(self._stdout, _CHUNK)):
                raise self._failed(self._exited())
            self._unread += more
        line = bytes(self._unread[:length])
        del self._unread[: length + 1]
        return line

    def _failed(self, problem: str) -> PolicyError:
        """Kill the program, so that it is not asked again, and return the error."""
        self._failure = problem
        self.close()
        return PolicyError(problem)

    def _late(self, problem: str) -> PolicyError:
        return PolicyError(f"{self._failed(f'{problem} within {self._seconds:g} s')}; --policy-timeout gives more time")

    def _start(self) -> None:
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  open while it runs
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                self._command, bufsize=0, stdin=pipe, stdout=pipe, stderr=self._errors, start_new_session=True
            )
        except OSError as error:
            raise self._failed(f"it cannot be started: {self._command[0]}: {error.strerror}") from error
        self._finalize = weakref.finalize(self, _end, process)
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._stdin, self._stdout = process, process.stdin.fileno(), process.stdout.fileno()
        os.set_blocking(self._stdin, False)

    def _deadline(self) -> float | None:
        return time.monotonic() + self._seconds if self._seconds else None

    def _exited(self) -> str:
        assert self._process is not None
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1)
        status = self._process.returncode
        how = "it closed its output" if status is None else f"it exited with status {status}"
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - _STDERR_SHOWN))
        said = printable(self._errors.read().decode(errors="backslashreplace").strip(), keep="\n")
        return f"{how}: …{said}" if said else how


def _left(end: float | None) -> float | None:
    return None if end is None else max(0.0, end - time.monotonic())


def _end(process: "subprocess.Popen[bytes]") -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):
                pipe.close()
    process.wait()
