"""``python -m shuttle_marl.league``: a round robin between policies."""

import shlex
from collections.abc import Sequence
from typing import Final

import tyro

from shuttle_marl.commands import cli
from shuttle_marl.errors import printable
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.folder import RALLIES
from shuttle_marl.league.report import console_table
from shuttle_marl.league.run import run_league


def play(config: tyro.conf.OmitArgPrefixes[LeagueConfig]) -> None:
    """Play a round robin and print the ranked table."""
    run = run_league(config, cli.console(stderr=True))
    out = cli.console()
    out.print(console_table(run.standings))
    out.print(f"run folder: {printable(str(run.folder))}", soft_wrap=True)
    log = run.folder / RALLIES
    if log.exists():
        out.print(f"watch it: python -m shuttle_marl.watch --replay {shlex.quote(printable(str(log)))}", soft_wrap=True)


COMMANDS: Final = play


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    description = (
        "A round robin between policies: every pair plays the same number of matches, seats and first serve balanced. "
        "Writes a run folder with results, ratings, a report and every rally played."
    )
    return cli.run(COMMANDS, prog="python -m shuttle_marl.league", description=description, argv=argv)
