"""Tables of training: win rates, the matrix over opponents, styles, and time to win, from ``benchmarks/results/``."""

from pathlib import Path
from typing import Any

from benchmarks.markdown import machine, markdown, saved
from experiments import styles, win_rates


def _made_by(result: dict[str, Any]) -> str:
    commit = result["git"]["commit"][:7] if result["git"] else "no checkout"
    return f"`{' '.join(result['command'])}`, commit {commit}"


def agents(_: Path) -> str:
    """How many matches the trained agents win, with exact figures."""
    result = saved("win_rates")
    table = markdown(win_rates.HEADINGS, list(win_rates.table_rows(result)), left=("agent",))
    played = f"{result['seeds']} seeds, {result['matches']:,} matches each, game `{result['game'][:12]}`"
    return f"{table}\n\n{played}: {_made_by(result)}."


def main_result(_: Path) -> str:
    """The same in short."""
    result = saved("win_rates")
    kept = ("agent", "matches won, %", "paper, %", "exact rally, %", "normalised score", "exploitability")
    columns = [win_rates.HEADINGS.index(heading) for heading in kept]
    rows = [[cells[column] for column in columns] for cells in win_rates.table_rows(result)]
    return markdown(kept, rows, left=("agent",))


def matrix(_: Path) -> str:
    """Exact chances of a match against opponents that nobody was trained against."""
    against = saved("win_rates")["exact_match_win_against"]
    opponents = next(iter(against.values()))
    rows = [(agent, *(f"{100 * chance:.1f}" for chance in odds.values())) for agent, odds in against.items()]
    return markdown(("agent", *opponents), rows, left=("agent",))


def style_figures(_: Path) -> str:
    """What agents with a style play, and what does not differ."""
    result = saved("styles")
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


def time_to_win(_: Path) -> str:
    """Seconds until 98 % of matches are won."""
    result = saved("time_to_win")
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
