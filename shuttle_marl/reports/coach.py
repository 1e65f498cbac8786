"""Reports for coaches as objects, from the files that hold matches: their figures, and their page.

Example::

    report("club/strokes.parquet", "final").save("report.html", language="id")
    scouting_report("an-se-young", "chen-yufei").figures["value"]
"""

import dataclasses
import functools
import shlex
import string
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from shuttle_marl.base.errors import ShuttleError, command, printable
from shuttle_marl.base.files import replace_file
from shuttle_marl.data import read_matches
from shuttle_marl.data.simulated import stroke_table
from shuttle_marl.data.words import bare
from shuttle_marl.game.scoring import RulesName
from shuttle_marl.game.shipped import folder_of, is_shipped, resolve_game
from shuttle_marl.game.tables import Game
from shuttle_marl.recording import Rallies, RallyLog
from shuttle_marl.recording.reader import breaks, is_log
from shuttle_marl.reports.languages import Language, speaking
from shuttle_marl.reports.match import MatchReport, match_report, matches_in
from shuttle_marl.reports.pages import NO_CLIPS, Clips, gaps, log_title, match_page, scouting_page
from shuttle_marl.reports.rally import LogPlayers, Players
from shuttle_marl.reports.scouting import ScoutingReport, scout
from shuttle_marl.reports.summary import AnalysisError

_LISTED = 12


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """The file of a match, for what its page shows beside the figures."""

    path: Path
    game: Game  # in which strokes are valued; of a log, that was played
    match: str | tuple[int, int]  # name of the match, or numbers of the pairing and of the match in a log
    people: tuple[str, str]  # the two players of the match
    strokes: pa.Table | None = None  # all annotated strokes of the file; None: it is a log
    mapped: bool = False  # whether the columns are mapped, so that the live court cannot open the file
    numbers: tuple[int, ...] = ()  # of the rallies in a log, from 0
    policies: Players | None = None  # that played a log; None: not known
    video: Callable[[float], str] | None = None  # address of the video at a time in seconds; None: no video

    @property
    def command(self) -> str:
        """Command that opens the live court with the rallies, as another reader of the report types it."""
        folder = folder_of(self.game.seats[0])
        model = () if self.strokes is None or folder is None or is_shipped(folder.name) else ("--game", folder.name)
        option = "--replay" if self.strokes is None else "--real"
        return shlex.join(["python", "-m", "shuttle_marl.watch", option, self.path.name, *model])


def of_strokes(
    path: Path, game: Game, match: str | None = None, columns: Path | None = None, rules: RulesName | None = None
) -> tuple[MatchReport, Source]:
    """The report of an annotated match; ``path``: a stroke table, a folder with the raw files, or a CSV file; ``game``: in which
    strokes are valued; ``match``: name of the match, or a part that only its name has (None: the only match). Raises DataError:
    the file cannot be read. Raises AnalysisError: no such match, or several."""
    strokes = read_matches(path, columns, rules)
    report = match_report(match_strokes(strokes, match), game=game)
    mapped = columns is not None
    return report, Source(path=path, game=game, match=report.match, people=report.players, strokes=strokes, mapped=mapped)


def match_strokes(strokes: pa.Table, match: str | None) -> pa.Table:
    """Strokes of the match with a name, or with all words in its name, in any order and without regard to capitals.

    None stands for the only match.

    Raises:
        AnalysisError: no such match, or several.
    """
    names, parts = matches_in(strokes), [bare(word) for word in (match or "").replace("_", " ").split()]
    named = match is None or any(parts)  # punctuation alone names nothing
    found = [match] if match in names else [name for name in names if named and all(part in bare(name) for part in parts)]
    if len(found) != 1:
        listed = ", ".join(map(printable, (found or names)[:_LISTED])) + (" …" if len(found or names) > _LISTED else "")
        asked = "give --match" if match is None else f"--match {match}"
        raise AnalysisError(f"{asked}: {len(found)} matches; expected words of one of these names: {listed}")
    return strokes.filter(pc.equal(strokes["match"], found[0]))


def of_log(path: Path, game: Game, pairing: int, match: int) -> tuple[MatchReport, Source]:
    """The report of a match of a rally log; ``path``: the log, or a folder of logs; ``game``: that was played; ``pairing``,
    ``match``: numbers of the pairing and of the match in it. Raises RecordingError: the log cannot be read, or was played on
    another game. Raises AnalysisError: no such match."""
    with RallyLog(path) as log:
        strokes = log_strokes(log, pairing, match)
        numbers = log.numbers_of_match(pairing, match).tolist()
        seats = tuple(log.policies[int(policy)].name for policy in log.rally(numbers[0]).policy[0])
        played = log.files[log.file_of(numbers[0])].header.rules
        policies = LogPlayers(log, game).of_rally(numbers[0])
    known = None if policies.value is None else policies
    odds = None if policies.value is None else policies.value.odds(seats.index(strokes["player"][0].as_py()))
    report = match_report(strokes, game=game, rules=played, odds=odds)
    source = Source(path=path, game=game, match=(pairing, match), people=report.players, numbers=tuple(numbers), policies=known)
    return report, source


