"""What a tournament came to, for people: the ranked table on the console and ``report.md``."""

import math
from collections.abc import Mapping, Sequence
from typing import Final

from rich.table import Table

from shuttle_marl.league.config import LeagueConfig
from shuttle_marl.league.exact_odds import ExactOdds
from shuttle_marl.league.folder import RALLIES
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.results import PairResult
from shuttle_marl.recording import Sampling

HEADINGS = (
    "",
    "player",
    "rating",
    "95 % interval",
    "matches won",
    "95 % interval",
    "exact",
    "rallies won",
    "serving",
    "receiving",
    "exploitability",
    "normalised",
)
_REPORT_ONLY: Final = (5, 8, 9)
"""Columns that the console leaves out: the interval of the matches won, serving, receiving."""


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
        _percent(standing.exact_share),
        _percent(standing.rally_share),
        _percent(standing.serving),
        _percent(standing.receiving),
        _number(standing.exploitability, ".3f"),
        _number(standing.normalised_score, ".3f"),
    )


def console_table(standings: Sequence[Standing]) -> Table:
    """The ranked table for the console; of what may not fit there, only the report tells."""
    table = Table(title="Round robin", title_justify="left", header_style="bold")
    shown = [i for i in range(len(HEADINGS)) if i not in _REPORT_ONLY]
    for i in shown:
        table.add_column(HEADINGS[i], justify="left" if HEADINGS[i] == "player" else "right", no_wrap=True)
    for standing in standings:
        row = cells(standing)
        table.add_row(*(row[i] for i in shown), style="dim" if standing.forfeits else None)
    return table


def report(
    config: LeagueConfig, standings: Sequence[Standing], results: Sequence[PairResult], game: str, exact: ExactOdds
) -> str:
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
        *_payoffs(standings, {names: share for result in played for names, share in _shares(result).items()}),
        "",
        "## Who beats whom, exactly",
        "",
        exact.problem or "Chance that the player of the row wins a match against the player of the column, without sampling.",
        "",
        *_payoffs(standings, {(a, b): exact.pair((a, b)) for a in exact.names for b in exact.names if a != b}),
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
        "- exact: the expected share of matches won, without sampling, against the entrants that have a table. Those that read "
        "the score have none, nor any other exact figure.",
        "- exploitability: what the best response to the player gains, as a value from 0 to 1; it wins half of it above 50 % "
        "of the rallies. 0 is perfect play.",
        "- normalised: by rallies won against `bc`; 0 is `bc` itself, 1 the best response to it.",
        _recorded(config),
        "",
    ]
    return "\n".join(lines)


def _recorded(config: LeagueConfig) -> str:
    every = Sampling.parse(config.record).every
    if not every:
        return "- rallies were not recorded (`--record none`)."
    what = "every rally stands" if every == 1 else f"one match in {every:,}, drawn by lot, stands with all its rallies"
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
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{100 * share:.1f} %"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
