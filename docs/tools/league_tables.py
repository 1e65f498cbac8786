"""Tables of the default tournament and of the layers of the package."""

import ast
import functools
import tomllib
from typing import Final

from docs.tools.markdown import ROOT, markdown
from shuttle_marl.exact import evaluate
from shuttle_marl.exact.odds import of_pair, over
from shuttle_marl.game.policy import tabulate
from shuttle_marl.game.shipped import load_game, refits_of
from shuttle_marl.league import LeagueConfig, page
from shuttle_marl.league.ranking import Standing
from shuttle_marl.policy.registry import resolve

SHORT: Final = ("minimax", "ppo:self-play", "ppo", "bc", "random")  # players of the short ranking
REFERENCE: Final = "bc"
_PACKAGE: Final = "shuttle_marl"
_CONTRACTS: Final = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
_LAYERS: Final = [layer.split(" : ") for contract in _CONTRACTS if contract["type"] == "layers" for layer in contract["layers"]]
"""Modules of each layer, highest layer first."""
_NO_TORCH: Final = {name for contract in _CONTRACTS if contract["type"] == "forbidden" for name in contract["source_modules"]}


def ranking(standings: list[Standing]) -> str:
    """The ranked table of the default tournament in brief, as the console shows it, and what was played."""
    config, players = LeagueConfig(), len(standings)
    game = load_game(config.game).hash[:12]
    played = f"{players} players, {config.matches:,} matches a pair, seed {config.seed}, game `{game}`."
    shown = page.ranking(standings)
    brief = [i for i, column in enumerate(shown.columns) if column.brief]
    headings = tuple(shown.columns[i].heading for i in brief)
    rows = [tuple(row[i].text for i in brief) for row in shown.rows]
    return f"{markdown(headings, rows, left=('player',))}\n\n{played}"


def ranking_short(standings: list[Standing]) -> str:
    """A few players with the figures that matter most."""
    shown = [standing for standing in standings if standing.player in SHORT]
    against = _rallies_won(tuple(s.player for s in shown))
    rows = [
        (
            f"`{s.player}`",
            f"{s.rating:+.0f} ({s.rating_low:+.0f} to {s.rating_high:+.0f})",
            f"{100 * s.share:.1f} %",
            *against[s.player],
            f"{s.exploitability:z.3f}",
            f"{s.normalised_score:.3f}",
        )
        for s in shown
    ]
    won = ("matches won", "rallies won against `bc`", "in refits (95 %)")
    return markdown(("player", "rating (95 %)", *won, "exploitability", "normalised score"), rows, left=("player",))


@functools.cache
def _rallies_won(players: tuple[str, ...]) -> dict[str, tuple[str, str]]:
    """Exact share of the rallies that each player wins against the average player, both serving equally often: in the game
    itself, and in its refits with the 95 % interval for one more refit."""
    game = load_game("default")
    refits = refits_of(game)
    opponent = tabulate(resolve(REFERENCE, game), game)
    shown = {}
    for name in players:
        table = tabulate(resolve(name, game), game)
        there = over(refits, functools.partial(of_pair, table, opponent))["rally_win"]
        mean, low, high = (f"{100 * min(1.0, max(0.0, part)):.1f}" for part in there)
        home = evaluate(table, opponent).odds().rally
        shown[name] = (f"{100 * home:.1f} %", f"{mean} % ({low} to {high})")
    return shown


def _summary(module: str) -> str:
    """First sentence of the docstring of a module or package."""
    folder = ROOT / _PACKAGE / module
    path = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(docstring.split("\n\n")[0].split()).split(". ")[0].removesuffix(".").replace("``", "`").replace(":mod:", "")


def layers() -> str:
    """Table of the layers with the first sentence of each docstring."""
    rows = []
    for name in (name for layer in _LAYERS for name in layer):
        kind = "/" if (ROOT / _PACKAGE / name).is_dir() else ".py"
        rows.append((f"`{name}{kind}`", _summary(name), "never" if f"{_PACKAGE}.{name}" in _NO_TORCH else ""))
    return markdown(("layer", "contents", "imports PyTorch"), rows, left=("layer", "contents", "imports PyTorch"))
