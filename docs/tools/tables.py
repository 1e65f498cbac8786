"""Writes the tables of the documentation from results, so that no number is typed by hand.

    python -m docs.tools.tables [--run FOLDER] [--check]

A table stands between ``<!-- begin: NAME -->`` and ``<!-- end: NAME -->`` on any page; :data:`BLOCKS` lists the names. The
rankings come from a run folder of the league; without ``--run`` the default tournament is played, which is the same on every
machine. The other tables come from ``benchmarks/results/`` and ``experiments/results/``. The model card is a page of its own.
Figures in sentences are those of :mod:`docs.tools.figures`, each with a tolerance. ``--check`` changes nothing and fails if a
page does not show what the results say.
"""

import difflib
import functools
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final

from rich.console import Console

from docs.tools import benchmark_tables, experiment_tables, figures, league_tables, structure, suite_tables
from docs.tools.league_tables import TableError
from docs.tools.markdown import ROOT
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.dynamics.card import as_markdown
from shuttle_marl.game.shipped import model_folder, read_model_card
from shuttle_marl.league.entrants import LeagueConfig
from shuttle_marl.league.run import run_league

LEAGUE_BLOCKS: Final[dict[str, Callable[[Path], str]]] = {
    "ranking": league_tables.ranking,
    "ranking_short": league_tables.ranking_short,
}
"""Tables of a tournament by name, and what makes them from its run folder."""
BLOCKS: Final[dict[str, Callable[[], str]]] = {
    "advice_results": experiment_tables.advice_results,
    "aec": benchmark_tables.aec,
    "cluster": benchmark_tables.cluster,
    "exact_values": benchmark_tables.exact_values,
    "human": experiment_tables.human,
    "human_players": experiment_tables.human_players,
    "layer_diagram": structure.diagram,
    "layers": structure.layers,
    "league": benchmark_tables.league,
    "league_training": experiment_tables.league_training,
    "next_stroke": experiment_tables.next_strokes,
    "pair_results": experiment_tables.pair_results,
    "pair_strokes": experiment_tables.pair_strokes,
    "paths": structure.paths,
    "recipes": experiment_tables.recipes,
    "recording": benchmark_tables.recording,
    "recovery_depth": experiment_tables.recovery_depth,
    "recovery_truth": experiment_tables.recovery_truth,
    "self_play": experiment_tables.self_play,
    "self_play_recovery": functools.partial(experiment_tables.self_play, "self_play_recovery"),
    "speed": benchmark_tables.speed,
    "staging": benchmark_tables.staging,
    **suite_tables.BLOCKS,
    "startup": benchmark_tables.startup,
    "stroke_value": experiment_tables.stroke_value,
    "styles": experiment_tables.style_figures,
    "tagging": benchmark_tables.tagging,
    "throughput": benchmark_tables.throughput,
    "throughput_bound": benchmark_tables.throughput_bound,
    "throughput_sizes": benchmark_tables.throughput_sizes,
    "time_to_win": benchmark_tables.time_to_win,
    "training_speed": benchmark_tables.training_speed,
    "truth_calibration": experiment_tables.truth_calibration,
    "truth_figures": experiment_tables.truth_figures,
    "truth_legality": experiment_tables.truth_legality,
    "truth_shares": experiment_tables.truth_shares,
    "depth_play": experiment_tables.depth_play,
    "depth_lists": experiment_tables.depth_lists,
    "truth_limits": experiment_tables.truth_limits,
    "truth_forecasts": experiment_tables.truth_forecasts,
    "truth_memory": experiment_tables.truth_memory,
    "truth_shots": experiment_tables.truth_shots,
    "truth_slopes": experiment_tables.truth_slopes,
    "truth_told_apart": experiment_tables.truth_told_apart,
    "viewer": benchmark_tables.viewer,
    "win_rates": experiment_tables.agents,
    "win_rates_matrix": experiment_tables.matrix,
}
"""Tables of saved results by name, and what makes them."""
EARLIER: Final[dict[str, str]] = {
    **dict.fromkeys(
        (
            *("advice_results", "human", "human_players", "next_stroke", "pair_results", "pair_strokes", "recipes", "self_play"),
            *("aec", "cluster", "exact_values", "recording", "speed", "startup", "throughput", "throughput_bound"),
            *("throughput_sizes", "time_to_win", "training_speed", "viewer"),
            *("stroke_value", "styles", "win_rates", "win_rates_matrix"),
            *(f"truth_{name}" for name in ("legality", "limits", "shares")),
        ),
        "d19cf2be",
    ),
    **dict.fromkeys(("league", "league_training", "staging"), "be089928"),
}
"""Tables with results of another game than the shipped one, and its hash. A result that is made again leaves this list."""
MODEL_CARD: Final = "docs/model_card.md"
"""The page that is made as a whole."""
_PAGES: Final = ("README.md", "benchmarks/README.md", "docs/*.md", "docs/suite/*.md")
_MARK: Final = re.compile(r"<!-- begin: (\w+) -->")


