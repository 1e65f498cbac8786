"""Tournament report in Markdown, and the ranked table of the console."""

import re
from collections.abc import Sequence
from typing import Final

from rich.table import Table as RichTable
from rich.text import Text

from shuttle_marl.base.errors import printable
from shuttle_marl.league.assessment import Assessment
from shuttle_marl.league.columns import cycles, meta_game, payoffs, ranking, robustness
from shuttle_marl.league.entrants import Format, LeagueConfig
from shuttle_marl.league.folder import RALLIES
from shuttle_marl.league.ranking import ExactOdds, Standing
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.pages import escaped, markdown
from shuttle_marl.recording import Sampling

TITLES: Final[dict[Format, str]] = {"round-robin": "Round robin", "swiss": "Swiss tournament", "gauntlet": "Gauntlet"}
_ABOUT_AWAY: Final = (
    "- away: the same in refits of the game on resampled matches: mean, and 95 % prediction interval for one more refit.",
)


def console_table(standings: Sequence[Standing], form: Format = "round-robin") -> RichTable:
    """The ranking for the console, with the columns that are brief."""
    shown = RichTable(title=TITLES[form], title_justify="left", header_style="bold")
    ranked = ranking(standings)
    for column in ranked.columns:
        if column.brief:
            shown.add_column(column.heading, justify="left" if column.left else "right", no_wrap=True)
    for standing, row in zip(standings, ranked.rows, strict=True):
        brief = (cell.text for cell, column in zip(row, ranked.columns, strict=True) if column.brief)
        shown.add_row(*(Text(printable(text)) for text in brief), style="dim" if standing.forfeits else None)
    return shown


def report(
    config: LeagueConfig,
    standings: Sequence[Standing],
    results: Sequence[PairResult],
    game: str,
    exact: ExactOdds,
    assessment: Assessment,
) -> str:
    """Content of ``report.md``: ranking, payoffs, meta-games, stability of the ranks, forfeits, and definitions."""
    played = [result for result in results if not result.forfeit]
    rallies = sum(counts["rallies"] for result in played for counts in result.seats)
    strokes = sum(counts["strokes"] for result in played for counts in result.seats)
    matches = sum(counts["matches"] for result in played for counts in result.seats)
    length = f"{strokes / rallies:.2f}" if rallies else "no"
    names = [standing.player for standing in standings]
    lines = [
        f"# {TITLES[config.format]}",
        "",
        f"{len(standings)} entrants, {matches:,} matches ({config.matches:,} a pair), {rallies:,} rallies, "
        f"{strokes:,} strokes, {length} strokes a rally. Seed {config.seed}, game {_code(config.game)} ({game[:12]}), "
        f"{config.rules} points.",
        "",
        *markdown(ranking(standings)),
        "",
        "## Payoffs, sampled",
        "",
        "Fraction of matches that the row won against the column.",
        "",
        *markdown(payoffs(names, {pair: share for result in played for pair, share in _shares(result).items()})),
        "",
        "## Payoffs, exact",
        "",
        exact.problem or "Exact probability that the row wins a match against the column.",
        "",
        *markdown(payoffs(names, {(a, b): exact.pair((a, b)) for a in exact.names for b in exact.names if a != b})),
        "",
    ]
    lines += [*_games(assessment), *_stability(assessment)]
    if len(played) < len(results):
        lines += ["## Forfeits", ""]
        lines += ["- " + escaped(_forfeit(result)) for result in results if result.forfeit]
        lines += ["", "Forfeited pairings count for neither side; entrants that forfeited are ranked last.", ""]
    lines += [
        "## Definitions",
        "",
        "- rating: Bradley-Terry rating in Elo points (400 points are odds of ten to one), mean of the pool 0, fitted to all "
        "matches at once with Jeffreys' prior, which keeps the ratings of unbeaten entrants finite. The interval comes from "
        "1,000 bootstrap samples of the cells, pairs of matches with swapped seats and the same random numbers.",
        "- exact rating: limit of the rating for infinitely many matches of every pair with tables.",
        "- ranks: 95 % interval of the rank, from simultaneous intervals of the differences to all others.",
        "- matches won: the interval is Wilson's for independent matches; those of a cell are negatively correlated, so it is "
        "slightly too wide.",
        "- exact: exact expected fraction of matches won against the entrants that have a table. Entrants that read the score "
        "have no table and no exact figures.",
        *_ABOUT_AWAY[: exact.away is not None],
        "- exploitability: gain of the best response, as a value from 0 to 1: the best response wins 50 % of the rallies plus "
        "half of it. 0 is perfect play.",
        "- normalised: score from rallies won against `bc`; 0 is `bc` itself, 1 the best response to it.",
        _recorded(config),
        "",
    ]
    return "\n".join(lines)


def _games(assessment: Assessment) -> list[str]:
    """Sections on the game between the entrants, and on cycles."""
    lines = ["## Meta-game", ""]
    lines += [
        "Each of two choosers selects an entrant. Nash averaging: the maximum-entropy equilibrium of the match win probability. "
        "Maximal lottery: the same for its sign. alpha-rank: stationary distribution of an evolving population. Entrants with "
        "probability 0 in all three are omitted.",
        "",
    ]
    for about, game in assessment.games.items():
        lines += [f"### {about.capitalize()}", "", *markdown(meta_game("", game)), ""]
    lines += [f"{100 * assessment.cyclic_share:.1f} % of the squared log-odds are cycles, which no rating can express.", ""]
    return [*lines, *markdown(cycles(assessment)), ""] if assessment.cycles else lines


def _stability(assessment: Assessment) -> list[str]:
    """Section on the stability of the ranks."""
    lines = ["## Stability of the ranks", ""]
    for shown in robustness(assessment):
        lines += [f"{shown.caption}.", "", *markdown(shown), ""]
    return lines


def _forfeit(result: PairResult) -> str:
    return f"{' v '.join(result.names)}: {' and '.join(result.forfeit)} forfeited: {result.reason}"


def _recorded(config: LeagueConfig) -> str:
    every = Sampling.parse(config.record).every
    if not every:
        return "- rallies were not recorded (`--record none`)."
    what = "every rally is" if every == 1 else f"one match in {every:,}, drawn at random, is with all its rallies"
    return f"- {what} in `{RALLIES}`: read it with `python -m shuttle_marl.recording`."


def _shares(result: PairResult) -> dict[tuple[str, str], float]:
    """Fraction of the matches of a pairing that each entrant won, by (player, opponent)."""
    counts = {names: result.seen_by(names[0]) for names in (result.names, result.names[::-1])}
    return {(name, other): count["wins"] / count["matches"] for (name, other), count in counts.items()}


def _code(text: str) -> str:
    """Text for Markdown as code."""
    text = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{text}{fence}" if len(fence) == 1 else f"{fence} {text} {fence}"
