"""Pictures of the documentation and the data they are drawn from: ``python -m docs.tools.pictures [--only NAME ...] [--check]``.

``docs/images/sources.json`` holds the digest of the data of each picture. ``--check`` fails for a picture whose data have changed
since it was drawn. Pictures of the court need the extra ``browser`` and Chromium.
"""

import hashlib
import io
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from docs.tools.markdown import IMAGES, ROOT, saved
from shuttle_marl.base.errors import ShuttleError
from shuttle_marl.base.files import replace_file
from shuttle_marl.commands import cli
from shuttle_marl.court.server import browser_page
from shuttle_marl.game import model_folder
from shuttle_marl.game.policy import States
from shuttle_marl.game.shipped import read_model_card
from shuttle_marl.game.stroke import SHOTS
from shuttle_marl.policy.registry import resolve

if TYPE_CHECKING:
    from playwright.sync_api import Page

SOURCES: Final = IMAGES / "sources.json"
_RANKING: Final = "ranking of docs/league.md"
_GAME: Final = "game"
_COLOURS: Final = ("#4477aa", "#ee6677", "#228833", "#aa3377")
"""Of Paul Tol's palette for colour-blind readers."""
_REPORT: Final = (1240, 2300)  # width of the page and height of the picture of a report [px]
_COACH: Final = (900, 2400)  # the same of a report for coaches
_SIZES: Final = {"wide": (1680, 980), "narrow": (390, 844)}
_MODES: Final = (("watch", "wide"), ("analyse", "wide"), ("learn", "wide"), ("play", "wide"), ("play", "narrow"))
"""Modes of the live court, and the sizes in which the documentation shows them."""
_PLAYERS: Final = ("viktor-axelsen", "kento-momota")
_PLAYED: Final = "#seed=0&a=bc:viktor-axelsen&b=bc:kento-momota&rally=1&stroke=9"
_LIMIT: Final = 240_000
_FPS: Final = 12


def _module(*command: str) -> Callable[[], None]:
    def run() -> None:
        subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=True)

    return run


def _truth() -> None:
    """Realised fraction of predicted advantages by horizon, before and after calibration."""
    from matplotlib.figure import Figure  # noqa: PLC0415  slow to import

    result = saved("experiments", "truth_cross")
    figure = Figure(figsize=(7, 3.4), layout="constrained")
    axes = figure.subplots()
    names = ["after 1 stroke", "after 4", "after 8", "end of the rally"]
    slopes, calibrated = (list(result[name].values()) for name in ("decision_slope", "calibration"))
    series = (
        ("predicted advantages", slopes, "value", -0.08, "#0b6e4f"),
        ("calibrated advantages", calibrated, "slope", 0.08, "#b8520a"),
    )
    for label, found, key, shift, colour in series:
        x, y = [i + shift for i in range(len(found))], [each[key] for each in found]
        error = [[each[key] - each["low"] for each in found], [each["high"] - each[key] for each in found]]
        axes.errorbar(x, y, yerr=error, fmt="o", color=colour, capsize=3, label=label)
    axes.axhline(1, color="0.6", linewidth=1)
    axes.set(xticks=range(len(names)), xticklabels=names, ylabel="realised / predicted", ylim=(0, 1.6))
    axes.legend(frameon=False, loc="lower left")
    figure.savefig(IMAGES / "truth.png", dpi=120)


