"""Match reports: what decided a match."""

from pathlib import Path
from typing import Annotated, Any, Final

import tyro

from shuttle_marl.commands import cli
from shuttle_marl.commands.options import RALLY_MODEL, RallyModel, ReportOptions, hands_told
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.reports.languages import speaking

_OUTPUT: Final = ReportOptions()


def report(
    path: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MATCH")],
    *,
    match: str | None = None,
    pairing: int = 0,
    columns: Path | None = None,
    rules: RulesName | None = None,
    model: RallyModel = RALLY_MODEL,
    video: str | None = None,
    output: tyro.conf.OmitArgPrefixes[ReportOptions] = _OUTPUT,
) -> None:
    """Write a report of a match: its course, key moments, the value of shots, costly decisions, and habits that changed.

    Args:
        path: annotated matches (a stroke table, a folder with the raw files, or a CSV file with --columns), or a rally log.
        match: name of the match, or words of it; of a rally log the number of the match, from 0. Default: the only one.
        pairing: of a rally log, number of the pairing.
        columns: column map of a CSV file.
        rules: points of a game, and best of how many, such as 15, 11 or 21x1; default: those of the table, or of its scores.
        model: game in which strokes are valued.
        video: address of the video with {seconds} where the time goes, such as https://example.org/watch?t={seconds}.
        output: what is written.
    """
    from shuttle_marl.court.clips import match_clips  # noqa: PLC0415  these keep --help quick
    from shuttle_marl.reports import coach  # noqa: PLC0415

    cli.check_suffix(output.out, ".html")
    game = model.load_for(path)
    options: dict[str, Any] = {"columns": columns, "rules": rules, "video": video}
    with hands_told(output.hand), cli.working("analysing the match"), speaking(output.language):
        found = coach.report(path, match, pairing=pairing, game=game, clips=match_clips, **options)
    output.write(found, "report.html")


COMMANDS: Final = report
main: Final = cli.entry_point(COMMANDS, "python -m shuttle_marl report", __doc__ or "")
