"""Match reports: what decided a match."""

import dataclasses
from pathlib import Path
from typing import Annotated, Final

import tyro

from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import HandsTold, Json, RallyGameOptions, hands_told
from shuttle_marl.commands.reports import write_figures, write_report
from shuttle_marl.pages.languages import Language, speaking

_MODEL: Final = RallyGameOptions()


def report(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MATCH")],
    *,
    out: Path = Path("report.html"),
    match: str | None = None,
    pairing: int = 0,
    columns: Path | None = None,
    hand: HandsTold = (),
    model: tyro.conf.OmitArgPrefixes[RallyGameOptions] = _MODEL,
    video: str | None = None,
    anonymous: bool = False,
    pdf: Path | None = None,
    figures: Path | None = None,
    language: Language = "en",
    json_output: Json = False,
) -> None:
    """Write a report of a match: its course, key moments, the value of shots, costly decisions, and habits that changed.

    Args:
        path: annotated matches (a stroke table, a folder with the raw files, or a CSV file with --columns), or a rally log.
        out: HTML file.
        match: name of the match, or words of it; of a rally log the number of the match, from 0. Default: the only one.
        pairing: of a rally log, number of the pairing.
        columns: column map of a CSV file.
        hand: hand of a player, such as kento-momota=left; may be repeated. Default: strokes around the head tell it.
        model: game in which strokes are valued.
        video: address of the video with {seconds} where the time goes, such as https://example.org/watch?t={seconds}.
        anonymous: replace the names of the players and of the match.
        pdf: PDF file, written by Chromium; its first page is one side for the player.
        figures: CSV or Parquet file for a table of all figures.
        language: language of the page: English, Chinese (simplified) or Indonesian.
        json_output: print the figures as JSON, and write no page.
    """
    from shuttle_marl.coach import sources  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.coach.match_page import match_page  # noqa: PLC0415
    from shuttle_marl.recording.reader import is_log  # noqa: PLC0415

    game = model.load_for(path)
    with hands_told(hand), cli.working("analysing the match"), speaking(language):
        if is_log(path):
            if columns is not None:
                raise ShuttleError(f"--columns {columns}: {path} is a rally log, which has no columns to map; omit it")
            if match is not None and not match.isdecimal():
                raise ShuttleError(f"--match {match}: expected the number of a match of the log, from 0")
            found, footage = sources.of_log(path, game, pairing, int(match or 0))
        elif pairing:
            raise ShuttleError(f"--pairing {pairing}: only rally logs have pairings; name the match with --match")
        else:
            found, footage = sources.of_strokes(path, game, match, columns)
    if video is not None:
        footage = dataclasses.replace(footage, video=sources.video_of(video))
    with speaking(language):
        if anonymous:
            found, footage = sources.anonymous(found, footage)
    if figures is not None:
        write_figures(found.as_json(), figures)
    if json_output:
        cli.print_json(found.as_json())
        if pdf is None:
            return
    with speaking(language):
        page = match_page(found, footage)
    write_report(page, out, pdf, quiet=json_output)


COMMANDS: Final = report


main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl report", __doc__ or "")
