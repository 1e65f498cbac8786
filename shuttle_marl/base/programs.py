"""Programs in any language that answer messages: groups of processes with a time limit."""

import contextlib
import os
import select
import shlex
import signal
import subprocess
import tempfile
import time
import weakref
from collections.abc import Sequence
from typing import IO, Final

from shuttle_marl.base.errors import ShuttleError, printable

_CHUNK: Final = 1 << 16  # most bytes that are read at once, and length of the longest line [bytes]
_STDERR_SHOWN: Final = 300


class ProgramError(ShuttleError):
    """A program that cannot be started, exited, or gave an invalid answer."""


class ProgramTimeoutError(ProgramError):
    """A program that exceeded its time limit."""


class Program:
    """A program that reads messages from its standard input and writes answers to its standard output.

    It is started without a shell, when the first message is written. A program that fails is killed, with the processes that it
    started, and is not asked again; it is also killed when this object is deleted.

    Args:
        command: program and arguments, in shell syntax or as a list.
        seconds: time limit for each message and each answer; 0 for no limit.

    Raises:
        ProgramError: the command is empty or has an unclosed quote.
    """

    def __init__(self, command: str | Sequence[str], seconds: float = 0.0) -> None:
        try:
            self._command = shlex.split(command) if isinstance(command, str) else list(command)
        except ValueError as error:
            raise ProgramError(str(error)) from error
        if not self._command:
            raise ProgramError("expected a command")
        self._seconds, self._failure = seconds, ""
        self._process: subprocess.Popen[bytes] | None = None
        self._unread = bytearray()

    @property
    def started(self) -> bool:
        """Whether the program was started."""
        return self._process is not None

    def write(self, message: bytes) -> None:
        """Write a message.

        Raises:
            ProgramError: the program cannot be started, has exited, or failed before.
            ProgramTimeoutError: it does not read.
        """
        if self._failure:
            raise ProgramError(f"{self._failure}; it is not asked again")
        if self._process is None:
            self._start()
        rest, end = memoryview(message), self._deadline()
        while rest:
            if not select.select([], [self._stdin], [], _left(end))[1]:
                raise self._late(f"it did not read within {self._seconds:g} s")
            try:
                written = os.write(self._stdin, rest)
            except BlockingIOError:
                continue
            except OSError as error:
                raise self.failed(self._exited()) from error
            rest, end = rest[written:], self._deadline()

    def read_line(self) -> bytes:
        """The next line of its output.

        Raises:
            ProgramError: the program has exited, or the line is too long.
            ProgramTimeoutError: it does not answer.
        """
        end = self._deadline()
        while (length := self._unread.find(b"\n")) < 0:
            if len(self._unread) > _CHUNK:
                raise self.failed(f"it answered a line of more than {_CHUNK:,} bytes")
            self._receive(end)
        line = bytes(self._unread[:length])
        del self._unread[: length + 1]
        return line

    def failed(self, problem: str) -> ProgramError:
        """Kill the program, so that it is not asked again, for instance because its answer is invalid; returns the error."""
        self._failure = problem
        self.close()
        return ProgramError(problem)

    def close(self) -> None:
        """Kill the program."""
        if self._process is not None:
            self._finalize()

    def _start(self) -> None:
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  open while it runs
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                self._command, bufsize=0, stdin=pipe, stdout=pipe, stderr=self._errors, start_new_session=True
            )
        except OSError as error:
            raise self.failed(f"it cannot be started: {self._command[0]}: {error.strerror}") from error
        self._finalize = weakref.finalize(self, _end, process)
        assert process.stdin is not None
        assert process.stdout is not None
        self._process, self._stdin, self._stdout = process, process.stdin.fileno(), process.stdout.fileno()
        os.set_blocking(self._stdin, False)

    def _receive(self, end: float | None) -> None:
        if not select.select([self._stdout], [], [], _left(end))[0]:
            raise self._late(f"no answer within {self._seconds:g} s")
        if not (more := os.read(self._stdout, _CHUNK)):
            raise self.failed(self._exited())
        self._unread += more

    def _late(self, problem: str) -> ProgramTimeoutError:
        return ProgramTimeoutError(str(self.failed(problem)))

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
