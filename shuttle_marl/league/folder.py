"""Run folder of a tournament: what decides it, how it was made, its finished pairings, one line each, and its report."""

import contextlib
import dataclasses
import json
import math
import os
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from rich.table import Table
from rich.text import Text

from shuttle_marl import runs
from shuttle_marl.errors import printable
from shuttle_marl.files import open_file, problem, replace_file
from shuttle_marl.game.rally import Game
from shuttle_marl.league.entrants import Entrant, LeagueConfig, LeagueError
from shuttle_marl.league.ranking import ExactOdds, Standing
from shuttle_marl.league.tournament import Pairing, PairResult
from shuttle_marl.recording import Sampling

PAIRINGS: Final = "pairings.jsonl"
RALLIES: Final = "rallies.mcap"
_CHECKSUM: Final = "crc32"
_PACKAGES: Final = ("numpy", "scipy", "numba", "pyarrow", "mcap", "zstandard")
"""Packages whose versions can change a file of the run."""


def open_run(config: LeagueConfig) -> contextlib.AbstractContextManager[Path]:
    """Hold the folder to play in: made for a new run, found for a resumed one.

    Raises:
        RunError: there is a run in the folder that was not to be resumed or replaced; or the run to resume is not there or
            was played with other flags.
    """
    return runs.open_run(
        config.out,
        f"league-{config.seed}",
        config.fixed(),
        resume=config.resume,
        overwrite=config.overwrite,
        called=f"of seed {config.seed}",
    )


def manifest(config: LeagueConfig, game: Game, entrants: Sequence[Entrant]) -> dict[str, Any]:
    """Everything one needs to know to get the same run again; the manifest of a run that starts now."""
    return {
        "status": "running",
        "seed": config.seed,
        **runs.describe(_PACKAGES),
        "game": {"model": config.game, "hash": game.hash, "catalogue": game.catalogue.version},
        "policies": {entrant.name: entrant.hash for entrant in entrants},
    }


def check_same(folder: Path, about: dict[str, Any]) -> None:
    """Refuse to continue a run that was started with another game or other policies.

    Raises:
        LeagueError: it was.
        RunError: the manifest cannot be read.
    """
    path = folder / runs.MANIFEST
    if not path.exists():
        return
    before = runs.read_json(path)
    for what in ("game", "policies"):
        if before.get(what) != about[what]:
            raise LeagueError(f"{folder}: the {what} changed since the run was started; start a new one with another --out")


def read_results(folder: Path, pairings: Sequence[Pairing], *, finished: bool = False) -> list[PairResult]:
    """The finished pairings of a run; of an unfinished one, a last line that was cut off is removed.

    Args:
        folder: of the run.
        pairings: all pairings of the tournament.
        finished: whether the run is finished, so that every pairing must be there.

    Raises:
        LeagueError: a line is damaged, or pairings are missing.
    """
    path = folder / PAIRINGS
    text = _content(path)
    whole = text[: text.rfind(b"\n") + 1]
    results = [_read_line(path, number, line) for number, line in enumerate(whole.splitlines(), 1)]
    expected = [(pairing.number, pairing.names) for pairing in pairings]
    found = [(result.pairing, result.names) for result in results]
    if found != expected[: len(found)] or (finished and (found != expected or whole != text)):
        raise LeagueError(f"{path}: pairings are missing, out of order or not of this run; {_ADVICE}")
    if len(whole) < len(text):
        replace_file(path, whole)
    return results


def append_results(folder: Path, results: list[PairResult]) -> None:
    """Add finished pairings; they are on the disk when this returns.

    Raises:
        LeagueError: no space or the like.
    """
    path = folder / PAIRINGS
    try:
        with path.open("ab") as file:
            file.write(b"".join(map(_line, results)))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise LeagueError(f"{path}: cannot be written ({error.strerror}); make room and continue with --resume") from error


_ADVICE: Final = "restore it from a copy, or play the tournament again with --overwrite"


