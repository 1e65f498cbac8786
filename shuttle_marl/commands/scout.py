"""Scouting reports: how to play against an opponent."""

from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import ReportOptions, hands_told
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.reports.languages import speaking

_OUTPUT: Final = ReportOptions()


def scout(
    player: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[PLAYER]")] = None,
    opponent: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[OPPONENT]")] = None,
    *,
    data: Path | None = None,
    rules: RulesName | None = None,
    game: str = "default",
    date: str | None = None,
    list_players: Annotated[bool, tyro.conf.arg(name="list")] = False,
    output: tyro.conf.OmitArgPrefixes[ReportOptions] = _OUTPUT,
) -> None:
    """Write a scouting report: a page for the player, how the opponent plays, and where the opponent can be hurt.

    Args:
        player: name of the player to prepare; without an opponent, of the player to describe.
        opponent: name of the opponent to describe.
        data: annotated matches, for counted habits: a stroke table, or a folder with the raw files.
        rules: of these matches, such as 15, 11 or 21x1; default: those of the table, or of its scores.
        game: model of the game: a shipped one or a folder.
        date: day of the players' skill, such as 2021-07-31; default: the last one known.
        list_players: list the players of the model instead.
        output: what is written.
    """
    from shuttle_marl.court.clips import scout_clips  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.reports.coach import scouting_report  # noqa: PLC0415
    from shuttle_marl.reports.habits import plain  # noqa: PLC0415
    from shuttle_marl.reports.scouting import players_of  # noqa: PLC0415

    if list_players:
        listed = players_of(game)
        rows = ((p.name, p.discipline, p.strokes, p.matches, str(p.last), "yes" if p.imitated else "no") for p in listed)
        headings = ("player", "discipline", "strokes", "matches", "last match", "own choices")
        cli.show({"players": [plain(each) for each in listed]}, output.json_output, cli.table("Players", headings, rows))
        return
    if player is None:
        raise ShuttleError("scout: expected PLAYER OPPONENT, or one player, or --list")
    cli.check_suffix(output.out, ".html")
    options: dict[str, Any] = {"rules": rules, "date": date, "model": game}
    with hands_told(output.hand), cli.working("analysing the match-up"), speaking(output.language):
        report = scouting_report(player, opponent, data=data, clips=scout_clips, **options)
    output.write(report, "scout.html")


COMMANDS: Final = scout
main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl scout", __doc__ or "")
