"""Page of a tournament: its ranking, who beats whom, styles, games between the players, how firm the ranks are, recordings."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from shuttle_marl.league.assessment import Assessment
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.folder import PAIRINGS, RALLIES, REPORT
from shuttle_marl.league.page import drawings
from shuttle_marl.league.page.document import (
    Cell,
    Column,
    Html,
    code,
    document,
    element,
    name,
    number,
    paragraph,
    section,
    share,
    table,
)
from shuttle_marl.league.page.learning import Curve, learning
from shuttle_marl.league.ranking import Standing
from shuttle_marl.league.report import TITLES
from shuttle_marl.league.style import AXES, PEOPLE
from shuttle_marl.league.tournament import PairResult
from shuttle_marl.recording import Sampling

if TYPE_CHECKING:
    from shuttle_marl.exact.losses import Holes

_MOST_RADARS: Final = 40
_MOST_MISFITS: Final = 40
_SHOWN: Final = 0.0005
"""Least share of a player that a table of equilibria shows."""
_RANKING: Final = (
    Column(name="#", falling=False),
    Column(name="player", left=True),
    Column(name="rating", about="Bradley-Terry, in Elo points; mean of the pool 0"),
    Column(name="95 % interval", about="of the rating, by a bootstrap over cells of swapped seats"),
    Column(name="exact", about="the rating after infinitely many matches of every pair"),
    Column(name="ranks", about="95 % interval of the place", falling=False),
    Column(name="matches won"),
    Column(name="exactly", about="expected share of the matches, without sampling"),
    Column(name="away", about="the same in refits of the game, mean"),
    Column(name="rallies won"),
    Column(name="serving", about="rallies won when serving"),
    Column(name="receiving", about="rallies won when receiving"),
    Column(name="exploitability", about="what the best response to the player gains; 0 is perfect play", falling=False),
    Column(name="normalised", about=f"by rallies won against {PEOPLE}: 0 for {PEOPLE}, 1 for the best response to it"),
    Column(name="likeness", about=f"share of the strokes in common with {PEOPLE}"),
)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Tournament:
    """All that the page of a tournament shows.

    Attributes:
        config: of the run.
        game: hash of the game.
        standings: the ranking.
        results: of every pairing, in the order in which they were played.
        assessment: of the tournament.
        curves: of the entrants that were trained in runs that are still there.
        logs: file of the rallies that begins with the pairing of a number, by that.
        holes: of some of the entrants, by name.
    """

    config: LeagueConfig
    game: str
    standings: Sequence[Standing]
    results: Sequence[PairResult]
    assessment: Assessment
    curves: Sequence[Curve] = ()
    logs: Mapping[int, str] = dataclasses.field(default_factory=lambda: {0: RALLIES})
    holes: "Mapping[str, Holes]" = dataclasses.field(default_factory=dict)


def page(shown: Tournament) -> bytes:
    """The page as a file's content."""
    sections = {
        "Ranking": _ranking(shown),
        "Who beats whom": _payoffs(shown),
        "Learning": [learning(shown.curves)] if shown.curves else [],
        "Holes": _holes(shown.holes),
        "Style": _style(shown),
        "The game between the players": _games(shown.assessment),
        "How firm the ranks are": _firmness(shown.assessment),
        "Pairings and recordings": _pairings(shown),
        "Forfeits": _forfeits(shown.results),
    }
    kept = {heading: content for heading, content in sections.items() if content}
    played = [result for result in shown.results if not result.forfeit]
    total = {what: sum(seat[what] for result in played for seat in result.seats) for what in ("matches", "rallies", "strokes")}
    tiles = [("players", len(shown.standings)), *total.items()]
    facts = [element("div", element("b", f"{count:,}"), element("span", what), class_="tile") for what, count in tiles]
    subtitle = f"seed {shown.config.seed} · game {shown.config.game} ({shown.game[:12]})"
    content = [element("div", *facts, class_="tiles"), *(section(heading, *parts) for heading, parts in kept.items())]
    return document(TITLES[shown.config.format], subtitle, list(kept), content)


def _ranking(shown: Tournament) -> list[Html]:
    likeness = {player: style.likeness for player, style in shown.assessment.styles.items()}
    rows = []
    for s in shown.standings:
        interval = "" if math.isnan(s.rating_low) else f"{s.rating_low:+.0f} to {s.rating_high:+.0f}"
        forfeits = f" (forfeited {s.forfeits})" if s.forfeits else ""
        rows.append(
            (
                Cell(shown=str(s.rank), key=s.rank),
                Cell(shown=s.player + forfeits, key=s.player.casefold()),
                number(s.rating, "+.0f"),
                Cell(shown=interval, key=None if math.isnan(s.rating_low) else s.rating_high - s.rating_low),
                number(s.rating_exact, "+.0f"),
                Cell(shown=f"{s.rank_low} to {s.rank_high}" if s.rank_low else "", key=s.rank_low or None),
                share(s.share),
                share(s.exact_share),
                share(s.away_share),
                share(s.rally_share),
                share(s.serving),
                share(s.receiving),
                number(s.exploitability, ".4f"),
                number(s.normalised_score, ".3f"),
                share(likeness.get(s.player, math.nan)),
            )
        )
    used = [i for i, column in enumerate(_RANKING) if column.left or any(row[i].shown for row in rows)]
    drawn = drawings.forest([(s.player, s.rating, s.rating_low, s.rating_high, s.rating_exact) for s in shown.standings], "Elo")
    return [
        table([_RANKING[i] for i in used], [[row[i] for i in used] for row in rows]),
        element(
            "figure",
            drawn,
            element(
                "figcaption",
                "Ratings in Elo points with 95 % intervals. Diamonds: what they become after infinitely many matches.",
            ),
        ),
    ]