def _content(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            return file.read()
    except FileNotFoundError:
        return b""
    except OSError as error:
        raise LeagueError(f"{path}: cannot be read ({problem(error)}); {_ADVICE}") from error


def _line(result: PairResult) -> bytes:
    """A finished pairing as a line: its fields as JSON, and a checksum of them."""
    fields = dataclasses.asdict(result)
    return (json.dumps({**fields, _CHECKSUM: _checksum(fields)}, ensure_ascii=False) + "\n").encode()


def _read_line(path: Path, number: int, line: bytes) -> PairResult:
    """Reverse :func:`_line`."""
    try:
        fields = json.loads(line.decode())
        if not isinstance(fields, dict):
            reason = "no JSON object"
        elif fields.pop(_CHECKSUM, None) != _checksum(fields):
            reason = f"its {_CHECKSUM} does not fit"
        else:
            return PairResult.from_json(fields)
    except RecursionError:
        reason = "nested too deeply"
    except (ValueError, TypeError, KeyError) as error:
        reason = f"{type(error).__name__}: {error}"
    raise LeagueError(f"{path}: line {number} is damaged ({reason}); {_ADVICE}")


def _checksum(fields: dict[str, Any]) -> str:
    """CRC-32 of the fields as JSON with sorted keys, in ASCII and without spaces; 8 hexadecimal digits."""
    return f"{zlib.crc32(json.dumps(fields, sort_keys=True, separators=(',', ':')).encode()):08x}"


HEADINGS = (
    "",
    "player",
    "rating",
    "95 % interval",
    "exact rating",
    "ranks (95 %)",
    "matches won",
    "95 % interval",
    "exact",
    "away (95 %)",
    "rallies won",
    "serving",
    "receiving",
    "exploitability",
    "normalised",
)
_REPORT_ONLY: Final = (4, 5, 7, 11, 12)
"""Columns that the console leaves out: exact rating, ranks, the interval of the matches won, serving, receiving."""
_ABOUT_AWAY: Final = (
    "- away: the same in refits of the game on resampled matches, which the same data could have given: mean, and 95 % interval "
    "for one more refit.",
)
_MARKUP: Final = re.compile(r"[\\`*\[\]<>|~&#]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")
"""Characters that mean something in Markdown or HTML; an underscore within a word does not."""


def cells(standing: Standing) -> tuple[str, ...]:
    """A row of the ranked table, as :data:`HEADINGS` has it."""
    player = f"{standing.player} (forfeited {standing.forfeits})" if standing.forfeits else standing.player
    return (
        str(standing.rank),
        player,
        _number(standing.rating, "+.0f"),
        f"{_number(standing.rating_low, '+.0f')} to {_number(standing.rating_high, '+.0f')}",
        "" if math.isnan(standing.rating_exact) else f"{standing.rating_exact:+.0f}",
        f"{standing.rank_low} to {standing.rank_high}" if standing.rank_low else "",
        _percent(standing.share),
        f"{_percent(standing.share_low)} to {_percent(standing.share_high)}",
        _percent(standing.exact_share),
        _away(standing),
        _percent(standing.rally_share),
        _percent(standing.serving),
        _percent(standing.receiving),
        _number(standing.exploitability, ".3f"),
        _number(standing.normalised_score, ".3f"),
    )


def _away(standing: Standing) -> str:
    if math.isnan(standing.away_share):
        return ""
    return f"{_percent(standing.away_share)} ({_percent(standing.away_low)} to {_percent(standing.away_high)})"


def ranked_table(standings: Sequence[Standing], left_out: Sequence[int] = ()) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Headings and rows of the ranked table, without some columns and without those in which nothing stands."""
    rows = [cells(standing) for standing in standings]
    kept = [i for i in range(len(HEADINGS)) if i not in left_out and any(row[i] for row in rows)]
    return tuple(HEADINGS[i] for i in kept), [tuple(row[i] for i in kept) for row in rows]


def console_table(standings: Sequence[Standing]) -> Table:
    """The ranked table for the console, without the columns that only the report has."""
    table = Table(title="Round robin", title_justify="left", header_style="bold")
    headings, rows = ranked_table(standings, _REPORT_ONLY)
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "player" else "right", no_wrap=True)
    for standing, row in zip(standings, rows, strict=True):
        table.add_row(*(Text(printable(cell)) for cell in row), style="dim" if standing.forfeits else None)
    return table


def report(
    config: LeagueConfig, standings: Sequence[Standing], results: Sequence[PairResult], game: str, exact: ExactOdds
) -> str:
    """Content of ``report.md``: the ranked table, who beat whom, who forfeited, and what the numbers mean."""
    played = [result for result in results if not result.forfeit]
    rallies = sum(counts["rallies"] for result in played for counts in result.seats)
    strokes = sum(counts["strokes"] for result in played for counts in result.seats)
    matches = sum(counts["matches"] for result in played for counts in result.seats)
    length = f"{strokes / rallies:.2f}" if rallies else "no"
    lines = [
        "# Round robin",
        "",
        f"{len(standings)} entrants, {matches:,} matches ({config.matches:,} a pair), {rallies:,} rallies, "
        f"{strokes:,} strokes, {length} strokes a rally. Seed {config.seed}, game {_code(config.game)} ({game[:12]}).",
        "",
        *_markdown(*ranked_table(standings)),
        "",
        "## Who beat whom",
        "",
        "Share of the matches that the player of the row won against the player of the column.",
        "",
        *_payoffs(standings, {names: share for result in played for names, share in _shares(result).items()}),
        "",
        "## Who beats whom, exactly",
        "",
        exact.problem
        or "Probability that the player of the row wins a match against the player of the column, without sampling.",
        "",
        *_payoffs(standings, {(a, b): exact.pair((a, b)) for a in exact.names for b in exact.names if a != b}),
        "",
    ]
    if len(played) < len(results):
        lines += ["## Forfeits", ""]
        lines += ["- " + _plain(_forfeit(result)) for result in results if result.forfeit]
        lines += ["", "Forfeited pairings count for neither side; entrants that forfeited are ranked behind all others.", ""]
    lines += [
        "## What the numbers mean",
        "",
        "- rating: Bradley-Terry, in Elo points (400 points are odds of ten to one), mean of the pool 0, fitted to all "
        "matches at once. Its interval comes from 1,000 bootstrap draws of the cells: two matches with the seats swapped "
        "and each seat's luck kept. Half a cell is added to each outcome of each pairing, which keeps ratings finite.",
        "- matches won: its interval is Wilson's and takes matches as independent; those of a cell are negatively correlated, "
        "so it is a little too wide.",
        "- exact: the expected share of matches won, without sampling, against the entrants that have a table. Those that read "
        "the score have none, nor any other exact figure.",
        *_ABOUT_AWAY[: exact.away is not None],
        "- exploitability: what the best response to the player gains, as a value from 0 to 1; it wins half of it above 50 % "
        "of the rallies. 0 is perfect play.",
        "- normalised: by rallies won against `bc`; 0 is `bc` itself, 1 the best response to it.",
        _recorded(config),
        "",
    ]
    return "\n".join(lines)


def _forfeit(result: PairResult) -> str:
    return f"{' v '.join(result.names)}: {' and '.join(result.forfeit)} forfeited: {result.reason}"


def _recorded(config: LeagueConfig) -> str:
    every = Sampling.parse(config.record).every
    if not every:
        return "- rallies were not recorded (`--record none`)."
    what = "every rally is" if every == 1 else f"one match in {every:,}, drawn at random, is with all its rallies"
    return f"- {what} in `{RALLIES}`: read it with `python -m shuttle_marl.recording`."


def _shares(result: PairResult) -> dict[tuple[str, str], float]:
    """Share of the matches of a pairing that each of the two won, by (player, opponent)."""
    counts = {names: result.seen_by(names[0]) for names in (result.names, result.names[::-1])}
    return {(name, other): count["wins"] / count["matches"] for (name, other), count in counts.items()}


def _payoffs(standings: Sequence[Standing], share: Mapping[tuple[str, str], float]) -> list[str]:
    names = [standing.player for standing in standings]
    rows = [[name, *(_percent(share.get((name, other), math.nan)) for other in names)] for name in names]
    return _markdown(["", *names], rows)


def _markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [headings, ["---"] * len(headings), *rows]
    return ["| " + " | ".join(map(_plain, line)) + " |" for line in lines]


def _plain(text: str) -> str:
    """Text for Markdown that is shown as it is."""
    return _MARKUP.sub(r"\\\g<0>", printable(text))


def _code(text: str) -> str:
    """Text for Markdown as code."""
    text = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{text}{fence}" if len(fence) == 1 else f"{fence} {text} {fence}"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f} %"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
