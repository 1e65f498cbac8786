"""Staged rallies in the pages of reports, with the program of the live court; what stages them is imported when it is needed."""

import json
from typing import Final

import pyarrow as pa

from shuttle_marl.base.cache import Cache, key_of
from shuttle_marl.court.building import BuildError, build
from shuttle_marl.data.table import strokes_hash
from shuttle_marl.reports.coach import Source
from shuttle_marl.reports.habits import Habit
from shuttle_marl.reports.html import Viewer
from shuttle_marl.reports.match import MatchReport
from shuttle_marl.reports.pages import Clips, Example
from shuttle_marl.reports.scouting import ScoutingReport

_CACHE: Final = Cache("clips", 16)  # about 30 MB


def viewer() -> Viewer:
    """The program of the live court, for pages that contain rallies. Raises BuildError: it is not built, and cannot be."""
    folder = build()
    script, style = ((folder / name).read_text(encoding="utf-8") for name in ("watch.js", "watch.css"))
    return Viewer(script=script.replace("</script", "<\\/script").replace("<!--", "<\\!--"), style=style.replace("</", "<\\/"))


def scout_clips(report: ScoutingReport, strokes: pa.Table | None = None) -> Clips:
    """A rally for each of the first two sure habits of the opponent: of annotated matches, or one in which both are imitated."""
    said = report.page1.of(1, "habit")
    if not said or report.pair is None or report.player is None:
        return Clips()
    try:
        program = viewer()
    except BuildError as error:
        return Clips(reason=str(error))
    told = repr([(each.figure.kind, each.figure.about, each.figure.answer) for each in said if isinstance(each.figure, Habit)])
    data = "" if strokes is None else strokes_hash(strokes)
    parts = "clips", report.pair.hash, report.player.name, report.opponent.name, told, data
    key = key_of(*parts, rooms=("court", "reports", "dynamics", "data"))
    kept = _CACHE.read([key]).get(key)
    if kept is None:
        from shuttle_marl.court.staged import habits_shown  # noqa: PLC0415  slow to import

        kept = json.dumps(habits_shown(report, strokes)).encode()
        _CACHE.store({key: kept})
    content, examples = json.loads(kept)
    return Clips(content=content, viewer=program if content else None, examples=[Example(*each) for each in examples])


def match_clips(report: MatchReport, source: Source) -> Clips:
    """The key moments of a match, and where its rallies are on the live court. Raises WatchError: the file has no whole rally."""
    from shuttle_marl.court.recorded import LogRallies, RealRallies  # noqa: PLC0415  slow to import
    from shuttle_marl.court.staged import shared  # noqa: PLC0415
    from shuttle_marl.recording.reader import RallyLog  # noqa: PLC0415

    found: LogRallies | RealRallies
    if source.strokes is None:
        found, numbers = LogRallies(RallyLog(source.path), source.game), dict(enumerate(source.numbers))
    else:
        found = RealRallies(source.path, source.game.seats[0], source.strokes)
        of_key = found.numbers(str(source.match))
        numbers = {i: of_key[row.key] for i, row in enumerate(report.rallies) if row.key in of_key}
    listed = {} if source.mapped else numbers
    try:
        program = viewer()
    except BuildError as error:
        return Clips(reason=str(error), numbers=listed)
    moments = [i for i in report.moments if i in numbers]
    staged = [found.rally(numbers[i]) for i in moments]
    game = report.game if source.policies is None else source.game
    content, count = shared([(rally, game) for rally in staged], source.policies)
    return Clips(content=content, viewer=program, shown=moments[:count], numbers=listed)
