"""What a tournament came to, for people: the ranked table on the console and ``report.md``."""

import math
from collections.abc import Sequence

from rich.table import Table

from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.folder import RALLIES
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.results import PairResult

HEADINGS = ("", "player", "rating", "95 % interval", "matches won", "95 % interval", "rallies won", "serving", "receiving")


def cells(standing: Standing) -> tuple[str, ...]:
    """A row of the ranked table, as :data:`HEADINGS` has it."""
    player = f"{standing.player} (forfeited {standing.forfeits})" if standing.forfeits else standing.player
    return (
        str(standing.rank),
        player,
        _number(standing.rating, "+.0f"),
        f"{_number(standing.rating_low, '+.0f')} to {_number(standing.rating_high, '+.0f')}",
        _percent(standing.share),
        f"{_percent(standing.share_low)} to {_percent(standing.share_high)}",
        _percent(standing.rally_share),
        _percent(standing.serving),
        _percent(standing.receiving),
    )


def console_table(standings: Sequence[Standing]) -> Table:
    """The ranked table for the console."""
    table = Table(title="Round robin", title_justify="left", header_style="bold")
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading == "player" else "right", no_wrap=True)
    for standing in standings:
        table.add_row(*cells(standing), style="dim" if standing.forfeits else None)
    return table


def report(config: LeagueConfig, standings: Sequence[Standing], results: Sequence[PairResult], game: str) -> str:
    """``report.md``: the ranked table, who beat whom, who forfeited, and what the numbers mean."""
    played = [result for result in results if not result.forfeit]
    rallies = sum(counts["rallies"] for result in played for counts in result.seats)
    strokes = sum(counts["strokes"] for result in played for counts in result.seats)
    matches = sum(counts["matches"] for result in played for counts in result.seats)
    length = f"{strokes / rallies:.2f}" if rallies else "no"
    lines = [
        "# Round robin",
        "",
        f"{len(standings)} entrants, {matches:,} matches ({config.matches:,} a pair), {rallies:,} rallies, "
        f"{strokes:,} strokes, {length} strokes a rally. Seed {config.seed}, game `{config.game}` ({game[:12]}).",
        "",
        *_markdown(HEADINGS, [cells(standing) for standing in standings]),
        "",
        "## Who beat whom",
        "",
        "Share of the matches that the player of the row won against the player of the column.",
        "",
        *_payoffs(standings, played),
        "",
    ]
    if len(played) < len(results):
        lines += ["## Forfeits", ""]
        lines += [f"- {r.names[0]} v {r.names[1]}: {' and '.join(r.forfeit)} forfeited: {r.reason}" for r in results if r.forfeit]
        lines += ["", "Forfeited pairings count for neither side; who forfeited stands behind everybody else.", ""]
    lines += [
        "## What the numbers mean",
        "",
        "- rating: Bradley-Terry, in Elo points (400 points are odds of ten to one), mean of the pool 0, fitted to all "
        "matches at once. Its interval comes from 1,000 bootstrap draws of the cells: two matches with the seats swapped "
        "and each seat's luck kept. Half a cell is added to each outcome of each pairing, which keeps ratings finite.",
        "- matches won: its interval is Wilson's and takes matches as independent; those of a cell lean against each other, "
        "so it is a little too wide.",
        f"- every rally stands in `{RALLIES}`: read it with `python -m shuttle_marl.recording`."
        if config.record == "all"
        else "- rallies were not recorded (`--record none`).",
        "",
    ]
    return "\n".join(lines)


def _payoffs(standings: Sequence[Standing], played: Sequence[PairResult]) -> list[str]:
    names = [standing.player for standing in standings]
    share = {
        (name, other): result.seen_by(name)["wins"] / result.seen_by(name)["matches"]
        for result in played
        for name, other in (result.names, result.names[::-1])
    }
    rows = [[name, *(_percent(share.get((name, other), math.nan)) for other in names)] for name in names]
    return _markdown(["", *names], rows)


def _markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [headings, ["---"] * len(headings), *rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f} %"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