def log_strokes(log: RallyLog, pairing: int, match: int) -> pa.Table:
    """Strokes of a match of a rally log, with places drawn in their areas. Raises AnalysisError: no such match."""
    numbers = log.numbers_of_match(pairing, match).tolist()
    if not numbers:
        raise AnalysisError(f"no match {match} of pairing {pairing}; the log has {len(log.pairings)} pairings")
    rallies = Rallies.concatenate([log.rally(number) for number in numbers])
    if len(odd := breaks(rallies, log.header.rules, log.catalogue)):
        told = f"rally {numbers[odd[0]]} does not follow from the one before, or from its strokes, so the report may be wrong"
        warnings.warn(f"{log.path}: {told}; `{command('recording', 'check', str(log.path))}` tells more", stacklevel=2)
    names, titles = [player.name for player in log.policies], [log_title(pairing, match)] * len(rallies)
    draws = np.random.default_rng([0, pairing, match])
    return stroke_table(rallies, log.catalogue, names, titles, draws, looks=log.header.looks)


def video_of(template: str) -> Callable[[float], str]:
    """Address of a video at a time in seconds; ``template``: address with ``{seconds}`` where the whole seconds go. Raises
    AnalysisError: it is no such address."""
    fields = [name for _, name, _, _ in string.Formatter().parse(template) if name is not None]
    if fields != ["seconds"] or urlsplit(template).scheme not in ("http", "https"):
        raise AnalysisError(f"--video {template}: expected an http or https address with {{seconds}} once")
    return lambda seconds: template.format(seconds=int(seconds))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class CoachReport:
    """A report."""

    _report: MatchReport | ScoutingReport
    _page: Callable[[], bytes]

    @functools.cached_property
    def figures(self) -> Mapping[str, Any]:
        """All figures by name, as ``--json`` prints them."""
        return self._report.as_json()

    def html(self, language: Language = "en") -> bytes:
        """The page, one HTML file: English, Chinese (``zh``) or Indonesian (``id``)."""
        with speaking(language):
            return self._page()

    def save(self, path: Path | str, language: Language = "en") -> Path:
        """Write the page, and return its path. Raises FileWriteError: it cannot be written."""
        replace_file(Path(path), self.html(language))
        return Path(path)


def report(
    path: Path | str,
    match: str | None = None,
    *,
    pairing: int = 0,
    game: Game | str | None = None,
    columns: Path | str | None = None,
    rules: RulesName | None = None,
    video: str | None = None,
    clips: Callable[[MatchReport, Source], Clips] | None = None,
) -> CoachReport:
    """The report of a match: what decided it, its key moments, and the choices that cost most.

    Args:
        path: annotated matches, as :func:`shuttle_marl.data.read_matches` reads them, or a rally log.
        match: words of the name of the match, or its number in a rally log; None: the only match, or the first of a log.
        pairing: of a rally log, number of the pairing.
        game: in which strokes are valued; None: the benchmark's.
        columns: column map of a CSV file.
        rules: of the match; None: those of the table, or of its scores.
        video: address of the video, with ``{seconds}`` where the time goes.
        clips: what stages the rallies of the page, ``shuttle_marl.court.clips.match_clips``; None: without rallies.

    Raises:
        DataError, RecordingError: the file cannot be read.
        AnalysisError: no such match, or several.
        ShuttleError: an argument that this kind of file does not have.
    """
    path, game = Path(path), resolve_game(game)
    if not is_log(path):
        if pairing:
            raise ShuttleError(f"--pairing {pairing}: only rally logs have pairings; name the match with --match")
        found, source = of_strokes(path, game, match, None if columns is None else Path(columns), rules)
    elif columns is not None or rules is not None:
        raise ShuttleError(f"--columns and --rules: {path} is a rally log, which has its own; omit them")
    elif match is not None and not match.isdecimal():
        raise ShuttleError(f"--match {match}: expected the number of a match of the log, from 0")
    else:
        found, source = of_log(path, game, pairing, int(match or 0))
    if video is not None:
        source = dataclasses.replace(source, video=video_of(video))

    def page() -> bytes:
        return match_page(found, source, NO_CLIPS if clips is None else clips(found, source))

    return CoachReport(_report=found, _page=page)


def scouting_report(
    player: str,
    opponent: str | None = None,
    *,
    data: Path | str | None = None,
    rules: RulesName | None = None,
    date: str | None = None,
    model: str = "default",
    clips: Callable[[ScoutingReport, pa.Table | None], Clips] | None = None,
) -> CoachReport:
    """Scouting report: what a player should do against an opponent, how the opponent plays, and where the opponent is weak.

    Args:
        player: who is to win; without an opponent, whose profile it is.
        data: annotated matches, for counted habits; None: those of the model alone.
        rules: of these matches; None: those of the table, or of its scores.
        date: day of the players' skill, such as 2021-07-31; None: the last one known.
        model: name or folder of the model.
        clips: what stages the rallies of the page, ``shuttle_marl.court.clips.scout_clips``; None: without rallies.

    Raises:
        ShuttleError: the model does not know a player, or the data cannot be read.
    """
    strokes = None if data is None else read_matches(data, rules=rules)
    names = (player,) if opponent is None else (opponent, player)
    found = scout(*names, model=model, date=date, data=strokes)

    def page() -> bytes:
        staged = NO_CLIPS if clips is None else clips(found, strokes)
        return scouting_page(found, () if strokes is None else gaps(strokes), staged)

    return CoachReport(_report=found, _page=page)