def _payoffs(shown: Tournament) -> list[Html]:
    found = shown.assessment
    order = [found.names.index(s.player) for s in shown.standings]
    names = [found.names[i] for i in order]
    about = "Per cent of the matches that the player of the row wins against that of the column; exact where both have a table."
    drawn = drawings.heat_map(names, found.win[order][:, order])
    return [element("figure", drawn, element("figcaption", about))]


def _style(shown: Tournament) -> list[Html]:
    styles = shown.assessment.styles
    if not styles:
        return []
    strength = {s.player: s.rating_exact for s in shown.standings if not math.isnan(s.rating_exact)}
    points = {player: (style.likeness, strength[player]) for player, style in styles.items() if player in strength}
    parts = []
    if len(points) > 1:
        about = f"Strength against likeness: the share of the strokes in common with {PEOPLE}, in the states that it meets."
        drawn = drawings.scatter(points, f"likeness to {PEOPLE}", "exact rating")
        parts.append(element("figure", drawn, element("figcaption", about)))
    rim = {axis: max(style.shots[axis] for style in styles.values()) or 1.0 for axis in AXES}
    usual = styles[PEOPLE].shots if PEOPLE in styles else dict.fromkeys(AXES, 0.0)
    ordered = [s.player for s in shown.standings if s.player in styles]
    radars = [
        element(
            "figure",
            drawings.radar(
                list(AXES),
                [styles[player].shots[axis] / rim[axis] for axis in AXES],
                [usual[axis] / rim[axis] for axis in AXES],
            ),
            element("figcaption", player),
        )
        for player in ordered[:_MOST_RADARS]
    ]
    dashed = f" Dashed: {PEOPLE}." if PEOPLE in styles else ""
    note = f"Mix of the strokes after the serve, against {PEOPLE}; the rim is the largest share of any player.{dashed}"
    columns = [
        Column(name="player", left=True),
        Column(name="likeness"),
        Column(name="strokes a rally"),
        *(Column(name=a) for a in AXES),
    ]
    rows = [
        [
            name(player),
            share(styles[player].likeness),
            number(styles[player].rally_length, ".2f"),
            *(share(styles[player].shots[axis]) for axis in AXES),
        ]
        for player in ordered
    ]
    return [*parts, paragraph(note), element("div", *radars, class_="figures"), table(columns, rows)]


def _holes(found: "Mapping[str, Holes]") -> list[Html]:
    columns = [
        Column(name="state", left=True, words=True),
        Column(name="in self-play", about="times in a rally against itself"),
        Column(name="against its best", about="times in a rally against its best response"),
        Column(name="loses a rally", about="what it loses there in a rally against its best response, as a value"),
        Column(name="plays most", left=True, words=True),
        Column(name="best stroke", left=True, words=True),
    ]
    parts = []
    for player, each in found.items():
        rows = [
            [
                name(hole.description),
                number(hole.in_self_play, ".2g"),
                number(hole.against_best_response, ".2g"),
                number(hole.loss, ".5f"),
                name(f"{hole.played} ({100 * hole.played_share:.0f} %)"),
                name(f"{hole.best} ({100 * hole.best_share:.0f} %)"),
            ]
            for hole in each.holes
        ]
        if not rows:
            parts.append(paragraph(f"{player} loses nowhere."))
            continue
        parts.append(
            table(columns, rows, f"{player}: exploitability {each.exploitability:.4f}, {100 * each.share:.0f} % of its loss here")
        )
    return parts


def _games(found: Assessment) -> list[Html]:
    parts = [
        paragraph(
            "Each of two chooses a player to play for them. Nash averaging: the equilibrium of most entropy, by matches won. "
            "Maximal lottery: the same if it only counts who wins more often than not. "
            "Alpha-rank: shares of an evolving population. Players that none of them plays are left out."
        )
    ]
    columns = [
        Column(name="player", left=True),
        *(Column(name=rule) for rule in ("Nash averaging", "maximal lottery", "alpha-rank")),
    ]
    tables = []
    for about, game in found.games.items():
        rows = [
            [name(player), *(share(float(p)) for p in figures)]
            for player, *figures in zip(game.names, game.nash_average, game.maximal_lottery, game.alpha_rank, strict=True)
            if max(figures) >= _SHOWN
        ]
        rows.sort(key=lambda row: -max(float(cell.key or 0) for cell in row[1:]))
        tables.append(table(columns, rows, about.capitalize()))
    parts.append(element("div", *tables, class_="columns"))
    parts.append(
        paragraph(
            f"Cycles, which no rating can express, make up {100 * found.cyclic_share:.1f} % of the squared log-odds of all pairs."
        )
    )
    if found.cycles:
        rows = [
            [*(name(player) for player in cycle.names), *map(share, cycle.wins), share(min(cycle.wins))] for cycle in found.cycles
        ]
        heads = ("this", "beats this", "beats this, which beats the first")
        shares = ("first win", "second", "third", "closest")
        parts.append(table([*(Column(name=h, left=True) for h in heads), *(Column(name=h) for h in shares)], rows))
    return parts


