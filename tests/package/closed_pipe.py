"""A command whose reader closes its output."""

import subprocess
from collections.abc import Sequence


def check_closed_pipe(command: Sequence[str]) -> None:
    """Check that the command ends without a word, with the status of a closed pipe."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        program.stdout.close()
        assert program.stderr.read() == ""
        assert program.wait(60) == 141
