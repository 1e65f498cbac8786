"""Marks of the strokes of real matches, and the puzzles of thirty days (:mod:`shuttle_marl.reports.rating`).

``python -m experiments.marks --data DIR [--json]``

A player's accuracy in a match is the share of judged strokes without ``?!``, ``?`` and ``??``. The thresholds of the marks were
chosen on the training matches; figures of all others are beside those of all.
"""

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import stats

from experiments.saving import show_figures
from shuttle_marl.commands import cli
from shuttle_marl.commands.options import Json
from shuttle_marl.data import matches_of, read_matches
from shuttle_marl.data.schema import Outcome
from shuttle_marl.game.rally.stepper import waited_at
from shuttle_marl.game.recovery import POSITIONS
from shuttle_marl.game.shipped import RELIABLE, load_game
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.game.tables import Game
from shuttle_marl.reports.rating import GOOD, MARKS, places_of, rated_strokes, rater_of, theme_of, usual_of
from shuttle_marl.watch.match import CourtRally, Match
from shuttle_marl.watch.plan import Plan, Side
from shuttle_marl.watch.policies import PolicyTables

LEAST_JUDGED: Final = 30
"""Judged strokes from which the accuracy of a player in a match counts."""
DAYS, PUZZLES, STRICT = 30, 5, 8
_RALLIES: Final = 40


def marks_of(data: Path, game: Game) -> dict[str, Any]:
    """Accuracy, marks and who was marked better, over the matches of a data set."""
    strokes = read_matches(data)
    found = rated_strokes(strokes, rater_of(game))
    match, player, won = (strokes[name].to_numpy(zero_copy_only=False) for name in ("match", "player", "outcome"))
    known, marks = found.rated.known[found.position], np.array(found.rated.marks)[found.position]
    marked, bad = marks != "", np.isin(marks, ("?!", "?", "??"))
    games = _winners(match, player, strokes, won)
    accuracy = {
        (name, who): float(1 - bad[mine].mean())
        for name, (winner, loser) in games.items()
        for who in (winner, loser)
        if (mine := known & (match[found.row] == name) & (player[found.row] == who)).sum() >= LEAST_JUDGED
    }
    both = [[accuracy[name, who] for who in pair] for name, pair in games.items() if all((name, who) in accuracy for who in pair)]
    better, decided = sum(a > b for a, b in both), sum(a != b for a, b in both)
    test = stats.binomtest(better, decided)
    interval = test.proportion_ci()
    unseen = ~np.isin([name for name, _ in accuracy], list(matches_of("train")))
    values = np.array(list(accuracy.values()))

    def spread(some: Any) -> dict[str, float]:
        p10, median, p90 = np.quantile(some, (0.1, 0.5, 0.9))
        return {"median": float(median), "p10": float(p10), "p90": float(p90), "n": len(some)}

    behind = found.rated.behind[found.position[marked]]
    return {
        "matches": len(games),
        "strokes": strokes.num_rows,
        "judged": int(known.sum()),
        "accuracy": spread(values),
        "accuracy_not_in_training": spread(values[unseen]) if unseen.any() else None,
        "per_100_strokes": {mark: 100 * float((marks == mark).sum()) / strokes.num_rows for mark in MARKS},
        "few": float((behind < RELIABLE).mean()) if len(behind) else 0.0,
        "winner_marked_better": {
            "matches": decided,
            "better": better,
            "share": better / decided,
            "low": interval.low,
            "high": interval.high,
            "p": float(test.pvalue),
        },
    }


def _winners(match: Any, player: Any, strokes: Any, outcome: Any) -> dict[str, tuple[str, str]]:
    """Winner and loser of each match: of the last rally in the data."""
    opponent, out = strokes["opponent"].to_numpy(zero_copy_only=False), {}
    last = np.flatnonzero(np.r_[match[1:] != match[:-1], True])
    for row in last.tolist():
        names = (str(player[row]), str(opponent[row]))
        out[str(match[row])] = names if outcome[row] == Outcome.WINNER else names[::-1]
    return out


class _Puzzle(NamedTuple):
    """A question; the first one in order is asked."""

    again: bool
    usual: int
    share: float
    stroke: int
    right: str
    theme: str
    rule: bool


def puzzles_of(game: Game) -> dict[str, Any]:
    """Right answers of the puzzles of thirty days, chosen as the page does, and how many a rule of thumb solves.

    The rule: smash above the net, play a net shot below it, and wait in the middle.

    Args:
        game: with recovery.
    """
    tables, elite = PolicyTables(game), Side(policy="bc")
    asked: list[_Puzzle] = []
    for day in range(DAYS):
        match = Match(Plan(seed=20260501 + day, sides=(elite, elite)), tables)
        today: list[_Puzzle] = []
        for number in range(_RALLIES):
            if len(today) == PUZZLES:
                break
            known, themes = {one.right for one in today}, {one.theme for one in today}
            found = [
                one._replace(again=one.theme in themes)
                for one in _questions(match.rally(number), tables)
                if one.right not in known and (number >= STRICT or one.theme not in themes)
            ]
            today += sorted(found)[:1]
        asked += today
    rights, of_theme = (Counter(values) for values in ([one.right for one in asked], [one.theme for one in asked]))
    total = len(asked)
    right, of_themes = ({name: n / total for name, n in counted.most_common()} for counted in (rights, of_theme))
    solved = {theme: sum(one.rule for one in asked if one.theme == theme) / n for theme, n in of_theme.items()}
    rule = sum(one.rule for one in asked) / total
    return {"puzzles": total, "right": right, "themes": of_themes, "rule_of_thumb": rule, "rule_of_thumb_by_theme": solved}


def _questions(rally: CourtRally, tables: PolicyTables) -> Iterator[_Puzzle]:
    """The questions of a rally, in the order of the page."""
    game = tables.game
    for i, (state, stroke) in enumerate(zip(rally.states(game).tolist(), rally.stroke.tolist(), strict=True)):
        judged, above = rater_of(game).rated(np.array([state])), bool(game.contact(state))
        question = judged.question(int(game.rank(np.array([state]), np.array([stroke]))[0]))
        theme = theme_of(rally, i, above=above)
        if question is not None and theme != "serve":
            right = SHOTS[judged.shot[question[0]]]
            rule = right == ("smash" if above else "net-shot")
            yield _Puzzle(False, usual_of(right), float(judged.share[question[0]]), i, right, theme, rule)
        places = places_of(game, state, int(rally.striker[i]), tables.solution)
        waited = waited_at(rally, game, i, state)
        if places is not None and waited is not None and (usual := places.question(waited)) is not None:
            good = places.loss <= GOOD
            right = f"wait:{POSITIONS[places.position[places.perfect.argmax()]]}"
            yield _Puzzle(False, usual, float(places.people[good].sum()), i, right, "wait", usual > 0)


def marks(*, data: Path, model: str = "default", out: Path | None = None, json_output: Json = False) -> None:
    """Mark the strokes of real matches as the page does.

    Args:
        data: folder of the download, or a Parquet file of `data convert`.
        model: a model by name or folder.
        out: JSON file for the result, with its provenance.
        json_output: print JSON.
    """
    game = load_game(model)
    hidden = load_game(f"{model}:recovery")
    result = {**marks_of(data, game), "puzzles": puzzles_of(hidden)}
    show_figures(result, out, as_json=json_output)


main = cli.entry_point(marks, "python -m experiments.marks", __doc__ or "")

if __name__ == "__main__":
    sys.exit(main())