def _learning_curves() -> None:
    """A panel per figure, a line per agent, and a band over the seeds."""
    import matplotlib as mpl  # noqa: PLC0415  slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    result = saved("experiments", "win_rates")
    panels = {
        "match_win": ("probability of winning a match against bc", 0.5),
        "normalised_score": ("normalised score", 0.0),
        "exploitability": ("exploitability", result["exploitability_of_bc"]),
    }
    with mpl.rc_context({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(10, 3.2), layout="constrained")
        for axes, (name, (title, level)) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
            for (agent, seeds), colour in zip(result["curves"].items(), _COLOURS, strict=False):
                strokes = np.array([point["strokes"] for point in seeds[0]]) / 1e6
                values = np.array([[point[name] for point in seed] for seed in seeds])
                axes.plot(strokes, values.mean(axis=0), color=colour, label=agent)
                axes.fill_between(strokes, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.2, lw=0)
            axes.axhline(level, color="0.4", lw=1, ls="--")
            axes.annotate("bc", (1, level), xycoords=("axes fraction", "data"), ha="right", va="bottom", color="0.4")
            axes.set(title=title, xlabel="million strokes of the learner", xlim=(0, None), ylim=(min(0, level), None))
        figure.axes[1].legend(frameon=False, loc="lower right")
        figure.savefig(IMAGES / "learning_curves.png", dpi=150)


def _rally() -> None:
    """The first smash that ends a long rally of a match between two scripted players."""
    from PIL import Image  # noqa: PLC0415  an extra

    from shuttle_marl import match_v0  # noqa: PLC0415

    env = match_v0.env(render_mode="rgb_array")
    game = env.unwrapped.game
    policies = dict(zip(env.possible_agents, (resolve(name, game) for name in ("defensive", "attacking")), strict=True))
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    for agent in env.agent_iter():
        states = States(game=game, state=np.array([env.unwrapped.state_number], dtype=np.int32))
        chance = policies[agent].probabilities(states)[0]
        stroke = rng.choice(len(chance), p=chance)
        env.step(stroke)
        moment = env.unwrapped.snapshot()
        if len(moment.strokes) >= 9 and SHOTS[game.catalogue.shot[stroke]] == "smash" and moment.reason is None:
            Image.fromarray(env.render()).save(IMAGES / "rally.png")
            return


def _league_report() -> None:
    """The first screens of the report of the default tournament."""
    with tempfile.TemporaryDirectory() as folder:
        _module("shuttle_marl.league", "--record", "none", "--out", f"{folder}/run")()
        _shown(Path(folder) / "run" / "report.html", _REPORT, "league_report")


def _shown(file: Path, size: tuple[int, int], name: str) -> None:
    with browser_page(size) as page:
        page.goto(file.as_uri())
        replace_file(IMAGES / f"{name}.png", page.screenshot())


def _reports() -> None:
    """The first parts of both reports for coaches."""
    sample = str(ROOT / "datasets" / "sample" / "strokes.parquet")
    commands = {
        "scouting_report": ("scout", "viktor-axelsen", "kento-momota"),
        "match_report": ("report", sample, "--match", "simulated-1"),
    }
    with tempfile.TemporaryDirectory() as folder:
        for name, (command, *arguments) in commands.items():
            file = Path(folder) / f"{name}.html"
            _module("shuttle_marl", command, *arguments, "--out", str(file))()
            _shown(file, _COACH, name)


def _film() -> None:
    """A whole rally of two players of their own skill as an animated picture."""
    from PIL import Image  # noqa: PLC0415  extras

    from benchmarks.viewer import serving  # noqa: PLC0415

    with serving("--players", *_PLAYERS) as (address, _), browser_page((800, 540), reduced_motion="reduce") as page:
        page.set_default_timeout(_LIMIT)
        page.goto(f"{address}{_PLAYED.partition('&stroke')[0]}")
        page.locator("body[data-ready]").wait_for()
        page.keyboard.press(" ")
        pictures, court = [], page.locator(".court")
        for frame in range(int(page.evaluate("window.viewer.state().duration") * _FPS) + 1):
            page.evaluate("(time) => window.viewer.seek(time)", frame / _FPS)
            pictures.append(Image.open(io.BytesIO(court.screenshot())).convert("RGB"))
        first, *others = pictures
        duration = 1000 // _FPS
        first.save(IMAGES / "film.webp", save_all=True, append_images=others, duration=duration, loop=0, quality=55, method=4)


def _court() -> None:
    """Modes of the page, and two players of their own skill, drawn on this machine in full quality."""
    from benchmarks.viewer import serving  # noqa: PLC0415  extras

    with serving() as (address, _):
        for mode, size in _MODES:
            _take(address, mode, size, IMAGES / f"watch_{mode}_{size}.jpg")
    with serving("--players", *_PLAYERS) as (address, _):
        _take(address, "watch", "wide", IMAGES / "watch_players.jpg", place=_PLAYED)


def _take(address: str, mode: str, size: str, picture: Path, *, place: str = "#seed=11&a=ppo&b=bc&rally=4&stroke=5") -> None:
    with browser_page(_SIZES[size], reduced_motion="reduce") as page:
        page.set_default_timeout(_LIMIT)
        page.goto(f"{address}?quality=full{place}")
        _show(page, mode)
        replace_file(picture, page.screenshot(type="jpeg", quality=88))


def _until(page: "Page", script: str) -> None:
    from benchmarks.viewer import until  # noqa: PLC0415  extras

    until(page, f"(() => {{ const s = window.viewer?.state(); return s && ({script}); }})()", _LIMIT / 1000)


def _show(page: "Page", mode: str) -> None:
    _until(page, "s.analysis")
    page.locator(".bars .bar").nth(10).wait_for(state="attached")
    if mode == "play":
        page.keyboard.press("t")
        _until(page, "s.turn")
        page.keyboard.press("i")
        page.locator(".shots small", has_text="wins").first.wait_for()
    elif mode == "learn":
        page.get_by_role("tab", name="Learn").click()
        page.locator(".quiz button:not(:disabled)").first.wait_for()
        page.locator(".quiz button:not(:disabled)").first.click()
        page.wait_for_timeout(1500)
    elif mode == "analyse":
        page.get_by_role("tab", name="Analyse").click()
        _until(page, "s.mode === 'analyse' && s.analysis")
        page.keyboard.press("3")
        page.evaluate("scrollTo(0, 0)")
    page.wait_for_timeout(1000)


PICTURES: Final[dict[tuple[str, ...], tuple[Callable[[], None], str]]] = {
    ("league_report.png",): (_league_report, _RANKING),
    ("match_report.png", "scouting_report.png"): (_reports, _GAME),
    ("learning_curves.png",): (_learning_curves, "experiments/results/win_rates.json"),
    ("rally.png",): (_rally, _GAME),
    ("suite_exploit.svg",): (
        _module("shuttle_marl.suite", "figure", "exploit-v1", "--out", str(IMAGES / "suite_exploit.svg")),
        "experiments/results/suite.json",
    ),
    ("truth.png",): (_truth, "experiments/results/truth_cross.json"),
    ("film.webp",): (_film, _GAME),
    ("watch_players.jpg", *(f"watch_{mode}_{size}.jpg" for mode, size in _MODES)): (_court, _GAME),
}
"""Pictures, what draws them, and the data they show."""


def digest(source: str) -> str:
    """SHA-256 of the data of pictures: the game, the published ranking, or a file of the repository."""
    if source == _GAME:
        return str(read_model_card(model_folder())["game_hash"])
    if source == _RANKING:
        page = (ROOT / "docs" / "league.md").read_text(encoding="utf-8")
        content = page.partition("<!-- begin: ranking -->")[2].partition("<!-- end: ranking -->")[0].encode()
    else:
        content = (ROOT / source).read_bytes()
    return hashlib.sha256(content).hexdigest()


KEPT: Final = frozenset({"strokes.png"})
"""Pictures whose program ended; docs/truth_record.md names it."""


def outdated() -> list[str]:
    """Pictures whose data are not those that they were drawn from, unless they are known to be, and pictures without data."""
    recorded: dict[str, Any] = json.loads(SOURCES.read_text(encoding="utf-8"))
    current = {name: digest(source) for names, (_, source) in PICTURES.items() for name in names}
    shown = {path.name for path in IMAGES.iterdir() if path != SOURCES}
    return sorted(name for name in (shown | set(current)) - KEPT if name not in shown or current.get(name) != recorded.get(name))


def main(*, only: tuple[str, ...] = (), check: bool = False) -> None:
    """Draw the pictures again, or check that they are up to date.

    Args:
        only: file names of pictures; default: those whose data have changed.
        check: draw nothing; fail if a picture is out of date.
    """
    old = outdated()
    if check:
        if old:
            raise ShuttleError(f"out of date: {', '.join(old)}; draw them with `python -m docs.tools.pictures`")
        return
    recorded: dict[str, str] = json.loads(SOURCES.read_text(encoding="utf-8"))
    for names, (draw, source) in PICTURES.items():
        if set(names) & set(only or old):
            draw()
            recorded |= dict.fromkeys(names, digest(source))
            replace_file(SOURCES, (json.dumps(recorded, indent=1, sort_keys=True) + "\n").encode())


if __name__ == "__main__":
    sys.exit(cli.run(main, prog="python -m docs.tools.pictures", description="Draw the pictures of the documentation."))
