"""``python -m shuttle_marl.league``: a tournament; ``… train``: policies that learn; ``… report``: runs compared."""

import dataclasses
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import tyro

from shuttle_marl import league
from shuttle_marl.base.files import replace_file
from shuttle_marl.base.runs import PAGE, RALLIES, interrupts_held
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import Json
from shuttle_marl.game.scoring import RULES, RulesName
from shuttle_marl.game.shipped import Profile
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


def pairs(
    *,
    pairs: Profile,
    players: tuple[str, ...] = (),
    game: str = "default",
    date: str | None = None,
    policy: str | None = None,
    rules: RulesName | None = None,
    data: Path | None = None,
    json_output: Json = False,
) -> None:
    """Predict the result of every pair of real players, each in the game of that pair, beside real results.

    Args:
        pairs: men or women: the players of that discipline.
        players: only these players; of two, the reasons are printed too.
        game: model of the game: a shipped one or a folder.
        date: day of the players' skill, such as 2021-07-31; default: the last one known.
        policy: policy of all players; default: each imitated.
        rules: of the predicted matches, such as 15, 11 or 21x1; default: those of the data if all have the same, else 21.
        data: annotated matches, for the real results: a stroke table, or a folder with the raw files.
    """
    from shuttle_marl.data import read_matches  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.data.matches import rules_of  # noqa: PLC0415
    from shuttle_marl.league.pairs import players_of, predict_pairs, ranked, with_results  # noqa: PLC0415

    strokes = None if data is None else read_matches(data)
    names = players_of(pairs, game, players)
    real = {} if strokes is None or rules is not None else rules_of(strokes)
    kinds = [name for name, those in RULES.items() if those in real.values()]
    rules = rules or (kinds[0] if len(kinds) == 1 else "21")
    if len(kinds) > 1:
        warnings.warn(f"{data}: matches by {', '.join(kinds)}; predicted by {rules}, or by --rules", stacklevel=2)
    found = predict_pairs(names, game=game, date=date, policy=policy, rules=RULES[rules])
    number = len(names) * (len(names) - 1) // 2
    predictions = list(cli.progress(found, "pairs", number))
    if strokes is not None:
        predictions = with_results(predictions, strokes)
    rows = ranked(names, predictions, game, date)
    met = sorted((each for each in predictions if each.matches), key=lambda each: -each.rallies)
    columns = ("real rallies", "real matches") if met else ()
    points = ((name, f"{value:+.2f}") for name, value in predictions[0].reasons.items()) if len(predictions) == 1 else ()
    cli.show(
        {"rules": rules, "players": [dataclasses.asdict(row) for row in rows], "pairs": [*map(dataclasses.asdict, predictions)]},
        json_output,
        cli.table(
            "Predicted against all others",
            ("player", "skill as of", "strokes in the data", "rallies won", "matches won"),
            ((row.name, row.since, row.strokes, row.rally_win, row.match_win) for row in rows),
        ),
        cli.table(
            "Predicted, first player against second",
            ("players", "rallies won", "matches won", *columns),
            (
                (
                    " against ".join(row.players),
                    (row.rally_win, row.rally_low, row.rally_high),
                    (row.match_win, row.match_low, row.match_high),
                    *(f"{row.rallies_won} of {row.rallies}", f"{row.matches_won} of {row.matches}")[: len(columns)],
                )
                for row in met or predictions
            ),
        ),
        cli.table(f"Points of 100 rallies for {predictions[0].players[0]}", ("offset", "points"), points),
    )


COMMANDS: Final = play
PAIRS: Final = "--pairs"
_PROG: Final = "python -m shuttle_marl.league"
_PLAY: Final = (
    "A round robin between policies: every pair plays the same number of matches, seats and first serve balanced. "
    "Writes a run folder with results, ratings, a report and every rally played. "
    f"`{_PROG} train --help`: a league that learns. `{_PROG} {PAIRS} men`: real players against each other. "
    f"`{_PROG} report RUN…`: runs side by side."
)
_TRAIN: Final = (
    "Main agents, main exploiters and league exploiters learn in rounds. After each, policies are frozen, payoffs and "
    "exploitability are solved exactly, and all is saved: --resume continues after the last round."
)
_REPORT: Final = "One HTML file that compares runs: ratings of tournaments, curves of training runs, figures over training seeds."
_PAIRS: Final = (
    "Every pair of real players in its own game: the probability of winning a rally and a match, with the interval of "
    "the players' skill. It predicts results as accurately as ratings do, and is not for selection, contracts or betting."
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    args = list(sys.argv[1:] if argv is None else argv)
    for name, command_of, description in (("train", train, _TRAIN), ("report", report, _REPORT)):
        if args[:1] == [name]:
            return cli.run(command_of, prog=f"{_PROG} {name}", description=description, argv=args[1:])
    if any(arg.partition("=")[0] == PAIRS for arg in args):
        return cli.run(pairs, prog=_PROG, description=_PAIRS, argv=args)
    return cli.run(COMMANDS, prog=_PROG, description=_PLAY, argv=args)
