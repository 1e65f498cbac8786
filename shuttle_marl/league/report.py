"""Tournament report in Markdown, and the ranked table of the console."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from rich.table import Table
from rich.text import Text

from shuttle_marl.errors import printable
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
"""Columns that the console leaves out: exact rating, ranks, the interval of the matches won, serving, receiving."""
_ABOUT_AWAY: Final = (
    "- away: the same in refits of the game on resampled matches, which the same data could have given: mean, and 95 % interval "
    "for one more refit.",
)
LEAST_SHOWN: Final = 0.0005
"""Least probability of a player that a table of equilibria shows."""
_WORST: Final = 10
"""So many pairs that fit worst are shown."""
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


def console_table(standings: Sequence[Standing], form: Format = "round-robin") -> Table:
    """The ranked table for the console, without the columns that only the report has."""
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
    """Content of ``report.md``: the ranked table, who beat whom, how firm that is, who forfeited, what the numbers mean."""
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
    lines += [*_games(assessment), *_firmness(assessment)]
    if len(played) < len(results):
        lines += ["## Forfeits", ""]
        lines += ["- " + _plain(_forfeit(result)) for result in results if result.forfeit]
        lines += ["", "Forfeited pairings count for neither side; entrants that forfeited are ranked behind all others.", ""]
    lines += [
        "## What the numbers mean",
        "",
        "- rating: Bradley-Terry, in Elo points (400 points are odds of ten to one), mean of the pool 0, fitted to all "
        "matches at once, with Jeffreys' prior, which keeps the ratings of the unbeaten finite. Its interval comes from 1,000 "
        "bootstrap draws of the cells: two matches with the seats swapped and each seat's luck kept.",
        "- exact rating: what the rating would be after infinitely many matches of every pair that has tables.",
        "- ranks: 95 % interval of the place, from the differences to all others at the same time.",
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


def _games(assessment: Assessment) -> list[str]:
    """Sections on the game between the entrants, and on cycles."""
    lines = ["## The game between the players", ""]
    lines += [
        "Each of two chooses a player to play for them. Nash averaging: the equilibrium of most entropy, by matches won. Maximal "
        "lottery: the same if it only counts who wins more often than not. alpha-rank: shares of an evolving population. Players "
        "that none of them plays are left out.",
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
        + ("These beat each other in a circle:" if assessment.cycles else "There are no three that beat each other in a circle."),
        "",
    ]
    for cycle in assessment.cycles:
        steps = [f"{name} beats ({_percent(win)})" for name, win in zip(cycle.names, cycle.wins, strict=True)]
        lines.append("- " + _plain(f"{', '.join(steps)} {cycle.names[0]}"))
    return [*lines, ""] if assessment.cycles else lines


def _firmness(assessment: Assessment) -> list[str]:
    """Sections on how firmly the ranks stand: removed matches, the misfit of the ratings, and refits of the game."""
    fit, stable = assessment.misfit, assessment.stability
    lines = ["## How firm the ranks are", ""]
    if assessment.flips:
        lines += [
            f"The fewest of {assessment.flips[0].played:,} matches that change the order of neighbours if they are removed.",
            "",
        ]
        rows = [[flip.above, flip.below, "none" if flip.matches is None else f"{flip.matches:,}"] for flip in assessment.flips]
        lines += [*_markdown(["above", "below", "matches"], rows), ""]
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
            "Ranks by exact matches won in the refits of the game; Kendall's tau to the ranks here is "
            f"{stable.agreement.mean():.2f} on average, {stable.agreement.min():.2f} at least.",
            "",
        ]
        rows = [
            [name, str(home), f"{away.min()} to {away.max()}", _percent(float((away == home).mean()))]
            for name, home, away in zip(stable.names, stable.home, stable.away.T, strict=True)
        ]
        lines += [*_markdown(["player", "rank", "in refits", "the same"], rows), ""]
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
    # Normal intervals of probabilities may reach beyond 0 and 1.
    return "-" if math.isnan(share) else f"{100 * min(1.0, max(0.0, share)):.1f} %"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
