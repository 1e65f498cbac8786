"""Tables of experiments: the next stroke, win rates, the matrix over opponents, styles, time to win, and the value of strokes."""

from typing import Any

from benchmarks.machine import machine
from docs.tools.markdown import markdown, saved
from experiments import human as human_play
from experiments import next_stroke, styles, win_rates


def _made_by(result: dict[str, Any]) -> str:
    commit = result["git"]["commit"][:7] if result["git"] else "no checkout"
    return f"`{' '.join(result['command'])}`, commit {commit}"


def agents() -> str:
    """Matches that the trained agents win, with exact figures."""
    result = saved("experiments", "win_rates")
    table = markdown(win_rates.HEADINGS, list(win_rates.table_rows(result)), left=("agent",))
    played = f"{result['seeds']} seeds, {result['matches']:,} matches each, game `{result['game'][:12]}`"
    return f"{table}\n\n{played}: {_made_by(result)}."


def matrix() -> str:
    """Exact probabilities to win a match against opponents that no agent was trained against."""
    against = saved("experiments", "win_rates")["exact_match_win_against"]
    opponents = next(iter(against.values()))
    rows = [(agent, *(f"{100 * probability:.1f}" for probability in odds.values())) for agent, odds in against.items()]
    return markdown(("agent", *opponents), rows, left=("agent",))


def style_figures() -> str:
    """Strokes that agents with a style play, and differences that are not significant."""
    result = saved("experiments", "styles")
    table = markdown(styles.HEADINGS, list(styles.table_rows(result)), left=("style",))
    same = styles.alike(result)
    count = len(result["different"])
    told = (
        f"All {count} differences between two rows"
        if not same
        else f"{count - len(same)} of {count} differences between two rows"
    )
    but = f" Not: {'; '.join(same)}." if same else ""
    return f"{table}\n\n{told} in one of the first five columns are significant (adjusted p < 0.05).{but} {_made_by(result)}."


def next_strokes() -> str:
    """Next strokes predicted right, by the imitator and by the game's clones, beside the paper's figures."""
    result = saved("experiments", "next_stroke")
    table = markdown(
        next_stroke.HEADINGS, next_stroke.table_rows(result, next_stroke.LEAST_PLAYERS), left=next_stroke.HEADINGS[:2]
    )
    fit = result["fit"]
    fitted = f"fitted on {fit['strokes']:,} strokes of {fit['matches']} train matches in {fit['seconds']} s"
    return f"{table}\n\nThe {result['split']} matches; the imitator {fitted}. {_made_by(result)}."


def time_to_win() -> str:
    """Seconds until 98 % of matches are won."""
    result = saved("benchmarks", "time_to_win")
    rows = []
    for row in result["learners"]:
        sign = "" if row["reached"] else "> "
        rows.append(
            (
                row["learner"],
                f"{sign}{row['seconds']:.0f}",
                f"{row['slowest']:.0f}",
                f"{row['strokes']:,}",
                f"{100 * row['match_win']:.1f}",
                f"{sign}{row['times']:.1f}",
            )
        )
    headings = ("learner", "seconds (median)", "slowest", "strokes", "exact match, %", "times as long")
    seeds = len(result["runs"]) // len(result["learners"])
    return f"{markdown(headings, rows, left=('learner',))}\n\n{seeds} seeds. {machine(result)}"


def human() -> str:
    """Strength against likeness along TAU."""
    result = saved("experiments", "human")
    played = f"{result['known']:,} strokes of {result['matches']} matches, split {result['split']}, game `{result['game'][:12]}`."
    return f"{markdown(human_play.HEADINGS, human_play.curve_rows(result), left=())}\n\n{played}"


def human_players() -> str:
    """TAU of single players."""
    result = saved("experiments", "human")
    return markdown(human_play.PLAYER_HEADINGS, human_play.player_rows(result), left=("player",))


def stroke_value() -> str:
    """Players ranked by value added, from ``experiments/results/stroke_value.json``."""
    result = saved("experiments", "stroke_value")
    groups = []
    for kind, title in (("MS", "men"), ("WS", "women")):
        rows = [
            (
                p["player"],
                str(p["matches"]),
                f"{p['strokes']:,}",
                *(
                    f"{100 * p[name]:+.2f} ({100 * p[low]:+.2f} to {100 * p[high]:+.2f})"
                    for name, low, high in (("value", "low", "high"), ("decision", "decision_low", "decision_high"))
                ),
            )
            for p in result["players"]
            if p["discipline"] == kind
        ]
        groups.append(markdown((title, "matches", "strokes", "points by 100 strokes", "by decisions"), rows, left=(title,)))
    played = f"{result['valued']:,} of {result['strokes']:,} strokes have a value; in brackets 95 % intervals."
    return "\n\n".join([*groups, played])