def _firmness(found: Assessment) -> list[Html]:
    parts, fit, stable = [], found.misfit, found.stability
    if found.flips:
        rows = [
            [
                name(flip.above),
                name(flip.below),
                Cell(shown="none" if flip.matches is None else f"{flip.matches:,}", key=flip.matches),
                share(math.nan if flip.matches is None else flip.matches / flip.played, 3),
            ]
            for flip in found.flips
        ]
        columns = [Column(name="above", left=True), Column(name="below", left=True), Column(name="matches", falling=False)]
        about = f"The fewest of {found.flips[0].played:,} matches that change the order of neighbours if they are removed"
        parts.append(table([*columns, Column(name="of all", falling=False)], rows, about))
    if stable is not None:
        rows = [
            [
                name(player),
                Cell(shown=str(home), key=float(home)),
                Cell(shown=f"{away.min()} to {away.max()}", key=float(away.max() - away.min())),
                share(float((away == home).mean()), 0),
            ]
            for player, home, away in zip(stable.names, stable.home, stable.away.T, strict=True)
        ]
        columns = [
            Column(name="player", left=True),
            Column(name="rank", falling=False),
            Column(name="in refits"),
            Column(name="the same"),
        ]
        about = f"Exact ranks in {len(stable.away)} refits of the game (mean Kendall's tau {stable.agreement.mean():.2f})"
        parts.append(table(columns, rows, about))
    if fit.degrees:
        pairs = zip(found.pairs, fit.share.tolist(), fit.expected.tolist(), fit.z.tolist(), strict=True)
        rows = [[name(a), name(b), share(won), share(by), number(z, "+.1f")] for (a, b), won, by, z in pairs]
        rows.sort(key=lambda row: -abs(float(row[-1].key or 0)))
        columns = [Column(name="player", left=True), Column(name="opponent", left=True), Column(name="matches won")]
        columns += [Column(name="by the ratings"), Column(name="standard errors")]
        about = f"Misfit of the ratings: chi-squared {fit.statistic:.1f} with {fit.degrees} degrees of freedom, p = {fit.p:.2g}"
        parts.append(table(columns, rows[:_MOST_MISFITS], about))
    return parts


def _pairings(shown: Tournament) -> list[Html]:
    every = Sampling.parse(shown.config.record).every
    log = Html(", ".join(element("a", file, href=file) for file in shown.logs.values()))
    if every:
        kept = "Every rally is" if every == 1 else f"One match in {every:,}, drawn at random, is"
        note = paragraph(
            kept,
            " in ",
            log,
            ". Watch one in 3D from this folder with ",
            code(f"python -m shuttle_marl.watch --replay {RALLIES} --rally N"),
            ".",
        )
    else:
        note = paragraph("Rallies were not recorded.")
    files = paragraph("As numbers: ", *(element("a", file, href=file) + Html(" ") for file in (REPORT, PAIRINGS, "results.csv")))
    columns = [Column(name="player", left=True), Column(name="opponent", left=True), Column(name="matches"), Column(name="won")]
    columns += [Column(name="rallies won"), Column(name="strokes a rally")]
    rows, first, file = [], 0, RALLIES
    for result in shown.results:
        if result.pairing in shown.logs:
            first, file = 0, shown.logs[result.pairing]
        counts = result.seen_by(result.names[0])
        if counts["matches"]:
            row = [*map(name, result.names), Cell(shown=f"{counts['matches']:,}", key=counts["matches"])]
            row += [share(counts["wins"] / counts["matches"]), share(counts["points_won"] / counts["rallies"])]
            row.append(number(counts["strokes"] / counts["rallies"], ".2f"))
            where = Cell(shown=f"{first} in {file}" if len(shown.logs) > 1 else str(first), key=first)
            rows.append([*row, where] if every == 1 else row)
        first += counts["rallies"]
    if every == 1:
        columns.append(Column(name="first rally", about="its number in the log", falling=False))
    return [note, files, table(columns, rows)]


def _forfeits(results: Sequence[PairResult]) -> list[Html]:
    rows = [
        [*map(name, result.names), name(" and ".join(result.forfeit)), Cell(shown=result.reason, key=result.reason)]
        for result in results
        if result.forfeit
    ]
    columns = [Column(name=heading, left=True) for heading in ("player", "opponent", "forfeited")]
    columns.append(Column(name="reason", left=True, words=True))
    note = "Forfeited pairings count for neither side; players that forfeited are ranked behind all others."
    return [paragraph(note), table(columns, rows)] if rows else []
