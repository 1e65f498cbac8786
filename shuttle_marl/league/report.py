"""Tournament report in Markdown, and the ranked table of the console."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from rich.table import Table
from rich.text import Text

from shuttle_marl.base.errors import printable
from shuttle_marl.league.assessment import Assessment
from shuttle_marl.league.entrants import Format, LeagueConfig
from shuttle_marl.league.folder import RALLIES
from shuttle_marl.league.ranking import ExactOdds, Standing
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.recording import Sampling

TITLES: Final[dict[Format, str]] = {"round-robin": "Round robin", "swiss": "Swiss tournament", "gauntlet": "Gauntlet"}
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
"""Columns omitted in the console: exact rating, ranks, the interval of the matches won, serving, receiving."""
_ABOUT_AWAY: Final = (
    "- away: the same in refits of the game on resampled matches: mean, and 95 % prediction interval for one more refit.",
)
LEAST_SHOWN: Final = 0.0005
"""Minimum probability of a player in a table of equilibria."""
_WORST: Final = 10
"""Number of worst-fitting pairs shown."""
_MARKUP: Final = re.compile(r"[\\`*\[\]<>|~&#]|(?<![A-Za-z0-9])_|_(?![A-Za-z0-9])")
"""Special characters of Markdown or HTML; an underscore within a word is none."""


def cells(standing: Standing) -> tuple[str, ...]:
    """A row of the ranking, with columns :data:`HEADINGS`."""
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
    """Headings and rows of the ranking, without the given columns and without empty ones."""
    rows = [cells(standing) for standing in standings]
    kept = [i for i in range(len(HEADINGS)) if i not in left_out and any(row[i] for row in rows)]
    return tuple(HEADINGS[i] for i in kept), [tuple(row[i] for i in kept) for row in rows]


def console_table(standings: Sequence[Standing], form: Format = "round-robin") -> Table:
    """The ranking for the console, without the columns of :data:`_REPORT_ONLY`."""
    table = Table(title=TITLES[form], title_justify="left", header_style="bold")
    headings, rows = ranked_table(standings, _REPORT_ONLY)
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "player" else "right", no_wrap=True)
    for standing, row in zip(standings, rows, strict=True):
        table.add_row(*(Text(printable(cell)) for cell in row), style="dim" if standing.forfeits else None)
    return table


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
    lines = [
        f"# {TITLES[config.format]}",
        "",
        f"{len(standings)} entrants, {matches:,} matches ({config.matches:,} a pair), {rallies:,} rallies, "
        f"{strokes:,} strokes, {length} strokes a rally. Seed {config.seed}, game {_code(config.game)} ({game[:12]}), "
        f"{config.rules} points.",
        "",
        *_markdown(*ranked_table(standings)),
        "",
        "## Payoffs, sampled",
        "",
        "Fraction of matches that the row won against the column.",
        "",
        *_payoffs(standings, {names: share for result in played for names, share in _shares(result).items()}),
        "",
        "## Payoffs, exact",
        "",
        exact.problem or "Exact probability that the row wins a match against the column.",
        "",
        *_payoffs(standings, {(a, b): exact.pair((a, b)) for a in exact.names for b in exact.names if a != b}),
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
        figures = np.stack([game.nash_average, game.maximal_lottery, game.alpha_rank], axis=1)
        rows = [
            [name, *map(_percent, row)] for name, row in zip(game.names, figures.tolist(), strict=True) if max(row) >= LEAST_SHOWN
        ]
        rows.sort(key=lambda row: -float(row[1].split()[0]))
        lines += [f"### {about.capitalize()}", ""]
        lines += [*_markdown(["player", "Nash averaging", "maximal lottery", "alpha-rank"], rows), ""]
    lines += [
        f"{_percent(assessment.cyclic_share)} of the squared log-odds are cycles, which no rating can express. "
        + ("Cycles of three entrants:" if assessment.cycles else "There are no cycles of three entrants."),
        "",
    ]
    for cycle in assessment.cycles:
        steps = [f"{name} beats ({_percent(win)})" for name, win in zip(cycle.names, cycle.wins, strict=True)]
        lines.append("- " + escaped(f"{', '.join(steps)} {cycle.names[0]}"))
    return [*lines, ""] if assessment.cycles else lines


def _stability(assessment: Assessment) -> list[str]:
    """Section on the stability of the ranks: misfit of the ratings, and refits of the game."""
    fit, stable = assessment.misfit, assessment.stability
    lines = ["## Stability of the ranks", ""]
    if fit.degrees:
        worst = sorted(zip(assessment.pairs, fit.share, fit.expected, fit.z, strict=True), key=lambda row: -abs(float(row[3])))
        lines += [
            f"Misfit of the ratings: chi-squared {fit.statistic:.1f} with {fit.degrees} degrees of freedom, "
            f"p = {fit.p:.2g}. The pairs that fit worst:",
            "",
            *_markdown(
                ["player", "opponent", "matches won", "by the ratings", "standard errors"],
                [[*names, _percent(share), _percent(expected), f"{z:+.1f}"] for names, share, expected, z in worst[:_WORST]],
            ),
            "",
        ]
    if stable is not None:
        lines += [
            "Ranks by exact matches won in the refits of the game; mean Kendall's tau with the ranks above "
            f"{stable.agreement.mean():.2f}, minimum {stable.agreement.min():.2f}.",
            "",
        ]
        rows = [
            [name, str(home), f"{away.min()} to {away.max()}", _percent(float((away == home).mean()))]
            for name, home, away in zip(stable.names, stable.home, stable.away.T, strict=True)
        ]
        lines += [*_markdown(["player", "rank", "in refits", "unchanged"], rows), ""]
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


def _payoffs(standings: Sequence[Standing], share: Mapping[tuple[str, str], float]) -> list[str]:
    names = [standing.player for standing in standings]
    rows = [[name, *(_percent(share.get((name, other), math.nan)) for other in names)] for name in names]
    return _markdown(["", *names], rows)


def _markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    lines = [headings, ["---"] * len(headings), *rows]
    return ["| " + " | ".join(map(escaped, line)) + " |" for line in lines]


def escaped(text: str) -> str:
    """Text, escaped for Markdown."""
    return _MARKUP.sub(r"\\\g<0>", printable(text))


def _code(text: str) -> str:
    """Text for Markdown as code."""
    text = printable(text)
    fence = "`" * (1 + max(map(len, re.findall("`+", text)), default=0))
    return f"{fence}{text}{fence}" if len(fence) == 1 else f"{fence} {text} {fence}"


def _percent(share: float) -> str:
    # Normal intervals of probabilities may reach beyond 0 and 1.
    return "-" if math.isnan(share) else f"{100 * min(1.0, max(0.0, share)):.1f} %"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
