"""``python -m shuttle_marl.league``: a tournament; ``… train``: policies that learn; ``… report``: runs compared."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro

from shuttle_marl import league
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.runs import PAGE, RALLIES, interrupts_held
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import Json
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.training.league.config import LeagueTrainingConfig


def play(config: tyro.conf.OmitArgPrefixes[LeagueConfig]) -> None:
    """Play a round robin and print the ranked table."""
    from shuttle_marl.league.page import console_table  # noqa: PLC0415  keeps --help quick

    run = league.run_league(config, cli.console(stderr=True))
    cli.console().print(console_table(run.standings, config.format))
    cli.say(f"run folder: {run.folder}", f"report: {run.folder / PAGE}")
    log = run.folder / RALLIES
    if log.exists():
        cli.say(cli.watching(log, config.game, None if config.players else config.profile))


def train(config: tyro.conf.OmitArgPrefixes[LeagueTrainingConfig], json_output: Json = False) -> None:
    """Train main agents and exploiters against each other, their past and exact best responses.

    Args:
        config: what to train.
    """
    with interrupts_held():
        from shuttle_marl.training.league.run import MAIN, train_league  # noqa: PLC0415  torch

    done = train_league(config, cli.console(stderr=True))
    figures = {**done.figures, "run": str(done.folder)}
    played = f"The main agent is the least exploitable of {len(figures['curve'])}; played as table:{done.folder / MAIN}"
    cli.show(figures, json_output, played)


def report(runs: Annotated[tuple[Path, ...], tyro.conf.Positional], *, out: Path = Path("report.html")) -> None:
    """Compare finished tournaments and training runs on one page.

    Args:
        runs: their folders.
        out: the HTML file.
    """
    from shuttle_marl.league.page import compare  # noqa: PLC0415  scipy

    replace_file(out, compare(runs))
    cli.say(f"report: {out}")


COMMANDS: Final = play
_PROG: Final = "python -m shuttle_marl.league"
_PLAY: Final = (
    "A round robin between policies: every pair plays the same number of matches, seats and first serve balanced. "
    "Writes a run folder with results, ratings, a report and every rally played. "
    f"`{_PROG} train --help`: a league that learns. "
    f"`{_PROG} report RUN…`: runs side by side."
)
_TRAIN: Final = (
    "Main agents, main exploiters and league exploiters learn in rounds. After each, policies are frozen, payoffs and "
    "exploitability are solved exactly, and all is saved: --resume continues after the last round."
)
_REPORT: Final = "One HTML file that compares runs: ratings of tournaments, curves of training runs, figures over training seeds."


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    args = list(sys.argv[1:] if argv is None else argv)
    for name, command_of, description in (("train", train, _TRAIN), ("report", report, _REPORT)):
        if args[:1] == [name]:
            return cli.run(command_of, prog=f"{_PROG} {name}", description=description, argv=args[1:])
    return cli.run(COMMANDS, prog=_PROG, description=_PLAY, argv=args)
