"""Scouting reports: how to play against an opponent."""

import dataclasses
from pathlib import Path
from typing import Annotated, Final

import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import HandsTold, Json, hands_told
from shuttle_marl.commands.reports import write_figures, write_report
from shuttle_marl.pages.languages import Language, speaking


def scout(
    player: Annotated[str | None, tyro.conf.Positional] = None,
    opponent: Annotated[str | None, tyro.conf.Positional] = None,
    *,
    beside: str | None = None,
    out: Path | None = None,
    data: Path | None = None,
    hand: HandsTold = (),
    game: str = "default",
    date: str | None = None,
    anonymous: bool = False,
    pdf: Path | None = None,
    figures: Path | None = None,
    language: Language = "en",
    list_players: Annotated[bool, tyro.conf.arg(name="list")] = False,
    json_output: Json = False,
) -> None:
    """Write a scouting report: a page for the player, how the opponent plays, and where the opponent can be hurt.

    Args:
        player: who is to win; alone: whose profile is written.
        opponent: who is described.
        beside: another opponent, whose habits are shown beside those of the first one.
        out: HTML file; default: scout.html.
        data: annotated matches, for counted habits: a stroke table, or a folder with the raw files.
        hand: hand of a player of the data, such as kento-momota=left; may be repeated. Default: strokes around the head tell it.
        game: model of the game: a shipped one or a folder.
        date: day of the players' skill, such as 2021-07-31; default: the last one known.
        anonymous: replace the names of the players.
        pdf: PDF file, written by Chromium; its first page is one side for the player.
        figures: CSV or Parquet file for a table of all figures.
        language: language of the page: English, Chinese (simplified) or Indonesian.
        list_players: list the players of the model instead.
        json_output: print the figures as JSON, and write no page unless --out or --pdf is given.
    """
    from shuttle_marl.analysis.scouting import plain, players_of  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.analysis.scouting import scout as scouted  # noqa: PLC0415
    from shuttle_marl.coach.scout_page import scouting_page  # noqa: PLC0415
    from shuttle_marl.coach.sources import gaps  # noqa: PLC0415
    from shuttle_marl.coach.words import words  # noqa: PLC0415
    from shuttle_marl.data import load_strokes  # noqa: PLC0415
    from shuttle_marl.game.pairs import people_of  # noqa: PLC0415

    if list_players:
        listed = players_of(game)
        if json_output:
            cli.print_json({"players": [plain(each) for each in listed]})
        else:
            cli.console().print(cli.scouted_rows(listed))
        return
    if player is None:
        raise ShuttleError("scout: expected PLAYER OPPONENT, or one player, or --list")
    names = (player,) if opponent is None else (opponent, player)
    with hands_told(hand), cli.working("analysing the match-up"):
        strokes = None if data is None else load_strokes(data)
        report = scouted(*names, beside=beside, model=game, date=date, data=strokes)
    if anonymous:
        names = (report.opponent.name,) if report.player is None else (report.opponent.name, report.player.name)
        with speaking(language):
            letters = [words()(f"report.player_{letter}") for letter in "abc"]
        hidden = dict(zip(names[::-1], letters, strict=False))
        pair, other = report.pair, report.beside
        if pair is not None:
            people = dataclasses.replace(people_of(pair), players=(hidden[names[-1]], hidden[names[0]]))
            pair = dataclasses.replace(pair, people=people)
        other = None if other is None else (letters[2], other[1])
        report = dataclasses.replace(report.renamed(lambda name: hidden.get(name, letters[2])), pair=pair, beside=other)
    if figures is not None:
        write_figures(report.as_json(), figures)
    if json_output:
        cli.print_json(report.as_json())
    if not json_output or out is not None or pdf is not None:
        with speaking(language):
            page = scouting_page(report, () if strokes is None else gaps(strokes))
        write_report(page, out or Path("scout.html"), pdf, quiet=json_output)


COMMANDS: Final = scout


main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl scout", __doc__ or "")