def replaced(text: str, name: str, table: str) -> str:
    """A page with one of its tables replaced.

    Raises:
        TableError: the page has no such place, or more than one.
    """
    begin, end = f"<!-- begin: {name} -->", f"<!-- end: {name} -->"
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise TableError(f"expected one {begin} with {end} behind it")
    return f"{text[: text.index(begin)]}{begin}\n{table}\n{text[text.index(end) :]}"


def marked(name: str, table: str) -> str:
    """A table, with the game of its results below if that is not the shipped one."""
    return f"{table}\n\n*Results of an earlier game, `{EARLIER[name]}…`.*" if name in EARLIER else table


def rendered(root: Path, run: Path) -> dict[str, str]:
    """Every page with tables as it should be, by its path from ``root``.

    Args:
        root: of the repository.
        run: folder of the tournament that the rankings show.

    Raises:
        TableError: a mark names no table, a place has no end, or a table stands on no page.
    """
    pages = {MODEL_CARD: as_markdown(read_model_card(model_folder()))}
    missing = {*LEAGUE_BLOCKS, *BLOCKS}
    made: dict[str, str] = {}
    for path in sorted(path for pattern in _PAGES for path in root.glob(pattern)):
        text = path.read_text(encoding="utf-8")
        for name in _MARK.findall(text):
            if name not in LEAGUE_BLOCKS and name not in BLOCKS:
                raise TableError(f"{path}: no table is called {name!r}; there are {', '.join(sorted({*LEAGUE_BLOCKS, *BLOCKS}))}")
            if name not in made:
                made[name] = marked(name, LEAGUE_BLOCKS[name](run) if name in LEAGUE_BLOCKS else BLOCKS[name]())
            pages[path.relative_to(root).as_posix()] = text = replaced(text, name, made[name])
            missing.discard(name)
    if missing:
        raise TableError(f"no page shows {', '.join(sorted(missing))}")
    return pages


def main(*, run: Path | None = None, check: bool = False) -> None:
    """Write all tables, or check them.

    Args:
        run: Folder of the finished run whose ranking is shown; by default the default tournament is played now.
        check: Change nothing; fail if a table differs.
    """
    with tempfile.TemporaryDirectory() as temporary:
        folder = run or run_league(LeagueConfig(out=Path(temporary) / "run", record="none"), Console(stderr=True)).folder
        pages = rendered(ROOT, folder)
    for name in {figure.page for figure in figures.FIGURES} - set(pages):
        pages[name] = (ROOT / name).read_text(encoding="utf-8")
    if not check:
        pages = figures.written(pages)
    elif lines := figures.drifted({name: (ROOT / name).read_text(encoding="utf-8") for name in pages}):
        raise TableError("figures have drifted; run this without --check\n" + "\n".join(lines))
    for name, after in pages.items():
        before = (ROOT / name).read_text(encoding="utf-8")
        if check and after != before:
            changes = "\n".join(difflib.unified_diff(before.splitlines(), after.splitlines(), name, "results", lineterm=""))
            raise TableError(f"{name} does not show what the results say; run this without --check\n{changes}")
        if not check:
            replace_file(ROOT / name, after.encode())
    Console().print(f"{len(pages)} pages {'checked' if check else 'written'}")


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.tables", description="Write or check the tables of the documentation."))
